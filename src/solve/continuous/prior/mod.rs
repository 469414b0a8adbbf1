// SPDX-License-Identifier: MIT OR Apache-2.0

//! Priors: on the smoothness of the path, and on γ and κ.

mod belief;
mod camera_belief;
mod prediction;
mod smoothness;

pub use belief::{Belief, MAX_DEVIATIONS, MEMORY};
pub use camera_belief::{CameraBelief, Observation, READOUT_DEVIATION};
pub use smoothness::Smoothness;
