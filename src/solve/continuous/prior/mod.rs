//! What is believed beforehand: how smooth the path is, and what γ and κ are.

pub mod belief;
pub mod camera_belief;
pub mod prediction;
pub mod smoothness;
