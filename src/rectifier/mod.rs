//! The rectifier, a lookahead queue over all modules: push luma, pop motions in order, drain, reset.

mod clock;
mod duplicates;
mod engine;
mod error;
#[cfg(test)]
mod sparse_tests;
#[cfg(test)]
mod tests;

use crate::correspond::{Correspondence, Pyramid, Sampler};
use crate::motion::{FrameMotion, Model, MotionPath};
use crate::plane::Luma;
use crate::readout::{Readout, ReadoutDirection, ReadoutPosterior, ReadoutPrior, ReadoutTime};
use crate::solve::continuous::{Camera, PairMeasurement};
use clock::Clock;
use duplicates::Duplicates;
use engine::{Engine, Settled, Step};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

pub use crate::solve::Origin;
pub use crate::solve::continuous::FittedCorrespondence;
pub use crate::solve::residual::REGIONS;
pub use error::{PushError, SettingsError};

/// The motion estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Estimator {
    /// Splines over exposure time; the readout is estimated from the picture unless given.
    #[default]
    Continuous,
    /// The paper's estimator: one 2D rotation per frame, each computed from that of its neighbour.
    Sequential,
}

/// Whether a frame is a duplicate of its predecessor, as after a conversion to a higher frame rate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Duplicate {
    /// Unknown: most duplicates are detected from the picture.
    #[default]
    Detect,
    /// The frame repeats its predecessor.
    Known,
}

/// How a stream is analysed.
///
/// ```
/// let mut settings = rsrectify::rectifier::Settings::default();
/// settings.lookahead = 8;
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Settings {
    /// Columns of the sampling grid.
    pub grid_columns: usize,
    /// Rows of the sampling grid.
    pub grid_rows: usize,
    /// Number of later frames needed before a frame's motion is available.
    pub lookahead: usize,
    /// The motion estimator.
    pub estimator: Estimator,
    /// The motion model of the continuous estimator.
    pub model: Model,
    /// Focal length in frame widths; `None` to estimate it from the picture. At least 0.354, a field of view
    /// of 110°; smaller values are raised to that.
    pub focal_length: Option<f64>,
    /// Which edge of the frame is read first; `None` to estimate it from the picture. The sequential
    /// estimator takes `None` as top to bottom.
    pub direction: Option<ReadoutDirection>,
    /// The readout time, if known.
    pub readout_time: ReadoutTime,
    /// Prior of the readout if it is unknown; ignored if it contradicts `direction`, and by the sequential
    /// estimator.
    pub readout_prior: Option<ReadoutPrior>,
    /// Whether [`FrameSolution::fitted`] is filled, which takes memory for each frame.
    pub keep_correspondences: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            grid_columns: 32,
            grid_rows: 24,
            lookahead: 4,
            estimator: Estimator::Continuous,
            model: Model::Auto,
            focal_length: None,
            direction: None,
            readout_time: ReadoutTime::Unknown,
            readout_prior: None,
            keep_correspondences: false,
        }
    }
}

/// The motion of one frame with its confidence.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct FrameSolution {
    /// The motion to rectify the frame with: the path during its readout, the shutter it was solved for, and
    /// the share of the correction to apply, less than 1 if a continuous path is uncertain.
    pub motion: FrameMotion,
    /// Confidence in the motion, 0 (untouched) to 1: the share of the correction that is expected to be
    /// right.
    pub confidence: f64,
    /// Expected root mean square error, in pixels, of the positions of the frame's points after rectification
    /// with [`motion`](Self::motion); `None` for a frame without a motion and from the sequential estimator.
    pub expected_error: Option<f64>,
    /// The same in each of [`REGIONS`], row by row; empty if it is `None`.
    pub region_errors: Vec<f64>,
    /// How the motion was obtained.
    pub origin: Origin,
    /// Number of correspondences in the pair of frames over which the motion was solved. For a frame without
    /// a motion, those with the previous frame: 0 for the first, after a gap in time and for a duplicate.
    pub correspondences: usize,
    /// Number of inliers among them.
    pub inliers: usize,
    /// Root mean square residual of an inlier in pixels: √E of 25.4, or a coordinate's deviation from
    /// the continuous path.
    pub residual: f64,
    /// Standard deviation of the estimated readout ratio; 0 if it was given.
    pub readout_deviation: f64,
    /// Whether very few points of the previous frame were found in this one, as at a cut; always false with
    /// the sequential estimator.
    pub begins_shot: bool,
    /// The focal length; `None` for a frame without a motion, from the sequential estimator, and for a model
    /// without perspective.
    pub focal_length: Option<FocalLength>,
    /// Correspondences of the frame and their residuals, at most one per point of the sampling grid; those
    /// with the next frame if there is one. Empty unless [`Settings::keep_correspondences`] is set, for a
    /// frame without a motion, and from the sequential estimator.
    pub fitted: Vec<FittedCorrespondence>,
}

