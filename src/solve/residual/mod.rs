// SPDX-License-Identifier: MIT OR Apache-2.0

//! The residual field: velocities beside the global path, from parallax and independently moving objects.
//!
//! The flow of a frame to a neighbour measures the error of the global path: the point of a cell lies at x′
//! in the neighbour, and the path predicts x̂. Divided by the time between the two exposures that is the
//! residual velocity
//!
//! > v = (x′ − x̂) / (t′ − t).
//!
//! It is applied with the row timing of the path: a point exposed at share s is moved by v·(ref − s), with v
//! in pixels per whole readout.
//!
//! | step | file |
//! |---|---|
//! | flow to both neighbours → residual velocity of each cell, with its information | `velocity` |
//! | velocities of all cells → the posterior of each | `diffuse`, with the messages of `chains` |
//!
//! The field is the posterior mean of a Gaussian Markov random field: a prior of mean zero (the path) with
//! the variance that residual velocities have in the frame, without that of their measurement, and neighbouring cells
//! that differ by a random step. The information of the flow is a matrix: along edges and stripes, where it is zero, the neighbouring
//! cells and the path determine the velocity.

mod chains;
mod diffuse;
mod estimate;
mod frame_flow;
mod local;
mod path;
mod solver;
mod velocity;

#[cfg(feature = "unstable")]
pub use frame_flow::FrameFlow;
pub use local::{LocalMotion, LocalMotions};
pub use path::Path;
#[cfg(feature = "unstable")]
pub use path::Still;
#[cfg(feature = "unstable")]
pub use solver::{CellVelocities, ResidualSolver};
pub use solver::{REGIONS, Region};
