// SPDX-License-Identifier: MIT OR Apache-2.0

//! The results of a frame: its expected error, and the residuals of its correspondences.

mod expected_error;
mod fitted;

pub use expected_error::Expected;
pub use fitted::FittedPair;
