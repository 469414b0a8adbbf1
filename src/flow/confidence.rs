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
use super::level::CELL;
use super::patch::{AREA, GROUP};
use super::rows::{RowKernel, fill};
use crate::cpu::CpuLevel;
use crate::lanes::WordCpu;

/// Least confidence at which a displacement is used.
pub(crate) const MIN_CONFIDENCE: f32 = 0.5;

/// Forward–backward error, in pixels of the level, at which the confidence is halved: consistent
/// displacements agree to some tenths, wrong ones differ by pixels.
pub(super) const RETURN_ERROR: f32 = 0.5;

/// … plus this share of the displacement, as a motion may vary within a cell.
pub(super) const RETURN_SHARE: f32 = 0.02;

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
    // All are written.
    field.cells.resize(own.means().len(), Cell::default());
    fill(cpu, &CellKernel { own, other, scale }, own.columns, &mut field.cells);
}

struct CellKernel<'a> {
    own: &'a FlowDirection,
    other: &'a FlowDirection,
    scale: LevelScale,
}

impl RowKernel<Cell> for CellKernel<'_> {
    type Scratch<C: WordCpu> = ();

    #[inline(always)]
    fn fill<C: WordCpu>(&self, cpu: C, (): &mut (), row: usize, out: &mut [Cell]) {
        let means = self.own.means().get(row * self.own.columns..).unwrap_or_default();
        for (group, (out, means)) in out.chunks_mut(GROUP).zip(means.chunks(GROUP)).enumerate() {
            let mut rows = [cpu.splat(0.0); GROUP];
            for (out, mean) in rows.iter_mut().zip(means) {
                *out = cpu.load(&mean.0);
            }
            let [x, y, residual, xx, xy, yy, energy, _] = cpu.transposed(rows);
            let mean = Means { shift: [x, y], residual, tensor: [xx, xy, yy], energy };
            let cells = cpu.transposed(self.cells(cpu, group * GROUP, row, mean));
            for (out, cell) in out.iter_mut().zip(cells) {
                let [x, y, confidence, xx, xy, yy, ..] = cpu.store(cell);
                *out = Cell { flow: [x, y], confidence, information: [xx, xy, yy] };
            }
        }
    }
}

/// The estimates of eight cells, one in each lane, as in [`Mean`](super::estimate::Mean).
struct Means<C: WordCpu> {
    shift: [C::Lanes; 2],
    residual: C::Lanes,
    tensor: [C::Lanes; 3],
    energy: C::Lanes,
}

impl CellKernel<'_> {
    /// The fields of eight cells from column `first` on: flow, confidence, information, and nothing else.
    #[inline(always)]
    fn cells<C: WordCpu>(&self, cpu: C, first: usize, row: usize, mean: Means<C>) -> [C::Lanes; GROUP] {
        let LevelScale { size, side, noise } = self.scale;
        let pixels = (side / CELL as f64) as f32;
        let [x, y] = mean.shift;
        let middle = |index: usize| (index as f32 + 0.5) * CELL as f32 - 0.5;
        let columns: [f32; GROUP] = std::array::from_fn(|k| middle(first + k));
        let to = [cpu.load(&columns) + x, cpu.splat(middle(row)) + y];
        let [back_x, back_y] = self.other.at(cpu, to);
        let error = length(cpu, x + back_x, y + back_y);
        let tolerance = cpu.splat(RETURN_ERROR) + cpu.splat(RETURN_SHARE) * length(cpu, x, y);
        let ratio = cpu.divided(error, tolerance);
        let one = cpu.splat(1.0);
        let consistency = cpu.divided(one, one + ratio * ratio * ratio * ratio);
        // The share of the patch's contrast that the displacement explains.
        let contrast = mean.energy + cpu.splat(2.0 * noise);
        let explained = cpu.divided(contrast, contrast + mean.residual);
        let tensor = Tensor::of(cpu, mean.tensor);
        let mut confidence = consistency * explained * tensor.texture(cpu, noise);
        for (at, length) in to.into_iter().zip([size.0, size.1]) {
            let zero = cpu.splat(0.0);
            let inside = cpu.above_floats(cpu.splat(length as f32 - 0.5), at, confidence, zero);
            confidence = cpu.above_floats(at, cpu.splat(-0.5), inside, zero);
        }
        let [xx, xy, yy] = tensor.information(cpu, mean.residual + cpu.splat(noise), noise);
        let (unit, area) = (cpu.splat(pixels), cpu.splat(pixels * pixels));
        let [xx, xy, yy] = [cpu.divided(xx, area), cpu.divided(xy, area), cpu.divided(yy, area)];
        [x * unit, y * unit, confidence, xx, xy, yy, one, one]
    }
}

