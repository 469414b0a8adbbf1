//! One level: candidates for each patch, steps from the best of them, and the mean of overlapping patches.
//!
//! Patches of 8 × 8 pixels overlap by half, so that each cell of 4 × 4 pixels is seen by up to four. A candidate is
//! judged by its residual alone; what it comes from (the coarser level, cells beside it, the prediction, the other
//! direction) only decides whether it is tried. A level sets the most comparisons of a patch; candidates that lie next to
//! each other share one.

use super::lanes::Cpu;
use super::patch::{AREA, Difference, SIDE, Template};
use crate::pyramid::Level;
use std::hint::select_unpredictable;

/// Side of a cell in pixels of the level.
pub(super) const CELL: usize = SIDE / 2;

/// A candidate replaces an earlier one that leaves more than this many times its residual, and the variance of a pixel's
/// noise more a pixel.
const BETTER: f32 = 1.15;

/// Candidates that differ by less along both axes, in pixels, lead to the same place by steps.
const ALIKE: f32 = 0.5;

/// Patches that are searched together, for a comparison waits for the step before it; their templates take 4 KB.
const TOGETHER: usize = 4;

/// What is known of a patch or a cell, all but the shift a mean over its pixels: displacement x and y in pixels of the
/// level; squared difference; structure tensor xx, xy, yy; squared difference from the mean; and 1, or 0 of nothing.
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

/// What was found for one patch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PatchFlow {
    pub(super) mean: Mean,
    /// Mean squared difference of its quarters: top left, bottom left, top right, bottom right.
    pub(super) quarters: [f32; 4],
}

impl PatchFlow {
    /// The same, with a structure tensor `share` times as large.
    pub(super) fn dimmed(mut self, share: f32) -> Self {
        self.mean.0[3..6].iter_mut().for_each(|value| *value *= share);
        self
    }
}

/// Whether a residual is so much less than an earlier one that what leaves it takes its place; `noise` is the variance of a
/// pixel's noise.
#[inline(always)]
fn is_better(next: f32, earlier: f32, noise: f32) -> bool {
    BETTER * next + AREA * noise < earlier
}

/// Cells (columns, rows) of a level of `width` × `height` pixels; the last ones may reach out of it.
pub(super) fn cells(level: &Level) -> (usize, usize) {
    (level.width().div_ceil(CELL), level.height().div_ceil(CELL))
}

/// Two levels, and the variance of a pixel's noise in squared grey levels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair<'a> {
    pub(super) first: &'a Level,
    pub(super) second: &'a Level,
    pub(super) noise: f32,
}

/// The patch of the first level whose top left pixel is (x, y), and how the second is compared with it.
pub(super) struct Search<'a, C: Cpu> {
    pub(super) template: &'a Template<C>,
    pub(super) pair: Pair<'a>,
    pub(super) x: usize,
    pub(super) y: usize,
}

/// A displacement in pixels, and its residual.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Best {
    shift: [f32; 2],
    left: Difference,
}

impl Best {
    /// Of two the later where it is clearly better; `noise` is the variance of a pixel's noise.
    #[inline(always)]
    pub(super) fn or(self, later: Self, noise: f32) -> Self {
        select_unpredictable(is_better(later.left.total, self.left.total, noise), later, self)
    }

    /// Where its step leads.
    #[inline(always)]
    fn next(&self) -> [f32; 2] {
        [self.shift[0] + self.left.step[0], self.shift[1] + self.left.step[1]]
    }
}

impl<C: Cpu> Search<'_, C> {
    /// The residual of a displacement.
    #[inline(always)]
    pub(super) fn at(&self, shift: [f32; 2]) -> Option<Best> {
        let corner = [self.x as f32 + shift[0], self.y as f32 + shift[1]];
        Some(Best { shift, left: self.template.compare(self.pair.second, corner)? })
    }

    #[inline(always)]
    pub(super) fn found(&self, best: Best) -> PatchFlow {
        let Difference { squares, total, .. } = best.left;
        let ([x, y], [xx, xy, yy]) = (best.shift, self.template.tensor);
        let [total, xx, xy, yy, energy] =
            [total, xx, xy, yy, self.template.energy].map(|sum| sum * (1.0 / AREA));
        let mean = Mean([x, y, total, xx, xy, yy, energy, 1.0]);
        PatchFlow { mean, quarters: squares.map(|square| square * (4.0 / AREA)) }
    }
}