/// A focal length, given or estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct FocalLength {
    /// In frame widths.
    pub widths: f64,
    /// Standard deviation in frame widths; 0 if it was given.
    pub deviation: f64,
}

/// Processing time so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Timings {
    /// Reduction of the luma, optical flow and correspondences.
    pub correspond: Duration,
    /// Estimation of the motion.
    pub solve: Duration,
}

/// A frame whose motion has not been solved yet.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    readout: Readout,
    correspondences: usize,
    /// The frame is a duplicate of its predecessor and not in the window.
    repeats: bool,
    begins_shot: bool,
}

/// Estimates the motion of a stream's frames, in order, in bounded memory.
///
/// Exactly one solution is popped for every frame pushed, in the same order.
#[derive(Debug)]
pub struct Rectifier {
    settings: Settings,
    size: (usize, usize),
    clock: Clock,
    sampler: Sampler,
    /// The luma of the reference, and of the current frame.
    before: Pyramid,
    now: Pyramid,
    correspondences: Vec<Correspondence>,
    /// Time of the reference: the frame with which the next one is compared.
    reference: Option<f64>,
    duplicates: Duplicates,
    engine: Engine,
    waiting: VecDeque<Waiting>,
    solved: VecDeque<FrameSolution>,
    /// The motion settled last, for duplicates of its frame.
    last: Option<Settled>,
    timings: Timings,
}

impl Rectifier {
    /// A rectifier for frames of `width` × `height` pixels, `period` seconds apart.
    ///
    /// `period` is the nominal one; if it is `None` or implausible (under a millisecond, over ten seconds,
    /// NaN), it is estimated from the times of the frames. Any size is valid; frames too small to be analysed
    /// are left untouched.
    ///
    /// # Errors
    /// If the settings are invalid or the frames are larger than any sensor; see [`SettingsError`].
    pub fn new(
        settings: Settings,
        width: usize,
        height: usize,
        period: Option<f64>,
    ) -> Result<Self, SettingsError> {
        settings.check(width, height)?;
        let sampler = Sampler::new(width, height, settings.grid_columns, settings.grid_rows);
        let engine = match settings.estimator {
            Estimator::Sequential => Engine::sequential(),
            Estimator::Continuous => {
                let camera = Camera {
                    model: settings.model,
                    direction: settings.direction,
                    readout_time: settings.readout_time,
                    readout_prior: settings.readout_prior,
                    focal_length: settings.focal_length,
                };
                let keep = settings.keep_correspondences;
                Engine::continuous(camera, (width, height), sampler.pixel_scale(), keep)
            }
        };
        Ok(Self {
            settings,
            size: (width, height),
            clock: Clock::new(period),
            sampler,
            before: Pyramid::default(),
            now: Pyramid::default(),
            correspondences: Vec::new(),
            reference: None,
            duplicates: Duplicates::default(),
            engine,
            waiting: VecDeque::new(),
            solved: VecDeque::new(),
            last: None,
            timings: Timings::default(),
        })
    }

    /// Adds the next frame: its luma and its timestamp in seconds.
    ///
    /// Times may decrease (reverse playback) or be missing; a time that is not finite counts as missing.
    ///
    /// # Errors
    /// If the luma is not of the rectifier's size: the frame is not pushed, and no solution is popped for it.
    pub fn push(
        &mut self,
        luma: &Luma<'_>,
        time: Option<f64>,
        duplicate: Duplicate,
    ) -> Result<(), PushError> {
        let started = Instant::now();
        let (found, expected) = (luma.plane.layout(), self.size);
        if (found.width, found.height) != expected {
            return Err(PushError::Size {
                found: [found.width, found.height],
                expected: [expected.0, expected.1],
            });
        }
        let tick = self.clock.tick(time);
        if !tick.continues {
            self.reference = None;
        }
        self.sampler.build(luma, &mut self.now);
        let repeats = self.reference.is_some()
            && (duplicate == Duplicate::Known
                || self.duplicates.is_repeated(self.sampler.difference(&self.before, &self.now)));
        let readout = self.readout();
        self.waiting.push_back(Waiting { readout, correspondences: 0, repeats, begins_shot: false });
        if repeats {
            self.timings.correspond += started.elapsed();
        } else {
            self.compare(tick.time, &readout, started);
        }
        while self.waiting.len() > self.settings.lookahead {
            self.settle();
        }
        Ok(())
    }

    /// The motion of the oldest frame not yet popped, as soon as `lookahead` later frames were pushed.
    pub fn pop(&mut self) -> Option<FrameSolution> {
        self.solved.pop_front()
    }

