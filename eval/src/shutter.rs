// SPDX-License-Identifier: MIT OR Apache-2.0

//! What a user says of a camera's shutter, on the command line.

use anyhow::{Result, ensure};
use clap::Args;
use rsrectify::readout::{ReadoutDirection, ReadoutTime};
use rsrectify::rectifier::Settings;

/// What is told of the shutter; the library's defaults hold where nothing is.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct Shutter {
    /// Readout time as a share of the frame period, -1 to 1: negative from the bottom (or the right).
    #[arg(long, value_name = "RATIO", allow_negative_numbers = true, conflicts_with = "delay")]
    pub readout_ratio: Option<f64>,
    /// Blank rows between the last row of a frame and the first of the next.
    #[arg(long, value_name = "ROWS")]
    pub delay: Option<f64>,
    /// Columns are read one after another, not rows: a portrait clip.
    #[arg(long)]
    pub sideways: bool,
}

impl Shutter {
    /// The library's settings for frames `period` seconds apart.
    ///
    /// # Errors
    /// If the ratio is not within ±1 or the delay is negative.
    pub fn settings(&self, period: f64, lookahead: usize) -> Result<Settings> {
        let mut settings = Settings::default();
        settings.lookahead = lookahead;
        let reversed = self.readout_ratio.is_some_and(|ratio| ratio < 0.0);
        match (self.sideways, reversed) {
            (false, true) => settings.direction = Some(ReadoutDirection::BottomToTop),
            (true, false) => settings.direction = Some(ReadoutDirection::LeftToRight),
            (true, true) => settings.direction = Some(ReadoutDirection::RightToLeft),
            (false, false) if self.readout_ratio.is_some() || self.delay.is_some() => {
                settings.direction = Some(ReadoutDirection::TopToBottom);
            }
            (false, false) => {}
        }
        if let Some(ratio) = self.readout_ratio {
            ensure!(ratio.abs() <= 1.0, "a readout ratio is between -1 and 1, not {ratio}");
            settings.readout_time = ReadoutTime::Seconds(ratio.abs() * period);
        }
        if let Some(rows) = self.delay {
            ensure!(rows >= 0.0 && rows.is_finite(), "a delay is 0 rows or more, not {rows}");
            settings.readout_time = ReadoutTime::DelayRows(rows);
        }
        Ok(settings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(readout_ratio: Option<f64>, delay: Option<f64>, sideways: bool) -> Result<Settings> {
        Shutter { readout_ratio, delay, sideways }.settings(0.04, 4)
    }

    #[test]
    fn the_sign_and_the_axis_make_the_direction() {
        use ReadoutDirection::{BottomToTop, LeftToRight, RightToLeft, TopToBottom};
        for (ratio, sideways, direction) in [
            (0.5, false, TopToBottom),
            (-0.5, false, BottomToTop),
            (0.5, true, LeftToRight),
            (-0.5, true, RightToLeft),
        ] {
            let settings = told(Some(ratio), None, sideways).unwrap();
            assert_eq!(settings.direction, Some(direction));
            assert_eq!(settings.readout_time, ReadoutTime::Seconds(0.02));
        }
        assert_eq!(told(None, Some(40.0), false).unwrap().readout_time, ReadoutTime::DelayRows(40.0));
        assert_eq!(told(None, None, false).unwrap(), Settings::default());
    }

    #[test]
    fn nonsense_is_refused() {
        for (ratio, delay) in [(Some(1.2), None), (Some(f64::NAN), None), (None, Some(-1.0))] {
            assert!(told(ratio, delay, false).is_err());
        }
    }
}
