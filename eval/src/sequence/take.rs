//! A scene and the camera that films it without interruption.

use super::settings::{Settings, Strength};
use crate::metrics::displacement;
use crate::scene::path::Oscillations;
use crate::scene::{Lens, RollingCamera, Scene, Shutter};
use crate::truth::Capture;
use std::ops::Range;
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

    /// The amplitude at which the motion has the strength that the settings ask for, over some captures.
    ///
    /// Displacement is nearly proportional to the amplitude, so that repeated proportion settles
    /// quickly; the visibility mask and perspective bend it a little.
    pub fn amplitude(settings: &Settings, scene: &Arc<Scene>, seed: u64, captures: Range<usize>) -> f64 {
        let target = match settings.strength {
            Strength::Amplitude(amplitude) => return amplitude,
            Strength::Displacement(target) => target,
        };
        let step = settings.width.max(settings.height) / 40;
        let mut amplitude = 1.0;
        for _ in 0..8 {
            let take = Self::new(settings, scene.clone(), seed, amplitude);
            let samples = captures.clone().flat_map(|k| take.capture(settings, k).samples(step));
            let reached = displacement::uncorrected(samples).rms;
            if (reached - target).abs() < 1e-3 * target {
                break;
            }
            amplitude *= target / reached.max(1e-6);
        }
        amplitude
    }

    /// The truth of capture `k`.
    pub fn capture(&self, settings: &Settings, k: usize) -> Capture<'_> {
        let start = k as f64 / settings.fps;
        let middle = start + settings.readout_time() / 2.0;
        let stabilised = settings.stabilisation.map(|s| s.warp(&self.camera, middle, settings.fps));
        Capture { take: self, start, warp: stabilised.unwrap_or_default() }
    }
}
