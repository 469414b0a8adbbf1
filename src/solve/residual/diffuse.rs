// SPDX-License-Identifier: MIT OR Apache-2.0

//! Vectors on a grid of cells, each measured with its own information: the posterior of each, given all.
//!
//! In a Gaussian Markov random field neighbouring vectors differ by a random step of variance q along each
//! axis. As on a chain, messages are passed along the rows and along the columns, in both directions:
//!
//! > message = (Λ⁻¹ + q·I)⁻¹, Λ = own information + prior + message of the previous cell
//!
//! and a cell's posterior is the sum of its own information, the prior and the four messages (belief
//! propagation, cut off after one sweep along each axis). A message that contradicts a cell's measurement
//! indicates a depth edge between them and is down-weighted.

use crate::parallel::*;
use crate::robust::loss::{GemanMcClure, Loss};

/// Squared distance of a message from a cell's own estimate, in units of their summed variances, at which its
/// weight is ¼.
const QUARTER_WEIGHT_DISTANCE: f32 = 4.0;

/// Information about a vector (xx, xy, yy), and that times the vector.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct VelocityEstimate {
    information: [f32; 3],
    sum: [f32; 2],
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
    fn after_step(&self, q: f32) -> Self {
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
    fn accept(&self, value: [f32; 2], message: &Self) -> Self {
        let other = message.value();
        let difference = [value[0] - other[0], value[1] - other[1]];
        let (own, other) = (self.squared_norm(difference), message.squared_norm(difference));
        // The variances of the two along their difference add up.
        let square = own * other / (own + other + f32::MIN_POSITIVE);
        message.times(GemanMcClure(QUARTER_WEIGHT_DISTANCE).weight(square))
    }
}

/// Smoothness and prior of the field.
#[derive(Clone, Copy, Debug)]
pub(super) struct FieldPrior {
    /// Cells in a row.
    pub(super) columns: usize,
    /// Variance q of the step from one cell to the next.
    pub(super) step: f32,
    /// Prior information of each cell, about zero.
    pub(super) prior: f32,
}

impl FieldPrior {
    /// The posterior of each cell from the measurements of all.
    pub(super) fn posterior(&self, own: &[VelocityEstimate], out: &mut Vec<VelocityEstimate>) {
        out.clear();
        out.extend(own.iter().map(|own| own.plus_prior(self.prior)));
        let columns = self.columns.max(1);
        out.par_chunks_mut(columns).zip(own.par_chunks(columns)).for_each(|(out, own)| {
            let mut message = VelocityEstimate::default();
            for (out, own) in out.iter_mut().zip(own) {
                message = self.pass(own, message, out);
            }
            message = VelocityEstimate::default();
            for (out, own) in out.iter_mut().zip(own).rev() {
                message = self.pass(own, message, out);
            }
        });
        // Row by row, for contiguous memory access.
        let mut messages = vec![VelocityEstimate::default(); columns];
        for (out, own) in out.chunks_mut(columns).zip(own.chunks(columns)) {
            self.pass_row(own, &mut messages, out);
        }
        messages.fill(VelocityEstimate::default());
        for (out, own) in out.chunks_mut(columns).zip(own.chunks(columns)).rev() {
            self.pass_row(own, &mut messages, out);
        }
    }

    fn pass_row(
        &self,
        own: &[VelocityEstimate],
        messages: &mut [VelocityEstimate],
        out: &mut [VelocityEstimate],
    ) {
        for ((out, own), message) in out.iter_mut().zip(own).zip(messages) {
            *message = self.pass(own, *message, out);
        }
    }

