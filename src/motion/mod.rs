// SPDX-License-Identifier: MIT OR Apache-2.0

//! Representations of image motion: the twist, the path over a readout, the residual field.
//!
//! Points are *centred*: pixels from the image centre ((W − 1)/2, (H − 1)/2), y down.

mod displacement;
pub mod file;
mod frame;
pub(crate) mod generators;
mod path;
mod precision;
mod residual;
mod sampled;
mod twist;

pub use frame::FrameMotion;
pub use generators::Model;
pub(crate) use path::project;
pub use path::{IntervalMotion, MotionPath};
pub(crate) use precision::{rounded_homography, rounded_velocity};
pub use residual::{MeshError, ResidualField, ResidualMesh};
pub(crate) use sampled::{PATH_STEPS, scaled};
pub use sampled::{PathError, SampledPath};
pub use twist::{Rigid, Twist};

use nalgebra::Vector2;

/// The image centre in pixels (pixel centres at integers): the origin of centred points.
#[must_use]
pub fn image_centre(width: usize, height: usize) -> Vector2<f64> {
    Vector2::new((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0)
}
