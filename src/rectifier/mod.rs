// SPDX-License-Identifier: MIT OR Apache-2.0

//! The rectifier, a lookahead queue over all modules: push luma, pop motions in order, drain, reset.

mod bars;
mod clock;
mod duplicates;
mod engine;
mod error;
#[cfg(test)]
mod film;
#[cfg(test)]
mod letterbox_tests;
mod settings;
#[cfg(test)]
mod sparse_tests;
mod steady;
#[cfg(test)]
mod steady_tests;
#[cfg(test)]
mod tests;

use crate::area::PictureArea;
use crate::correspond::{Correspondence, Pyramid, Sampler};
use crate::plane::Luma;
use crate::readout::{Readout, ReadoutPosterior};
use crate::stabilize::Stabilizer;
use bars::Bars;
use clock::Clock;
use duplicates::Duplicates;
use engine::{Engine, Step};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

pub use crate::solve::residual::REGIONS;
pub use crate::solve::{
    AsRecorded, FittedCorrespondence, FocalLength, FrameSolution, FrameTiming, Origin, Timeline,
};
pub use crate::stabilize::PLANNED_SHARE;
pub use error::{PushError, SettingsError};
pub use settings::{Effort, Estimator, MOTION_LOOKAHEAD, Settings, stabilization_lookahead};

/// Whether a frame is a duplicate of its predecessor, as after a conversion to a higher frame rate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Duplicate {
    /// Unknown: most duplicates are detected from the picture.
    #[default]
    Detect,
    /// The frame repeats its predecessor.
    Known,
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
    index: usize,
    /// Timestamp in seconds, as it was pushed.
    stated: Option<f64>,
    /// Time assigned to it, in seconds.
    time: f64,
    readout: Readout,
    correspondences: usize,
    /// The frame is a duplicate of its predecessor and not in the window.
    repeats: bool,
    begins_shot: bool,
}

