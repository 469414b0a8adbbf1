// SPDX-License-Identifier: MIT OR Apache-2.0

//! The global path that residual velocities are added to.

use nalgebra::Matrix3;

/// The global path, in frame pixels; times are seconds after the frame's timestamp.
pub trait Path: Sync {
    /// The homography from the path's first instant to a time.
    fn until(&self, time: f64) -> Matrix3<f64>;

    /// The homography from a time back to the path's first instant.
    fn back(&self, time: f64) -> Matrix3<f64>;
}

/// A path without motion.
#[cfg(feature = "unstable")]
#[derive(Clone, Copy, Debug, Default)]
pub struct Still;

#[cfg(feature = "unstable")]
impl Path for Still {
    fn until(&self, _: f64) -> Matrix3<f64> {
        Matrix3::identity()
    }

    fn back(&self, _: f64) -> Matrix3<f64> {
        Matrix3::identity()
    }
}
