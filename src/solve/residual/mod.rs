//! The residual field: what parallax and things that move on their own add to the global path.
//!
//! The flow of a frame to a neighbour says where the global path is wrong: the point of a cell lies at x′ in the
//! neighbour, where the path carries it to x̂. Over the time between the two exposures that is the residual velocity
//!
//! > v = (x′ − x̂) / (t′ − t).
//!
//! It is applied with the path's own row timing: a point exposed at share s is shown v·(ref − s) further, with v in
//! pixels per whole readout.
//!
//! | step | file |
//! |---|---|
//! | flow to both neighbours → residual velocity of each cell, with its information | `velocity` |
//! | velocities of all cells → the posterior of each | `diffuse` |
//!
//! The field is the posterior mean of a Gaussian Markov random field: a prior of mean zero (the path) with the variance
//! that residual velocities have in the frame, and neighbouring cells that differ by a random step. The information of a
//! flow has a direction, so that along edges and stripes, where the picture says nothing, its surroundings and the path
//! decide.

mod diffuse;
mod frame_flow;
mod local;
mod path;
mod solver;
mod velocity;

pub use frame_flow::FrameFlow;
pub use local::{LocalMotion, LocalMotions};
pub use path::{Path, Still};
pub use solver::{CellVelocities, REGIONS, Region, ResidualSolver};
