// SPDX-License-Identifier: MIT OR Apache-2.0

//! Matches, and where they lie in a frame.

use nalgebra::{Matrix2, Vector2};

/// The two points of a correspondence, in radii from the image centre.
#[derive(Clone, Copy, Debug)]
pub struct Match {
    pub from: Vector2<f64>,
    pub to: Vector2<f64>,
    /// Covariance of `to` in px².
    pub covariance: Matrix2<f64>,
}

impl Match {
    #[inline(always)]
    pub fn displacement(&self) -> Vector2<f64> {
        self.to - self.from
    }

    /// Halfway between the two points.
    #[inline(always)]
    pub fn middle(&self) -> Vector2<f64> {
        (self.from + self.to) / 2.0
    }
}

/// The axis along which the sensor is read. Which one it is, `CameraPosterior` estimates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanAxis {
    /// Whether rows, not columns, are read one after another.
    pub by_rows: bool,
    /// Length of the frame along the axis, in radii.
    pub length: f64,
}

impl ScanAxis {
    /// Bands of lines into which a frame is divided to see what the matches of a line have in common, and how many lines have any.
    pub const LINE_BANDS: usize = 16;

    /// Place of a point along the axis: 0 at the top (left) edge, 1 at the other.
    #[inline(always)]
    pub fn place(&self, point: Vector2<f64>) -> f64 {
        0.5 + if self.by_rows { point.y } else { point.x } / self.length
    }

    /// Number of the band in which a point lies; those at the edges have the points outside, too.
    pub fn line_band(&self, point: Vector2<f64>) -> usize {
        let last = (Self::LINE_BANDS - 1) as f64;
        (self.place(point) * Self::LINE_BANDS as f64).clamp(0.0, last) as usize
    }

    /// Position of a point along its line, across the axis.
    #[inline(always)]
    pub fn across(&self, point: Vector2<f64>) -> f64 {
        if self.by_rows { point.x } else { point.y }
    }
}
