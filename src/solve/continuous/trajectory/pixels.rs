//! The path as those see it who know pixels and seconds only.

use crate::solve::continuous::fit::solver::Solver;
use crate::solve::residual::Path;
use nalgebra::{Matrix3, Vector2};

/// A solver's path in pixels, with times in seconds after a frame's timestamp.
pub struct PixelPath<'a> {
    pub solver: &'a Solver,
    /// The frame's timestamp and the seconds to a frame period.
    pub frame: f64,
    pub unit: f64,
    pub centre: Vector2<f64>,
    pub radius: f64,
}

impl PixelPath<'_> {
    fn instant(&self, time: f64) -> f64 {
        // Where the far edge is read first, γ is negative and the first exposure that much before the stamp.
        let start = self.frame + self.solver.shared[0].min(0.0);
        self.solver.time(start + time / self.unit, 0.0)
    }

    fn in_pixels(&self, homography: Matrix3<f64>) -> Matrix3<f64> {
        let scaled = |factor: f64| Matrix3::new_nonuniform_scaling(&Vector2::new(factor, factor));
        let to = Matrix3::new_translation(&self.centre) * scaled(self.radius);
        to * homography * scaled(1.0 / self.radius) * Matrix3::new_translation(&-self.centre)
    }
}

impl Path for PixelPath<'_> {
    fn until(&self, time: f64) -> Matrix3<f64> {
        self.in_pixels(self.solver.flow.until(self.instant(time)))
    }

    fn back(&self, time: f64) -> Matrix3<f64> {
        self.in_pixels(self.solver.flow.back(self.instant(time)))
    }
}
