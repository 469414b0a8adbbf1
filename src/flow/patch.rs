//! One patch of 8 × 8 pixels and its comparison with another frame between pixels.
//!
//! Inverse compositional (S. Baker, I. Matthews, *Lucas–Kanade 20 Years On*, IJCV 56(3), 2004): the gradients are the
//! template's, so that their matrix is inverted once. They are given a zero mean and nothing in common with
//! the template, which takes a difference of brightness or of contrast out of the step; the residual is taken about its mean.
//!
//! A comparison reads 9 rows of 9 samples and takes 64 × 11 additions and multiplications.

use super::kernels::{self, Centred};
use crate::cpu::CpuLevel;
use crate::pyramid::Level;

pub(super) use super::kernels::{AREA, SIDE};

/// A patch of the first frame.
pub(super) struct Template {
    cpu: CpuLevel,
    patch: Centred,
    /// Inverse of the gradients' matrix, with their noise added to its diagonal: xx, xy, yy.
    inverse: [f32; 3],
}

/// How a patch of the second frame differs from the template.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Difference {
    /// The step of Gauss and Newton in pixels, to be added to the displacement.
    pub(super) step: [f32; 2],
    /// Squared differences, about the mean of the patch, summed over its quarters: top left, bottom left, top right,
    /// bottom right; squared grey levels.
    pub(super) squares: [f32; 4],
    /// Of the whole patch.
    pub(super) total: f32,
}

impl Template {
    /// The patch of `level` whose top left pixel is (x, y); `None` further outside than the border. `noise` is the
    /// variance of a pixel's noise in squared grey levels: a central difference has half of it, which is added to both
    /// eigenvalues of the gradients' matrix, so that along an edge the start is kept.
    #[inline(always)]
    pub(super) fn new(cpu: CpuLevel, level: &Level, noise: f32, x: usize, y: usize) -> Option<Self> {
        let rows = level.from(x as isize - 1, y as isize - 1)?;
        let patch = kernels::centred(cpu, rows, level.stride())?;
        let [xx, xy, yy, _] = patch.products;
        let damping = AREA * 0.5 * noise;
        let (a, d) = (xx + damping, yy + damping);
        let share = 1.0 / (a * d - xy * xy);
        Some(Self { cpu, patch, inverse: [d * share, -xy * share, a * share] })
    }

    /// Sums over the patch of the products of its zero-mean gradients: xx, xy, yy, in squared grey levels.
    pub(super) fn tensor(&self) -> [f32; 3] {
        let [xx, xy, yy, _] = self.patch.products;
        [xx, xy, yy]
    }

    /// Sum of squared differences from the mean, in squared grey levels.
    pub(super) fn energy(&self) -> f32 {
        self.patch.products[3]
    }

    /// Compares with the patch of `level` whose top left pixel lies at `corner`, sampled linearly. A corner further
    /// outside than a patch is moved there; `None` only for a level without pixels.
    #[inline(always)]
    pub(super) fn compare(&self, level: &Level, corner: [f32; 2]) -> Option<Difference> {
        let x = corner[0].clamp(-(SIDE as f32), level.width() as f32);
        let y = corner[1].clamp(-(SIDE as f32), level.height() as f32);
        let (left, top) = (floor(x), floor(y));
        let rows = level.from(left as isize, top as isize)?;
        let shift = [x - left as f32, y - top as f32];
        let sums = kernels::sums(self.cpu, &self.patch, rows, level.stride(), shift)?;
        let [a, b, c] = self.inverse;
        let [x, y] = sums.slope;
        Some(Difference {
            step: [-(a * x + b * y), -(b * x + c * y)],
            squares: sums.squares,
            total: sums.total,
        })
    }

    /// The residual at a whole displacement: sum of squared differences about their mean.
    #[inline(always)]
    pub(super) fn residual_at(&self, level: &Level, x: isize, y: isize) -> Option<f32> {
        let rows = level.from(x, y)?;
        let [sum, square] = kernels::whole_sums(self.cpu, &self.patch.values, rows, level.stride())?;
        Some((square - sum * sum * (1.0 / AREA)).max(0.0))
    }
}

/// The whole number at or before one that is at least −[`SIDE`]; `f32::floor` is a call where SSE4.1 is not a given.
#[inline(always)]
fn floor(at: f32) -> i32 {
    (at + SIDE as f32) as i32 - SIDE as i32
}
