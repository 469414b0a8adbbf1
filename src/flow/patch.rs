// SPDX-License-Identifier: MIT OR Apache-2.0

//! Patches of 8 × 8 pixels and their comparison with another frame at sub-pixel positions.
//!
//! Inverse compositional (S. Baker, I. Matthews, *Lucas–Kanade 20 Years On*, IJCV 56(3), 2004): the gradients
//! g are the template's, so that their matrix is inverted once. With d the difference of the patches and n
//! the noise variance of a pixel the step is δ = −(Σ g·gᵀ + 32n·I)⁻¹·Σ g·d. The mean of the gradients and
//! their projection on the template are removed, which makes the step independent of brightness and contrast;
//! the residual is taken about its mean. Nothing is subtracted from the gradients pixel by pixel: with g′ = g
//! − ḡ − a·(v − v̄) the sums Σ g′·d and Σ g′·g′ follow from those of g, v and d.
//!
//! A comparison reads 9 rows of 9 samples and takes 64 × 15 additions and multiplications, in 8 × 10
//! instructions. These have the pixels of a row in the lanes; all that is computed from the sums has one patch in
//! each lane, eight at a time.

use super::rows::Scratch;
use crate::lanes::rows::SampleRows;
use crate::lanes::sums::{SUMS, add_products};
use crate::lanes::wholes::{ROUND, whole};
use crate::lanes::{FLOATS, WordCpu};
use crate::pyramid::Level;

/// Pixels in a row of a patch: one vector.
pub(super) const SIDE: usize = FLOATS;

/// Pixels of a patch.
pub(super) const AREA: f32 = (SIDE * SIDE) as f32;

/// Patches that are compared side by side: one in each lane.
pub(super) const GROUP: usize = FLOATS;

/// The pixels of a patch of the first frame, row by row.
#[derive(Clone, Copy)]
struct Block<C: WordCpu> {
    /// Grey.
    values: [C::Lanes; SIDE],
    /// Differences of neighbours two pixels apart: twice the gradients.
    gradient_x: [C::Lanes; SIDE],
    gradient_y: [C::Lanes; SIDE],
}

/// Up to eight patches of the first frame, one in each lane; what unused lanes hold is of no meaning.
pub(super) struct PatchGroup<C: WordCpu> {
    pub(super) cpu: C,
    blocks: [Block<C>; GROUP],
    /// The top left pixels: x, y.
    corners: [C::Lanes; 2],
    /// Means of values and of twice the gradients.
    means: [C::Lanes; 3],
    /// Coefficients a of the projection of twice each gradient on the values.
    shares: [C::Lanes; 2],
    /// Sums of the products of g′: xx, xy, yy.
    pub(super) tensor: [C::Lanes; 3],
    /// Squared differences from the mean, summed, in squared grey levels.
    pub(super) energy: C::Lanes,
    /// Half of the negative inverse of the tensor with the noise of gradients added to its diagonal: xx, xy, yy.
    inverse: [C::Lanes; 3],
    /// Scratch: of each patch, sums over its rows; a comparison has seven.
    sums: [[C::Lanes; SUMS]; GROUP],
}

/// How patches of the second frame differ from the templates.
#[derive(Clone, Copy)]
pub(super) struct Difference<C: WordCpu> {
    /// The Gauss–Newton step in pixels, to be added to the displacement.
    pub(super) step: [C::Lanes; 2],
    /// Sums of squared differences about the mean of the patch, in squared grey levels, by quarter: top left,
    /// bottom left, top right, bottom right.
    pub(super) squares: [C::Lanes; 4],
    /// The same sum over the whole patch.
    pub(super) total: C::Lanes,
}

impl<C: WordCpu> Scratch<C> for PatchGroup<C> {
    /// A group to be filled by [`take`](Self::take).
    #[inline(always)]
    fn new(cpu: C) -> Self {
        let zero = cpu.splat(0.0);
        let rows = [zero; SIDE];
        Self {
            cpu,
            blocks: [Block { values: rows, gradient_x: rows, gradient_y: rows }; GROUP],
            corners: [zero; 2],
            means: [zero; 3],
            shares: [zero; 2],
            tensor: [zero; 3],
            energy: zero,
            inverse: [zero; 3],
            sums: [[zero; SUMS]; GROUP],
        }
    }
}

