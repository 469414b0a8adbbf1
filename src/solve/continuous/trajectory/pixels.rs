//! The path about a frame in pixels and seconds.

use super::path::Trajectory;
use crate::solve::residual::Path;
use nalgebra::{Matrix3, Vector2};

/// The path about a frame, in pixels, with times in seconds after the timestamp of the frame.
#[derive(Clone, Copy, Debug)]
pub struct FramePath<'a> {
    pub trajectory: &'a Trajectory,
    /// Instant in frame periods at which the first line is exposed.
    pub first: f64,
    /// Seconds to a frame period.
    pub period: f64,
    /// Image centre in pixels.
    pub centre: Vector2<f64>,
    /// Pixels to the unit of points.
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
        self.in_pixels(self.trajectory.until(self.block(time)))
    }

    fn back(&self, time: f64) -> Matrix3<f64> {
        self.in_pixels(self.trajectory.back(self.block(time)))
    }
}
