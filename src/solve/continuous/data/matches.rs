//! Matches, and when they are exposed.

use nalgebra::{Matrix2, Vector2};

/// Points of a correspondence, in units of the radius from the image centre.
#[derive(Clone, Copy, Debug)]
pub struct Match {
    pub from: Vector2<f64>,
    pub to: Vector2<f64>,
    /// Covariance of `to` in squared pixels.
    pub covariance: Matrix2<f64>,
}

/// Along which axis the sensor is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanAxis {
    /// Whether rows, not columns, are read one after another.
    pub by_rows: bool,
    /// Units of the radius from the first line to past the last.
    pub length: f64,
}

impl ScanAxis {
    /// Place of a point along the axis: 0 at the top (left) edge, 1 at the other.
    pub fn place(&self, point: Vector2<f64>) -> f64 {
        0.5 + if self.by_rows { point.y } else { point.x } / self.length
    }
}

/// When the lines of a frame are exposed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shutter {
    pub scan_axis: ScanAxis,
    /// γ, the signed readout time in frame periods.
    pub gamma: f64,
}

impl Shutter {
    /// Instant in frame periods at which the line at `place` along the scan axis of the frame with this timestamp is exposed:
    /// t = t_k + γ·p.
    pub fn exposure(&self, stamp: f64, place: f64) -> f64 {
        stamp + self.gamma * place
    }
}