impl<C: WordCpu> PatchGroup<C> {
    /// Takes the patches of `level` whose top left pixels are `corners` (x, y), eight at most; `None` if one reaches
    /// beyond the border. `noise` is the noise variance of a pixel in squared grey levels: a central difference has
    /// half of it, which is added to both eigenvalues of the gradients' matrix, so that the step along an edge is
    /// zero.
    #[inline(always)]
    pub(super) fn take(&mut self, level: &Level, noise: f32, corners: &[[usize; 2]]) -> Option<()> {
        let cpu = self.cpu;
        let (mut pivots, mut at) = ([0.0; GROUP], [[0.0; GROUP]; 2]);
        for (k, &[x, y]) in corners.iter().enumerate().take(GROUP) {
            let samples = level.from(x as i32 - 1, y as i32 - 1)?;
            let rows = SampleRows::<{ SIDE + 2 }, { SIDE + 2 }>::new(samples, level.stride())?;
            // Subtracting a grey of the patch avoids cancellation in the sums of squares.
            let pivot = rows.at(SIDE / 2, 1)[SIDE / 2];
            (pivots[k], at[0][k], at[1][k]) = (pivot, x as f32, y as f32);
            let block = &mut self.blocks[k];
            let mut sums = [cpu.splat(0.0); SUMS];
            let (mut above, mut here) = (cpu.load(rows.at(0, 1)), cpu.load(rows.at(1, 1)));
            for r in 0..SIDE {
                let below = cpu.load(rows.at(r + 2, 1));
                let value = here - cpu.splat(pivot);
                // Twice the gradients: powers of two leave all sums as they are, and one product a row is saved.
                let dx = cpu.load(rows.at(r + 1, 2)) - cpu.load(rows.at(r + 1, 0));
                let dy = below - above;
                (block.values[r], block.gradient_x[r], block.gradient_y[r]) = (here, dx, dy);
                add_products(cpu, &mut sums, [value, dx, dy]);
                (above, here) = (here, below);
            }
            self.sums[k] = sums;
        }
        let [sum, sum_x, sum_y] = [self.total::<0>(), self.total::<1>(), self.total::<2>()];
        let share = cpu.splat(1.0 / AREA);
        let (mean, mean_x, mean_y) = (sum * share, sum_x * share, sum_y * share);
        let (half, quarter) = (cpu.splat(0.5), cpu.splat(0.25));
        let (xx, xy, yy) =
            (quarter * self.total::<3>(), quarter * self.total::<4>(), quarter * self.total::<5>());
        let (x, y) = (half * self.total::<7>(), half * self.total::<8>());
        self.means = [cpu.load(&pivots) + mean, mean_x, mean_y];
        let (sum_x, sum_y) = (half * sum_x, half * sum_y);
        let (mean_x, mean_y) = (sum_x * share, sum_y * share);
        let (xx, xy, yy) = (xx - mean_x * sum_x, xy - mean_x * sum_y, yy - mean_y * sum_y);
        let zero = cpu.splat(0.0);
        let energy = cpu.greater(self.total::<6>() - mean * sum, zero);
        let (x, y) = (x - mean_x * sum, y - mean_y * sum);
        let share = cpu.divided(cpu.splat(1.0), energy + cpu.splat(f32::MIN_POSITIVE));
        let (a, b) = (x * share, y * share);
        self.shares = [cpu.splat(2.0) * a, cpu.splat(2.0) * b];
        self.energy = energy;
        let (xx, xy, yy) = (cpu.greater(xx - a * x, zero), xy - a * y, cpu.greater(yy - b * y, zero));
        self.tensor = [xx, xy, yy];
        let damping = cpu.splat(AREA * 0.5 * noise);
        let (a, d) = (xx + damping, yy + damping);
        let share = half * cpu.divided(cpu.splat(1.0), a * d - xy * xy);
        self.inverse = [(zero - d) * share, xy * share, (zero - a) * share];
        self.corners = [cpu.load(&at[0]), cpu.load(&at[1])];
        Some(())
    }

    /// Sums number `N` of all patches over all lanes.
    #[inline(always)]
    fn total<const N: usize>(&self) -> C::Lanes {
        self.cpu.totals(self.of_all::<N>())
    }

    /// Sums number `N` of all patches over the first four lanes, and over the last four.
    #[inline(always)]
    fn halves<const N: usize>(&self) -> [C::Lanes; 2] {
        self.cpu.halves(self.of_all::<N>())
    }

    /// Sums number `N` of all patches.
    #[inline(always)]
    fn of_all<const N: usize>(&self) -> [C::Lanes; GROUP] {
        let [a, b, c, d, e, f, g, h] = &self.sums;
        [a[N], b[N], c[N], d[N], e[N], f[N], g[N], h[N]]
    }

