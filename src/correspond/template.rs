// SPDX-License-Identifier: MIT OR Apache-2.0

//! Sub-pixel registration of one patch: inverse-compositional Lucas–Kanade.
//!
//! S. Baker, I. Matthews, *Lucas–Kanade 20 Years On: A Unifying Framework*, IJCV 56(3), 2004. The
//! patch moves by a translation; the given local distortion is applied to the template
//! beforehand. Brightness changes I = a·T + b are projected out: the steepest-descent images g are
//! made orthogonal to 1 and to T, so that ∑ g·T = 0 and the step is H⁻¹ ∑ g·I / a. Its fixed point
//! does not depend on the gradient filter, a or b.
//!
//! One sampling of N × N pixels takes 4·N·(2N + 3) multiply-adds, its sums 5·N²: 3.5 k for N = 16, in some 800
//! instructions.

use super::patch::{AREA, Block, DistortedPatch, Sums, WIDTH_WITH_MARGIN, centre};
use crate::lanes::WordCpu;
use crate::pyramid::Level;
use nalgebra::{Matrix2, Vector2};

/// Largest ratio of the contrasts of the two frames, either way.
const MAX_GAIN: f32 = 3.0;

/// A patch of 16 × 16 pixels of the first frame, its gradients and their matrix.
///
/// With v the values less their mean, the gradients are made orthogonal to 1 and to v: g′ = g − ḡ − a·v. Nothing is
/// subtracted pixel by pixel, as ∑ g′·I and ∑ g′·g′ᵀ follow from the sums of g, v and I.
pub(super) struct Template<C: WordCpu> {
    cpu: C,
    /// Scratch.
    distorted: DistortedPatch,
    block: Block<C>,
    /// Mean grey, and the mean of the block's values.
    mean: f32,
    values_mean: f32,
    /// Sum of squares of v.
    energy: f32,
    /// ḡ.
    gradient: Vector2<f32>,
    /// a.
    share: Vector2<f32>,
    /// The matrix of g′, summed over the patch, squared grey levels.
    pub(super) matrix: Matrix2<f32>,
    /// Inverse of the damped matrix.
    inverse: Matrix2<f32>,
    /// The smaller eigenvalue of the matrix, per pixel.
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

impl<C: WordCpu> Template<C> {
    /// A template to be filled by [`take`](Self::take).
    #[inline(always)]
    pub(super) fn new(cpu: C) -> Self {
        let (vector, matrix) = (Vector2::zeros(), Matrix2::zeros());
        Self {
            cpu,
            distorted: DistortedPatch::new(),
            block: Block::new(cpu),
            mean: 0.0,
            values_mean: 0.0,
            energy: 0.0,
            gradient: vector,
            share: vector,
            matrix,
            inverse: matrix,
            texture: 0.0,
        }
    }

    /// Takes the patch as it appears in the second frame: sampled at c + `distortion`·(x − c), with c the
    /// centre of the patch at `corner`. `None` if that leaves the frame, or has no contrast at all.
    ///
    /// Sampled linearly: c lies midway between pixels on both axes, so the errors of the interpolation are
    /// odd about c and cancel. `damping` (squared grey levels per pixel) is added to the eigenvalues, so that
    /// the step along an edge is zero.
    #[inline(always)]
    pub(super) fn take(
        &mut self,
        level: &Level,
        corner: (usize, usize),
        distortion: &Matrix2<f32>,
        damping: f32,
    ) -> Option<()> {
        let centre = centre(Vector2::new(corner.0 as f32, corner.1 as f32));
        let first = centre - distortion * Vector2::repeat(0.5 * (WIDTH_WITH_MARGIN as f32 - 1.0));
        let samples = self.distorted.sample(self.cpu, level, first, distortion)?;
        let sums = self.block.take(self.cpu, samples)?;
        self.values_mean = sums.values / AREA;
        self.mean = self.block.pivot + self.values_mean;
        self.energy = sums.squares - self.values_mean * sums.values;
        if !(self.energy > 0.0 && self.energy.is_finite()) {
            return None;
        }
        // The block has twice the gradients.
        let sum = sums.gradients * 0.5;
        self.gradient = sum / AREA;
        let products = sums.products * 0.5 - sum * self.values_mean;
        self.share = products / self.energy;
        self.matrix =
            sums.tensor * 0.25 - self.gradient * sum.transpose() - self.share * products.transpose();
        let (xx, xy, yy) = (self.matrix.m11, self.matrix.m12, self.matrix.m22);
        let texture = (0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt()) / AREA;
        self.texture = texture.max(0.0);
        self.inverse = (self.matrix + Matrix2::identity() * (damping * AREA)).try_inverse()?;
        Some(())
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
            let sums = self.block.sample_sums(self.cpu, level, corner, self.mean)?;
            let product = sums.values - self.values_mean * sums.sum;
            let gain = product / self.energy;
            if !(gain > 1.0 / MAX_GAIN && gain < MAX_GAIN) {
                return None;
            }
            let slope = sums.slope * 0.5 - self.gradient * sums.sum - self.share * product;
            let step = self.inverse * slope / gain;
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
        let energy = (sums.squares - sums.sum * sums.sum / AREA).max(0.0);
        let explained = gain * gain * self.energy;
        let residual = ((energy - explained).max(0.0) / AREA).sqrt();
        (residual, (explained / energy.max(f32::MIN_POSITIVE)).min(1.0).sqrt())
    }
}
