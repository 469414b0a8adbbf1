// SPDX-License-Identifier: MIT OR Apache-2.0

//! Errors of the rectifier.

use super::settings::Settings;
use crate::readout::ReadoutError;
use thiserror::Error;

/// Largest side of a frame in pixels.
const MAX_SIDE: usize = 1 << 20;
/// Most columns, and rows, of the sampling grid.
const MAX_GRID: usize = 1 << 10;

/// Why settings are invalid.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// An invalid readout time or inter-frame delay.
    #[error(transparent)]
    Readout(#[from] ReadoutError),
    /// A focal length that is not positive, infinite or NaN.
    #[error("focal length of {0} frame widths: must be finite and positive")]
    FocalLength(f64),
    /// A sampling grid that is too large.
    #[error("sampling grid of {columns} x {rows} points: at most {MAX_GRID} along a side")]
    Grid {
        /// Columns asked for.
        columns: usize,
        /// Rows asked for.
        rows: usize,
    },
    /// A frame larger than any sensor.
    #[error("frames of {width} x {height} pixels: at most {MAX_SIDE} along a side")]
    Size {
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
    },
}

/// Why a frame was not added.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum PushError {
    /// The luma is not of the rectifier's size.
    #[error("luma of {} x {} pixels for frames of {} x {}", found[0], found[1], expected[0], expected[1])]
    Size {
        /// Width and height of the luma.
        found: [usize; 2],
        /// Width and height of the rectifier's frames.
        expected: [usize; 2],
    },
}

impl Settings {
    /// Checks these settings for frames of `width` × `height` pixels.
    pub(super) fn check(&self, width: usize, height: usize) -> Result<(), SettingsError> {
        self.readout_time.check()?;
        if let Some(focal) = self.focal_length.filter(|focal| !(focal.is_finite() && *focal > 0.0)) {
            return Err(SettingsError::FocalLength(focal));
        }
        let (columns, rows) = (self.grid_columns, self.grid_rows);
        if columns.max(rows) > MAX_GRID {
            return Err(SettingsError::Grid { columns, rows });
        }
        if width.max(height) > MAX_SIDE {
            return Err(SettingsError::Size { width, height });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readout::ReadoutTime;

    #[test]
    fn invalid_settings_are_refused_by_name() {
        let check = |settings: Settings| settings.check(64, 48).map_err(|error| error.to_string());
        let time = |readout_time| check(Settings { readout_time, ..Settings::default() });
        for value in [f64::NAN, -1.0, -1e-300, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(time(ReadoutTime::Seconds(value)).unwrap_err().starts_with("readout time"));
            assert!(time(ReadoutTime::DelayRows(value)).unwrap_err().starts_with("inter-frame delay"));
            let settings = Settings { focal_length: Some(value), ..Settings::default() };
            assert!(check(settings).unwrap_err().starts_with("focal length"));
        }
        let focal_length = Some(0.0);
        assert!(check(Settings { focal_length, ..Settings::default() }).is_err());
        for (grid_columns, grid_rows) in [(usize::MAX, 0), (0, usize::MAX), (1025, 24)] {
            let settings = Settings { grid_columns, grid_rows, ..Settings::default() };
            assert!(check(settings).unwrap_err().starts_with("sampling grid"));
        }
        assert!(Settings::default().check(usize::MAX, 1).unwrap_err().to_string().starts_with("frames of"));
    }

    #[test]
    fn valid_settings_are_accepted() {
        for readout_time in [
            ReadoutTime::Unknown,
            ReadoutTime::WholePeriod,
            ReadoutTime::Seconds(0.0),
            ReadoutTime::Seconds(0.033),
            ReadoutTime::DelayRows(0.0),
            ReadoutTime::DelayRows(1e9),
        ] {
            let focal_length = Some(1e-3);
            let settings = Settings { readout_time, focal_length, ..Settings::default() };
            for (width, height) in [(0, 0), (1, 1), (1, 1 << 20), (7680, 4320)] {
                assert_eq!(settings.check(width, height), Ok(()), "{readout_time:?}");
            }
        }
        let largest = Settings { grid_columns: 1024, grid_rows: 1024, ..Settings::default() };
        assert_eq!(largest.check(64, 48), Ok(()));
    }
}
