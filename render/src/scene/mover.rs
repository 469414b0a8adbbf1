// SPDX-License-Identifier: MIT OR Apache-2.0

//! Rigid objects that move on their own.

use super::camera::{CameraPath, Pose};
use super::path::Oscillations;
use nalgebra::Vector3;

/// A rigid object's motion: oscillations about a place where it would rest.
///
/// Surfaces that belong to a mover are given in its own axes, with the origin at its resting place.
#[derive(Clone, Debug, PartialEq)]
pub struct Mover {
    /// Where its origin would rest, in metres (world axes).
    pub rest: Vector3<f64>,
    /// Its turns about that origin and its shifts from it.
    pub path: Oscillations,
}

impl Mover {
    /// Takes the mover's axes to those of the world at time `t` (seconds).
    pub fn pose(&self, t: f64) -> Pose {
        let pose = self.path.pose(t);
        Pose { position: self.rest + pose.position, ..pose }
    }
}
