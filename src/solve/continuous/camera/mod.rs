//! The posterior of the camera: hypotheses, their evidence, and when they are tried.

pub mod bank;
pub mod evidence;
pub mod given;
pub mod hypothesis;
