// SPDX-License-Identifier: MIT OR Apache-2.0

//! The path about a frame in pixels and seconds.

use super::path::Trajectory;
use crate::solve::residual::Path;
use nalgebra::{Matrix3, Vector2};

/// Adapter of a path to pixels, and to seconds after the timestamp of a frame.
#[derive(Clone, Copy, Debug)]
pub struct FramePath<'a> {
    pub trajectory: &'a Trajectory,
    /// Exposure time of the first line, in frame periods.
    pub first: f64,
    /// Seconds to a frame period.
    pub period: f64,
    /// Image centre in pixels.
    pub centre: Vector2<f64>,
    /// Pixels to a radius.
    pub radius: f64,
}

impl FramePath<'_> {
    fn block(&self, time: f64) -> f64 {
        self.trajectory.block(self.first + time / self.period)
    }

    fn in_pixels(&self, homography: Matrix3<f64>) -> Matrix3<f64> {
        let scaled = |factor: f64| Matrix3::new_nonuniform_scaling(&Vector2::new(factor, factor));
        let to = Matrix3::new_translation(&self.centre) * scaled(self.radius);
        to * homography * scaled(1.0 / self.radius) * Matrix3::new_translation(&-self.centre)
    }
}

impl Path for FramePath<'_> {
    fn until(&self, time: f64) -> Matrix3<f64> {
        self.in_pixels(self.trajectory.homographies.until(self.block(time)))
    }

    fn back(&self, time: f64) -> Matrix3<f64> {
        self.in_pixels(self.trajectory.homographies.back(self.block(time)))
    }
}
