//! The named sequences.

use super::settings::{Settings, Strength};
use crate::scene::FirstEdge;
use crate::scene::path::Motion;

/// The settings of all named sequences.
///
/// The first five follow the data set of P.-E. Forssén and E. Ringaby, *Rectifying rolling shutter
/// video from hand-held devices*, CVPR 2010, in name, kind of motion, frame size and blank rows.
pub fn catalogue() -> Vec<Settings> {
    use Strength::{Amplitude, Displacement};
    let shake = |lowest, highest| Motion::Shake { lowest, highest };
    vec![
        Settings::new("rot1_B0", Motion::SpiralRotation, Displacement(9.0)),
        Settings::new("rot1_B40", Motion::SpiralRotation, Displacement(9.0)).blank_rows(40.0),
        Settings::new("rot2_B40", Motion::Rotation, Displacement(5.5)).blank_rows(40.0),
        Settings::new("trans1_B40", Motion::Translation, Displacement(5.0)).blank_rows(40.0),
        Settings::new("trans_rot1_B40", Motion::RotationAndTranslation, Displacement(6.0)).blank_rows(40.0),
        Settings {
            readout_ratio: 0.42,
            noise: 3.0,
            frames: 30,
            ..Settings::new("shake_g042", shake(0.04, 0.4), Displacement(3.0))
        },
        Settings {
            readout_ratio: 0.85,
            first: FirstEdge::Bottom,
            noise: 3.0,
            frames: 30,
            ..Settings::new("btt_g085", shake(0.015, 0.15), Displacement(5.0))
        },
        Settings { frames: 30, ..Settings::new("vibration", Motion::Vibration, Displacement(5.0)) },
        Settings { readout_ratio: 0.0, ..Settings::new("control_global", shake(0.04, 0.4), Amplitude(1.0)) },
        Settings { noise: 2.0, ..Settings::new("control_still", Motion::Still, Amplitude(0.0)) },
    ]
}

/// The settings of the sequence with this name.
pub fn named(name: &str) -> Option<Settings> {
    catalogue().into_iter().find(|settings| settings.name == name)
}

/// The clip that shows what a rolling shutter does: 4.5 s at 1280×720, strongly shaken.
pub fn demo() -> Settings {
    Settings {
        width: 1280,
        height: 720,
        frames: 135,
        noise: 1.0,
        ..Settings::new("demo", Motion::Shake { lowest: 0.05, highest: 0.13 }, Strength::Displacement(13.0))
    }
}
