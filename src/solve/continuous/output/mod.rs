//! What is given out of a frame: its expected error, and how its correspondences fit.

mod expected_error;
mod fitted;

pub use fitted::FittedPair;
