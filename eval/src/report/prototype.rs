// SPDX-License-Identifier: MIT OR Apache-2.0

//! The figures of an earlier prototype, measured with another renderer on sequences of the same
//! kinds, beside those of the run.

use super::results::{Results, Spread, Trial};
use super::tables::Table;
use crate::correspondences::Source;

/// The sequences of the columns.
const SEQUENCES: [&str; 6] =
    ["rot1_B0", "rot2_B40", "trans1_B40", "trans_rot1_B40", "shake_g042", "vibration"];

/// What a row is called, the system it belongs to here, and the prototype's shares left in percent.
type Row = (&'static str, &'static str, [Option<f64>; 6]);

const ROWS: [Row; 5] = [
    (
        "translation a frame",
        "translation",
        [Some(30.0), Some(43.0), None, Some(52.0), Some(68.0), Some(100.0)],
    ),
    (
        "2D rotation, initialisation only",
        "paper-initialisation",
        [Some(29.0), Some(40.0), None, Some(50.0), Some(68.0), Some(101.0)],
    ),
    (
        "2D rotation, delay 0",
        "paper-delay-0",
        [Some(13.5), Some(21.0), Some(38.0), Some(47.0), Some(52.0), Some(101.0)],
    ),
    ("2D rotation", "paper", [Some(13.5), Some(18.0), Some(40.0), Some(45.0), Some(48.0), Some(101.0)]),
    (
        "3D rotation, constant in each frame",
        "3d-rotation-2-constant",
        [Some(10.5), Some(15.5), Some(40.0), Some(43.0), Some(44.0), Some(101.0)],
    ),
];

/// Share left here, and the prototype's in brackets.
pub fn compared(results: &Results) -> String {
    let titles = std::iter::once("system").chain(SEQUENCES).map(String::from);
    let mut table = Table::new(titles);
    for (label, method, before) in ROWS {
        let cell = |(sequence, before): (&&str, &Option<f64>)| {
            let trials = results.of(sequence, Source::Sampler, method);
            let here = Spread::of(trials.filter_map(Trial::share))?;
            let before = before.map_or("–".into(), |before| format!("{before} %"));
            Some(format!("{:.1} % ({before})", 100.0 * here.mean))
        };
        table.row(label, SEQUENCES.iter().zip(&before).map(cell).collect());
    }
    table.markdown()
}
