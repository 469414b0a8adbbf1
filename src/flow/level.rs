// SPDX-License-Identifier: MIT OR Apache-2.0

//! One level: candidates for each patch, Gauss–Newton steps from the best one, and the mean of overlapping
//! patches.
//!
//! Patches of 8 × 8 pixels overlap by half, so that each cell of 4 × 4 pixels is covered by up to four.
//! Candidates are compared by residual alone, whatever their source (the coarser level, neighbouring cells,
//! the prediction, the opposite direction). Candidates that hardly differ are compared once.

use super::candidates::Candidates;
use super::estimate::{Mean, PatchFlow};
use super::patch::{AREA, Difference, GROUP, PatchGroup, SIDE};
use crate::lanes::WordCpu;
use crate::pyramid::Level;

/// Side of a cell in pixels of the level.
pub(super) const CELL: usize = SIDE / 2;

/// A candidate replaces an earlier one whose residual is more than this many times its own, plus the noise
/// variance per pixel.
const RESIDUAL_GAIN: f32 = 1.15;

/// Cells (columns, rows) of a level; the last ones may extend beyond it.
pub(super) fn cells(level: &Level) -> (usize, usize) {
    (level.width().div_ceil(CELL), level.height().div_ceil(CELL))
}

/// The same level of two frames, and the noise variance of a pixel in squared grey levels.
#[derive(Clone, Copy, Debug)]
pub(super) struct LevelPair<'a> {
    pub(super) first: &'a Level,
    pub(super) second: &'a Level,
    pub(super) noise: f32,
}

/// Displacements in pixels, one in each lane, with their residuals and Gauss–Newton steps.
#[derive(Clone, Copy)]
pub(super) struct Trial<C: WordCpu> {
    shift: [C::Lanes; 2],
    pub(super) difference: Difference<C>,
}

impl<C: WordCpu> Trial<C> {
    /// In each lane the later of two if it is clearly better, otherwise this one; `noise` is the noise variance of a
    /// pixel.
    #[inline(always)]
    fn or(self, cpu: C, later: Self, noise: f32) -> Self {
        let limit = cpu.splat(RESIDUAL_GAIN) * later.difference.total + cpu.splat(AREA * noise);
        self.or_where(cpu, [self.difference.total, limit], later)
    }

    /// The lanes of `next` where the first of `bounds` is greater than the second, of this one elsewhere.
    #[inline(always)]
    fn or_where(self, cpu: C, bounds: [C::Lanes; 2], next: Self) -> Self {
        let (own, other) = (self.difference, next.difference);
        let ([x, y], [next_x, next_y]) = (self.shift, next.shift);
        let ([a, b], [next_a, next_b]) = (own.step, other.step);
        let ([p, q, r, s], [next_p, next_q, next_r, next_s]) = (own.squares, other.squares);
        Self {
            shift: [chosen(cpu, bounds, next_x, x), chosen(cpu, bounds, next_y, y)],
            difference: Difference {
                step: [chosen(cpu, bounds, next_a, a), chosen(cpu, bounds, next_b, b)],
                squares: [
                    chosen(cpu, bounds, next_p, p),
                    chosen(cpu, bounds, next_q, q),
                    chosen(cpu, bounds, next_r, r),
                    chosen(cpu, bounds, next_s, s),
                ],
                total: chosen(cpu, bounds, other.total, own.total),
            },
        }
    }

    /// The displacements after the step.
    #[inline(always)]
    fn next(&self) -> [C::Lanes; 2] {
        [self.shift[0] + self.difference.step[0], self.shift[1] + self.difference.step[1]]
    }
}

impl<C: WordCpu> PatchGroup<C> {
    /// Compares the patches at displacements, those whose bit in `active` is set.
    #[inline(always)]
    pub(super) fn at(&mut self, level: &Level, shift: [C::Lanes; 2], active: u32) -> Option<Trial<C>> {
        Some(Trial { shift, difference: self.compare(level, shift, active)? })
    }

    /// Gauss–Newton steps from one displacement per patch, accepted if the residual falls.
    ///
    /// The patches take turns, and there is no branch on the results: a comparison waits for the previous step
    /// of its own patch only.
    #[inline(always)]
    fn refine(&mut self, level: &Level, best: &mut Trial<C>, steps: usize, active: u32) -> Option<()> {
        let cpu = self.cpu;
        let half = cpu.splat(0.5);
        for _ in 0..steps {
            let next = self.at(level, best.next(), active)?;
            let [x, y] = best.difference.step;
            // A step that raises the residual is halved.
            let difference = Difference { step: [half * x, half * y], ..best.difference };
            let halved = Trial { difference, ..*best };
            *best = halved.or_where(cpu, [best.difference.total, next.difference.total], next);
        }
        Some(())
    }

    /// Refines the patches from two displacements each; the second result is taken only if clearly better.
    #[inline(always)]
    pub(super) fn best_of_two(
        &mut self,
        pair: LevelPair<'_>,
        [first, second]: [[C::Lanes; 2]; 2],
        steps: usize,
        active: u32,
    ) -> Option<Trial<C>> {
        let mut first = self.at(pair.second, first, active)?;
        self.refine(pair.second, &mut first, steps, active)?;
        let mut second = self.at(pair.second, second, active)?;
        self.refine(pair.second, &mut second, steps, active)?;
        Some(first.or(self.cpu, second, pair.noise))
    }

