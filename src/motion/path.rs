//! The motion path of one frame through its readout.

use super::Twist;
use nalgebra::Vector2;

/// The image motion during one frame's readout, by elapsed share.
///
/// The paper's frame rotates uniformly about a fixed centre: one twist.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionPath {
    /// Velocity of the frame.
    pub twist: Twist,
    /// Readout time T in seconds.
    pub readout_time: f64,
}

impl MotionPath {
    /// A frame that does not move.
    pub const STILL: Self = Self { twist: Twist::ZERO, readout_time: 0.0 };

    /// Where a point (centred pixels), seen when share `from` of the readout had elapsed, is when
    /// share `to` has: f(x, (to − from)·T·ω, c), the map of 25.11.
    pub fn carry(&self, point: Vector2<f64>, from: f64, to: f64) -> Vector2<f64> {
        self.twist.after((to - from) * self.readout_time).apply(point)
    }

    /// Whether no point moves during the readout.
    pub fn is_still(&self) -> bool {
        self.twist == Twist::ZERO || self.readout_time == 0.0
    }
}
