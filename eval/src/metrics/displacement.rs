//! Displacement that is left.

use super::stats::{Stats, distances, uncorrected};
use crate::footage::FrameTruth;
use crate::methods::Correction;

/// The displacement left over the frames of a sequence.
pub fn left(truth: &[FrameTruth], corrections: &[Box<dyn Correction>]) -> Stats {
    let frames = truth.iter().zip(corrections);
    let left = frames.flat_map(|(truth, correction)| distances(&truth.samples, |x| correction.correct(x)));
    Stats::of(left.collect())
}

/// By how much the RMS displacement of a frame is above that of its input, in pixels, in the frame where it is most.
pub fn worst_above_input(truth: &[FrameTruth], corrections: &[Box<dyn Correction>]) -> f64 {
    let above = |(truth, correction): (&FrameTruth, _)| {
        let left = left(std::slice::from_ref(truth), std::slice::from_ref(correction));
        left.rms - uncorrected(truth.samples.iter().copied()).rms
    };
    truth.iter().zip(corrections).map(above).fold(f64::NEG_INFINITY, f64::max)
}
