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

/// Of two that were found for one patch the later where it is clearly better.
#[inline(always)]
pub(super) fn better(earlier: Option<Found>, later: Option<Found>, noise: f32) -> Option<Found> {
    match (&earlier, &later) {
        (Some(one), Some(other)) if !is_better(other.total, one.total, noise) => earlier,
        (_, Some(_)) => later,
        _ => earlier,
    }
}

/// Cells (columns, rows) of a level of `width` × `height` pixels; the last ones may reach out of it.
pub(super) fn cells(level: &Level) -> (usize, usize) {
    (level.width().div_ceil(CELL), level.height().div_ceil(CELL))
}

/// Two levels, and how often a patch is compared.
#[derive(Clone, Copy)]
pub(super) struct Pair<'a> {
    pub(super) first: &'a Level,
    pub(super) second: &'a Level,
    /// Comparisons after the candidates'.
    pub(super) steps: usize,
    /// Variance of a pixel's noise, squared grey levels.
    pub(super) noise: f32,
}

impl Pair<'_> {
    /// Finds the patch whose top left pixel is (x, y): of `candidates` (displacements in pixels) the best, the first
    /// being preferred where others are hardly better, and from there by Gauss–Newton steps for as long as the residual
    /// falls. `template` is scratch.
    #[inline(always)]
    pub(super) fn find<C: Cpu>(
        &self,
        template: &mut Template<C>,
        x: usize,
        y: usize,
        candidates: &[[f32; 2]],
    ) -> Option<Found> {
        template.take(self.first, self.noise, x, y)?;
        let at = [x as f32, y as f32];
        let mut best: Option<([f32; 2], Difference)> = None;
        for (index, shift) in candidates.iter().enumerate() {
            let is_tried =
                |other: &[f32; 2]| (other[0] - shift[0]).abs() < ALIKE && (other[1] - shift[1]).abs() < ALIKE;
            if candidates.iter().take(index).any(is_tried) {
                continue;
            }
            let next = self.compared(template, at, *shift)?;
            if best.is_none_or(|(_, best)| is_better(next.1.total, best.total, self.noise)) {
                best = Some(next);
            }
        }
        let (mut shift, mut best) = best?;
        for _ in 0..self.steps {
            let [x, y] = best.step;
            let (to, next) = self.compared(template, at, [shift[0] + x, shift[1] + y])?;
            if next.total < best.total {
                (shift, best) = (to, next);
            } else {
                // A step that leads away is halved.
                best.step = best.step.map(|step| 0.5 * step);
            }
        }
        let Difference { squares, total, .. } = best;
        Some(Found { shift, squares, total, tensor: template.tensor, energy: template.energy })
    }
}

impl Pair<'_> {
    #[inline(always)]
    fn compared<C: Cpu>(
        &self,
        template: &Template<C>,
        [x, y]: [f32; 2],
        shift: [f32; 2],
    ) -> Option<([f32; 2], Difference)> {
        Some((shift, template.compare(self.second, [x + shift[0], y + shift[1]])?))
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
