// SPDX-License-Identifier: MIT OR Apache-2.0

//! Sequences whose rows are exposed at once, as of a global shutter, an animation or a screen: nothing of them is to be corrected,
//! however much a depth that varies down the picture, or a thing that turns or sways, looks like a readout.

use super::settings::{Settings, Strength};
use crate::scene::SceneKind;
use crate::scene::path::Motion;

/// The settings, named `at_once_scene`. They are no part of the report.
pub fn at_once() -> Vec<Settings> {
    let of = |name: &str, scene, motion| Settings {
        readout_ratio: 0.0,
        scene,
        ..Settings::compressed(&format!("at_once_{name}"), motion, Strength::Amplitude(1.0))
    };
    let scroll = |lowest, highest| Motion::Scroll { lowest, highest };
    vec![
        of("layers", SceneKind::Layers, scroll(0.02, 0.3)),
        of("layers_slow", SceneKind::Layers, scroll(0.02, 0.1)),
        of("window", SceneKind::Window, scroll(0.02, 0.3)),
        of("ground", SceneKind::Ground, Motion::Steer),
        of("roller", SceneKind::Roller, Motion::Still),
        of("translation", SceneKind::Room, Motion::Translation),
        of("foreground", SceneKind::Foreground, Motion::Shake { lowest: 0.015, highest: 0.15, sway: 0.03 }),
        of("driving", SceneKind::Street, Motion::Drive),
        of("tracking", SceneKind::Followed, Motion::Follow),
        of("crowd", SceneKind::Crowd, Motion::Translation),
        of("water", SceneKind::Water, Motion::Translation),
        of("selfie", SceneKind::Selfie, Motion::Pan),
        of("caption", SceneKind::Caption, Motion::Pan),
        of("zoom", SceneKind::Room, Motion::Zoom { factor: 1.4 }),
    ]
}
