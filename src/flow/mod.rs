//! Two pyramids → dense optical flow: dense inverse search.
//!
//! T. Kroeger, R. Timofte, D. Dai, L. Van Gool, *Fast Optical Flow using Dense Inverse Search*, ECCV 2016.
//!
//! | step | file | what it does |
//! |---|---|---|
//! | search | `search` | every patch of the coarsest level, over a quarter of the frame's width |
//! | predict | `prediction` | a predicted motion as one more candidate |
//! | compare | `patch`, `lanes` | residual and step of one patch, eight pixels at a time |
//! | step | `level` | the best of some candidates, steps from it, the mean of overlapping patches |
//! | descend | `direction` | from level to level |
//! | agree | `consensus` | where the picture does not tell, the motion that most of it shares |
//! | dispatch | `rows` | kernels on all cores, with the machine's instructions |
//! | judge | `confidence` | forward–backward consistency, residual, texture |
//! | conclude | `occlusion` | what the other frame hides goes with what it hides behind something |
//! | hand out | `field` | cells, and interpolation between them |
//!
//! What departs from the paper: candidates are compared by residual on every level, so that neither the coarser level
//! nor the prediction can hide a motion that fits better; both directions run together, and what one finds is a
//! candidate of the other; the mean of overlapping patches is taken for cells of 4 × 4 pixels, not for each pixel;
//! no variational refinement.
//!
//! # Cost
//!
//! The finest level has half the analysed resolution. For 960×540 analysed pixels that is 480×270: 119 × 67 patches,
//! each compared at most 2 + 2 times, on coarser levels at most 8 + 3 times and again; both directions: at most some 0.12 M
//! comparisons of 64 pixels, 0.05 M where neighbours move alike. Only the patches that move otherwise than most are compared
//! again, ten times. With AVX2 a comparison takes 16 loads of a row and 8 × 10 operations of eight lanes, and some 100
//! instructions around these; the start of a patch some 200.

mod confidence;
mod consensus;
mod direction;
mod field;
mod lanes;
mod level;
mod occlusion;
mod patch;
mod prediction;
mod rows;
mod search;
#[cfg(test)]
mod tests;

pub use field::{Cell, FlowField};

use crate::cpu::CpuLevel;
use crate::parallel;
use crate::pyramid::{Level, Pyramid, Reducer};
use direction::{Direction, Stage};
use level::Pair;
use nalgebra::Vector2;
use occlusion::{Beside, Frames, Known};

/// The finest level that is searched: half of the analysed resolution.
const FINEST: usize = 1;

/// Variance of a pixel's noise on the analysed luma, squared grey levels: that of a camera by day, coded well.
const NOISE: f32 = 2.0;

/// What is left of it on coarse levels, at least: rounding, and interpolation between pixels.
const LEAST_NOISE: f32 = 0.05;

/// Variance of a pixel's noise on the level that is 2^`depth` times coarser, of which each pixel is a mean of 4^`depth`.
fn noise(depth: usize) -> f32 {
    (NOISE * 0.25f32.powi(depth as i32)).max(LEAST_NOISE)
}

/// Estimates the flow between frames of one size, in both directions.
#[derive(Debug)]
pub struct DenseFlow {
    cpu: CpuLevel,
    size: (usize, usize),
    scale: f64,
    forward: Direction,
    backward: Direction,
    fields: [FlowField; 2],
    hidden: [Beside; 2],
}

impl DenseFlow {
    /// For the pyramids of `reducer`.
    pub fn new(reducer: &Reducer) -> Self {
        Self::with_cpu(CpuLevel::detect(), reducer)
    }

    /// As [`new`](Self::new), with the instructions of `cpu`; all find the same but for rounding.
    pub fn with_cpu(cpu: CpuLevel, reducer: &Reducer) -> Self {
        Self {
            cpu,
            size: reducer.size(),
            scale: reducer.scale(),
            forward: Direction::default(),
            backward: Direction::default(),
            fields: Default::default(),
            hidden: Default::default(),
        }
    }

    /// Estimates the flow from `first` to `second` and back.
    ///
    /// `predict` says where a point (full-frame pixels) of the first frame is expected in the second; the identity where
    /// nothing is known. It is one candidate among others.
    pub fn estimate(
        &mut self,
        first: &Pyramid,
        second: &Pyramid,
        predict: impl Fn(Vector2<f64>) -> Vector2<f64>,
    ) {
        self.fields.iter_mut().for_each(|field| field.cells.clear());
        self.forward.restart();
        self.backward.restart();
        let is_usable = first.is_of(self.size) && second.is_of(self.size);
        if !is_usable || self.size.0.min(self.size.1) < 2 * patch::SIDE {
            return;
        }
        self.forward.prediction.fill(self.size, self.scale, false, &predict);
        self.backward.prediction.fill(self.size, self.scale, true, &predict);
        // Inside, no task waits for a thread of the pool to be woken.
        parallel::scope(|_| self.descend(first.levels(), second.levels()));
    }

    /// From the coarsest level to the finest, and judges what was found there.
    fn descend(&mut self, first: &[Level], second: &[Level]) {
        let Self { forward, backward, .. } = self;
        let finest = FINEST.min(first.len() - 1);
        for (depth, (first_level, second_level)) in first.iter().zip(second).enumerate().skip(finest).rev() {
            let stage = Stage {
                cpu: self.cpu,
                pair: Pair { first: first_level, second: second_level, noise: noise(depth) },
                depth,
                is_coarsest: depth + 1 == first.len(),
                is_finest: depth == finest,
            };
            parallel::join(|| forward.run(&stage), || backward.run(&stage.reversed()));
            if !stage.is_finest {
                forward.listen(backward);
                backward.listen(forward);
            }
        }
        let side = ((level::CELL << finest) as f64) * self.scale;
        let size = (self.size.0 >> finest, self.size.1 >> finest);
        let scale = confidence::Scale { size, side, noise: noise(finest) };
        let [there, back] = &mut self.fields;
        confidence::judge(self.cpu, forward, backward, scale, there);
        confidence::judge(self.cpu, backward, forward, scale, back);
        let (Some(first), Some(second), FINEST) = (first.first(), second.first(), finest) else { return };
        let pair = Pair { first, second, noise: noise(0) };
        let frames = Frames { cpu: self.cpu, pair, depth: finest };
        let known = Known { own: (forward, there), reverse: (backward, back) };
        let [hidden, hidden_back] = &mut self.hidden;
        parallel::join(
            || hidden.find(frames, known),
            || hidden_back.find(frames.reversed(), known.reversed()),
        );
        hidden.complete(there);
        hidden_back.complete(back);
    }

    /// From the first frame to the second; without cells where one of them was empty.
    pub fn forward(&self) -> &FlowField {
        &self.fields[0]
    }

    /// From the second frame to the first.
    pub fn backward(&self) -> &FlowField {
        &self.fields[1]
    }
}
