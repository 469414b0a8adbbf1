//! The motion path of a window.

use super::homographies::{Homographies, Instant};
use super::knots::KnotDensity;
use super::splines::Splines;
use nalgebra::{Matrix3, Vector2};

/// Blocks before the first exposure and after the last that the path covers: points may leave the frame, and the readout may
/// turn out longer.
const MARGIN: f64 = 0.25;

/// The motion path of a window.
///
/// The coefficients of the splines are what is estimated; homographies and rates follow from them. Its clock counts blocks, of
/// which [`KnotDensity::blocks`] make a frame period.
#[derive(Clone, Debug, Default)]
pub struct Trajectory {
    density: KnotDensity,
    /// Pixels to the unit of points.
    radius: f64,
    pub splines: Splines,
    homographies: Homographies,
}

impl Trajectory {
    /// A path without coefficients, for points in units of `radius` pixels.
    pub fn new(density: KnotDensity, radius: f64) -> Self {
        Self { density, radius, ..Self::default() }
    }

    pub fn density(&self) -> KnotDensity {
        self.density
    }

    /// Pixels to the unit of points.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Block of an instant in frame periods.
    pub fn block(&self, instant: f64) -> f64 {
        self.density.blocks() * instant
    }

    /// Removes the coefficients.
    pub fn clear(&mut self) {
        self.splines.coefficients.clear();
    }

    /// Moves on to the instants between these, in frame periods, and integrates the homographies there. Blocks that are new
    /// continue at the last rate.
    pub fn cover(&mut self, [from, to]: [f64; 2], kappa: f64) {
        if from > to {
            return;
        }
        let [from, to] = [self.block(from) - MARGIN, self.block(to) + MARGIN];
        let base = from.floor() as i64;
        self.splines.kappa = kappa;
        self.splines.shift(base, (to.floor() as i64 - base + 4) as usize);
        self.integrate([from, to]);
    }

    /// Integrates the homographies between two blocks.
    fn integrate(&mut self, blocks: [f64; 2]) {
        self.homographies.integrate(&self.splines, blocks, self.radius);
    }

    /// Forgets the homographies, so that nothing is covered.
    pub fn forget_homographies(&mut self) {
        self.homographies = Homographies::default();
    }

    /// The path at a block; `None` where nothing was integrated.
    pub fn at(&self, block: f64) -> Option<Instant<'_>> {
        self.homographies.at(block)
    }

    /// Whether a block lies within what is covered.
    pub fn covers(&self, block: f64) -> bool {
        self.homographies.covers(block)
    }

    /// Where a point seen at block `from` is at block `to`.
    pub fn carry(&self, point: Vector2<f64>, from: f64, to: f64) -> Vector2<f64> {
        self.homographies.carry(point, from, to)
    }

    /// The homography from the first instant to a block.
    pub fn until(&self, block: f64) -> Matrix3<f64> {
        self.homographies.until(block)
    }

    /// The homography from a block back to the first instant.
    pub fn back(&self, block: f64) -> Matrix3<f64> {
        self.homographies.back(block)
    }

    /// A path with these coefficients between two blocks.
    #[cfg(test)]
    pub fn of(splines: Splines, density: KnotDensity, radius: f64, blocks: [f64; 2]) -> Self {
        let mut trajectory = Self { splines, ..Self::new(density, radius) };
        trajectory.integrate(blocks);
        trajectory
    }
}
