// SPDX-License-Identifier: MIT OR Apache-2.0

//! A point correspondence, in full-frame pixels.

use nalgebra::{Matrix2, Vector2};

/// The same scene point in a frame and in a later one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correspondence {
    /// Pixels of the full frame (pixel centres at integers) in the first frame.
    pub from: Vector2<f64>,
    /// Pixels of the full frame in the second frame.
    pub to: Vector2<f64>,
    /// The smaller eigenvalue of the patch's gradient matrix, per pixel, in squared grey levels (0 to 255)
    /// per squared analysed pixel: how well the patch can be located. Computed from the patch distorted as it
    /// appears in the second frame, with gradients orthogonal to the mean and to the patch itself.
    pub texture: f32,
    /// Root mean square difference of the two patches in grey levels after brightness was matched.
    pub residual: f32,
    /// Covariance of `to` given `from`, squared full-frame pixels.
    pub covariance: Matrix2<f64>,
}

impl Correspondence {
    /// The variance along the axis where it is largest, squared full-frame pixels.
    pub fn variance(&self) -> f64 {
        let c = self.covariance;
        0.5 * (c.m11 + c.m22) + (0.5 * (c.m11 - c.m22)).hypot(c.m12)
    }
}

/// Converts analysed pixels, each `scale` full-frame pixels wide, to full-frame pixels.
pub(super) fn to_full(at: Vector2<f32>, scale: f64) -> Vector2<f64> {
    at.map(f64::from).add_scalar(0.5) * scale - Vector2::repeat(0.5)
}
