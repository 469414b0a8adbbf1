// SPDX-License-Identifier: MIT OR Apache-2.0

//! What each effort leaves of the distortion, and what its analysis takes.

use crate::metrics::displacement;
use crate::systems::product::{self, Delay};
use anyhow::Result;
use render::footage::Footage;
use rsrectify::rectifier::{Effort, Estimator};
use std::time::Instant;

/// The heading of the table.
pub const HEADING: &str = "| sequence | size | uncorrected px | balanced: left px, share | fast: left px, share | analysis, fast / balanced |\n\
                           |---|---|---|---|---|---|";

/// A row of the table: the readout unknown, both efforts on the same frames, one after the other.
///
/// # Errors
/// Those of the library.
pub fn row(footage: &Footage, lookahead: usize) -> Result<String> {
    let uncorrected = footage.uncorrected();
    let left = |effort| -> Result<(String, f64)> {
        let mut settings =
            product::settings(footage.settings(), Delay::Unknown, Estimator::Continuous, lookahead);
        settings.effort = effort;
        let started = Instant::now();
        let solutions = product::solve(footage, settings)?;
        let seconds = started.elapsed().as_secs_f64();
        let left = displacement::left(&footage.truth, &product::corrections(solutions));
        let share =
            left.share_of(&uncorrected).map_or("–".into(), |share| format!("{:.1} %", 100.0 * share));
        Ok((format!("{:.2}, {share}", left.rms), seconds))
    };
    let (balanced, usual) = left(Effort::Balanced)?;
    let (fast, short) = left(Effort::Fast)?;
    let sequence = footage.settings();
    Ok(format!(
        "| {} | {} × {} | {:.2} | {balanced} | {fast} | {:.2} |",
        sequence.name,
        sequence.width,
        sequence.height,
        uncorrected.rms,
        short / usual
    ))
}
