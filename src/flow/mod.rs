// SPDX-License-Identifier: MIT OR Apache-2.0

//! Two pyramids → dense optical flow: dense inverse search.
//!
//! T. Kroeger, R. Timofte, D. Dai, L. Van Gool, *Fast Optical Flow using Dense Inverse Search*, ECCV 2016.
//!
//! | step | file | what it does |
//! |---|---|---|
//! | search | `search` | exhaustive search on the coarsest level, ± a quarter of the frame's width |
//! | predict | `prediction` | the predicted motion as an additional candidate |
//! | candidates | `candidates` | displacements of eight patches to start from, and which of them differ |
//! | compare | `patch` | residuals and Gauss–Newton steps of eight patches, eight pixels at a time |
//! | estimate | `estimate` | what is kept of a patch and of a cell |
//! | step | `level` | best candidate, Gauss–Newton steps from it, mean of overlapping patches |
//! | descend | `direction` | coarse to fine |
//! | dominant motion | `consensus` | robust affine motion, used where the picture is ambiguous |
//! | dispatch | `rows` | kernels on all cores, with the machine's instructions |
//! | confidence | `confidence` | forward–backward consistency, residual, texture |
//! | occlusion | `occlusion` | occluded cells take the background's motion |
//! | output | `field` | cells, and interpolation between them |
//!
//! Differences from the paper: candidates are compared by residual on every level, so that neither the
//! coarser level nor the prediction can hide a motion that fits better; both directions run together, and the
//! result of one is a candidate of the other; the mean of overlapping patches is taken for cells of 4 × 4
//! pixels, not for each pixel; no variational refinement.
//!
//! # Cost
//!
//! The finest level has half the analysed resolution. For 960×540 analysed pixels that is 480×270: 119 × 67
//! patches, each compared at most 2 + 2 times, on coarser levels at most 8 + 3 times and again; both
//! directions: at most some 0.12 M comparisons of 64 pixels, 0.05 M where neighbours have the same motion.
//! Only patches that disagree with the dominant motion are compared again, ten times. Counted with AVX2: 150
//! instructions a comparison, of which 107 compute with eight lanes, and some 25 for the step that follows, of all that
//! is computed for eight patches at once; 20 a displacement of the exhaustive search; 200 for a template, and 50 for the
//! candidates of a patch on the finest level, 250 on coarser ones.

mod candidates;
mod confidence;
mod consensus;
mod direction;
mod estimate;
mod field;
mod level;
mod occlusion;
mod patch;
mod prediction;
mod rows;
mod search;
#[cfg(test)]
mod tests;

pub(crate) use confidence::MIN_CONFIDENCE;
#[cfg(feature = "unstable")]
pub use field::Cell;
pub use field::FlowField;

use crate::cpu::CpuLevel;
use crate::parallel;
use crate::pyramid::{Level, Pyramid, Reducer};
use direction::{FlowDirection, Stage};
use level::LevelPair;
use nalgebra::Vector2;
use occlusion::{DirectionPair, FinerLevels, OcclusionFinder};

/// The finest level that is searched: half of the analysed resolution.
const FINEST: usize = 1;

/// Noise variance of a pixel of the analysed luma, squared grey levels: a camera in daylight, coded at good
/// quality.
const NOISE: f32 = 2.0;

/// Noise floor on coarse levels, squared grey levels: rounding, and interpolation between pixels.
const MIN_NOISE: f32 = 0.05;

/// Noise variance of a pixel on the level that is 2^`depth` times coarser: each pixel is a mean of 4^`depth`.
fn noise(depth: usize) -> f32 {
    (NOISE * 0.25f32.powi(depth as i32)).max(MIN_NOISE)
}

/// Estimates the flow between frames of one size, in both directions.
#[derive(Debug)]
pub struct DenseFlow {
    cpu: CpuLevel,
    size: (usize, usize),
    scale: f64,
    forward: FlowDirection,
    backward: FlowDirection,
    fields: [FlowField; 2],
    occluded: [OcclusionFinder; 2],
}

