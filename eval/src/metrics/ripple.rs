// SPDX-License-Identifier: MIT OR Apache-2.0

//! What a correction does to a picture beside a smooth change from line to line.
//!
//! Of the displacement that is applied to the textured samples of a frame, d(x), the best
//! c₀ + c₁·p + c₂·p² + c₃·p³ + c₄·q is taken away, p the place along the readout and q the one across: what a camera
//! that is held in a hand does to a flat scene. The rest is true where depth or things that move on their own make it;
//! beyond that it is ripple, which is seen as wobbling.

use baselines::methods::Correction;
use nalgebra::{SMatrix, SVector, Vector2};
use render::footage::{Footage, STEP};
use render::scene::Frame;
use render::stats::Stats;
use render::truth::Sample;

/// Terms of the smooth change.
const TERMS: usize = 5;
/// A sample is textured where the grey levels around it have this standard deviation, half the step of the samples away
/// along both axes: three times that of the strongest noise that sequences usually have.
const TEXTURED: f64 = 9.0;

/// The 95th percentile over the frames of the ripple that is applied, and that of the ripple of the true displacement, RMS
/// in pixels.
pub fn of_sequence(footage: &Footage, corrections: &[Box<dyn Correction>]) -> [f64; 2] {
    let by_rows = footage.readout().direction().is_by_rows();
    let frames = footage.frames.iter().zip(&footage.truth).zip(corrections);
    let (applied, own): (Vec<f64>, Vec<f64>) = frames
        .map(|((frame, truth), correction)| {
            let textured = textured(frame, &truth.samples);
            let applied = |sample: &Sample| correction.correct(sample.seen) - sample.seen;
            (of_frame(&textured, by_rows, applied), of_frame(&textured, by_rows, |s| s.truth - s.seen))
        })
        .unzip();
    [applied, own].map(|ripples| Stats::of(ripples).p95)
}

/// The samples around which a frame shows something.
fn textured(frame: &Frame, samples: &[Sample]) -> Vec<Sample> {
    let luma = frame.luma();
    let spread = |at: Vector2<f64>| {
        let [mut count, mut sum, mut squares] = [0.0; 3];
        let around = |centre: f64, size: usize| {
            let (centre, half) = (centre.round().max(0.0) as usize, STEP / 2);
            centre.saturating_sub(half)..(centre + half).min(size)
        };
        for y in around(at.y, frame.height) {
            for x in around(at.x, frame.width) {
                let grey = f64::from(luma[y * frame.width + x]);
                (count, sum, squares) = (count + 1.0, sum + grey, squares + grey * grey);
            }
        }
        if count > 0.0 { (squares / count - (sum / count).powi(2)).max(0.0).sqrt() } else { 0.0 }
    };
    samples.iter().filter(|sample| spread(sample.seen) >= TEXTURED).copied().collect()
}

/// RMS in pixels of what the best smooth change leaves of a displacement; 0 for too few samples to tell.
fn of_frame(samples: &[Sample], by_rows: bool, displaced: impl Fn(&Sample) -> Vector2<f64>) -> f64 {
    let low = samples.iter().fold(Vector2::repeat(f64::INFINITY), |low, s| low.inf(&s.seen));
    let high = samples.iter().fold(Vector2::repeat(f64::NEG_INFINITY), |high, s| high.sup(&s.seen));
    // From −1 to 1, so that the powers are told from each other.
    let place = |sample: &Sample| {
        let at = (sample.seen * 2.0 - low - high).component_div(&(high - low).map(|size| size.max(1.0)));
        if by_rows { at.yx() } else { at }
    };
    let terms = |sample: &Sample| {
        let [p, q] = place(sample).into();
        SVector::<f64, TERMS>::from([1.0, p, p * p, p * p * p, q])
    };
    let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
    let mut right = SMatrix::<f64, TERMS, 2>::zeros();
    for sample in samples {
        normal += terms(sample) * terms(sample).transpose();
        right += terms(sample) * displaced(sample).transpose();
    }
    let Some(solved) = normal.cholesky().map(|normal| normal.solve(&right)) else { return 0.0 };
    let left = |sample: &Sample| (displaced(sample) - solved.transpose() * terms(sample)).norm_squared();
    let squares: f64 = samples.iter().map(left).sum();
    (squares / samples.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use render::sequence::{Settings, named};

    fn grid() -> Vec<Sample> {
        let at = |k: usize| Vector2::new((k % 40 * 8) as f64, (k / 40 * 8) as f64);
        (0..40 * 30).map(|k| Sample { seen: at(k), truth: at(k) }).collect()
    }

    #[test]
    fn a_cubic_along_the_readout_and_a_plane_across_are_no_ripple() {
        let smooth = |[p, q]: [f64; 2]| {
            let p = p / 100.0;
            Vector2::new(3.0 * p * p * p - p, 1.0 - 2.0 * p * p + 0.01 * q)
        };
        let rows = of_frame(&grid(), true, |s| smooth([s.seen.y, s.seen.x]));
        let columns = of_frame(&grid(), false, |s| smooth([s.seen.x, s.seen.y]));
        assert!(rows < 1e-9 && columns < 1e-9, "{rows}, {columns}");
        assert!(of_frame(&grid(), false, |s| smooth([s.seen.y, s.seen.x])) > 0.5);
    }

    #[test]
    fn a_ripple_is_measured_whole() {
        // Eight periods down the picture: hardly anything of them is a cubic.
        let ripple = of_frame(&grid(), true, |s| Vector2::new((s.seen.y * 0.21).sin(), 0.0));
        assert!((ripple - 0.5_f64.sqrt()).abs() < 0.03, "{ripple}");
        assert_eq!(of_frame(&grid()[..3], true, |s| s.seen), 0.0);
        assert_eq!(of_frame(&[], true, |s| s.seen), 0.0);
    }

    #[test]
    fn the_truth_has_its_own_and_no_correction_has_none() {
        let settings = Settings { width: 160, height: 120, frames: 3, ..named("foreground").unwrap() };
        let footage = Footage::of_settings(&settings).unwrap();
        let still = |pixel: Vector2<f64>| pixel;
        let corrections: Vec<Box<dyn Correction>> =
            footage.frames.iter().map(|_| Box::new(still) as Box<dyn Correction>).collect();
        let [applied, own] = of_sequence(&footage, &corrections);
        assert!(applied < 1e-9 && own > 0.05, "{applied}, {own}");
    }

    #[test]
    fn flat_parts_of_a_picture_do_not_count() {
        let settings = Settings { width: 160, height: 120, frames: 1, ..named("low_texture").unwrap() };
        let footage = Footage::of_settings(&settings).unwrap();
        let samples = &footage.truth[0].samples;
        let textured = textured(&footage.frames[0], samples);
        assert!(!textured.is_empty() && textured.len() < samples.len());
    }
}
