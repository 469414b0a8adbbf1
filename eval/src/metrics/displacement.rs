// SPDX-License-Identifier: MIT OR Apache-2.0

//! Displacement that is left.

use super::harm;
use baselines::methods::Correction;
use render::footage::FrameTruth;
use render::stats::{Stats, distances, uncorrected};

/// The displacement left over the frames of a sequence.
pub fn left(truth: &[FrameTruth], corrections: &[Box<dyn Correction>]) -> Stats {
    let frames = truth.iter().zip(corrections);
    let left = frames.flat_map(|(truth, correction)| distances(&truth.samples, |x| correction.correct(x)));
    Stats::of(left.collect())
}

/// By how much the RMS displacement of a frame is above that of its input, in pixels, in the frame where it is most. In a
/// frame without samples, which is to be left as it is, any displacement is above.
pub fn worst_above_input(truth: &[FrameTruth], corrections: &[Box<dyn Correction>]) -> f64 {
    let above = |(truth, correction): (&FrameTruth, _)| {
        if truth.samples.is_empty() {
            return harm::added(truth.size, std::slice::from_ref(correction)).rms;
        }
        let left = left(std::slice::from_ref(truth), std::slice::from_ref(correction));
        left.rms - uncorrected(truth.samples.iter().copied()).rms
    };
    truth.iter().zip(corrections).map(above).fold(f64::NEG_INFINITY, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use render::footage::Footage;
    use render::sequence::{Settings, named};

    #[test]
    fn moving_a_blended_frame_is_harm_and_nothing_is_left_in_it() {
        let settings =
            Settings { width: 96, height: 72, frames: 4, bitrate: None, ..named("blended_30_walk").unwrap() };
        let footage = Footage::of_settings(&settings).unwrap();
        let shift = |pixel: Vector2<f64>| pixel.add_scalar(1.0);
        let moved: Vec<Box<dyn Correction>> = vec![Box::new(shift)];
        let blended = &footage.truth[3..];
        assert_eq!(left(blended, &moved).count, 0);
        assert!((worst_above_input(blended, &moved) - 2f64.sqrt()).abs() < 1e-12);
    }
}
