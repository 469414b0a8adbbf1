//! What is believed beforehand: how smooth the path is, and what γ and κ are.

mod belief;
mod camera_belief;
mod prediction;
mod smoothness;

pub use belief::{Belief, REMEMBERED};
pub use camera_belief::{CameraBelief, Observation};
pub use smoothness::Smoothness;
