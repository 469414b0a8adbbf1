//! How far each cell is to be trusted.
//!
//! > c = E/(E + ρ) · λ₁/(λ₁ + n/2) · 1/(1 + (b/(½ + 0.02·|u|))⁴)
//!
//! with E the variance of the patch plus 2n, n the variance of a pixel's noise, ρ the mean squared difference, λ₁ ≥ λ₂ the
//! eigenvalues of the mean structure tensor, u the displacement and b the distance between start and return. The
//! eigenvalues of the information are aᵢ/(ρ + n + 0.075²·aᵢ), aᵢ = 64·max(λᵢ − n/2, 0).

use super::direction::Direction;
use super::field::{Cell, FlowField};
use super::lanes::Cpu;
use super::level::{CELL, Mean};
use super::patch::AREA;
use super::rows::{RowKernel, fill};
use crate::cpu::CpuLevel;

/// A point that does not come back to where it started by this many pixels of the level is trusted half: displacements
/// that belong together agree to some tenths, wrong ones are off by pixels.
const RETURN_ERROR: f32 = 0.5;

/// … and by this share of the displacement more, by which a motion may differ within a cell.
const RETURN_SHARE: f32 = 0.02;

/// Deviation of a displacement in pixels of the level, however much there is to be seen: the linear interpolation of a
/// comparison.
const LEAST_DEVIATION: f32 = 0.075;

/// A level and how its pixels lie in the frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scale {
    /// Pixels of the level.
    pub(super) size: (usize, usize),
    /// Side of a cell in full-frame pixels.
    pub(super) side: f64,
    /// Variance of a pixel's noise, squared grey levels.
    pub(super) noise: f32,
}

/// Makes the field of one direction.
pub(super) fn judge(cpu: CpuLevel, own: &Direction, other: &Direction, scale: Scale, field: &mut FlowField) {
    (field.columns, field.rows, field.side) = (own.columns, own.rows, scale.side);
    field.cells.resize(own.means.len(), Cell::default());
    fill(cpu, &Judgement { own, other, scale }, own.columns, &mut field.cells);
}

struct Judgement<'a> {
    own: &'a Direction,
    other: &'a Direction,
    scale: Scale,
}

impl RowKernel<Cell> for Judgement<'_> {
    #[inline(always)]
    fn fill<C: Cpu>(&self, _: C, row: usize, out: &mut [Cell]) {
        let Scale { size, side, noise } = self.scale;
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
                consistency(mean.shift(), back) * explained(mean, noise) * tensor.texture(noise)
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
    let usual = RETURN_ERROR + RETURN_SHARE * length(shift[0], shift[1]);
    let ratio = error / usual;
    1.0 / (1.0 + ratio * ratio * ratio * ratio)
}

/// The share of the patch's contrast that the displacement explains.
#[inline(always)]
fn explained(mean: &Mean, noise: f32) -> f32 {
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

    /// Whether there is anything to be seen: the larger eigenvalue against the noise of gradients.
    #[inline(always)]
    fn texture(&self, noise: f32) -> f32 {
        self.larger / (self.larger + 0.5 * noise)
    }

    /// The inverse covariance of a cell's displacement (xx, xy, yy; pixels of the level): least squares over a patch,
    /// n·(T − noise)/s² with s² = `variance` that of the residual, up to the accuracy of a comparison.
    #[inline(always)]
    fn information(&self, variance: f32, noise: f32) -> [f32; 3] {
        let [xx, xy, yy] = self.entries;
        let along = |eigenvalue: f32| {
            let signal = AREA * (eigenvalue - 0.5 * noise).max(0.0);
            signal / (variance + LEAST_DEVIATION * LEAST_DEVIATION * signal)
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
    fn along_an_edge_nothing_is_known() {
        // Gradients along (3, 4)/5 only.
        let mean = Mean([0.0, 0.0, 1.0, 36.0, 48.0, 64.0, 0.0, 1.0]);
        let [xx, xy, yy] = Tensor::of(&mean).information(1.5, 0.5);
        let along = |x: f32, y: f32| xx * x * x + 2.0 * xy * x * y + yy * y * y;
        let signal = 64.0 * (100.0 - 0.25);
        let expected = signal / (1.5 + LEAST_DEVIATION * LEAST_DEVIATION * signal);
        assert!((along(0.6, 0.8) / expected - 1.0).abs() < 1e-3, "{}", along(0.6, 0.8));
        assert!(along(0.8, -0.6).abs() < 1e-2, "{}", along(0.8, -0.6));
    }

    #[test]
    fn a_flat_cell_says_nothing() {
        assert_eq!(Tensor::of(&Mean::default()).information(0.5, 0.5), [0.0; 3]);
        assert_eq!(Tensor::of(&Mean::default()).texture(0.5), 0.0);
    }
}
