// SPDX-License-Identifier: MIT OR Apache-2.0

//! The named sequences.

use super::at_once::at_once;
use super::processed::processed;
use super::settings::{Settings, Strength};
use super::{Gain, Move, Stabilisation, Timeline};
use crate::scene::path::Motion;
use crate::scene::{FirstEdge, SceneKind};
use anyhow::{Context, Result, ensure};

/// The settings of all named sequences.
///
/// The first five follow the data set of P.-E. Forssén and E. Ringaby, *Rectifying rolling shutter
/// video from hand-held devices*, CVPR 2010, in name, kind of motion, frame size and blank rows.
pub fn catalogue() -> Vec<Settings> {
    use Strength::{Amplitude, Displacement};
    let phone = |name| phone(name, Displacement(5.0));
    vec![
        Settings::new("rot1_B0", Motion::SpiralRotation, Displacement(9.0)),
        Settings::new("rot1_B40", Motion::SpiralRotation, Displacement(9.0)).blank_rows(40.0),
        Settings::new("rot2_B40", Motion::Rotation, Displacement(5.5)).blank_rows(40.0),
        Settings::new("trans1_B40", Motion::Translation, Displacement(5.0)).blank_rows(40.0),
        Settings::new("trans_rot1_B40", Motion::RotationAndTranslation, Displacement(6.0)).blank_rows(40.0),
        short_readout("shake_g042", 0.0),
        short_readout("shake_g042_sway", SWAY),
        from_the_bottom("btt_g085", 0.0),
        from_the_bottom("btt_g085_sway", SWAY),
        phone("hand_g08"),
        Settings { width: 480, height: 640, first: FirstEdge::Left, ..phone("ltr_g08") },
        Settings { frames: 30, ..Settings::new("vibration", Motion::Vibration, Displacement(5.0)) },
        Settings { scene: SceneKind::Foreground, ..phone("foreground") },
        Settings { scene: SceneKind::LowTexture, ..phone("low_texture") },
        Settings { exposure: 0.015, bitrate: Some(1500), ..phone("blur_h264") },
        Settings { cut: Some(15), ..phone("cut") },
        Settings { timeline: Timeline::Duplicates(vec![5, 12, 13, 21]), ..phone("duplicates") },
        Settings { timeline: Timeline::Drops(vec![5, 12, 13, 21]), ..phone("drops") },
        Settings { gain: Some(Gain { ramp: [6, 14], end: 0.6, flash: Some((20, 1.8)) }), ..phone("gain") },
        Settings { distortion: [-0.3, 0.05], ..phone("fisheye") },
        Settings { stabilisation: Some(STABILISATION), ..self::phone("eis", Displacement(3.5)) },
        Settings { timeline: Timeline::Resampled(25.0), ..phone("resampled_25") },
        Settings { timeline: Timeline::Resampled(60.0), ..phone("resampled_60") },
        Settings {
            readout_ratio: 0.0,
            ..Settings::new("control_global", shake(0.04, 0.4, SWAY), Amplitude(1.0))
        },
        Settings { noise: 2.0, ..Settings::new("control_still", Motion::Still, Amplitude(0.0)) },
        Settings {
            readout_ratio: 0.0,
            stabilisation: Some(STABILISATION),
            ..self::phone("control_eis", Amplitude(1.0))
        },
    ]
}

/// The settings of the sequences in which motion is hard to measure. They are no part of the report.
pub fn hard() -> Vec<Settings> {
    let own = Strength::Amplitude(1.0);
    let of = |name: &str, scene, motion| Settings {
        scene,
        readout_ratio: 0.8,
        noise: 2.0,
        frames: 30,
        ..Settings::new(name, motion, own)
    };
    // Half of the frame time at 30 frames a second.
    let exposure = 1.0 / 60.0;
    // As a phone in a hand, which also walks where there is parallax to be seen.
    let held =
        |name: &str, scene, sway| Settings { scene, ..phone_with(name, Strength::Displacement(4.0), sway) };
    let rattle = Motion::Rattle { lowest: 0.6, highest: 0.8 };
    vec![
        Settings { exposure, readout_ratio: 0.6, ..of("selfie", SceneKind::Selfie, Motion::Pan) },
        Settings { readout_ratio: 1.0, ..of("driving", SceneKind::Street, Motion::Drive) },
        held("thin", SceneKind::Thin, 2.0 * SWAY),
        Settings { exposure, readout_ratio: 0.42, ..of("whip_pan", SceneKind::Room, Motion::Pan) },
        of("tracking", SceneKind::Followed, Motion::Follow),
        held("crowd", SceneKind::Crowd, SWAY),
        Settings { noise: 12.0, exposure, ..held("night", SceneKind::Room, SWAY) },
        held("water", SceneKind::Water, SWAY),
        held("blinds", SceneKind::Blinds, SWAY),
        of("caption", SceneKind::Caption, Motion::Pan),
        Settings {
            readout_ratio: 0.7,
            frames: 24,
            strength: Strength::Displacement(4.0),
            ..of("zoom", SceneKind::Room, Motion::Zoom { factor: 1.4 })
        },
        Settings { width: 1920, height: 1080, frames: 8, ..held("thin_1080", SceneKind::Thin, 2.0 * SWAY) },
        rough("road_g05", shake(0.04, 0.9, SWAY), 0.5),
        rough("road_g08", shake(0.04, 0.7, SWAY), 0.8),
        rough("rattle_g06", rattle, 0.6),
        rough("rattle_g03", rattle, 0.3),
        // Long enough for a right readout to be lost to a rival that is tried later.
        Settings {
            width: 360,
            height: 240,
            frames: 212,
            readout_ratio: 0.89,
            first: FirstEdge::Bottom,
            noise: 6.0,
            bitrate: Some(150),
            ..phone("small_noisy", Strength::Displacement(2.0))
        },
    ]
}