    /// Adds a message to a cell's posterior, and returns the message to the next cell.
    ///
    /// Messages are compared with the cell's measurement only, not with the prior: neighbours predict a cell
    /// better than the mean of the frame.
    #[inline(always)]
    fn pass(
        &self,
        own: &VelocityEstimate,
        message: VelocityEstimate,
        out: &mut VelocityEstimate,
    ) -> VelocityEstimate {
        let alone = own.plus_prior(self.prior);
        let accepted = own.accept(alone.value(), &message);
        *out = out.plus(accepted);
        alone.plus(accepted).after_step(self.step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(columns: usize) -> FieldPrior {
        FieldPrior { columns, step: 0.1, prior: 0.0 }
    }

    fn round(information: f32, value: [f32; 2]) -> VelocityEstimate {
        VelocityEstimate::new([information, 0.0, information], value)
    }

    #[test]
    fn a_step_adds_to_the_covariance() {
        let before = VelocityEstimate::new([3.0, 1.0, 2.0], [4.0, -5.0]);
        let after = before.after_step(0.5);
        // Λ = (3 1; 1 2), Λ⁻¹ + ½·I = (0.9 −0.2; −0.2 1.1), whose inverse is (1.1 0.2; 0.2 0.9)/0.95.
        let expected = [1.1 / 0.95, 0.2 / 0.95, 0.9 / 0.95];
        assert!(after.information.iter().zip(expected).all(|(is, ought)| (is - ought).abs() < 1e-5));
        let [x, y] = after.value();
        assert!((x - 4.0).abs() < 1e-4 && (y + 5.0).abs() < 1e-4, "{x} {y}");
    }

    #[test]
    fn a_gap_is_bridged_and_an_edge_is_kept() {
        let at = |column: usize| match column {
            0..8 => round(50.0, [1.0, -2.0]),
            // Only a prior here.
            8..12 => round(0.01, [0.0; 2]),
            _ => round(50.0, [9.0, 6.0]),
        };
        let own: Vec<VelocityEstimate> = (0..20 * 15).map(|index| at(index % 20)).collect();
        let mut out = Vec::new();
        field(20).posterior(&own, &mut out);
        let row: Vec<[f32; 2]> = out[7 * 20..8 * 20].iter().map(VelocityEstimate::value).collect();
        let is_near = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) < 0.1;
        assert!(is_near(row[3], [1.0, -2.0]) && is_near(row[16], [9.0, 6.0]), "{row:?}");
        assert!(is_near(row[7], [1.0, -2.0]) && is_near(row[12], [9.0, 6.0]), "{row:?}");
        assert!((8..12).all(|column| row[column][0] > 0.8 && row[column][0] < 9.2), "{row:?}");
    }

    #[test]
    fn a_cell_measured_along_one_axis_is_completed_by_its_neighbours() {
        let at = |index: usize| match index {
            5 => VelocityEstimate::new([100.0, 0.0, 0.0], [3.0, 0.0]),
            _ => round(20.0, [2.0, 7.0]),
        };
        let own: Vec<VelocityEstimate> = (0..11).map(at).collect();
        let mut out = Vec::new();
        field(11).posterior(&own, &mut out);
        let [x, y] = out[5].value();
        assert!((x - 3.0).abs() < 0.3 && (y - 7.0).abs() < 0.1, "{x} {y}");
    }

    #[test]
    fn where_nothing_is_measured_neighbours_count_more_than_the_prior() {
        let measured =
            |column: usize| if column < 3 { round(50.0, [9.0, 0.0]) } else { VelocityEstimate::default() };
        let own: Vec<VelocityEstimate> = (0..10).map(measured).collect();
        let mut out = Vec::new();
        // A deviation of 10, of which the steps over all cells make a tenth.
        FieldPrior { columns: 10, step: 0.1, prior: 0.01 }.posterior(&own, &mut out);
        let last = out[9].value()[0];
        assert!(last > 8.0 && last < 9.0, "{last}");
    }

    #[test]
    fn without_information_the_posterior_is_zero() {
        let mut out = Vec::new();
        field(4).posterior(&[VelocityEstimate::default(); 12], &mut out);
        assert!(out.iter().all(|posterior| posterior.value() == [0.0; 2]));
        field(0).posterior(&[], &mut out);
        assert!(out.is_empty());
    }
}
