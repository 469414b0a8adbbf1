// SPDX-License-Identifier: MIT OR Apache-2.0

//! A scene and the camera that films it without interruption.

use super::settings::Settings;
use crate::scene::path::Oscillations;
use crate::scene::{Lens, RollingCamera, Scene, Shutter};
use std::sync::Arc;

/// Focal length in multiples of the frame's longer side: a field of view of 53° along it.
const FOCAL: f64 = 1.0;

/// A scene and the camera that films it.
pub struct Take {
    /// What is seen.
    pub scene: Arc<Scene>,
    /// Who sees it.
    pub camera: RollingCamera,
}

impl Take {
    /// A scene filmed along the path of a seed, with the motion of the settings times `amplitude`.
    pub fn new(settings: &Settings, scene: Arc<Scene>, seed: u64, amplitude: f64) -> Self {
        let focal = FOCAL * settings.width.max(settings.height) as f64;
        let camera = RollingCamera {
            lens: Lens {
                width: settings.width,
                height: settings.height,
                focal,
                distortion: settings.distortion,
            },
            shutter: Shutter {
                first: settings.first,
                readout: settings.readout_time(),
                open: settings.exposure,
            },
            path: Box::new(Oscillations::new(settings.motion, amplitude, settings.fps, seed)),
        };
        Self { scene, camera }
    }
}
