// SPDX-License-Identifier: MIT OR Apache-2.0

//! The systems that rsrectify is compared with, behind one trait.

pub mod affine;
mod banded;
pub mod content_preserving;
pub mod curve;
pub mod full3d;
pub mod homography;
pub mod jitter;
pub mod knots;
mod low_pass;
mod mesh;
pub mod mixture;
pub mod paper;
pub mod robust;
pub mod rotation3d;
pub mod subspace;
pub mod timed;
mod tracks;
pub mod translation;
pub mod translation3d;
#[cfg(test)]
mod wall;

use anyhow::Result;
use nalgebra::Vector2;
use render::footage::Footage;
use rsrectify::correspond::Correspondence;
use rsrectify::readout::Readout;
use std::sync::Arc;

/// What a method finds out about one frame: where each of its pixels belongs.
pub trait Correction: Send + Sync {
    /// Where the scene point seen at `pixel` is at the reference instant, the middle of the readout.
    fn correct(&self, pixel: Vector2<f64>) -> Vector2<f64>;
}

impl<F: Fn(Vector2<f64>) -> Vector2<f64> + Send + Sync> Correction for F {
    fn correct(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        self(pixel)
    }
}

/// The corrections of successive frames.
pub type Corrections = Vec<Box<dyn Correction>>;

/// What a method is given: a run of frames that follow one another, without a cut and without repeated
/// frames, and the correspondences between them.
pub struct Input<'a> {
    /// The shutter that the method is told.
    pub readout: Readout,
    /// Focal length in pixels; only calibrated methods look at it.
    pub focal: f64,
    /// The nominal frame period in seconds.
    pub period: f64,
    /// The start of each frame's readout in seconds.
    pub stamps: Vec<f64>,
    /// The correspondences from each frame to the one after it: one list less than frames.
    pub pairs: &'a [Vec<Correspondence>],
}

/// A way to rectify, given correspondences.
pub trait Method: Send + Sync {
    /// A short name, unique among the methods, such as `3d-rotation-2`.
    fn name(&self) -> String;

    /// Finds the correction of each frame.
    ///
    /// # Errors
    /// Where the input does not determine a motion and there is no sensible fallback. A frame whose
    /// motion cannot be found is best left as it is.
    fn solve(&self, input: &Input) -> Result<Corrections>;
}

/// Applies a method to each run of the footage, given the correspondences of each run. A frame that
/// repeats the one before it is corrected as that one is.
pub fn solve(
    method: &dyn Method,
    footage: &Footage,
    readout: Readout,
    pairs: &[Vec<Vec<Correspondence>>],
) -> Result<Corrections> {
    let mut found: Vec<Option<Arc<dyn Correction>>> = vec![None; footage.frames.len()];
    for (run, pairs) in footage.runs().iter().zip(pairs) {
        let input = Input {
            readout,
            focal: footage.sequence.focal(),
            period: 1.0 / footage.settings().delivered_fps(),
            stamps: run.iter().map(|index| footage.stamps[*index]).collect(),
            pairs,
        };
        for (index, correction) in run.iter().zip(method.solve(&input)?) {
            found[*index] = Some(correction.into());
        }
    }
    let mut corrections: Corrections = Vec::with_capacity(found.len());
    let mut last: Arc<dyn Correction> = Arc::new(|pixel| pixel);
    for own in found {
        last = own.unwrap_or(last);
        let shared = last.clone();
        corrections.push(Box::new(move |pixel| shared.correct(pixel)));
    }
    Ok(corrections)
}

/// Leaves every frame as it is.
pub struct Uncorrected;

impl Method for Uncorrected {
    fn name(&self) -> String {
        "uncorrected".into()
    }

    fn solve(&self, input: &Input) -> Result<Corrections> {
        Ok(input.stamps.iter().map(|_| Box::new(|pixel| pixel) as Box<dyn Correction>).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correspondences::{self, Source};
    use render::sequence::{Settings, Timeline, named};

    /// Moves each frame by its timestamp in seconds.
    struct ByStamp;

    impl Method for ByStamp {
        fn name(&self) -> String {
            "by-stamp".into()
        }

        fn solve(&self, input: &Input) -> Result<Corrections> {
            let by = |shift: f64| Box::new(move |x| x + Vector2::new(shift, 0.0)) as Box<dyn Correction>;
            Ok(input.stamps.iter().map(|stamp| by(*stamp)).collect())
        }
    }

    #[test]
    fn a_duplicate_is_corrected_as_the_frame_it_repeats() {
        let timeline = Timeline::Duplicates(vec![2, 3]);
        let (width, height, frames, cut) = (96, 72, 6, Some(5));
        let settings = Settings { width, height, frames, timeline, cut, ..named("cut").unwrap() };
        let footage = Footage::of_settings(&settings).unwrap();
        let pairs: Result<Vec<_>> =
            footage.runs().iter().map(|run| correspondences::of_run(&footage, run, Source::Exact)).collect();
        let corrections = solve(&ByStamp, &footage, footage.readout(), &pairs.unwrap()).unwrap();
        let shifts: Vec<f64> = corrections.iter().map(|c| 30.0 * c.correct(Vector2::zeros()).x).collect();
        for (shift, expected) in shifts.iter().zip([0.0, 1.0, 1.0, 1.0, 4.0, 5.0]) {
            assert!((shift - expected).abs() < 1e-9, "{shifts:?}");
        }
    }
}
