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
mod median;
#[cfg(test)]
mod random;
pub mod residual;
mod start;
pub mod window;

pub use link::{Fit, Link};
pub use window::{MotionCandidate, Origin, Window};

#[cfg(test)]
mod tests;

/// Root mean square; `None` for no values.
#[must_use]
pub fn root_mean_square(values: &[f64]) -> Option<f64> {
    let mean_square = values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64;
    (!values.is_empty()).then(|| mean_square.sqrt())
}