    /// The motion of the oldest frame not yet popped, from the frames pushed so far, without waiting for
    /// `lookahead` later ones. `None` if every frame pushed has been popped.
    pub fn pop_early(&mut self) -> Option<FrameSolution> {
        if self.solved.is_empty() {
            self.settle();
        }
        self.solved.pop_front()
    }

    /// Ends a segment of the stream: all waiting frames are solved from the frames pushed so far and can
    /// be popped; the next frame pushed starts a new segment.
    pub fn drain(&mut self) {
        while !self.waiting.is_empty() {
            self.settle();
        }
        self.start_segment();
    }

    /// Discards all frames, including those not yet popped; estimates of the camera are kept.
    pub fn reset(&mut self) {
        self.waiting.clear();
        self.solved.clear();
        self.start_segment();
    }

    /// Processing time so far in each stage.
    #[must_use]
    pub fn timings(&self) -> Timings {
        self.timings
    }

    /// Posterior of the readout given all frames so far; `None` if the readout is given, before the first
    /// frame, and from the sequential estimator.
    #[must_use]
    pub fn readout_posterior(&self) -> Option<ReadoutPosterior> {
        self.engine.posterior()
    }

    fn start_segment(&mut self) {
        self.engine.restart();
        self.clock.restart();
        self.duplicates = Duplicates::default();
        self.reference = None;
        self.last = None;
    }

    fn readout(&self) -> Readout {
        let (width, height) = self.size;
        let direction = self.settings.direction.unwrap_or_default();
        Readout::resolved(width, height, direction, self.settings.readout_time, self.clock.period())
    }

    /// Measures the frame in `now` against the reference, if there is one, and makes it the reference.
    fn compare(&mut self, time: f64, readout: &Readout, started: Instant) {
        let interval = self.reference.map(|reference| time - reference);
        if let Some(interval) = interval {
            let predict = self.engine.predictor(readout, interval);
            self.sampler.correspond(&self.before, &self.now, predict, &mut self.correspondences);
            if let Some(waiting) = self.waiting.back_mut() {
                waiting.correspondences = self.correspondences.len();
            }
        }
        let measured = Instant::now();
        self.timings.correspond += measured - started;
        self.engine.push(&Step {
            found: interval.map(|_| {
                let flow = self.sampler.flow();
                PairMeasurement { grid: &self.correspondences, flow: Some([flow.forward(), flow.backward()]) }
            }),
            time,
            interval: interval.unwrap_or(0.0),
            spacing: self.clock.spacing(),
            readout: *readout,
            pixel_scale: self.sampler.pixel_scale(),
        });
        if let Some(waiting) = self.waiting.back_mut() {
            waiting.begins_shot = self.engine.is_at_cut();
        }
        self.reference = Some(time);
        std::mem::swap(&mut self.before, &mut self.now);
        self.timings.solve += measured.elapsed();
    }

    /// Settles the motion of the first waiting frame.
    fn settle(&mut self) {
        let started = Instant::now();
        let Some(frame) = self.waiting.pop_front() else { return };
        if !frame.repeats {
            self.last = self.engine.settle();
        }
        let solution = match &self.last {
            Some(settled) => self.solution(&frame, settled),
            None => self.untouched(&frame),
        };
        self.solved.push_back(solution);
        self.timings.solve += started.elapsed();
    }

    fn untouched(&self, frame: &Waiting) -> FrameSolution {
        let (readout, readout_deviation) = self.engine.belief(&frame.readout);
        FrameSolution {
            motion: FrameMotion::new(readout, MotionPath::STILL).with_weight(0.0),
            confidence: 0.0,
            expected_error: None,
            region_errors: Vec::new(),
            origin: Origin::Untouched,
            correspondences: frame.correspondences,
            inliers: 0,
            residual: 0.0,
            readout_deviation,
            begins_shot: frame.begins_shot,
            focal_length: None,
            fitted: Vec::new(),
        }
    }

    fn solution(&self, frame: &Waiting, settled: &Settled) -> FrameSolution {
        let confidence = settled.confidence;
        let weight = if settled.origin == Origin::Continuous { confidence } else { 1.0 };
        FrameSolution {
            motion: FrameMotion::new(settled.readout, settled.path.clone()).with_weight(weight),
            confidence,
            expected_error: crate::solve::root_mean_square(&settled.errors),
            region_errors: settled.errors.clone(),
            origin: if frame.repeats { Origin::Repeated } else { settled.origin },
            correspondences: settled.correspondences,
            inliers: settled.inliers,
            residual: settled.residual,
            readout_deviation: settled.readout_deviation,
            begins_shot: frame.begins_shot,
            focal_length: settled.focal_length.map(|(widths, deviation)| FocalLength { widths, deviation }),
            fitted: settled.fitted.clone(),
        }
    }
}