    /// Compares with the patches of `level` that are displaced by `shift`, sampled linearly, those whose bit in
    /// `active` is set. Corners are clamped to one patch outside the level; `None` only for a level without pixels.
    #[inline(always)]
    pub(super) fn compare(
        &mut self,
        level: &Level,
        shift: [C::Lanes; 2],
        active: u32,
    ) -> Option<Difference<C>> {
        let cpu = self.cpu;
        let [width, height] = level.extent();
        let (column, across) = split(cpu, self.corners[0] + shift[0], width);
        let (row, down) = split(cpu, self.corners[1] + shift[1], height);
        let first = cpu.splat(level.origin() as f32 + ROUND) + column;
        let firsts = cpu.store(first + row * cpu.splat(level.stride() as f32));
        let (across, down) = (cpu.store(across), cpu.store(down));
        let zero = cpu.splat(0.0);
        let mut left = active;
        while left != 0 {
            let k = left.trailing_zeros() as usize % GROUP;
            left &= left - 1;
            let block = &self.blocks[k];
            let samples = level.samples().get(whole(firsts[k]) as usize..)?;
            let rows = SampleRows::<{ SIDE + 1 }, { SIDE + 1 }>::new(samples, level.stride())?;
            let (across, down) = (cpu.splat(across[k]), cpu.splat(down[k]));
            let mut slopes = [zero; 3];
            let (mut differences, mut squares) = ([zero; 2], [zero; 2]);
            let mut above = blended(cpu, &rows, 0, across);
            for r in 0..SIDE {
                let below = blended(cpu, &rows, r + 1, across);
                let difference = cpu.fused(down, below - above, above) - block.values[r];
                let weights = [block.gradient_x[r], block.gradient_y[r], block.values[r]];
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
            let [x, y, value] = slopes;
            let sums = [x, y, value, differences[0], differences[1], squares[0], squares[1]];
            self.sums[k][..sums.len()].copy_from_slice(&sums);
        }
        Some(self.difference())
    }

    /// The differences that follow from the sums of a comparison.
    #[inline(always)]
    fn difference(&self) -> Difference<C> {
        let cpu = self.cpu;
        let ([a, c], [b, d]) = (self.halves::<3>(), self.halves::<4>());
        let sum = (a + b) + (c + d);
        let mean = sum * cpu.splat(1.0 / AREA);
        let ([e, g], [f, h]) = (self.halves::<5>(), self.halves::<6>());
        let squares = [
            about_mean(cpu, e, a, mean),
            about_mean(cpu, f, b, mean),
            about_mean(cpu, g, c, mean),
            about_mean(cpu, h, d, mean),
        ];
        let value = self.total::<2>() - self.means[0] * sum;
        let x = self.total::<0>() - self.means[1] * sum - self.shares[0] * value;
        let y = self.total::<1>() - self.means[2] * sum - self.shares[1] * value;
        let [a, b, c] = self.inverse;
        let total = (squares[0] + squares[1]) + (squares[2] + squares[3]);
        Difference { step: [a * x + b * y, b * x + c * y], squares, total }
    }

    /// The patch in lane `k` less its mean.
    #[inline(always)]
    pub(super) fn centred(&self, k: usize) -> Option<[C::Lanes; SIDE]> {
        let mean = self.cpu.splat(*self.cpu.store(self.means[0]).get(k)?);
        let mut rows = self.blocks.get(k)?.values;
        for row in &mut rows {
            *row = *row - mean;
        }
        Some(rows)
    }
}

/// The sums of products of a patch and those that begin at eight successive samples.
#[inline(always)]
pub(super) fn products<C: WordCpu>(
    cpu: C,
    patch: &[C::Lanes; SIDE],
    rows: &SampleRows<'_, SIDE, { SIDE + GROUP }>,
) -> C::Lanes {
    let mut sums = [cpu.splat(0.0); GROUP];
    // Rows outside, so that the eight sums stay in registers.
    for (r, values) in patch.iter().enumerate() {
        for (c, sum) in sums.iter_mut().enumerate() {
            *sum = cpu.fused(*values, cpu.load(rows.at(r, c)), *sum);
        }
    }
    let [low, high] = cpu.halves(sums);
    low + high
}

/// The sum of squares of a quarter of a patch about the mean of the whole patch, from the sum and that about 0.
#[inline(always)]
fn about_mean<C: WordCpu>(cpu: C, square: C::Lanes, sum: C::Lanes, mean: C::Lanes) -> C::Lanes {
    cpu.greater(square - mean * (cpu.splat(2.0) * sum - cpu.splat(0.25 * AREA) * mean), cpu.splat(0.0))
}

/// A row of samples, interpolated by `across` towards the next sample on the right. A function, because a
/// closure that is not inlined would be compiled for any CPU.
#[inline(always)]
fn blended<C: WordCpu>(
    cpu: C,
    rows: &SampleRows<'_, { SIDE + 1 }, { SIDE + 1 }>,
    row: usize,
    across: C::Lanes,
) -> C::Lanes {
    let left = cpu.load(rows.at(row, 0));
    // In this order the sample on the right is an operand in memory, and needs no register.
    cpu.fused_less(across, left - cpu.load(rows.at(row, 1)), left)
}

/// Positions much smaller than 2²², clamped to one patch outside a level of `length` pixels: whole pixels and fraction,
/// 0 to 1.
#[inline(always)]
fn split<C: WordCpu>(cpu: C, at: C::Lanes, length: f32) -> (C::Lanes, C::Lanes) {
    let (at, round) = (cpu.clamped(at, -(SIDE as f32), length), cpu.splat(ROUND));
    let whole = ((at - cpu.splat(0.5)) + round) - round;
    (whole, at - whole)
}

#[cfg(test)]
#[path = "patch_tests.rs"]
mod tests;
