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

/// Patches that are searched together.
const TOGETHER: usize = 4;

/// A step shorter than this, in pixels, is taken where no comparison is left for it.
const LAST: f32 = 0.25;

/// What was found for one patch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Found {
    /// Displacement in pixels of the level.
    pub(super) shift: [f32; 2],
    /// Squared differences of its quarters, and of all of it.
    pub(super) squares: [f32; 4],
    pub(super) total: f32,
    /// Its structure tensor, summed.
    pub(super) tensor: [f32; 3],
    /// Its squared differences from the mean, summed.
    pub(super) energy: f32,
}

/// A cell's displacement in pixels of its level.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Mean {
    pub(super) shift: [f32; 2],
    /// Weighted means over the patches that see the cell, per pixel: squared difference, tensor, energy.
    pub(super) residual: f32,
    pub(super) tensor: [f32; 3],
    pub(super) energy: f32,
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

/// A displacement in pixels, and what it leaves.
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
    /// What a displacement leaves.
    #[inline(always)]
    pub(super) fn at(&self, shift: [f32; 2]) -> Option<Best> {
        let corner = [self.x as f32 + shift[0], self.y as f32 + shift[1]];
        Some(Best { shift, left: self.template.compare(self.pair.second, corner)? })
    }

    #[inline(always)]
    pub(super) fn found(&self, best: Best) -> Found {
        let Difference { squares, total, .. } = best.left;
        Found {
            shift: best.shift,
            squares,
            total,
            tensor: self.template.tensor,
            energy: self.template.energy,
        }
    }
}

impl Pair<'_> {
    /// The patch whose top left pixel is `at` from two displacements, the first being preferred where the second leads to
    /// something hardly better.
    #[inline(always)]
    pub(super) fn best_of_two<C: Cpu>(
        self,
        template: &mut Template<C>,
        [x, y]: [usize; 2],
        steps: usize,
        from: impl FnOnce(&Search<'_, C>) -> [[f32; 2]; 2],
    ) -> Option<Found> {
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
    for best in best {
        let [x, y] = best.left.step;
        best.shift = select_unpredictable(x * x + y * y < LAST * LAST, best.next(), best.shift);
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
    out: &mut [Found],
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

/// The mean over the patches that see the cell in `column` and `row`, where `patches` has `across` of them in a row and
/// `noise` is the variance of a pixel's noise.
#[inline(always)]
pub(super) fn mean(patches: &[Found], across: usize, column: usize, row: usize, noise: f32) -> Mean {
    let mut sum = Mean::default();
    let mut weights = 0.0;
    let down = patches.len() / across.max(1);
    for (j, i) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        // The patch that has the cell as its quarter (j, i).
        let (Some(y), Some(x)) = (row.checked_sub(j), column.checked_sub(i)) else { continue };
        if x >= across || y >= down {
            continue;
        }
        let Some(patch) = patches.get(y * across + x) else { continue };
        let residual = patch.squares[2 * i + j] * (4.0 / AREA);
        let all = patch.total * (1.0 / AREA);
        // Patches that fit to within the noise of two frames count alike.
        let weight = 1.0 / ((2.0 * noise + residual) * (2.0 * noise + all));
        sum.shift[0] += weight * patch.shift[0];
        sum.shift[1] += weight * patch.shift[1];
        sum.residual += weight * residual;
        sum.energy += weight * (1.0 / AREA) * patch.energy;
        for (sum, value) in sum.tensor.iter_mut().zip(patch.tensor) {
            *sum += weight * (1.0 / AREA) * value;
        }
        weights += weight;
    }
    if weights > 0.0 {
        let share = 1.0 / weights;
        sum.shift = sum.shift.map(|value| value * share);
        sum.tensor = sum.tensor.map(|value| value * share);
        sum.residual *= share;
        sum.energy *= share;
    }
    sum
}
