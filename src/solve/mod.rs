// SPDX-License-Identifier: MIT OR Apache-2.0

//! Correspondences of a window → a motion path for each frame.
//!
//! | module | |
//! |---|---|
//! | [`sequential`] | the paper's estimator, with the readout given |
//! | [`continuous`] | a path over a window of frames, with its readout |
//! | [`residual`] | residual velocities of parallax and moving objects beside the path |
//! | `frame_timing` | whether frames were exposed when their timestamps say so |
//! | `as_recorded` | why a frame keeps its picture |
//! | `pairs` | which pairs of frames are fitted, and when a fit explains their motion |
//! | `solution` | what either estimator returns for a frame |
//!
//! All times are exposure times t = t_k + T·s, so that any frame rate, dropped frames and reverse
//! playback are handled without special cases; see [`readout`](crate::readout).

mod as_recorded;
pub mod continuous;
mod frame_timing;
pub(crate) mod pairs;
#[cfg(test)]
mod random;
pub mod residual;
pub mod sequential;
mod solution;

pub use as_recorded::AsRecorded;
pub use frame_timing::{FrameTiming, Timeline};
pub use sequential::link::Link;
pub use sequential::window::{MotionCandidate, Window};
pub use solution::{FittedCorrespondence, FocalLength, FrameSolution, Origin};
