// SPDX-License-Identifier: MIT OR Apache-2.0

//! The motion path: splines over exposure time, and the homographies that they define.

mod homographies;
mod knots;
mod path;
mod pixels;
pub mod spline;
mod splines;

pub use knots::KnotDensity;
pub use path::Trajectory;
pub use pixels::FramePath;
pub use splines::{BLOCK, Splines, ratio};
