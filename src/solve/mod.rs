//! Correspondences of a window → a motion path for each frame.
//!
//! | file | the paper's |
//! |---|---|
//! | [`measurement`] | measurement constraint 25.4 and its sparse Levenberg–Marquardt |
//! | `start` | (a start that survives outliers; the paper has none) |
//! | [`link`] | one pair: uniform rotation 25.6, sequential steps 25.7–25.10 |
//! | [`continuous`] | (a path through all frames of a window, and with it readout time and direction; the paper takes these as known) |
//! | [`residual`] | (what parallax adds to the global path; the paper has none) |
//! | [`window`] | least E over the window, both directions, final choice 25.4.1.3 |
//!
//! The only clock is the exposure time t = t_k + T·s, so that any frame rate, dropped frame or
//! reverse playback is right; see the [`readout`](crate::readout).

pub mod continuous;
pub mod link;
pub mod measurement;
#[cfg(test)]
mod random;
pub mod residual;
mod solution;
mod start;
pub mod window;

pub use link::{Fit, Link};
pub use solution::{FittedCorrespondence, FocalLength, FrameSolution, root_mean_square};
pub use window::{Candidate, Origin, Window};

#[cfg(test)]
mod tests;