/// Takes most of a hand's shake out of the frame's middle.
const STABILISATION: Stabilisation = Stabilisation { kind: Move::Turn, smoothing: 5.0, zoom: 1.25 };

/// Peak translation of a hand in metres, where it turns by 0.03 radians: it turns about the elbow.
const SWAY: f64 = 0.01;

/// γ = 0.42, noise, and shake up to 0.4 cycles a frame.
fn short_readout(name: &str, sway: f64) -> Settings {
    let strength = Strength::Displacement(3.0);
    Settings {
        readout_ratio: 0.42,
        noise: 3.0,
        frames: 30,
        ..Settings::new(name, shake(0.04, 0.4, sway), strength)
    }
}

/// A camera upside down: γ = 0.85, noise, and shake up to 0.15 cycles a frame.
fn from_the_bottom(name: &str, sway: f64) -> Settings {
    let motion = shake(0.015, 0.15, sway);
    let (first, strength) = (FirstEdge::Bottom, Strength::Displacement(5.0));
    Settings { readout_ratio: 0.85, first, noise: 3.0, frames: 30, ..Settings::new(name, motion, strength) }
}

/// What a phone in a hand takes: 30 frames with shake up to 0.15 cycles a frame, γ = 0.8, some noise.
fn phone(name: &str, strength: Strength) -> Settings {
    phone_with(name, strength, SWAY)
}

/// The same with another translation.
fn phone_with(name: &str, strength: Strength, sway: f64) -> Settings {
    let motion = shake(0.015, 0.15, sway);
    Settings { readout_ratio: 0.8, noise: 2.0, frames: 30, ..Settings::new(name, motion, strength) }
}

/// On a bicycle or in a car: much of the motion is above half a cycle a frame, where the shifts between frames are aliased.
fn rough(name: &str, motion: Motion, readout_ratio: f64) -> Settings {
    let strength = Strength::Displacement(4.0);
    Settings { readout_ratio, noise: 2.0, frames: 40, ..Settings::new(name, motion, strength) }
}

fn shake(lowest: f64, highest: f64, sway: f64) -> Motion {
    Motion::Shake { lowest, highest, sway }
}

/// The settings of the sequence with this name.
///
/// # Errors
/// If there is none.
pub fn named(name: &str) -> Result<Settings> {
    all().find(|settings| settings.name == name).with_context(|| none_named(name))
}

/// The settings of the sequences that are named, that begin as a name that ends in `*`, or that `processed` stands for.
///
/// # Errors
/// If there are none for a name.
pub fn chosen(names: &[String]) -> Result<Vec<Settings>> {
    let mut chosen = Vec::new();
    for name in names {
        let found: Vec<Settings> = match (name.strip_suffix('*'), name.as_str()) {
            (None, "processed") => processed(),
            (None, name) => vec![named(name)?],
            (Some(start), _) => all().filter(|settings| settings.name.starts_with(start)).collect(),
        };
        ensure!(!found.is_empty(), none_named(name));
        chosen.extend(found);
    }
    Ok(chosen)
}

fn none_named(name: &str) -> String {
    format!("no sequence is named {name}; `list` prints the names")
}

/// The settings of all sequences, with or without a place in the report.
pub fn all() -> impl Iterator<Item = Settings> {
    catalogue().into_iter().chain(hard()).chain(processed()).chain(at_once())
}

/// The clip that shows what a rolling shutter does: 4.5 s at 1280×720, strongly shaken.
pub fn demo() -> Settings {
    Settings {
        width: 1280,
        height: 720,
        frames: 135,
        noise: 1.0,
        ..Settings::new("demo", shake(0.05, 0.13, SWAY), Strength::Displacement(13.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_groups_are_chosen() {
        let mut names: Vec<String> = all().map(|settings| settings.name).collect();
        names.sort();
        assert!(names.windows(2).all(|pair| pair[0] != pair[1]));
        let count = |name: &str| chosen(&[name.into()]).map(|found| found.len()).ok();
        assert_eq!(
            ["processed", "eis_sim_*", "eis", "nothing", "no*"].map(count),
            [Some(32), Some(4), Some(1), None, None]
        );
    }
}
