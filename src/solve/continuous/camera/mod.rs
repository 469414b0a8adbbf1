//! The posterior of the camera: hypotheses, their evidence, and when they are tried.

pub mod evidence;
pub mod given;
pub mod hypothesis;
pub mod posterior;
pub mod schedule;