impl Pair<'_> {
    /// From the second frame to the first.
    pub(super) fn reversed(self) -> Self {
        Self { first: self.second, second: self.first, ..self }
    }

    /// The patch whose top left pixel is `at` from two displacements, the first being preferred where the second leads to
    /// something hardly better.
    #[inline(always)]
    pub(super) fn best_of_two<C: Cpu>(
        self,
        template: &mut Template<C>,
        [x, y]: [usize; 2],
        steps: usize,
        from: impl FnOnce(&Search<'_, C>) -> [[f32; 2]; 2],
    ) -> Option<PatchFlow> {
        template.take(self.first, self.noise, x, y)?;
        let search = Search { template, pair: self, x, y };
        let [first, second] = from(&search);
        let mut both = [search.at(first)?, search.at(second)?];
        refine([&search, &search], &mut both, steps)?;
        let [first, second] = both;
        Some(search.found(first.or(second, self.noise)))
    }
}

/// Goes on from a displacement of each of some searches by Gauss–Newton steps for as long as the residual falls.
///
/// In turn, and without a branch on what is found: a comparison waits for the step before it, but not for another search.
#[inline(always)]
pub(super) fn refine<C: Cpu, const G: usize>(
    searches: [&Search<'_, C>; G],
    best: &mut [Best; G],
    steps: usize,
) -> Option<()> {
    for _ in 0..steps {
        for (search, best) in searches.iter().zip(best.iter_mut()) {
            let next = search.at(best.next())?;
            // A step that leads away is halved.
            let step = best.left.step.map(|step| 0.5 * step);
            let halved = Best { left: Difference { step, ..best.left }, ..*best };
            *best = select_unpredictable(next.left.total < best.left.total, next, halved);
        }
    }
    Some(())
}

/// Finds a row of patches: each from the best of its candidates (displacements in pixels), the first being preferred where
/// others are hardly better.
#[inline(always)]
pub(super) fn find<C: Cpu, const N: usize>(
    cpu: C,
    pair: Pair<'_>,
    row: usize,
    steps: usize,
    candidates: impl Fn(usize) -> [[f32; 2]; N],
    out: &mut [PatchFlow],
) -> Option<()> {
    let last = out.len().checked_sub(1)?;
    let mut templates: [_; TOGETHER] = std::array::from_fn(|_| Template::new(cpu));
    for (group, out) in out.chunks_mut(TOGETHER).enumerate() {
        let column = |k: usize| (group * TOGETHER + k).min(last);
        for (k, template) in templates.iter_mut().enumerate() {
            template.take(pair.first, pair.noise, column(k) * CELL, row * CELL)?;
        }
        let mut k = 0;
        let searches = templates.each_ref().map(|template| {
            k += 1;
            Search { template, pair, x: column(k - 1) * CELL, y: row * CELL }
        });
        let mut best = [Best::default(); TOGETHER];
        for (k, (search, best)) in searches.iter().zip(&mut best).enumerate() {
            let candidates = candidates(column(k));
            for (index, shift) in candidates.iter().enumerate() {
                let is_alike = |other: &[f32; 2]| {
                    (other[0] - shift[0]).abs() < ALIKE && (other[1] - shift[1]).abs() < ALIKE
                };
                if index == 0 {
                    *best = search.at(*shift)?;
                } else if !candidates.iter().take(index).any(is_alike) {
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

/// A row of cells from the patches that see them, where `patches` has `across` of them in a row and `noise` is the variance of
/// a pixel's noise.
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
    // Before the first there is nothing either.
    let lines = [line(row), line(row.wrapping_sub(1))];
    for (column, out) in out.iter_mut().enumerate() {
        let (mut sum, mut residuals) = (cpu.splat(0.0), 0.0);
        for (j, line) in lines.iter().enumerate() {
            for i in 0..2 {
                // The patch that has the cell as its quarter (i, j).
                let Some(patch) = line.get(column.wrapping_sub(i)) else { continue };
                let residual = patch.quarters[2 * i + j];
                // Patches that fit to within the noise of two frames count alike.
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
