// SPDX-License-Identifier: MIT OR Apache-2.0

//! One patch of 8 × 8 pixels and its comparison with another frame at sub-pixel positions.
//!
//! Inverse compositional (S. Baker, I. Matthews, *Lucas–Kanade 20 Years On*, IJCV 56(3), 2004): the gradients
//! g are the template's, so that their matrix is inverted once. With d the difference of the patches and n
//! the noise variance of a pixel the step is δ = −(Σ g·gᵀ + 32n·I)⁻¹·Σ g·d. The mean of the gradients and
//! their projection on the template are removed, which makes the step independent of brightness and contrast;
//! the residual is taken about its mean. Nothing is subtracted from the gradients pixel by pixel: with g′ = g
//! − ḡ − a·(v − v̄) the sums Σ g′·d and Σ g′·g′ follow from those of g, v and d.
//!
//! A comparison reads 9 rows of 9 samples and takes 64 × 15 additions and multiplications, in 8 × 10
//! instructions.

use crate::lanes::rows::SampleRows;
use crate::lanes::{Cpu, FLOATS};
use crate::pyramid::Level;

/// Pixels in a row of a patch: one vector.
pub(super) const SIDE: usize = FLOATS;

/// Pixels of a patch.
pub(super) const AREA: f32 = (SIDE * SIDE) as f32;

/// A patch of the first frame.
#[derive(Clone, Debug)]
pub(super) struct PatchTemplate<C: Cpu> {
    cpu: C,
    /// Grey, row by row.
    values: [C::Lanes; SIDE],
    /// Differences of neighbours two pixels apart: twice the gradients.
    gradient_x: [C::Lanes; SIDE],
    gradient_y: [C::Lanes; SIDE],
    /// Means of values and of twice the gradients.
    means: [f32; 3],
    /// Coefficients a of the projection of twice each gradient on the values.
    shares: [f32; 2],
    /// Sums of the products of g′: xx, xy, yy.
    pub(super) tensor: [f32; 3],
    /// Squared differences from the mean, summed, in squared grey levels.
    pub(super) energy: f32,
    /// Half of the negative inverse of the tensor with the noise of gradients added to its diagonal: xx, xy, yy.
    inverse: [f32; 3],
}

/// How a patch of the second frame differs from the template.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Difference {
    /// The Gauss–Newton step in pixels, to be added to the displacement.
    pub(super) step: [f32; 2],
    /// Sums of squared differences about the mean of the patch, in squared grey levels, by quarter: top left,
    /// bottom left, top right, bottom right.
    pub(super) squares: [f32; 4],
    /// The same sum over the whole patch.
    pub(super) total: f32,
}

impl<C: Cpu> PatchTemplate<C> {
    /// A template to be filled by [`take`](Self::take).
    #[inline(always)]
    pub(super) fn new(cpu: C) -> Self {
        let block = [cpu.splat(0.0); SIDE];
        Self {
            cpu,
            values: block,
            gradient_x: block,
            gradient_y: block,
            means: [0.0; 3],
            shares: [0.0; 2],
            tensor: [0.0; 3],
            energy: 0.0,
            inverse: [0.0; 3],
        }
    }

