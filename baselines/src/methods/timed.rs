// SPDX-License-Identifier: MIT OR Apache-2.0

//! Correspondences with the time of both ends: what the image-plane baselines fit.

use super::{Correction, Corrections, Input};
use nalgebra::Vector2;
use rsrectify::motion::image_centre;
use rsrectify::readout::Readout;

/// A correspondence with the time at which each end was exposed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPair {
    /// Place in the first frame, in pixels from the image centre.
    pub from: Vector2<f64>,
    /// Place in the second.
    pub to: Vector2<f64>,
    /// Exposure time of `from` in seconds, on the clock of the timestamps.
    pub start: f64,
    /// Exposure time of `to`.
    pub end: f64,
}

impl TimedPair {
    /// x′ − x in pixels.
    pub fn displacement(&self) -> Vector2<f64> {
        self.to - self.from
    }

    /// t′ − t in seconds.
    pub fn elapsed(&self) -> f64 {
        self.end - self.start
    }
}

/// The timed correspondences from frame `k` of the run to the next.
pub fn timed(input: &Input, k: usize) -> Vec<TimedPair> {
    let readout = &input.readout;
    let centre = image_centre(readout.width(), readout.height());
    let exposure = |frame: usize, x: Vector2<f64>| input.stamps[frame] + readout.offset(x.x, x.y);
    let pairs = input.pairs[k].iter().map(|pair| TimedPair {
        from: pair.from - centre,
        to: pair.to - centre,
        start: exposure(k, pair.from),
        end: exposure(k + 1, pair.to),
    });
    pairs.collect()
}

/// One correction a frame from one finding a *pair* of frames: each frame takes that of the pair which
/// it begins and the last frame that of the pair which it ends; without a finding a frame stays as it is.
pub fn from_pairs<T: Clone>(
    input: &Input,
    found: &[Option<T>],
    correction: impl Fn(T) -> Box<dyn Correction>,
) -> Corrections {
    let frames = 0..input.stamps.len();
    let of_frame = |k: usize| found.get(k).or(found.last()).cloned().flatten();
    frames.map(|k| of_frame(k).map_or_else(untouched, &correction)).collect()
}

/// Leaves a frame as it is.
pub fn untouched() -> Box<dyn Correction> {
    Box::new(|pixel| pixel)
}

/// Time in seconds from the exposure of a pixel to the reference instant, the middle of the readout.
pub fn until_reference(readout: &Readout, pixel: Vector2<f64>) -> f64 {
    0.5 * readout.time() - readout.offset(pixel.x, pixel.y)
}

/// Runs with a closed form, for the tests of the image-plane baselines.
#[cfg(test)]
pub(super) mod closed_form {
    use super::*;
    use crate::methods::Method;
    use nalgebra::Matrix2;
    use rsrectify::correspond::Correspondence;
    use rsrectify::readout::{ReadoutDirection, ReadoutTime};

    const SIZE: [usize; 2] = [320, 240];
    const PERIOD: f64 = 0.04;

    /// The shutters that a method must get right.
    pub const SHUTTERS: [(ReadoutDirection, f64); 4] = [
        (ReadoutDirection::TopToBottom, 1.0),
        (ReadoutDirection::BottomToTop, 0.85),
        (ReadoutDirection::LeftToRight, 0.42),
        (ReadoutDirection::RightToLeft, 0.7),
    ];

    /// A run in which a point that is at p at time 0 is at `flow(p, t)` at time t (centred pixels).
    pub struct Run {
        pub readout: Readout,
        pub stamps: Vec<f64>,
        pub pairs: Vec<Vec<Correspondence>>,
    }

    type Flow<'a> = &'a dyn Fn(Vector2<f64>, f64) -> Vector2<f64>;

    impl Run {
        /// Frames with somewhat uneven timestamps. `inverse` takes a point at time t back to time 0.
        /// Every `outliers`th correspondence is off by many pixels; 0 for none.
        pub fn new(
            (direction, ratio): (ReadoutDirection, f64),
            frames: usize,
            flow: Flow,
            inverse: Flow,
            outliers: usize,
        ) -> Self {
            let [width, height] = SIZE;
            let time = ReadoutTime::Seconds(ratio * PERIOD);
            let readout = Readout::new(width, height, direction, time, PERIOD).unwrap();
            let jitter = |k: usize| if k % 3 == 1 { 0.002 } else { 0.0 };
            let stamps: Vec<f64> = (0..frames).map(|k| k as f64 * PERIOD + jitter(k)).collect();
            let mut run = Self { readout, stamps, pairs: Vec::new() };
            for k in 0..frames.saturating_sub(1) {
                let places =
                    (0..40 * 30).map(|i| Vector2::new(3.5 + (i % 40 * 8) as f64, 3.5 + (i / 40 * 8) as f64));
                let pairs = places.enumerate().map(|(i, from)| {
                    let off = if outliers > 0 && i % outliers == 0 {
                        Vector2::new(9.0, -6.0)
                    } else {
                        Vector2::zeros()
                    };
                    let to = run.seen(k + 1, inverse(run.centred(from), run.exposure(k, from)), flow) + off;
                    Correspondence { from, to, texture: 1000.0, residual: 0.0, covariance: Matrix2::zeros() }
                });
                let pairs = pairs.collect();
                run.pairs.push(pairs);
            }
            run
        }

