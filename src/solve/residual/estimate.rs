// SPDX-License-Identifier: MIT OR Apache-2.0

//! What is known of the velocity of a cell, and what of it is passed on to the next cell.

use crate::robust::loss::{GemanMcClure, Loss};

/// Squared distance of a message from a cell's own estimate, in units of their summed variances, at which its
/// weight is ¼.
pub(super) const QUARTER_WEIGHT_DISTANCE: f32 = 4.0;

/// Information about a vector (xx, xy, yy), and that times the vector.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct VelocityEstimate {
    pub(super) information: [f32; 3],
    pub(super) sum: [f32; 2],
}

impl VelocityEstimate {
    #[inline(always)]
    pub(super) fn new(information: [f32; 3], value: [f32; 2]) -> Self {
        Self { information, sum: [0.0; 2] }.with_value(value)
    }

    /// The same information about another value.
    #[inline(always)]
    pub(super) fn with_value(self, [x, y]: [f32; 2]) -> Self {
        let [xx, xy, yy] = self.information;
        Self { sum: [xx * x + xy * y, xy * x + yy * y], ..self }
    }

    /// The product of two independent likelihoods.
    #[inline(always)]
    pub(super) fn plus(self, other: Self) -> Self {
        Self {
            information: std::array::from_fn(|k| self.information[k] + other.information[k]),
            sum: std::array::from_fn(|k| self.sum[k] + other.sum[k]),
        }
    }

    /// The product with a prior of mean zero and this information along each axis.
    #[inline(always)]
    pub(super) fn plus_prior(self, prior: f32) -> Self {
        let [xx, xy, yy] = self.information;
        Self { information: [xx + prior, xy, yy + prior], ..self }
    }

    /// Sum of the variances along both axes.
    pub(super) fn variance(&self) -> f32 {
        let [xx, xy, yy] = self.information;
        self.trace() / (xx * yy - xy * xy).max(f32::MIN_POSITIVE)
    }

    /// Sum of the information along both axes.
    pub(super) fn trace(&self) -> f32 {
        self.information[0] + self.information[2]
    }

    /// The squared Mahalanobis norm of a vector.
    #[inline(always)]
    fn squared_norm(&self, [x, y]: [f32; 2]) -> f32 {
        let [xx, xy, yy] = self.information;
        xx * x * x + 2.0 * xy * x * y + yy * y * y
    }

    #[inline(always)]
    fn times(self, share: f32) -> Self {
        Self {
            information: self.information.map(|value| share * value),
            sum: self.sum.map(|value| share * value),
        }
    }

    /// The mean; zero if the information is singular.
    #[inline(always)]
    pub(super) fn value(&self) -> [f32; 2] {
        let ([xx, xy, yy], [x, y]) = (self.information, self.sum);
        let determinant = xx * yy - xy * xy;
        if determinant > 0.0 {
            let share = 1.0 / determinant;
            [(yy * x - xy * y) * share, (xx * y - xy * x) * share]
        } else {
            [0.0; 2]
        }
    }

    /// The message to the next cell, a random step of variance q away: (I + q·Λ)⁻¹ times information and sum.
    #[inline(always)]
    pub(super) fn after_step(&self, q: f32) -> Self {
        let ([xx, xy, yy], [x, y]) = (self.information, self.sum);
        let (trace, determinant) = (xx + yy, (xx * yy - xy * xy).max(0.0));
        let share = 1.0 / (1.0 + q * trace + q * q * determinant);
        Self {
            information: [(xx + q * determinant) * share, xy * share, (yy + q * determinant) * share],
            sum: [(x + q * (yy * x - xy * y)) * share, (y + q * (xx * y - xy * x)) * share],
        }
    }

    /// The message, down-weighted where it contradicts the cell's own measurement; `value` is the cell's
    /// posterior without the message.
    #[inline(always)]
    pub(super) fn accept(&self, value: [f32; 2], message: &Self) -> Self {
        let other = message.value();
        let difference = [value[0] - other[0], value[1] - other[1]];
        let (own, other) = (self.squared_norm(difference), message.squared_norm(difference));
        // The variances of the two along their difference add up.
        let square = own * other / (own + other + f32::MIN_POSITIVE);
        message.times(GemanMcClure(QUARTER_WEIGHT_DISTANCE).weight(square))
    }
}
