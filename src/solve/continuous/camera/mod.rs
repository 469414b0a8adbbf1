// SPDX-License-Identifier: MIT OR Apache-2.0

//! The posterior of the camera: hypotheses, their evidence, and the schedule of their trials.

mod evidence;
mod given;
mod hypothesis;
mod posterior;
mod schedule;

pub use given::{Camera, READOUT_BELIEF};
pub use hypothesis::Hypothesis;
pub use posterior::{Break, CameraPosterior};