    /// The results, one for each patch; `noise` is the noise variance of a pixel.
    #[inline(always)]
    pub(super) fn found(&self, best: &Trial<C>, noise: f32) -> [PatchFlow; GROUP] {
        let cpu = self.cpu;
        let Difference { squares: [p, q, r, s], total, .. } = best.difference;
        let ([x, y], [xx, xy, yy]) = (best.shift, self.tensor);
        let (share, quarter, one) = (cpu.splat(1.0 / AREA), cpu.splat(4.0 / AREA), cpu.splat(1.0));
        let (xx, xy, yy, residual) = (xx * share, xy * share, yy * share, total * share);
        let means = cpu.transposed([x, y, residual, xx, xy, yy, self.energy * share, one]);
        let (p, q, r, s) = (p * quarter, q * quarter, r * quarter, s * quarter);
        // Residuals below the noise of two frames are not distinguished.
        let both = cpu.splat(2.0 * noise);
        let whole = both + residual;
        let quarters = cpu.transposed([
            p,
            q,
            r,
            s,
            cpu.divided(one, (both + p) * whole),
            cpu.divided(one, (both + q) * whole),
            cpu.divided(one, (both + r) * whole),
            cpu.divided(one, (both + s) * whole),
        ]);
        let mut out = [PatchFlow::default(); GROUP];
        for ((out, mean), quarters) in out.iter_mut().zip(means).zip(quarters) {
            let [p, q, r, s, a, b, c, d] = cpu.store(quarters);
            *out = PatchFlow { mean: Mean(cpu.store(mean)), quarters: [p, q, r, s], weights: [a, b, c, d] };
        }
        out
    }
}

#[inline(always)]
fn chosen<C: WordCpu>(cpu: C, [value, limit]: [C::Lanes; 2], next: C::Lanes, lanes: C::Lanes) -> C::Lanes {
    cpu.above_floats(value, limit, next, lanes)
}

/// The bits of the first `count` patches of a group.
pub(super) fn first_bits(count: usize) -> u32 {
    (1 << count.min(GROUP)) - 1
}

impl LevelPair<'_> {
    /// The same levels from the second frame to the first.
    pub(super) fn reversed(self) -> Self {
        Self { first: self.second, second: self.first, ..self }
    }
}

/// Finds a row of patches, each from the best of its candidates; `candidates(first, count)` are those of `count` patches from
/// column `first` on. A later candidate must be clearly better than an earlier one.
#[inline(always)]
pub(super) fn find<C: WordCpu, const N: usize>(
    group: &mut PatchGroup<C>,
    pair: LevelPair<'_>,
    row: usize,
    steps: usize,
    candidates: impl Fn(usize, usize) -> Candidates<C, N>,
    out: &mut [PatchFlow],
) -> Option<()> {
    let cpu = group.cpu;
    for (index, out) in out.chunks_mut(GROUP).enumerate() {
        let first = index * GROUP;
        let corners: [[usize; 2]; GROUP] = std::array::from_fn(|k| [(first + k) * CELL, row * CELL]);
        group.take(pair.first, pair.noise, corners.get(..out.len())?)?;
        let Candidates { shifts, active } = candidates(first, out.len());
        let all = first_bits(out.len());
        let mut best: Option<Trial<C>> = None;
        for (shift, active) in shifts.into_iter().zip(active) {
            let active = active & all;
            if active == 0 {
                continue;
            }
            let next = group.at(pair.second, shift, active)?;
            best = Some(match best {
                None => next,
                Some(best) => {
                    let there: [f32; GROUP] = std::array::from_fn(|k| (active >> k & 1) as f32);
                    let bounds = [cpu.load(&there), cpu.splat(0.5)];
                    // Infinite where a patch has no such candidate, so that none is taken.
                    let total = chosen(cpu, bounds, next.difference.total, cpu.splat(f32::INFINITY));
                    let difference = Difference { total, ..next.difference };
                    best.or(cpu, Trial { difference, ..next }, pair.noise)
                }
            });
        }
        let mut best = best?;
        group.refine(pair.second, &mut best, steps, all)?;
        for (out, found) in out.iter_mut().zip(group.found(&best, pair.noise)) {
            *out = found;
        }
    }
    Some(())
}

/// A row of cells, each the weighted mean of the patches that cover it. `patches` has `across` patches in a row.
#[inline(always)]
pub(super) fn overlap<C: WordCpu>(
    cpu: C,
    patches: &[PatchFlow],
    across: usize,
    row: usize,
    out: &mut [Mean],
) {
    let line = |row: usize| patches.chunks(across.max(1)).nth(row).unwrap_or_default();
    // Wraps at row 0 to an index that no row has.
    let lines = [line(row), line(row.wrapping_sub(1))];
    for (column, out) in out.iter_mut().enumerate() {
        let (mut sum, mut residuals) = (cpu.splat(0.0), 0.0);
        for (j, line) in lines.iter().enumerate() {
            for i in 0..2 {
                // The patch whose quarter (i, j) is this cell.
                let Some(patch) = line.get(column.wrapping_sub(i)) else { continue };
                let weight = patch.weights[2 * i + j];
                sum = cpu.fused(cpu.splat(weight), cpu.load(&patch.mean.0), sum);
                residuals += weight * patch.quarters[2 * i + j];
            }
        }
        let [.., weights] = cpu.store(sum);
        let share = if weights > 0.0 { 1.0 / weights } else { 0.0 };
        out.0 = cpu.store(sum * cpu.splat(share));
        out.0[2] = residuals * share;
    }
}
