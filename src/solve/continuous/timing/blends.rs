// SPDX-License-Identifier: MIT OR Apache-2.0

//! Whether frames are blends of two exposures, as a conversion of the frame rate by interpolation leaves them.
//!
//! Frame k of such a clip shows (1 − f)·A + f·B of two exposures, f going through the multiples of 1/p in p frames: p is 6
//! from 25 to 30 frames a second, 5 from 24 to 30 and back from 30 to 25, 4 from 30 to 24. Where A and B are apart by more
//! than their details are wide, the mean square of the gradient falls to 1 − 2f·(1 − f) of that of either. So its
//! logarithm y follows
//!
//! > yₖ = cubic(k) − 2a·f·(1 − f) + noise, f = ((k + phase) mod p)/p,
//!
//! the cubic standing for what changes in the scene, with a from 0 where nothing moves to about 1 where details are apart.
//! Coded pictures have such periods, too, where one of p frames is a key frame and sharper than the others: blends must
//! explain more.

use crate::solve::frame_timing::{FrameTiming, Timeline};
use nalgebra::{SMatrix, SVector};
use std::collections::VecDeque;

/// Frames that are judged together: three of the longest period.
const FRAMES: usize = FrameTiming::FRAMES;
const PERIODS: std::ops::RangeInclusive<usize> = 4..=6;
/// Least share of the variance about the cubic that blends explain, and least a. Of phone and street clips that ffmpeg's
/// `framerate` converted it is 0.88 to 0.98 in the clearest 18 frames; of 45 real clips as recorded 0.42 at most, of a rendered
/// one with blur by jerks 0.6. Where a is small, the blended exposures are hardly apart.
const MIN_EXPLAINED: f64 = 0.75;
const MIN_EFFECT: f64 = 0.25;

/// The sharpness of the last frames.
#[derive(Debug, Default)]
pub struct Blends {
    /// Logarithms of the mean square of the gradient.
    sharpness: VecDeque<f64>,
}

impl Blends {
    /// Forgets all frames.
    pub fn clear(&mut self) {
        self.sharpness.clear();
    }

    /// Adds a frame by the mean square of its gradient.
    pub fn push(&mut self, sharpness: f64) {
        if self.sharpness.len() == FRAMES {
            self.sharpness.pop_front();
        }
        self.sharpness.push_back(sharpness.max(f64::MIN_POSITIVE).ln());
    }

    /// The timeline, if the last frames are blends.
    pub fn found(&self) -> Option<Timeline> {
        let sharpness = SVector::<f64, FRAMES>::from_iterator(
            (self.sharpness.len() == FRAMES).then_some(self.sharpness.iter().copied())?,
        );
        let cubic = cubic();
        let varying = |of: SVector<f64, FRAMES>| of - cubic * (cubic.transpose() * of);
        let sharpness = varying(sharpness);
        let variance = sharpness.norm_squared();
        let phases = PERIODS.flat_map(|period| (0..period).map(move |phase| (period, phase)));
        let fitted = |loss: fn(usize, usize) -> f64, least: f64| {
            let fits = phases.clone().map(|(period, phase)| {
                let lost = varying(SVector::from_fn(|frame, _| loss((frame + phase) % period, period)));
                let (product, length) = (-sharpness.dot(&lost), lost.norm_squared());
                Fit { explained: product * product / (length * variance), effect: product / length, period }
            });
            let telling = fits.filter(|fit| fit.effect > least);
            telling.max_by(|a, b| a.explained.total_cmp(&b.explained))
        };
        let blends = fitted(blended, MIN_EFFECT).filter(|fit| fit.explained > MIN_EXPLAINED)?;
        let coded = fitted(coded, 0.0).map_or(0.0, |fit| fit.explained);
        (blends.explained > coded).then_some(Timeline::Blended { period: blends.period })
    }
}

/// How a loss of sharpness that repeats fits.
struct Fit {
    /// Share of the variance.
    explained: f64,
    /// a.
    effect: f64,
    period: usize,
}

/// The loss of a frame by blending, 2f·(1 − f).
fn blended(frame: usize, period: usize) -> f64 {
    let share = frame as f64 / period as f64;
    2.0 * share * (1.0 - share)
}

/// The loss of all frames but key frames.
fn coded(frame: usize, _: usize) -> f64 {
    if frame == 0 { 0.0 } else { 1.0 }
}

/// Orthonormal cubics of the frame's number.
fn cubic() -> SMatrix<f64, FRAMES, 4> {
    let place = |frame: usize| 2.0 * frame as f64 / (FRAMES - 1) as f64 - 1.0;
    SMatrix::<f64, FRAMES, 4>::from_fn(|frame, power| place(frame).powi(power as i32)).qr().q()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::random::Random;

    /// Of frames whose gradient has this share of its mean square, in a scene that changes, with noise.
    fn found(share: impl Fn(usize) -> f64) -> Option<Timeline> {
        let (mut blends, mut random) = (Blends::default(), Random(3));
        for frame in 0..40 {
            let scene = 300.0 * (0.05 * frame as f64).sin().exp();
            blends.push(scene * share(frame) * (0.05 * random.normal()).exp());
        }
        blends.found()
    }

    #[test]
    fn blends_are_found_at_any_period() {
        for period in PERIODS {
            let blend = |frame: usize| 1.0 - blended((frame + 1) % period, period);
            assert_eq!(found(blend), Some(Timeline::Blended { period }));
            assert_eq!(found(|frame| blend(frame).powf(0.1)), None, "they are hardly apart");
        }
    }

    #[test]
    fn frames_as_recorded_are_no_blends() {
        assert_eq!(found(|_| 1.0), None);
        for group in [2, 3, 4, 5, 6, 8, 12, 15] {
            for others in [0.7, 0.8, 0.9] {
                let coded = |frame: usize| if frame.is_multiple_of(group) { 1.0 } else { others };
                assert_eq!(found(coded), None, "key frames, one in {group}, are sharper");
            }
        }
    }

    #[test]
    fn a_few_frames_or_flat_ones_say_nothing() {
        let mut blends = Blends::default();
        assert_eq!(blends.found(), None);
        (0..FRAMES).for_each(|_| blends.push(0.0));
        assert_eq!(blends.found(), None);
        (0..FRAMES).for_each(|_| blends.push(f64::NAN));
        assert_eq!(blends.found(), None);
    }
}