    /// Takes the patch of `level` whose top left pixel is (x, y); `None` if it reaches beyond the border.
    /// `noise` is the noise variance of a pixel in squared grey levels: a central difference has half of it,
    /// which is added to both eigenvalues of the gradients' matrix, so that the step along an edge is zero.
    #[inline(always)]
    pub(super) fn take(&mut self, level: &Level, noise: f32, x: usize, y: usize) -> Option<()> {
        let cpu = self.cpu;
        let samples = level.from(x as i32 - 1, y as i32 - 1)?;
        let rows = SampleRows::<{ SIDE + 2 }, { SIDE + 2 }>::new(samples, level.stride())?;
        // Subtracting a grey of the patch avoids cancellation in the sums of squares.
        let pivot = rows.at(SIDE / 2, 1)[SIDE / 2];
        let mut sums = [cpu.splat(0.0); 3];
        let mut products = [cpu.splat(0.0); 6];
        let (mut above, mut here) = (cpu.load(rows.at(0, 1)), cpu.load(rows.at(1, 1)));
        for r in 0..SIDE {
            let below = cpu.load(rows.at(r + 2, 1));
            let value = here - cpu.splat(pivot);
            // Twice the gradients: powers of two leave all sums as they are, and one product a row is saved.
            let dx = cpu.load(rows.at(r + 1, 2)) - cpu.load(rows.at(r + 1, 0));
            let dy = below - above;
            (self.values[r], self.gradient_x[r], self.gradient_y[r]) = (here, dx, dy);
            sums[0] = sums[0] + value;
            sums[1] = sums[1] + dx;
            sums[2] = sums[2] + dy;
            products[0] = cpu.fused(dx, dx, products[0]);
            products[1] = cpu.fused(dx, dy, products[1]);
            products[2] = cpu.fused(dy, dy, products[2]);
            products[3] = cpu.fused(value, value, products[3]);
            products[4] = cpu.fused(dx, value, products[4]);
            products[5] = cpu.fused(dy, value, products[5]);
            (above, here) = (here, below);
        }
        let [sum, sum_x, sum_y] = sums;
        let [xx, xy, yy, energy, x, y] = products;
        let [xx, xy, yy, energy] = cpu.totals([xx, xy, yy, energy]);
        let [x, y, sum, sum_x] = cpu.totals([x, y, sum, sum_x]);
        let [sum_y, ..] = cpu.totals([sum_y; 4]);
        self.means = [sum, sum_x, sum_y].map(|sum| sum * (1.0 / AREA));
        let [xx, xy, yy] = [xx, xy, yy].map(|sum| 0.25 * sum);
        let [x, y, sum_x, sum_y] = [x, y, sum_x, sum_y].map(|sum| 0.5 * sum);
        let [mean, mean_x, mean_y] = [sum, sum_x, sum_y].map(|sum| sum * (1.0 / AREA));
        let (xx, xy, yy) = (xx - mean_x * sum_x, xy - mean_x * sum_y, yy - mean_y * sum_y);
        let (x, y, energy) = (x - mean_x * sum, y - mean_y * sum, (energy - mean * sum).max(0.0));
        let share = 1.0 / (energy + f32::MIN_POSITIVE);
        let (a, b) = (x * share, y * share);
        self.means[0] = pivot + mean;
        self.shares = [2.0 * a, 2.0 * b];
        self.energy = energy;
        let (xx, xy, yy) = ((xx - a * x).max(0.0), xy - a * y, (yy - b * y).max(0.0));
        self.tensor = [xx, xy, yy];
        let damping = AREA * 0.5 * noise;
        let (a, d) = (xx + damping, yy + damping);
        let share = 1.0 / (a * d - xy * xy);
        self.inverse = [-d * share, xy * share, -a * share].map(|entry| 0.5 * entry);
        Some(())
    }

