// SPDX-License-Identifier: MIT OR Apache-2.0

//! One level: candidates for each patch, Gauss–Newton steps from the best one, and the mean of overlapping
//! patches.
//!
//! Patches of 8 × 8 pixels overlap by half, so that each cell of 4 × 4 pixels is covered by up to four.
//! Candidates are compared by residual alone, whatever their source (the coarser level, neighbouring cells,
//! the prediction, the opposite direction). Candidates closer than [`SAME_CANDIDATE`] are compared once.

use super::patch::{AREA, Difference, PatchTemplate, SIDE};
use crate::lanes::Cpu;
use crate::pyramid::Level;
use std::hint::select_unpredictable;

/// Side of a cell in pixels of the level.
pub(super) const CELL: usize = SIDE / 2;

/// A candidate replaces an earlier one whose residual is more than this many times its own, plus the noise
/// variance per pixel.
const RESIDUAL_GAIN: f32 = 1.15;

/// Candidates that differ by less than this along both axes, in pixels, converge to the same displacement.
const SAME_CANDIDATE: f32 = 0.5;

/// Patches searched in turn, so that one comparison does not wait for the previous step of the same patch;
/// their templates take 4 KB.
const INTERLEAVED: usize = 4;

/// The estimate for a patch or a cell: displacement x and y in pixels of the level; then means over its
/// pixels: squared difference; structure tensor xx, xy, yy; squared difference from the mean grey; and last
/// 1, or 0 without an estimate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Mean(pub(super) [f32; SIDE]);

impl Mean {
    #[inline(always)]
    pub(super) fn shift(&self) -> [f32; 2] {
        [self.0[0], self.0[1]]
    }

    #[inline(always)]
    pub(super) fn residual(&self) -> f32 {
        self.0[2]
    }

    #[inline(always)]
    pub(super) fn tensor(&self) -> [f32; 3] {
        [self.0[3], self.0[4], self.0[5]]
    }

    #[inline(always)]
    pub(super) fn energy(&self) -> f32 {
        self.0[6]
    }
}

/// The result for one patch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PatchFlow {
    pub(super) mean: Mean,
    /// Mean squared differences of the quarters: top left, bottom left, top right, bottom right.
    pub(super) quarters: [f32; 4],
}

impl PatchFlow {
    /// The same, with the structure tensor multiplied by `share`.
    pub(super) fn with_scaled_tensor(mut self, share: f32) -> Self {
        self.mean.0[3..6].iter_mut().for_each(|value| *value *= share);
        self
    }
}

/// Whether a candidate of residual `next` replaces an earlier one; `noise` is the noise variance of a pixel.
#[inline(always)]
fn is_better(next: f32, earlier: f32, noise: f32) -> bool {
    RESIDUAL_GAIN * next + AREA * noise < earlier
}

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

/// The search for the patch of the first level whose top left pixel is (x, y) in the second.
pub(super) struct PatchSearch<'a, C: Cpu> {
    pub(super) template: &'a PatchTemplate<C>,
    pub(super) pair: LevelPair<'a>,
    /// x and y.
    pub(super) corner: [f32; 2],
}

/// A displacement in pixels with its residual and Gauss–Newton step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Trial {
    shift: [f32; 2],
    difference: Difference,
}

impl Trial {
    /// The later of two if it is clearly better, otherwise this one; `noise` is the noise variance of a
    /// pixel.
    #[inline(always)]
    pub(super) fn or(self, later: Self, noise: f32) -> Self {
        select_unpredictable(is_better(later.difference.total, self.difference.total, noise), later, self)
    }

    /// The displacement after the step.
    #[inline(always)]
    fn next(&self) -> [f32; 2] {
        [self.shift[0] + self.difference.step[0], self.shift[1] + self.difference.step[1]]
    }
}

impl<C: Cpu> PatchSearch<'_, C> {
    /// Compares the patch at a displacement.
    #[inline(always)]
    pub(super) fn at(&self, shift: [f32; 2]) -> Option<Trial> {
        let corner = [self.corner[0] + shift[0], self.corner[1] + shift[1]];
        Some(Trial { shift, difference: self.template.compare(self.pair.second, corner)? })
    }

    #[inline(always)]
    pub(super) fn found(&self, best: Trial) -> PatchFlow {
        let Difference { squares, total, .. } = best.difference;
        let ([x, y], [xx, xy, yy]) = (best.shift, self.template.tensor);
        let [total, xx, xy, yy, energy] =
            [total, xx, xy, yy, self.template.energy].map(|sum| sum * (1.0 / AREA));
        let mean = Mean([x, y, total, xx, xy, yy, energy, 1.0]);
        PatchFlow { mean, quarters: squares.map(|square| square * (4.0 / AREA)) }
    }
}

