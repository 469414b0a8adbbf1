//! Takes rolling-shutter distortion (lean, jello, wobble, stretch) out of video from **unknown**
//! cameras: no gyroscope, no calibration, no metadata.
//!
//! The library knows nothing of any media framework: it is given borrowed image planes and their
//! times, and gives back the motion of each frame and rectified planes.
//!
//! Data flows one way, and no module imports from a later one:
//!
//! | module | from | to |
//! |---|---|---|
//! | [`plane`] | bytes | borrowed views of image planes |
//! | [`readout`] | direction, time, delay | when a point of a frame was exposed |
//! | [`pyramid`] | a luma plane | the same at several resolutions |
//! | [`flow`] | two pyramids | dense optical flow |
//! | [`correspond`] | flow | point correspondences at a grid, to sub-pixel accuracy |
//! | [`motion`] | | what an image motion is: the twist, the path over a readout |
//! | [`solve`] | correspondences of a window | a motion path for each frame |
//! | [`warp`] | a path and a plane | the rectified plane |
//! | [`rectifier`] | luma planes, one by one | the motions, in order |
//!
//! Equation numbers 25.n cite *A Rectification Method for Removing Rolling Shutter Distortion*
//! (chapter 25), from which the method starts.

// Whoever embeds it owns the terminal.
#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr))]

pub mod correspond;
pub mod cpu;
pub mod flow;
pub mod motion;
pub mod plane;
pub mod pyramid;
pub mod readout;
pub mod rectifier;
pub mod solve;
pub mod warp;

pub use cpu::CpuLevel;
pub use plane::{Plane, PlaneMut};
pub use rectifier::Rectifier;
pub use warp::Warper;

/// The README's example is a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