/// Estimates the motion of a stream's frames, in order, in bounded memory.
///
/// Exactly one solution is popped for every frame pushed, in the same order, with the frame's
/// [number](FrameSolution::index) and [timestamp](FrameSolution::time).
#[derive(Debug)]
pub struct Rectifier {
    settings: Settings,
    bars: Bars,
    /// Where the picture lies: the part of the frames that is analysed.
    area: PictureArea,
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
    /// Frames pushed since the rectifier was made or reset.
    pushed: usize,
    /// How many of them had been pushed at the last [`drain`](Self::drain).
    drained: usize,
    waiting: VecDeque<Waiting>,
    stabilizer: Stabilizer<FrameSolution>,
    solved: VecDeque<FrameSolution>,
    /// The motion settled last, for duplicates of its frame.
    last: Option<FrameSolution>,
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
        let (sampler, engine) = analysis(&settings, width, height);
        Ok(Self {
            settings,
            bars: Bars::default(),
            area: PictureArea::whole(width, height),
            clock: Clock::new(period),
            sampler,
            before: Pyramid::default(),
            now: Pyramid::default(),
            correspondences: Vec::new(),
            reference: None,
            duplicates: Duplicates::default(),
            engine,
            pushed: 0,
            drained: 0,
            waiting: VecDeque::new(),
            stabilizer: Stabilizer::new([width, height], settings.target()),
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
        let (found, expected) = (luma.plane.layout(), self.area.frame());
        if [found.width, found.height] != expected {
            return Err(PushError::Size { found: [found.width, found.height], expected });
        }
        let area = self.bars.area(luma);
        if area != self.area {
            self.begin_picture(area);
        }
        let [columns, rows] = area.ranges();
        let luma = &luma.part(&columns, &rows).unwrap_or(*luma);
        let tick = self.clock.tick(time);
        if !tick.continues {
            self.reference = None;
        }
        self.sampler.build(luma, &mut self.now);
        let repeats = self.reference.is_some()
            && (duplicate == Duplicate::Known
                || self.duplicates.is_repeated(self.sampler.difference(&self.before, &self.now)));
        let readout = self.readout();
        self.waiting.push_back(Waiting {
            index: self.pushed,
            stated: time.filter(|time| time.is_finite()),
            time: tick.time,
            readout,
            correspondences: 0,
            repeats,
            begins_shot: false,
        });
        self.pushed += 1;
        if repeats {
            self.timings.correspond += started.elapsed();
        } else {
            self.compare(tick.time, &readout, started);
        }
        while self.waiting.len() > self.motion_lookahead() {
            self.settle();
        }
        while self.stabilizer.waiting() + self.waiting.len() > self.settings.lookahead && self.place() {}
        Ok(())
    }

    /// The motion of the oldest frame not yet popped, as soon as `lookahead` later frames were pushed.
    pub fn pop(&mut self) -> Option<FrameSolution> {
        let index = self.solved.front()?.index;
        let is_due = index < self.drained || self.pushed.saturating_sub(index) > self.settings.lookahead;
        if is_due { self.solved.pop_front() } else { None }
    }

    /// The motion of the oldest frame not yet popped, from the frames pushed so far, without waiting for
    /// `lookahead` later ones. `None` if every frame pushed has been popped.
    pub fn pop_early(&mut self) -> Option<FrameSolution> {
        if self.solved.is_empty() && !self.place() {
            self.settle();
            self.place();
        }
        self.solved.pop_front()
    }

    /// Ends a segment of the stream: all waiting frames are solved from the frames pushed so far and can
    /// be popped; the next frame pushed starts a new segment.
    pub fn drain(&mut self) {
        self.end_segment();
        self.drained = self.pushed;
        self.bars.restart();
    }

    /// Discards all frames, including those not yet popped; estimates of the camera are kept.
    pub fn reset(&mut self) {
        self.waiting.clear();
        self.solved.clear();
        (self.pushed, self.drained) = (0, 0);
        self.start_segment();
        self.bars.restart();
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

    /// Solves all waiting frames from those pushed so far.
    fn end_segment(&mut self) {
        while !self.waiting.is_empty() {
            self.settle();
        }
        while self.place() {}
        self.start_segment();
    }

    fn start_segment(&mut self) {
        self.engine.restart();
        self.stabilizer.restart();
        self.clock.restart();
        self.duplicates = Duplicates::default();
        self.reference = None;
        self.last = None;
    }

    /// Ends the segment; from now on the picture lies elsewhere in the frame, and nothing is known of its camera.
    fn begin_picture(&mut self, area: PictureArea) {
        self.end_segment();
        self.area = area;
        let [width, height] = area.size();
        (self.sampler, self.engine) = analysis(&self.settings, width, height);
        self.stabilizer = Stabilizer::new([width, height], self.settings.target());
    }

    fn readout(&self) -> Readout {
        let [width, height] = self.area.size();
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
                (self.correspondences.as_slice(), [flow.forward(), flow.backward()])
            }),
            time,
            interval: interval.unwrap_or(0.0),
            spacing: self.clock.spacing(),
            readout: *readout,
            pixel_scale: self.sampler.pixel_scale(),
            sharpness: self.sampler.sharpness(&self.now),
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
            Some(last) if frame.repeats => FrameSolution { origin: Origin::Repeated, ..last.clone() },
            Some(last) => last.clone(),
            None => self.untouched(&frame),
        };
        let as_recorded = solution.reason_as_recorded(self.clock.period());
        let Waiting { index, stated: time, begins_shot, .. } = frame;
        let solution = FrameSolution { index, time, begins_shot, as_recorded, ..solution };
        self.pass_on(solution.within(self.area), &frame);
        self.timings.solve += started.elapsed();
    }

    fn untouched(&self, frame: &Waiting) -> FrameSolution {
        let (readout, readout_deviation) = self.engine.belief(&frame.readout);
        FrameSolution {
            correspondences: frame.correspondences,
            readout_deviation,
            timing: self.engine.timing(),
            ..FrameSolution::untouched(readout)
        }
    }
}

/// What compares pictures of `width` × `height` pixels and what estimates their motion, for a camera of which nothing is known
/// but the settings.
fn analysis(settings: &Settings, width: usize, height: usize) -> (Sampler, Engine) {
    let (columns, rows) = (settings.grid_columns, settings.grid_rows);
    let sampler = Sampler::with_effort(settings.effort, width, height, columns, rows);
    let engine = Engine::new(settings, width, height, sampler.pixel_scale());
    (sampler, engine)
}
