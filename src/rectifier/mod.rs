//! The lookahead queue that joins the rooms: push luma, pop motions in order, drain, reset.

mod clock;
mod duplicates;
#[cfg(test)]
mod tests;

use crate::correspond::{Correspondence, Pyramid, Sampler};
use crate::motion::{MotionPath, Twist, image_centre};
use crate::plane::Luma;
use crate::readout::{Readout, ReadoutDirection, ReadoutTime};
use crate::solve::{Candidate, Link, Window};
use clock::Clock;
use duplicates::Duplicates;
use nalgebra::Vector2;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

pub use crate::solve::Origin;

/// Standard deviation of a tracked coordinate, in pixels of the analysed luma: what the sampler
/// reaches on compressed footage.
const TRACKING_NOISE: f64 = 0.1;
/// Confidence grows with the share of grid nodes whose correspondences follow the motion, up to this
/// share.
const FULL_COVERAGE: f64 = 0.1;

/// How a stream is analysed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Columns of the sampling grid.
    pub grid_columns: usize,
    /// Rows of the sampling grid.
    pub grid_rows: usize,
    /// Frames waited for before a frame's motion is given out.
    pub lookahead: usize,
    /// Which edge of the frame is read first.
    pub direction: ReadoutDirection,
    /// What is known of the readout time.
    pub readout_time: ReadoutTime,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            grid_columns: 32,
            grid_rows: 24,
            lookahead: 4,
            direction: ReadoutDirection::TopToBottom,
            readout_time: ReadoutTime::WholePeriod,
        }
    }
}

/// The motion of one frame and how far it is to be trusted.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameSolution {
    /// The shutter the motion was solved with.
    pub readout: Readout,
    /// The motion through the frame's readout; still where none was found.
    pub path: MotionPath,
    /// Trust in the motion, 0 (untouched) to 1.
    pub confidence: f64,
    /// Where the motion comes from.
    pub origin: Origin,
    /// Correspondences measured with the frame before it; 0 for the first, after a gap in time and
    /// for a duplicate.
    pub correspondences: usize,
    /// Correspondences that follow the motion, of the pair over which it was solved.
    pub inliers: usize,
    /// √E, the root mean square residual of 25.4 per inlier, in pixels.
    pub residual: f64,
}

/// Time spent so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timings {
    /// Reduction of the luma and correspondences.
    pub correspond: Duration,
    /// Solving.
    pub solve: Duration,
}

/// A frame whose motion has not been given out.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    readout: Readout,
    correspondences: usize,
    /// It repeats the frame before it and is not in the window.
    repeats: bool,
}

/// The frame that the next one is compared with.
#[derive(Clone, Copy, Debug)]
struct Reference {
    time: f64,
    /// The motion that the next pair is expected to go on with.
    expected: Twist,
}

/// Solves the motion of a stream's frames, one after another, in bounded memory.
///
/// Every frame pushed is popped once, in order.
#[derive(Debug)]
pub struct Rectifier {
    settings: Settings,
    size: (usize, usize),
    clock: Clock,
    sampler: Sampler,
    /// The reference's luma, and room for the next frame's.
    before: Pyramid,
    now: Pyramid,
    correspondences: Vec<Correspondence>,
    reference: Option<Reference>,
    duplicates: Duplicates,
    window: Window,
    waiting: VecDeque<Waiting>,
    solved: VecDeque<FrameSolution>,
    /// The motion given out last, for the duplicates that follow it.
    last: Option<Candidate>,
    timings: Timings,
}

impl Rectifier {
    /// A rectifier for frames of `width` × `height` pixels, `period` seconds apart.
    ///
    /// `period` is the nominal one; `None` takes it from the times of the frames.
    pub fn new(settings: Settings, width: usize, height: usize, period: Option<f64>) -> Self {
        Self {
            settings,
            size: (width, height),
            clock: Clock::new(period),
            sampler: Sampler::new(width, height, settings.grid_columns, settings.grid_rows),
            before: Pyramid::default(),
            now: Pyramid::default(),
            correspondences: Vec::new(),
            reference: None,
            duplicates: Duplicates::default(),
            window: Window::default(),
            waiting: VecDeque::new(),
            solved: VecDeque::new(),
            last: None,
            timings: Timings::default(),
        }
    }

