// SPDX-License-Identifier: MIT OR Apache-2.0

//! Dense optical flow: the motion of every pixel from one frame to another.
//!
//! After D. Sun, S. Roth, M. J. Black, *Secrets of Optical Flow Estimation and Their Principles*, CVPR
//! 2010, from which the paper of the method takes its correspondences. This is their *Classic* recipe
//! with a Charbonnier penalty: texture decomposition, a pyramid, on each level several warps with
//! cubic interpolation, and a 5 × 5 median of the flow after each. Unlike theirs, the energy is
//! convex from the start (no graduated non-convexity), the weights of a step in u and v are shared, the
//! sizes of the levels go by halves, each level has its own texture and the median is not weighted.
//!
//! A flow of 640 × 480 pixels takes about 0.7 s of one core (optimised for speed, without AVX): half of
//! it for 2 × 5 · 3 · 10 half-sweeps of the solver on the full level, a tenth for the median. It holds
//! some 25 numbers a pixel at a time, 30 MB.
//!
//! | module | what it holds |
//! |---|---|
//! | [`image`] | pictures of one channel: halving, interpolation, derivatives |
//! | [`texture`] | a picture less its large structure |
//! | [`board`] | a picture in the order of a chessboard, for the solver |
//! | [`solver`] | the robust energy around one warp, minimised |
//! | `prepared` | a frame and the pyramid of its texture |
//! | `field` | the displacement of each pixel |
//! | `estimate` | coarse to fine |
//! | [`median`] | the median filter |
//! | [`points`] | correspondences out of the flow |

pub mod board;
mod estimate;
mod field;
pub mod image;
pub mod median;
pub mod points;
mod prepared;
pub mod solver;
pub mod texture;

pub use field::Flow;
pub use prepared::Prepared;

#[cfg(test)]
mod tests;
