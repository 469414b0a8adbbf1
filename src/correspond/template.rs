// SPDX-License-Identifier: MIT OR Apache-2.0

//! Sub-pixel registration of one patch: inverse-compositional Lucas–Kanade.
//!
//! S. Baker, I. Matthews, *Lucas–Kanade 20 Years On: A Unifying Framework*, IJCV 56(3), 2004. The
//! patch moves by a translation; the given local distortion is applied to the template
//! beforehand. Brightness changes I = a·T + b are projected out: the steepest-descent images g are
//! made orthogonal to 1 and to T, so that ∑ g·T = 0 and the step is H⁻¹ ∑ g·I / a. Its fixed point
//! does not depend on the gradient filter, a or b.
//!
//! One sampling of N × N pixels takes 4·N·(2N + 3) multiply-adds, its sums 4·N²: 3.3 k for N = 16.

use super::patch::{
    PATCH_SIDE, PatchValues, Samples, Sums, combine, dot, remove_mean, sample_distorted, sample_sums,
};
use crate::pyramid::Level;
use nalgebra::{Matrix2, Vector2};

/// Largest ratio of the contrasts of the two frames, either way.
const MAX_GAIN: f32 = 3.0;

/// A patch of 16 × 16 pixels of the first frame, its gradients and their matrix.
pub(super) struct Template {
    /// Mean grey.
    mean: f32,
    /// Grey less its mean.
    values: PatchValues,
    /// Sum of squares of `values`.
    energy: f32,
    /// Gradients, orthogonal to 1 and to `values`.
    gradient_x: PatchValues,
    gradient_y: PatchValues,
    /// The matrix of the gradients, summed over the patch, squared grey levels.
    pub(super) matrix: Matrix2<f32>,
    /// Inverse of the damped matrix.
    inverse: Matrix2<f32>,
    /// The smaller eigenvalue of the matrix of the gradients, per pixel.
    pub(super) texture: f32,
}

/// The registration of a template in the second frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct PatchMatch {
    /// The top left pixel of the patch, pixels of the level.
    pub(super) corner: Vector2<f32>,
    /// Root mean square difference after matching brightness and contrast, grey levels.
    pub(super) residual: f32,
    /// Coefficient of correlation of the two patches, 0 to 1.
    pub(super) correlation: f32,
}

/// When the registration of a template stops.
#[derive(Clone, Copy, Debug)]
pub(super) struct StoppingCriterion {
    /// Most samplings of the image.
    pub(super) iterations: usize,
    /// A step shorter than this, in pixels, is the last.
    pub(super) tolerance: f32,
}

impl Template {
    /// From (N + 2) × (N + 2) samples: the patch and a margin of one pixel.
    #[inline(always)]
    fn from_samples(samples: &Samples, damping: f32) -> Option<Self> {
        let mut values = [[0.0; PATCH_SIDE]; PATCH_SIDE];
        let mut gradient_x = [[0.0; PATCH_SIDE]; PATCH_SIDE];
        let mut gradient_y = [[0.0; PATCH_SIDE]; PATCH_SIDE];
        for r in 0..PATCH_SIDE {
            for c in 0..PATCH_SIDE {
                values[r][c] = samples[r + 1][c + 1];
                gradient_x[r][c] = 0.5 * (samples[r + 1][c + 2] - samples[r + 1][c]);
                gradient_y[r][c] = 0.5 * (samples[r + 2][c + 1] - samples[r][c + 1]);
            }
        }
        let mean = remove_mean(&mut values);
        let energy = dot(&values, &values);
        if !(energy > 0.0 && energy.is_finite()) {
            return None;
        }
        for gradient in [&mut gradient_x, &mut gradient_y] {
            remove_mean(gradient);
            let share = dot(gradient, &values) / energy;
            combine(gradient, &values, -share);
        }
        let xx = dot(&gradient_x, &gradient_x);
        let xy = dot(&gradient_x, &gradient_y);
        let yy = dot(&gradient_y, &gradient_y);
        let count = (PATCH_SIDE * PATCH_SIDE) as f32;
        let texture = (0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt()) / count;
        let damping = Matrix2::identity() * (damping * count);
        let inverse = (Matrix2::new(xx, xy, xy, yy) + damping).try_inverse()?;
        let texture = texture.max(0.0);
        let matrix = Matrix2::new(xx, xy, xy, yy);
        Some(Self { mean, values, energy, gradient_x, gradient_y, matrix, inverse, texture })
    }

    /// Registers the template in `level` from an initial position; `None` if it leaves the image or
    /// the contrasts differ too much.
    #[inline(always)]
    pub(super) fn find(
        &self,
        level: &Level,
        start: Vector2<f32>,
        stopping: StoppingCriterion,
    ) -> Option<PatchMatch> {
        let mut corner = start;
        let mut best = None;
        for _ in 0..stopping.iterations {
            let gradients = [&self.gradient_x, &self.gradient_y];
            let sums = sample_sums(level, corner, self.mean, &self.values, gradients)?;
            let gain = sums.values / self.energy;
            if !(gain > 1.0 / MAX_GAIN && gain < MAX_GAIN) {
                return None;
            }
            let step = self.inverse * sums.slope / gain;
            corner -= step;
            let length = step.norm();
            best = Some((sums, gain, length));
            if length < stopping.tolerance {
                break;
            }
        }
        let (sums, gain, step) = best?;
        let (residual, correlation) = self.compare(&sums, gain);
        step.is_finite().then_some(PatchMatch { corner, residual, correlation })
    }

    /// Residual and correlation of a sampled patch of known gain.
    #[inline(always)]
    fn compare(&self, sums: &Sums, gain: f32) -> (f32, f32) {
        let count = (PATCH_SIDE * PATCH_SIDE) as f32;
        let energy = (sums.squares - sums.sum * sums.sum / count).max(0.0);
        let explained = gain * gain * self.energy;
        let residual = ((energy - explained).max(0.0) / count).sqrt();
        (residual, (explained / energy.max(f32::MIN_POSITIVE)).min(1.0).sqrt())
    }

    /// The patch as it appears in the second frame: sampled at c + `distortion`·(x − c), with c the
    /// centre of the patch at `corner`. `None` if that leaves the frame, or has no contrast at all.
    ///
    /// Sampled linearly: c lies midway between pixels on both axes, so the errors of the interpolation are
    /// odd about c and cancel. `damping` (squared grey levels per pixel) is added to the eigenvalues, so that
    /// the step along an edge is zero.
    #[inline(always)]
    pub(super) fn distorted(
        level: &Level,
        corner: (usize, usize),
        distortion: &Matrix2<f32>,
        damping: f32,
    ) -> Option<Self> {
        let half = 0.5 * (PATCH_SIDE as f32 - 1.0);
        let centre = Vector2::new(corner.0 as f32 + half, corner.1 as f32 + half);
        let first = centre - distortion * Vector2::new(half + 1.0, half + 1.0);
        Self::from_samples(&sample_distorted(level, first, distortion)?, damping)
    }
}
