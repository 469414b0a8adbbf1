// SPDX-License-Identifier: MIT OR Apache-2.0

//! Confidence and information of each cell.
//!
//! > c = E/(E + ρ) · λ₁/(λ₁ + n/2) · 1/(1 + (b/(½ + 0.02·|u|))⁴)
//!
//! with E the variance of the patch plus 2n, n the noise variance of a pixel, ρ the mean squared difference,
//! λ₁ ≥ λ₂ the eigenvalues of the mean structure tensor, u the displacement and b the forward–backward error.
//! The eigenvalues of the information are aᵢ/(ρ + n + 0.075²·aᵢ), aᵢ = 64·max(λᵢ − n/2, 0).

use super::direction::FlowDirection;
use super::field::{Cell, FlowField};
use super::level::{CELL, Mean};
use super::patch::AREA;
use super::rows::{RowKernel, fill};
use crate::cpu::CpuLevel;
use crate::lanes::WordCpu;

/// Forward–backward error, in pixels of the level, at which the confidence is halved: consistent
/// displacements agree to some tenths, wrong ones differ by pixels.
const RETURN_ERROR: f32 = 0.5;

/// … plus this share of the displacement, as a motion may vary within a cell.
const RETURN_SHARE: f32 = 0.02;

/// Least standard deviation of a displacement, in pixels of the level, at any texture: the error of linear
/// interpolation.
const MIN_DEVIATION: f32 = 0.075;

/// Size and scale of a level.
#[derive(Clone, Copy, Debug)]
pub(super) struct LevelScale {
    /// Pixels of the level.
    pub(super) size: (usize, usize),
    /// Side of a cell in full-frame pixels.
    pub(super) side: f64,
    /// Noise variance of a pixel, squared grey levels.
    pub(super) noise: f32,
}

/// Fills the field of one direction.
pub(super) fn fill_field(
    cpu: CpuLevel,
    own: &FlowDirection,
    other: &FlowDirection,
    scale: LevelScale,
    field: &mut FlowField,
) {
    (field.columns, field.rows, field.side) = (own.columns, own.rows, scale.side);
    field.cells.resize(own.means.len(), Cell::default());
    fill(cpu, &CellKernel { own, other, scale }, own.columns, &mut field.cells);
}

struct CellKernel<'a> {
    own: &'a FlowDirection,
    other: &'a FlowDirection,
    scale: LevelScale,
}

impl RowKernel<Cell> for CellKernel<'_> {
    type Scratch<C: WordCpu> = ();

    fn scratch<C: WordCpu>(_: C) {}

    #[inline(always)]
    fn fill<C: WordCpu>(&self, _: C, (): &mut (), row: usize, out: &mut [Cell]) {
        let LevelScale { size, side, noise } = self.scale;
        let pixels = (side / CELL as f64) as f32;
        let means = self.own.means.iter().skip(row * self.own.columns);
        for (column, (out, mean)) in out.iter_mut().zip(means).enumerate() {
            let middle = |index: usize| (index as f32 + 0.5) * CELL as f32 - 0.5;
            let to = [middle(column) + mean.shift()[0], middle(row) + mean.shift()[1]];
            let is_inside = |at: f32, length: usize| at > -0.5 && at < length as f32 - 0.5;
            let is_seen = is_inside(to[0], size.0) && is_inside(to[1], size.1);
            let tensor = Tensor::of(mean);
            let confidence = if is_seen {
                let back = self.other.at(to[0], to[1]);
                consistency(mean.shift(), back) * explained_contrast(mean, noise) * tensor.texture(noise)
            } else {
                0.0
            };
            let information = tensor.information(mean.residual() + noise, noise);
            *out = Cell {
                flow: mean.shift().map(|shift| shift * pixels),
                confidence,
                information: information.map(|value| value / (pixels * pixels)),
            };
        }
    }
}

#[inline(always)]
fn consistency(shift: [f32; 2], back: [f32; 2]) -> f32 {
    let length = |x: f32, y: f32| (x * x + y * y).sqrt();
    let error = length(shift[0] + back[0], shift[1] + back[1]);
    let tolerance = RETURN_ERROR + RETURN_SHARE * length(shift[0], shift[1]);
    let ratio = error / tolerance;
    1.0 / (1.0 + ratio * ratio * ratio * ratio)
}

/// The share of the patch's contrast that the displacement explains.
#[inline(always)]
fn explained_contrast(mean: &Mean, noise: f32) -> f32 {
    let contrast = mean.energy() + 2.0 * noise;
    contrast / (contrast + mean.residual())
}

/// The mean structure tensor of a cell (xx, xy, yy) and its eigenvalues.
struct Tensor {
    entries: [f32; 3],
    larger: f32,
    smaller: f32,
}

impl Tensor {
    #[inline(always)]
    fn of(mean: &Mean) -> Self {
        let [xx, xy, yy] = mean.tensor();
        let (half, middle) = (0.5 * (xx - yy), 0.5 * (xx + yy));
        let root = (half * half + xy * xy).sqrt();
        Self { entries: mean.tensor(), larger: middle + root, smaller: middle - root }
    }

    /// Texture as a share, 0 to 1: the larger eigenvalue over itself plus the noise variance of gradients.
    #[inline(always)]
    fn texture(&self, noise: f32) -> f32 {
        self.larger / (self.larger + 0.5 * noise)
    }

    /// The inverse covariance of a cell's displacement (xx, xy, yy; pixels of the level): least squares over
    /// the n pixels of a patch, n·(T − noise)/s² with s² = `variance` of the residual, bounded by
    /// [`MIN_DEVIATION`].
    #[inline(always)]
    fn information(&self, variance: f32, noise: f32) -> [f32; 3] {
        let [xx, xy, yy] = self.entries;
        let along = |eigenvalue: f32| {
            let signal = AREA * (eigenvalue - 0.5 * noise).max(0.0);
            signal / (variance + MIN_DEVIATION * MIN_DEVIATION * signal)
        };
        let (strong, weak) = (along(self.larger), along(self.smaller));
        // weak·I + (strong − weak)·e·eᵀ with e·eᵀ = (T − smaller·I)/(larger − smaller).
        let share = (strong - weak) / (self.larger - self.smaller).max(f32::MIN_POSITIVE);
        [weak + share * (xx - self.smaller), share * xy, weak + share * (yy - self.smaller)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn information_along_an_edge_is_zero() {
        // Gradients along (3, 4)/5 only.
        let mean = Mean([0.0, 0.0, 1.0, 36.0, 48.0, 64.0, 0.0, 1.0]);
        let [xx, xy, yy] = Tensor::of(&mean).information(1.5, 0.5);
        let along = |x: f32, y: f32| xx * x * x + 2.0 * xy * x * y + yy * y * y;
        let signal = 64.0 * (100.0 - 0.25);
        let expected = signal / (1.5 + MIN_DEVIATION * MIN_DEVIATION * signal);
        assert!((along(0.6, 0.8) / expected - 1.0).abs() < 1e-3, "{}", along(0.6, 0.8));
        assert!(along(0.8, -0.6).abs() < 1e-2, "{}", along(0.8, -0.6));
    }

    #[test]
    fn a_flat_cell_has_no_information() {
        assert_eq!(Tensor::of(&Mean::default()).information(0.5, 0.5), [0.0; 3]);
        assert_eq!(Tensor::of(&Mean::default()).texture(0.5), 0.0);
    }
}