impl DenseFlow {
    /// For the pyramids of `reducer`.
    #[cfg(feature = "unstable")]
    pub fn new(reducer: &Reducer) -> Self {
        Self::with_cpu(CpuLevel::detect(), reducer)
    }

    /// For the pyramids of `reducer`, with the instructions of `cpu`; results differ by rounding only.
    pub fn with_cpu(cpu: CpuLevel, reducer: &Reducer) -> Self {
        Self {
            cpu,
            size: reducer.size(),
            scale: reducer.scale(),
            forward: FlowDirection::default(),
            backward: FlowDirection::default(),
            fields: Default::default(),
            occluded: Default::default(),
        }
    }

    /// Estimates the flow from `first` to `second` and back.
    ///
    /// `predict` maps a point of the first frame (full-frame pixels) to its expected position in the second:
    /// the identity without a prediction. It is one candidate among others.
    pub fn estimate(
        &mut self,
        first: &Pyramid,
        second: &Pyramid,
        predict: impl Fn(Vector2<f64>) -> Vector2<f64>,
    ) {
        self.forward.restart();
        self.backward.restart();
        let is_usable = first.is_of(self.size) && second.is_of(self.size);
        if !is_usable || self.size.0.min(self.size.1) < 2 * patch::SIDE {
            self.fields.iter_mut().for_each(|field| field.cells.clear());
            return;
        }
        self.forward.prediction.fill(self.size, self.scale, false, &predict);
        self.backward.prediction.fill(self.size, self.scale, true, &predict);
        // Inside a scope of the pool, tasks start without waking a thread.
        parallel::scope(|_| self.descend(first.levels(), second.levels()));
    }

    /// Runs from the coarsest level to the finest, then computes confidence and occlusion.
    fn descend(&mut self, first: &[Level], second: &[Level]) {
        let Self { forward, backward, .. } = self;
        let finest = FINEST.min(first.len() - 1);
        for (depth, (first_level, second_level)) in first.iter().zip(second).enumerate().skip(finest).rev() {
            let stage = Stage {
                cpu: self.cpu,
                pair: LevelPair { first: first_level, second: second_level, noise: noise(depth) },
                depth,
                is_coarsest: depth + 1 == first.len(),
                is_finest: depth == finest,
            };
            parallel::join(|| forward.run(&stage), || backward.run(&stage.reversed()));
            if !stage.is_finest {
                forward.take_reverse(backward);
                backward.take_reverse(forward);
            }
        }
        let side = ((level::CELL << finest) as f64) * self.scale;
        let size = (self.size.0 >> finest, self.size.1 >> finest);
        let scale = confidence::LevelScale { size, side, noise: noise(finest) };
        let [there, back] = &mut self.fields;
        confidence::fill_field(self.cpu, forward, backward, scale, there);
        confidence::fill_field(self.cpu, backward, forward, scale, back);
        let (Some(first), Some(second), FINEST) = (first.first(), second.first(), finest) else { return };
        let pair = LevelPair { first, second, noise: noise(0) };
        let frames = FinerLevels { cpu: self.cpu, pair, depth: finest };
        let directions = DirectionPair { own: (forward, there), reverse: (backward, back) };
        let [occluded, occluded_back] = &mut self.occluded;
        parallel::join(
            || occluded.find(frames, directions),
            || occluded_back.find(frames.reversed(), directions.reversed()),
        );
        occluded.complete(there);
        occluded_back.complete(back);
    }

    /// The flow from the first frame to the second; no cells if a frame was empty.
    pub fn forward(&self) -> &FlowField {
        &self.fields[0]
    }

    /// The flow from the second frame to the first.
    pub fn backward(&self) -> &FlowField {
        &self.fields[1]
    }
}
