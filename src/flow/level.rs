//! One level: candidates for each patch, steps from the best of them, and the mean of overlapping patches.
//!
//! Patches of 8 × 8 pixels overlap by half, so that each cell of 4 × 4 pixels is seen by up to four. A candidate is
//! judged by its residual alone; what it comes from (the coarser level, cells beside it, the prediction, the other
//! direction) only decides whether it is tried. A level sets the most comparisons of a patch; candidates that lie next to
//! each other share one.

use super::lanes::Cpu;
use super::patch::{AREA, Difference, SIDE, Template};
use crate::pyramid::Level;

/// Side of a cell in pixels of the level.
pub(super) const CELL: usize = SIDE / 2;

/// A candidate replaces an earlier one that leaves more than this many times its residual, and the variance of a pixel's
/// noise more a pixel.
const BETTER: f32 = 1.15;

/// Candidates that differ by less along both axes, in pixels, lead to the same place by steps.
const ALIKE: f32 = 0.5;

/// A step shorter than this, in pixels, is compared no more.
const SHORT: f32 = 0.05;

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

impl<'a> Pair<'a> {
    /// `template` is scratch; `None` further outside than the border.
    #[inline(always)]
    pub(super) fn patch<C: Cpu>(
        self,
        template: &'a mut Template<C>,
        x: usize,
        y: usize,
    ) -> Option<Search<'a, C>> {
        template.take(self.first, self.noise, x, y)?;
        Some(Search { template, pair: self, x, y })
    }
}

/// A displacement in pixels, and what it leaves.
#[derive(Clone, Copy, Debug)]
pub(super) struct Best {
    shift: [f32; 2],
    left: Difference,
}

impl Best {
    /// Of two the later where it is clearly better; `noise` is the variance of a pixel's noise.
    #[inline(always)]
    pub(super) fn or(self, later: Self, noise: f32) -> Self {
        if is_better(later.left.total, self.left.total, noise) { later } else { self }
    }

    #[inline(always)]
    fn step(&self) -> f32 {
        let [x, y] = self.left.step;
        x * x + y * y
    }

    #[inline(always)]
    fn next(&self) -> [f32; 2] {
        [self.shift[0] + self.left.step[0], self.shift[1] + self.left.step[1]]
    }
}

impl<C: Cpu> Search<'_, C> {
    /// What a displacement leaves.
    #[inline(always)]
    fn at(&self, shift: [f32; 2]) -> Option<Best> {
        let corner = [self.x as f32 + shift[0], self.y as f32 + shift[1]];
        Some(Best { shift, left: self.template.compare(self.pair.second, corner)? })
    }

    /// The best of some displacements, the first being preferred where others are hardly better.
    #[inline(always)]
    fn best<const N: usize>(&self, candidates: [[f32; 2]; N]) -> Option<Best> {
        let (first, others) = candidates.split_first()?;
        let mut best = self.at(*first)?;
        for (index, shift) in others.iter().enumerate() {
            let is_alike =
                |other: &[f32; 2]| (other[0] - shift[0]).abs() < ALIKE && (other[1] - shift[1]).abs() < ALIKE;
            if !candidates.iter().take(index + 1).any(is_alike) {
                best = best.or(self.at(*shift)?, self.pair.noise);
            }
        }
        Some(best)
    }

    /// The best of some displacements, and steps from there.
    #[inline(always)]
    pub(super) fn from<const N: usize>(&self, candidates: [[f32; 2]; N], steps: usize) -> Option<Best> {
        self.refined(self.best(candidates)?, steps)
    }

    /// Goes on by Gauss–Newton steps for as long as the residual falls.
    #[inline(always)]
    fn refined(&self, mut best: Best, steps: usize) -> Option<Best> {
        for _ in 0..steps {
            if best.step() < SHORT * SHORT {
                break;
            }
            let next = self.at(best.next())?;
            if next.left.total < best.left.total {
                best = next;
            } else {
                // A step that leads away is halved.
                best.left.step = best.left.step.map(|step| 0.5 * step);
            }
        }
        if best.step() < LAST * LAST {
            best.shift = best.next();
        }
        Some(best)
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