impl LevelPair<'_> {
    /// The same levels from the second frame to the first.
    pub(super) fn reversed(self) -> Self {
        Self { first: self.second, second: self.first, ..self }
    }

    /// Refines the patch whose top left pixel is (x, y) from two displacements; the second result is taken
    /// only if clearly better.
    #[inline(always)]
    pub(super) fn best_of_two<C: Cpu>(
        self,
        template: &mut PatchTemplate<C>,
        [x, y]: [usize; 2],
        steps: usize,
        from: impl FnOnce(&PatchSearch<'_, C>) -> [[f32; 2]; 2],
    ) -> Option<PatchFlow> {
        template.take(self.first, self.noise, x, y)?;
        let search = PatchSearch { template, pair: self, corner: [x as f32, y as f32] };
        let [first, second] = from(&search);
        let mut both = [search.at(first)?, search.at(second)?];
        refine([&search, &search], &mut both, steps)?;
        let [first, second] = both;
        Some(search.found(first.or(second, self.noise)))
    }
}

/// Gauss–Newton steps from one displacement per search, accepted if the residual falls.
///
/// The searches take turns, and there is no branch on the results: a comparison waits for the previous step
/// of its own search only.
#[inline(always)]
pub(super) fn refine<C: Cpu, const G: usize>(
    searches: [&PatchSearch<'_, C>; G],
    best: &mut [Trial; G],
    steps: usize,
) -> Option<()> {
    for _ in 0..steps {
        for (search, best) in searches.iter().zip(best.iter_mut()) {
            let next = search.at(best.next())?;
            // A step that raises the residual is halved.
            let step = best.difference.step.map(|step| 0.5 * step);
            let halved = Trial { difference: Difference { step, ..best.difference }, ..*best };
            *best = select_unpredictable(next.difference.total < best.difference.total, next, halved);
        }
    }
    Some(())
}

/// Finds a row of patches, each from the best of its candidates (displacements in pixels); a later candidate
/// must be clearly better than an earlier one.
#[inline(always)]
pub(super) fn find<C: Cpu, const N: usize>(
    cpu: C,
    pair: LevelPair<'_>,
    row: usize,
    steps: usize,
    candidates: impl Fn(usize) -> [[f32; 2]; N],
    out: &mut [PatchFlow],
) -> Option<()> {
    let last = out.len().checked_sub(1)?;
    let mut templates: [_; INTERLEAVED] = std::array::from_fn(|_| PatchTemplate::new(cpu));
    for (group, out) in out.chunks_mut(INTERLEAVED).enumerate() {
        let column = |k: usize| (group * INTERLEAVED + k).min(last);
        for (k, template) in templates.iter_mut().enumerate() {
            template.take(pair.first, pair.noise, column(k) * CELL, row * CELL)?;
        }
        let mut k = 0;
        let searches = templates.each_ref().map(|template| {
            k += 1;
            let corner = [column(k - 1) * CELL, row * CELL].map(|at| at as f32);
            PatchSearch { template, pair, corner }
        });
        let mut best = [Trial::default(); INTERLEAVED];
        for (k, (search, best)) in searches.iter().zip(&mut best).enumerate() {
            let candidates = candidates(column(k));
            for (index, shift) in candidates.iter().enumerate() {
                let is_same = |other: &[f32; 2]| {
                    (other[0] - shift[0]).abs() < SAME_CANDIDATE
                        && (other[1] - shift[1]).abs() < SAME_CANDIDATE
                };
                if index == 0 {
                    *best = search.at(*shift)?;
                } else if !candidates.iter().take(index).any(is_same) {
                    *best = best.or(search.at(*shift)?, pair.noise);
                }
            }
        }
        refine(searches.each_ref(), &mut best, steps)?;
        for (out, (search, best)) in out.iter_mut().zip(searches.iter().zip(best)) {
            *out = search.found(best);
        }
    }
    Some(())
}

/// A row of cells, each the weighted mean of the patches that cover it. `patches` has `across` patches in a
/// row; `noise` is the noise variance of a pixel.
#[inline(always)]
pub(super) fn overlap<C: Cpu>(
    cpu: C,
    patches: &[PatchFlow],
    across: usize,
    row: usize,
    noise: f32,
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
                let residual = patch.quarters[2 * i + j];
                // Residuals below the noise of two frames are not distinguished.
                let weight = 1.0 / ((2.0 * noise + residual) * (2.0 * noise + patch.mean.residual()));
                sum = cpu.fused(cpu.splat(weight), cpu.load(&patch.mean.0), sum);
                residuals += weight * residual;
            }
        }
        let [.., weights] = cpu.store(sum);
        let share = if weights > 0.0 { 1.0 / weights } else { 0.0 };
        out.0 = cpu.store(sum * cpu.splat(share));
        out.0[2] = residuals * share;
    }
}