    /// Adds the next frame: its luma and its timestamp in seconds.
    ///
    /// Times may fall (reverse playback) or be missing; `duplicate` marks a frame known to repeat
    /// the one before it (most duplicates are also found by themselves). A luma that is not of the
    /// rectifier's size is taken as a frame in which nothing can be seen.
    pub fn push(&mut self, luma: &Luma<'_>, time: Option<f64>, duplicate: bool) {
        let started = Instant::now();
        let tick = self.clock.tick(time);
        if !tick.continues {
            self.reference = None;
        }
        self.sampler.build(luma, &mut self.now);
        let repeats = self.reference.is_some()
            && (duplicate || self.duplicates.is_repeated(self.sampler.difference(&self.before, &self.now)));
        let readout = self.readout();
        self.waiting.push_back(Waiting { readout, correspondences: 0, repeats });
        if repeats {
            self.timings.correspond += started.elapsed();
        } else {
            self.compare(tick.time, &readout, started);
        }
        while self.waiting.len() > self.settings.lookahead {
            self.give_out();
        }
    }

    /// The motion of the oldest frame not yet popped, once `lookahead` frames follow it.
    pub fn pop(&mut self) -> Option<FrameSolution> {
        self.solved.pop_front()
    }

    /// Ends a stretch of the stream: the frames still waiting are solved from what there is and can
    /// be popped; the next frame pushed starts anew.
    pub fn drain(&mut self) {
        while !self.waiting.is_empty() {
            self.give_out();
        }
        self.forget_the_past();
    }

    /// Forgets everything, frames not yet popped too.
    pub fn reset(&mut self) {
        self.waiting.clear();
        self.solved.clear();
        self.forget_the_past();
    }

    /// Time spent so far in each stage.
    pub fn timings(&self) -> Timings {
        self.timings
    }

    fn forget_the_past(&mut self) {
        self.window.reset();
        self.clock.restart();
        self.duplicates = Duplicates::default();
        self.reference = None;
        self.last = None;
    }

    fn readout(&self) -> Readout {
        let (width, height) = self.size;
        Readout::new(width, height, self.settings.direction, self.settings.readout_time, self.clock.period())
    }

    /// Links the frame in `now` to the reference, where there is one, and makes it the reference.
    fn compare(&mut self, time: f64, readout: &Readout, started: Instant) {
        let link = self.reference.map(|reference| {
            let interval = time - reference.time;
            let centre = image_centre(readout.width, readout.height);
            let expected = reference.expected.after(interval);
            let predict = |point: Vector2<f64>| expected.apply(point - centre) + centre;
            self.sampler.correspond(&self.before, &self.now, predict, &mut self.correspondences);
            let noise = TRACKING_NOISE * self.sampler.pixel_scale();
            Link::new(&self.correspondences, readout, interval, noise)
        });
        if let (Some(link), Some(waiting)) = (&link, self.waiting.back_mut()) {
            waiting.correspondences = link.len();
        }
        let tracked = Instant::now();
        self.timings.correspond += tracked - started;
        let uniform = self.window.push(link);
        self.reference = Some(Reference { time, expected: uniform.map_or(Twist::ZERO, |fit| fit.twist) });
        std::mem::swap(&mut self.before, &mut self.now);
        self.timings.solve += tracked.elapsed();
    }

    /// Gives out the motion of the first frame that waits.
    fn give_out(&mut self) {
        let started = Instant::now();
        let Some(frame) = self.waiting.pop_front() else { return };
        if !frame.repeats {
            self.last = self.window.settle();
        }
        let solution = match self.last {
            Some(candidate) => self.solution(&frame, candidate),
            None => FrameSolution {
                readout: frame.readout,
                path: MotionPath::STILL,
                confidence: 0.0,
                origin: Origin::Untouched,
                correspondences: frame.correspondences,
                inliers: 0,
                residual: 0.0,
            },
        };
        self.solved.push_back(solution);
        self.timings.solve += started.elapsed();
    }

    fn solution(&self, frame: &Waiting, Candidate { fit, origin }: Candidate) -> FrameSolution {
        let nodes = self.settings.grid_columns * self.settings.grid_rows;
        let coverage = fit.inliers as f64 / (FULL_COVERAGE * nodes as f64).max(1.0);
        FrameSolution {
            readout: frame.readout,
            path: MotionPath::uniform(fit.twist, frame.readout.time),
            confidence: fit.confidence * coverage.min(1.0),
            origin: if frame.repeats { Origin::Repeated } else { origin },
            correspondences: frame.correspondences,
            inliers: fit.inliers,
            residual: fit.energy.sqrt(),
        }
    }
}
