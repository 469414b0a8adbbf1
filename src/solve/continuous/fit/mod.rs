//! The fit of a path, γ and κ to the pairs of a window.

pub mod multistart;
pub mod solver;
