// SPDX-License-Identifier: MIT OR Apache-2.0

//! The motion path of a window.

use super::homographies::Homographies;
use super::knots::KnotDensity;
use super::spline::KNOTS;
use super::splines::Splines;

/// Blocks covered beyond the exposures: points may leave the frame, and the readout may get longer.
const MARGIN: f64 = 0.25;

/// The motion path of a window. The splines' coefficients are estimated; homographies follow from them.
#[derive(Clone, Debug, Default)]
pub struct Trajectory {
    pub density: KnotDensity,
    /// Pixels to a radius.
    pub radius: f64,
    /// Blocks of the first and the last exposure.
    exposures: [f64; 2],
    pub splines: Splines,
    pub homographies: Homographies,
}

impl Trajectory {
    /// A path without coefficients; `radius` in pixels.
    pub fn new(density: KnotDensity, radius: f64) -> Self {
        Self { density, radius, ..Self::default() }
    }

    /// Block of an instant in frame periods.
    #[inline(always)]
    pub fn block(&self, instant: f64) -> f64 {
        self.density.blocks() * instant
    }

    /// Block at which the lines at a place along the scan axis are exposed: at t = t_k + γ·p, t_k being the timestamp.
    #[inline(always)]
    pub fn exposure(&self, stamp: f64, gamma: f64, place: f64) -> f64 {
        self.block(stamp + gamma * place)
    }

    /// Moves to these instants, in frame periods, and integrates there. New blocks continue at the last rate.
    pub fn cover(&mut self, [from, to]: [f64; 2], kappa: f64) {
        if from > to {
            return;
        }
        self.exposures = [self.block(from), self.block(to)];
        let [from, to] = [self.exposures[0] - MARGIN, self.exposures[1] + MARGIN];
        let base = from.floor() as i64;
        self.splines.kappa = kappa;
        self.splines.shift(base, (to.floor() as i64 - base + KNOTS as i64) as usize);
        self.homographies.integrate(&self.splines, [from, to], self.radius);
    }

    /// Extends the rows of a band, given by their first columns, to hold the covariance of the motion between the middle of the
    /// readout and any line, in the first frame and in the last: beyond their outermost matches nothing else couples the knots.
    pub fn reach(&self, gamma: f64, first: &mut [usize]) {
        let [from, to] = self.exposures;
        let half = 0.5 * self.block(gamma.abs());
        for span in [[from, from + half], [to - half, to]] {
            let places = self.splines.supporting(span);
            let least = places.clone().min().unwrap_or(0);
            places.for_each(|place| first[place] = first[place].min(least));
        }
    }

    /// A path with these coefficients between two blocks.
    #[cfg(test)]
    pub fn of(splines: Splines, density: KnotDensity, radius: f64, blocks: [f64; 2]) -> Self {
        let mut trajectory = Self { splines, ..Self::new(density, radius) };
        trajectory.homographies.integrate(&trajectory.splines, blocks, radius);
        trajectory
    }
}
