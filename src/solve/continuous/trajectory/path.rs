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
        let [from, to] = [self.block(from) - MARGIN, self.block(to) + MARGIN];
        let base = from.floor() as i64;
        self.splines.kappa = kappa;
        self.splines.shift(base, (to.floor() as i64 - base + KNOTS as i64) as usize);
        self.homographies.integrate(&self.splines, [from, to], self.radius);
    }

    /// A path with these coefficients between two blocks.
    #[cfg(test)]
    pub fn of(splines: Splines, density: KnotDensity, radius: f64, blocks: [f64; 2]) -> Self {
        let mut trajectory = Self { splines, ..Self::new(density, radius) };
        trajectory.homographies.integrate(&trajectory.splines, blocks, radius);
        trajectory
    }
}
