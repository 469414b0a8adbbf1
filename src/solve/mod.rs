//! Correspondences of a window → a motion path for each frame.
//!
//! | file | the paper's |
//! |---|---|
//! | [`measurement`] | measurement constraint 25.4 and its sparse Levenberg–Marquardt |
//! | `start` | (robust initial estimate; not in the paper) |
//! | [`link`] | one pair: uniform rotation 25.6, sequential steps 25.7–25.10 |
//! | [`continuous`] | (a path over a window of frames with its readout, which the paper takes as known) |
//! | [`residual`] | (residual velocities of parallax and moving objects; not in the paper) |
//! | [`window`] | least E over the window, both directions, final choice 25.4.1.3 |
//!
//! All times are exposure times t = t_k + T·s, so that any frame rate, dropped frames and reverse
//! playback are handled without special cases; see [`readout`](crate::readout).

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
pub use solution::{FittedCorrespondence, FocalLength, FrameSolution, Origin, root_mean_square};
pub use window::{MotionCandidate, Window};

#[cfg(test)]
mod tests;