#[inline(always)]
fn length<C: WordCpu>(cpu: C, x: C::Lanes, y: C::Lanes) -> C::Lanes {
    cpu.root(x * x + y * y)
}

/// The mean structure tensors of cells (xx, xy, yy) and their eigenvalues.
struct Tensor<C: WordCpu> {
    entries: [C::Lanes; 3],
    larger: C::Lanes,
    smaller: C::Lanes,
}

impl<C: WordCpu> Tensor<C> {
    #[inline(always)]
    fn of(cpu: C, entries: [C::Lanes; 3]) -> Self {
        let [xx, xy, yy] = entries;
        let (half, middle) = (cpu.splat(0.5) * (xx - yy), cpu.splat(0.5) * (xx + yy));
        let root = length(cpu, half, xy);
        Self { entries, larger: middle + root, smaller: middle - root }
    }

    /// Texture as a share, 0 to 1: the larger eigenvalue over itself plus the noise variance of gradients.
    #[inline(always)]
    fn texture(&self, cpu: C, noise: f32) -> C::Lanes {
        cpu.divided(self.larger, self.larger + cpu.splat(0.5 * noise))
    }

    /// The inverse covariance of a cell's displacement (xx, xy, yy; pixels of the level): least squares over
    /// the n pixels of a patch, n·(T − noise)/s² with s² = `variance` of the residual, bounded by
    /// [`MIN_DEVIATION`].
    #[inline(always)]
    fn information(&self, cpu: C, variance: C::Lanes, noise: f32) -> [C::Lanes; 3] {
        let [xx, xy, yy] = self.entries;
        let (strong, weak) =
            (along(cpu, self.larger, variance, noise), along(cpu, self.smaller, variance, noise));
        // weak·I + (strong − weak)·e·eᵀ with e·eᵀ = (T − smaller·I)/(larger − smaller).
        let apart = cpu.greater(self.larger - self.smaller, cpu.splat(f32::MIN_POSITIVE));
        let share = cpu.divided(strong - weak, apart);
        [weak + share * (xx - self.smaller), share * xy, weak + share * (yy - self.smaller)]
    }
}

/// The information along the axis of an eigenvalue.
#[inline(always)]
fn along<C: WordCpu>(cpu: C, eigenvalue: C::Lanes, variance: C::Lanes, noise: f32) -> C::Lanes {
    let excess = cpu.greater(eigenvalue - cpu.splat(0.5 * noise), cpu.splat(0.0));
    let signal = cpu.splat(AREA) * excess;
    cpu.divided(signal, variance + cpu.splat(MIN_DEVIATION * MIN_DEVIATION) * signal)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Cpu;
    use crate::lanes::scalar::Scalar;

    fn information(tensor: [f32; 3], variance: f32) -> [f32; 3] {
        let tensor = Tensor::of(Scalar, tensor.map(|entry| Scalar.splat(entry)));
        tensor.information(Scalar, Scalar.splat(variance), 0.5).map(|entry| Scalar.store(entry)[0])
    }

    #[test]
    fn information_along_an_edge_is_zero() {
        // Gradients along (3, 4)/5 only.
        let [xx, xy, yy] = information([36.0, 48.0, 64.0], 1.5);
        let along = |x: f32, y: f32| xx * x * x + 2.0 * xy * x * y + yy * y * y;
        let signal = 64.0 * (100.0 - 0.25);
        let expected = signal / (1.5 + MIN_DEVIATION * MIN_DEVIATION * signal);
        assert!((along(0.6, 0.8) / expected - 1.0).abs() < 1e-3, "{}", along(0.6, 0.8));
        assert!(along(0.8, -0.6).abs() < 1e-2, "{}", along(0.8, -0.6));
    }

    #[test]
    fn a_flat_cell_has_no_information() {
        assert_eq!(information([0.0; 3], 0.5), [0.0; 3]);
        let flat = Tensor::of(Scalar, [Scalar.splat(0.0); 3]);
        assert_eq!(Scalar.store(flat.texture(Scalar, 0.5)), [0.0; 8]);
    }
}
