// SPDX-License-Identifier: MIT OR Apache-2.0

//! Messages along chains of cells, and the score of their variance: up to eight chains, or cells, at a time.

use super::estimate::VelocityEstimate;
use crate::lanes::{FLOATS, WordCpu};

/// Chains in a vector.
pub(super) const CHAINS: usize = FLOATS;
/// Squared distance of a message from a cell's own estimate, in units of their summed variances, at which its
/// weight is ¼.
pub(super) const QUARTER_WEIGHT_DISTANCE: f32 = 4.0;

/// A cell of each chain: information and sum, as of [`VelocityEstimate`]; nothing is known of chains that are not there.
#[derive(Clone, Copy)]
struct Estimates<C: WordCpu> {
    information: [C::Lanes; 3],
    sum: [C::Lanes; 2],
}

impl<C: WordCpu> Estimates<C> {
    #[inline(always)]
    fn zero(cpu: C) -> Self {
        Self { information: [cpu.splat(0.0); 3], sum: [cpu.splat(0.0); 2] }
    }

    /// Of the cells from the first on that are `stride` apart.
    #[inline(always)]
    fn load(cpu: C, cells: &[VelocityEstimate], stride: usize) -> Self {
        let mut rows = [cpu.splat(0.0); CHAINS];
        for (row, cell) in rows.iter_mut().zip(cells.iter().step_by(stride)) {
            *row = cpu.load(&cell.0);
        }
        let [xx, xy, yy, x, y, ..] = cpu.transposed(rows);
        Self { information: [xx, xy, yy], sum: [x, y] }
    }

    #[inline(always)]
    fn store(self, cpu: C, cells: &mut [VelocityEstimate], stride: usize) {
        let ([xx, xy, yy], [x, y], zero) = (self.information, self.sum, cpu.splat(0.0));
        let rows = cpu.transposed([xx, xy, yy, x, y, zero, zero, zero]);
        for (cell, row) in cells.iter_mut().step_by(stride).zip(rows) {
            cell.0 = cpu.store(row);
        }
    }

    /// The product of independent likelihoods.
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        let ([a, b, c], [d, e, f]) = (self.information, other.information);
        let ([x, y], [u, v]) = (self.sum, other.sum);
        Self { information: [a + d, b + e, c + f], sum: [x + u, y + v] }
    }

    /// The product with a prior of mean zero and this information along each axis.
    #[inline(always)]
    fn plus_prior(self, prior: C::Lanes) -> Self {
        let [xx, xy, yy] = self.information;
        Self { information: [xx + prior, xy, yy + prior], ..self }
    }

    /// The squared Mahalanobis norms of vectors.
    #[inline(always)]
    fn squared_norm(self, cpu: C, [x, y]: [C::Lanes; 2]) -> C::Lanes {
        let [xx, xy, yy] = self.information;
        xx * x * x + cpu.splat(2.0) * xy * x * y + yy * y * y
    }

    /// The means; zero where the information is singular.
    #[inline(always)]
    fn value(self, cpu: C) -> [C::Lanes; 2] {
        let ([xx, xy, yy], [x, y]) = (self.information, self.sum);
        let determinant = xx * yy - xy * xy;
        let (zero, share) = (cpu.splat(0.0), cpu.divided(cpu.splat(1.0), determinant));
        let (x, y) = ((yy * x - xy * y) * share, (xx * y - xy * x) * share);
        [cpu.above_floats(determinant, zero, x, zero), cpu.above_floats(determinant, zero, y, zero)]
    }

    /// The messages to the next cells, a random step of variance q away: (I + q·Λ)⁻¹ times information and sum.
    #[inline(always)]
    fn after_step(self, cpu: C, q: C::Lanes) -> Self {
        let ([xx, xy, yy], [x, y]) = (self.information, self.sum);
        let (trace, determinant) = (xx + yy, cpu.greater(xx * yy - xy * xy, cpu.splat(0.0)));
        let one = cpu.splat(1.0);
        let share = cpu.divided(one, one + q * trace + q * q * determinant);
        Self {
            information: [(xx + q * determinant) * share, xy * share, (yy + q * determinant) * share],
            sum: [(x + q * (yy * x - xy * y)) * share, (y + q * (xx * y - xy * x)) * share],
        }
    }

    /// The messages, down-weighted where they contradict the cells' own measurements; `value` are the cells' posteriors without
    /// them.
    #[inline(always)]
    fn accept(self, cpu: C, value: [C::Lanes; 2], message: Self) -> Self {
        let other = message.value(cpu);
        let difference = [value[0] - other[0], value[1] - other[1]];
        let (own, other) = (self.squared_norm(cpu, difference), message.squared_norm(cpu, difference));
        // The variances of the two along their difference add up.
        let square = cpu.divided(own * other, own + other + cpu.splat(f32::MIN_POSITIVE));
        // The weight of Geman and McClure.
        let quarter = cpu.splat(QUARTER_WEIGHT_DISTANCE);
        let share = cpu.divided(quarter, quarter + square);
        let ([xx, xy, yy], [x, y], weight) = (message.information, message.sum, share * share);
        Self { information: [weight * xx, weight * xy, weight * yy], sum: [weight * x, weight * y] }
    }
}

/// Fisher's score of the variance V of the cells' vectors, and its information, times two: Σ (|M·v|² − tr M) and Σ tr M², where a
/// vector v that is measured with the information Λ has M = (V·I + Λ⁻¹)⁻¹.
#[inline(always)]
pub(super) fn score_of_variance<C: WordCpu>(cpu: C, variance: f32, cells: &[VelocityEstimate]) -> [f32; 2] {
    let (variance, two) = (cpu.splat(variance), cpu.splat(2.0));
    let mut sums = [cpu.splat(0.0); 2];
    for cells in cells.chunks(CHAINS) {
        let Estimates { information: [xx, xy, yy], sum: [x, y] } =
            Estimates::load(cpu, cells, 1).after_step(cpu, variance);
        let [score, information] = sums;
        sums = [score + (x * x + y * y - (xx + yy)), information + (xx * xx + two * xy * xy + yy * yy)];
    }
    sums.map(|lanes| cpu.store(lanes).iter().sum())
}

/// Passes messages along `count` chains that are `stride` cells apart, by the indices of the first chain's cells in their order,
/// and adds them to the posterior of the cells. `step` and `prior` are those of the field.
///
/// A message is what the cells before have measured, without the prior, which thus counts once in each cell: with it in every message the
/// field would be pulled to zero, and seem to be known, a few cells from all measurements.
///
/// Messages are compared with the cell's measurement only, not with the prior: neighbours predict a cell better than the
/// mean of the frame.
#[inline(always)]
pub(super) fn pass_along<C: WordCpu>(
    cpu: C,
    [step, prior]: [f32; 2],
    cells: impl Iterator<Item = usize>,
    [count, stride]: [usize; 2],
    own: &[VelocityEstimate],
    out: &mut [VelocityEstimate],
) {
    let (step, prior) = (cpu.splat(step), cpu.splat(prior));
    let mut message = Estimates::zero(cpu);
    for first in cells {
        let last = first + count.saturating_sub(1) * stride;
        let (Some(own), Some(out)) = (own.get(first..=last), out.get_mut(first..=last)) else { return };
        let own = Estimates::load(cpu, own, stride);
        let alone = own.plus_prior(prior);
        let accepted = own.accept(cpu, alone.value(cpu), message);
        Estimates::load(cpu, out, stride).plus(accepted).store(cpu, out, stride);
        message = own.plus(accepted).after_step(cpu, step);
    }
}
