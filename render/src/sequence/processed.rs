// SPDX-License-Identifier: MIT OR Apache-2.0

//! Sequences that were stabilised or re-timed after their readout, as phones and editors do it.

use super::settings::{Settings, Strength};
use super::{Move, Stabilisation, Timeline};
use crate::scene::path::Motion;
use crate::scene::{FirstEdge, SceneKind};

/// How far a stabiliser smooths, and the enlargement, which cuts off 18 % of the rows.
const SMOOTHING: f64 = 3.0;
const ZOOM: f64 = 1.22;

/// The settings of each kind with each motion, named `kind_motion`. They are no part of the report.
pub fn processed() -> Vec<Settings> {
    let placed = |kind| Some(Stabilisation { kind, smoothing: SMOOTHING, zoom: ZOOM });
    let kinds: [(&str, &dyn Fn(Settings) -> Settings); 8] = [
        ("plain", &|motion| motion),
        ("eis_sim", &|motion| Settings { stabilisation: placed(Move::Similarity), ..motion }),
        ("eis_rot", &|motion| Settings { stabilisation: placed(Move::Turn), ..motion }),
        ("eis_aware", &|motion| Settings { stabilisation: placed(Move::TurnByRow), ..motion }),
        ("eis_global", &|motion| Settings {
            readout_ratio: 0.0,
            stabilisation: placed(Move::Similarity),
            ..motion
        }),
        ("duplicated_30", &|motion| Settings { fps: 25.0, timeline: Timeline::Resampled(30.0), ..motion }),
        ("blended_30", &|motion| Settings { fps: 25.0, timeline: Timeline::Blended(30.0), ..motion }),
        ("dropped_24", &|motion| Settings { timeline: Timeline::Resampled(24.0), ..motion }),
    ];
    let named = |(kind, process): &(&str, &dyn Fn(Settings) -> Settings)| {
        motions().map(|motion| Settings { name: format!("{kind}_{}", motion.name), ..process(motion) })
    };
    kinds.iter().flat_map(named).collect()
}

/// What all kinds are made of, through H.264. The amplitudes are fixed, so that all kinds have the same path: they
/// displace the rows of `plain` by about 3.5 px (RMS) over 62 frames.
fn motions() -> [Settings; 4] {
    let of = |name, motion, amplitude| Settings::compressed(name, motion, Strength::Amplitude(amplitude));
    let shake = |lowest, highest, sway| Motion::Shake { lowest, highest, sway };
    let (bottom, street) = (FirstEdge::Bottom, SceneKind::Street);
    [
        // A hand that walks: parallax in a room.
        Settings { readout_ratio: 0.8, ..of("walk", shake(0.015, 0.15, 0.03), 8.8) },
        // Mostly turns to and fro, hardly any parallax.
        Settings { readout_ratio: 0.6, ..of("pan", Motion::Pan, 0.24) },
        // Only turns, read from the bottom.
        Settings { readout_ratio: 0.76, first: bottom, ..of("shake", shake(0.04, 0.4, 0.0), 3.5) },
        // Forward between near walls, read from the bottom.
        Settings { readout_ratio: 0.7, first: bottom, scene: street, ..of("drone", Motion::Drive, 1.4) },
    ]
}
