// SPDX-License-Identifier: MIT OR Apache-2.0

//! Takes rolling-shutter distortion (lean, jello, wobble, stretch) out of video from **unknown**
//! cameras: no gyroscope, no calibration, no metadata.
//!
#![doc = include_str!("../docs/library.md")]
//!
//! # Modules
//!
//! Data flows one way, and no module imports from a later one:
//!
//! | module | from | to |
//! |---|---|---|
//! | [`plane`] | bytes | borrowed views of image planes |
//! | [`area`] | | where the picture lies in its frame |
//! | [`readout`] | direction, time, delay | exposure time of each point of a frame |
//! | `pyramid` | a luma plane | its image pyramid |
//! | `robust` | residuals | robust losses, the median, the motion that most displacements share |
//! | `flow` | two pyramids | dense optical flow |
//! | `correspond` | flow | point correspondences on a grid, to sub-pixel accuracy |
//! | [`motion`] | | representations of image motion: the twist, the path over a readout, the residual field |
//! | `solve` | correspondences of a window | a motion path for each frame |
//! | `stabilize` | motions from frame to frame | the placement of each frame in a steady picture |
//! | [`warp`] | a path and a plane | the rectified plane |
//! | [`rectifier`] | luma planes, in order | the motions, in order |
//!
//! Modules without a link are private, except with the feature `unstable`.
//!
//! # Features
//!
//! | feature | default | |
//! |---|---|---|
//! | `rayon` | yes | distributes the work over the threads of the rayon pool in which the library is called, the global one by default; without it all work is done on the calling thread, with the same results |
//! | `unstable` | no | makes the other modules public, for the project's own tools; they are not covered by semantic versioning |
//!
//! Equation numbers 25.n cite *A Rectification Method for Removing Rolling Shutter Distortion*
//! (chapter 25), from which the method starts.

// A library must not write to the terminal of its user.
#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr))]

mod lanes;
mod parallel;
mod stabilize;

pub mod area;
pub mod motion;
pub mod plane;
pub mod readout;
pub mod rectifier;
pub mod warp;

#[cfg(feature = "unstable")]
pub mod correspond;
#[cfg(feature = "unstable")]
pub mod cpu;
#[cfg(feature = "unstable")]
pub mod flow;
#[cfg(feature = "unstable")]
pub mod pyramid;
#[cfg(feature = "unstable")]
pub mod robust;
#[cfg(feature = "unstable")]
pub mod solve;

#[cfg(not(feature = "unstable"))]
mod correspond;
#[cfg(not(feature = "unstable"))]
mod cpu;
#[cfg(not(feature = "unstable"))]
mod flow;
#[cfg(not(feature = "unstable"))]
mod pyramid;
#[cfg(not(feature = "unstable"))]
mod robust;
#[cfg(not(feature = "unstable"))]
mod solve;

/// The linear algebra of [`motion`], in the version used in the public interface.
pub use nalgebra;

pub use area::PictureArea;
pub use cpu::CpuLevel;
pub use plane::{Plane, PlaneMut, SampleFormat};
pub use rectifier::{Duplicate, Rectifier, Settings};
pub use warp::{FrameLayout, WarpSettings, Warper};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_may_share_everything() {
        fn check<T: Send + Sync + 'static>() {}
        check::<Rectifier>();
        check::<rectifier::Settings>();
        check::<rectifier::FrameSolution>();
        check::<rectifier::FittedCorrespondence>();
        check::<rectifier::SettingsError>();
        check::<rectifier::PushError>();
        check::<Warper>();
        check::<warp::PreparedFrame<'static>>();
        check::<warp::FrameLayout>();
        check::<warp::WarpSettings>();
        check::<warp::WarpError>();
        check::<motion::FrameMotion>();
        check::<motion::MotionPath>();
        check::<motion::file::MotionFile>();
        check::<motion::file::MotionFileError>();
        check::<motion::file::MotionRecord>();
        check::<motion::MeshError>();
        check::<motion::PathError>();
        check::<readout::Readout>();
        check::<readout::ReadoutError>();
        check::<Plane<'static>>();
        check::<PlaneMut<'static>>();
        check::<plane::Luma<'static>>();
        check::<plane::LumaError>();
        check::<plane::PlaneError>();
        check::<PictureArea>();
        check::<CpuLevel>();
    }
}
