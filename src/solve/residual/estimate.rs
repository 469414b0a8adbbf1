// SPDX-License-Identifier: MIT OR Apache-2.0

//! The estimate of the velocity of a cell, with its information.

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
}
