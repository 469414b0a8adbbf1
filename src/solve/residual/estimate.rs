// SPDX-License-Identifier: MIT OR Apache-2.0

//! The estimate of the velocity of a cell, with its information.

use crate::lanes::FLOATS;

/// Information about a vector (xx, xy, yy), and that times the vector (x, y); the numbers after these are 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct VelocityEstimate(pub(super) [f32; FLOATS]);

impl VelocityEstimate {
    #[inline(always)]
    pub(super) fn new([xx, xy, yy]: [f32; 3], [x, y]: [f32; 2]) -> Self {
        Self([xx, xy, yy, xx * x + xy * y, xy * x + yy * y, 0.0, 0.0, 0.0])
    }

    /// The same information about another value.
    #[inline(always)]
    pub(super) fn with_value(self, value: [f32; 2]) -> Self {
        let [xx, xy, yy, ..] = self.0;
        Self::new([xx, xy, yy], value)
    }

    /// The product of two independent likelihoods.
    #[inline(always)]
    pub(super) fn plus(self, other: Self) -> Self {
        Self(std::array::from_fn(|k| self.0[k] + other.0[k]))
    }

    /// The product with a prior of mean zero and this information along each axis.
    #[inline(always)]
    pub(super) fn plus_prior(mut self, prior: f32) -> Self {
        self.0[0] += prior;
        self.0[2] += prior;
        self
    }

    /// Sum of the variances along both axes.
    pub(super) fn variance(&self) -> f32 {
        let [xx, xy, yy, ..] = self.0;
        self.trace() / (xx * yy - xy * xy).max(f32::MIN_POSITIVE)
    }

    /// Sum of the information along both axes.
    pub(super) fn trace(&self) -> f32 {
        self.0[0] + self.0[2]
    }

    /// The mean; zero if the information is singular.
    #[inline(always)]
    pub(super) fn value(&self) -> [f32; 2] {
        let [xx, xy, yy, x, y, ..] = self.0;
        let determinant = xx * yy - xy * xy;
        if determinant > 0.0 {
            let share = 1.0 / determinant;
            [(yy * x - xy * y) * share, (xx * y - xy * x) * share]
        } else {
            [0.0; 2]
        }
    }
}