    /// Compares with the patch of `level` whose top left pixel lies at `corner`, sampled linearly. The corner
    /// is clamped to one patch outside the level; `None` only for a level without pixels.
    #[inline(always)]
    pub(super) fn compare(&self, level: &Level, corner: [f32; 2]) -> Option<Difference> {
        let cpu = self.cpu;
        let [width, height] = level.extent();
        let x = corner[0].clamp(-(SIDE as f32), width);
        let y = corner[1].clamp(-(SIDE as f32), height);
        let ([left, top], [across, down]) = split([x, y]);
        let samples = level.from(left, top)?;
        let rows = SampleRows::<{ SIDE + 1 }, { SIDE + 1 }>::new(samples, level.stride())?;
        let (across, down) = (cpu.splat(across), cpu.splat(down));
        let mut slopes = [cpu.splat(0.0); 3];
        let (mut differences, mut squares) = ([cpu.splat(0.0); 2], [cpu.splat(0.0); 2]);
        let mut above = blended(cpu, &rows, 0, across);
        for r in 0..SIDE {
            let below = blended(cpu, &rows, r + 1, across);
            let difference = cpu.fused(down, below - above, above) - self.values[r];
            let weights = [self.gradient_x[r], self.gradient_y[r], self.values[r]];
            for (slope, weight) in slopes.iter_mut().zip(weights) {
                *slope = if r == 0 { weight * difference } else { cpu.fused(weight, difference, *slope) };
            }
            let half = r / (SIDE / 2);
            if r % (SIDE / 2) == 0 {
                (differences[half], squares[half]) = (difference, difference * difference);
            } else {
                differences[half] = differences[half] + difference;
                squares[half] = cpu.fused(difference, difference, squares[half]);
            }
            above = below;
        }
        let [x, y, value, _] = cpu.totals([slopes[0], slopes[1], slopes[2], slopes[2]]);
        let quarters = cpu.halves([differences[0], differences[1], squares[0], squares[1]]);
        let differences = [quarters[0], quarters[1], quarters[4], quarters[5]];
        let squares = [quarters[2], quarters[3], quarters[6], quarters[7]];
        let four = |values: [f32; 4]| (values[0] + values[1]) + (values[2] + values[3]);
        let sum = four(differences);
        let mean = sum * (1.0 / AREA);
        let squares = std::array::from_fn(|k| {
            (squares[k] - mean * (2.0 * differences[k] - 0.25 * AREA * mean)).max(0.0)
        });
        let value = value - self.means[0] * sum;
        let x = x - self.means[1] * sum - self.shares[0] * value;
        let y = y - self.means[2] * sum - self.shares[1] * value;
        let [a, b, c] = self.inverse;
        Some(Difference { step: [a * x + b * y, b * x + c * y], squares, total: four(squares) })
    }

    /// The residual at whole pixels, from samples `stride` apart from row to row: sum of squared differences about
    /// their mean.
    #[inline(always)]
    pub(super) fn residual_at(&self, samples: &[f32], stride: usize) -> Option<f32> {
        let cpu = self.cpu;
        let rows = SampleRows::<SIDE, SIDE>::new(samples, stride)?;
        let mut sums = [cpu.splat(0.0); 2];
        for (r, values) in self.values.iter().enumerate() {
            let difference = *values - cpu.load(rows.at(r, 0));
            if r == 0 {
                sums = [difference, difference * difference];
            } else {
                sums = [sums[0] + difference, cpu.fused(difference, difference, sums[1])];
            }
        }
        let [sum, square, ..] = cpu.totals([sums[0], sums[1], sums[0], sums[1]]);
        Some((square - sum * sum * (1.0 / AREA)).max(0.0))
    }
}

/// A row of samples, interpolated by `across` towards the next sample on the right. A function, because a
/// closure that is not inlined would be compiled for any CPU.
#[inline(always)]
fn blended<C: Cpu>(
    cpu: C,
    rows: &SampleRows<'_, { SIDE + 1 }, { SIDE + 1 }>,
    row: usize,
    across: C::Lanes,
) -> C::Lanes {
    let left = cpu.load(rows.at(row, 0));
    // In this order the sample on the right is an operand in memory, and needs no register.
    cpu.fused_less(across, left - cpu.load(rows.at(row, 1)), left)
}

/// Whole pixels and fraction, 0 to 1, of positions much smaller than 2²².
///
/// Numbers between 2²³ and 2²⁴ have no fraction, so that adding 1.5·2²³ rounds, and leaves the whole number
/// in the lowest bits: half as many instructions as a conversion, which must be defined for every number.
#[inline(always)]
fn split(at: [f32; 2]) -> ([i32; 2], [f32; 2]) {
    const ROUND: f32 = 1.5 * (1 << 23) as f32;
    let rounded = at.map(|at| (at - 0.5) + ROUND);
    let whole = rounded.map(|rounded| rounded.to_bits().wrapping_sub(ROUND.to_bits()) as i32);
    (whole, [at[0] - (rounded[0] - ROUND), at[1] - (rounded[1] - ROUND)])
}

#[cfg(test)]
#[path = "patch_tests.rs"]
mod tests;
