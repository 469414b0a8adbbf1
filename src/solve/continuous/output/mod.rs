//! What is given out of a frame.

pub mod expected_error;
pub mod fitted;
