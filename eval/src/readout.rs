// SPDX-License-Identifier: MIT OR Apache-2.0

//! How well the library finds the readout from the picture alone.

use crate::metrics::readout::{error, signed_ratio};
use crate::systems::product::{self, Delay};
use anyhow::{Context, Result};
use render::footage::Footage;
use render::media::Clip;
use rsrectify::Rectifier;
use rsrectify::rectifier::{Estimator, FrameSolution, Settings};

/// Frames that the library looks ahead.
const LOOKAHEAD: usize = 4;

/// The heading of the rows of [`row`].
pub const HEADING: &str = "| sequence | seed | true ratio | found | ± | error |\n|---|---|---|---|---|---|";

/// What the library states with the last frame of a clip of which it is told nothing.
///
/// # Errors
/// If the clip has no frame, or the rectifier refuses one.
pub fn of_clip(clip: &Clip) -> Result<FrameSolution> {
    let mut settings = Settings::default();
    settings.lookahead = LOOKAHEAD;
    let mut rectifier = Rectifier::new(settings, clip.width, clip.height, Some(1.0 / clip.fps))?;
    let frames = clip.frames.iter().enumerate().map(|(k, frame)| (frame, k as f64 / clip.fps));
    product::motions(&mut rectifier, frames)?.pop().context("the clip has no frame")
}

/// Direction, signed ratio and its standard deviation in frame periods, as cells of a table; `fps` are the frames a second.
pub fn cells(found: &FrameSolution, fps: f64) -> String {
    let readout = found.motion.readout();
    let ratio = signed_ratio(readout, 1.0 / fps);
    format!("{:?} {ratio:+.3} | {:.3}", readout.direction(), found.readout_deviation)
}

/// A row of the table: ratios are signed, the error is that of [`error`], in frame periods.
///
/// # Errors
/// If the rectifier refuses a frame.
pub fn row(footage: &Footage) -> Result<String> {
    let (settings, truth, fps) = (footage.settings(), footage.readout(), footage.settings().delivered_fps());
    let told = product::settings(settings, Delay::Unknown, Estimator::Continuous, LOOKAHEAD);
    let found = product::solve(footage, told)?.pop().context("a sequence has frames")?;
    let distance = error(found.motion.readout(), &truth, 1.0 / fps);
    let ratio = signed_ratio(&truth, 1.0 / fps);
    let (name, seed, direction) = (&settings.name, settings.seed, truth.direction());
    Ok(format!("| {name} | {seed} | {direction:?} {ratio:+.3} | {} | {distance:.3} |", cells(&found, fps)))
}