        /// A run of a picture that is shifted by `path(t)`.
        pub fn translated(
            shutter: (ReadoutDirection, f64),
            frames: usize,
            path: impl Fn(f64) -> Vector2<f64>,
            outliers: usize,
        ) -> Self {
            Self::new(shutter, frames, &|p, t| p + path(t), &|p, t| p - path(t), outliers)
        }

        fn centred(&self, pixel: Vector2<f64>) -> Vector2<f64> {
            pixel - image_centre(self.readout.width(), self.readout.height())
        }

        fn exposure(&self, k: usize, pixel: Vector2<f64>) -> f64 {
            self.stamps[k] + self.readout.offset(pixel.x, pixel.y)
        }

        /// Where frame `k` sees a point: the row of arrival decides when, and when decides the row.
        fn seen(&self, k: usize, point: Vector2<f64>, flow: Flow) -> Vector2<f64> {
            let centre = image_centre(self.readout.width(), self.readout.height());
            let mut pixel = point + centre;
            for _ in 0..60 {
                pixel = flow(point, self.exposure(k, pixel)) + centre;
            }
            pixel
        }

        pub fn input(&self) -> Input<'_> {
            Input {
                readout: self.readout,
                focal: 320.0,
                period: PERIOD,
                stamps: self.stamps.clone(),
                pairs: &self.pairs,
            }
        }

        /// Root mean squares over all frames of what a method leaves and of what there was, in pixels.
        pub fn left(&self, method: &dyn Method, flow: Flow, inverse: Flow) -> (f64, f64) {
            let corrections = method.solve(&self.input()).unwrap();
            assert_eq!(corrections.len(), self.stamps.len());
            let (mut left, mut moved, mut count) = (0.0, 0.0, 0.0);
            for (k, correction) in corrections.iter().enumerate() {
                let reference = self.stamps[k] + 0.5 * self.readout.time();
                for i in 0..192 {
                    let pixel = Vector2::new((i % 16 * 20) as f64, (i / 16 * 20) as f64);
                    let point = inverse(self.centred(pixel), self.exposure(k, pixel));
                    let truth = flow(point, reference) + pixel - self.centred(pixel);
                    left += (correction.correct(pixel) - truth).norm_squared();
                    moved += (pixel - truth).norm_squared();
                    count += 1.0;
                }
            }
            ((left / count).sqrt(), (moved / count).sqrt())
        }
    }

    /// Asserts that a method undoes a constant translation to 0.01 px, whatever the shutter, with every
    /// fifth correspondence wrong.
    pub fn assert_undoes_a_constant_translation(method: &dyn Method) {
        let velocity = Vector2::new(190.0, -130.0);
        let (flow, inverse) = translation(move |t| velocity * t);
        for shutter in SHUTTERS {
            let run = Run::new(shutter, 6, &flow, &inverse, 5);
            let (left, moved) = run.left(method, &flow, &inverse);
            assert!(moved > 0.5 && left < 0.01, "{} {shutter:?}: {left} of {moved} px", method.name());
        }
    }

    /// Asserts that a method takes what says nothing: a single frame, and frames without correspondences.
    pub fn assert_survives_ignorance(method: &dyn Method) {
        let mut run = Run::translated(SHUTTERS[0], 3, |_| Vector2::zeros(), 0);
        run.pairs.iter_mut().for_each(Vec::clear);
        let pixel = Vector2::new(17.0, 31.0);
        let corrections = method.solve(&run.input()).unwrap();
        assert_eq!(corrections.len(), 3);
        assert!(corrections.iter().all(|correction| correction.correct(pixel) == pixel));
        let single = Run::translated(SHUTTERS[0], 1, |_| Vector2::zeros(), 0);
        assert_eq!(method.solve(&single.input()).unwrap()[0].correct(pixel), pixel);
    }

    type OwnedFlow = Box<dyn Fn(Vector2<f64>, f64) -> Vector2<f64>>;

    /// The flow of a translation path and its inverse.
    pub fn translation(path: impl Fn(f64) -> Vector2<f64> + Copy + 'static) -> (OwnedFlow, OwnedFlow) {
        (Box::new(move |p, t| p + path(t)), Box::new(move |p, t| p - path(t)))
    }
}
