//! How far a rectified frame is from the truth.

pub mod displacement;

pub use displacement::{Stats, distances};
