//! The lookahead queue that joins the rooms: push luma, pop motions in order, drain, reset.

use crate::motion::MotionPath;
use crate::plane::Luma;
use crate::readout::{Readout, ReadoutDirection, ReadoutTime};
use std::collections::VecDeque;

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

/// Where a frame's motion comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Origin {
    /// One pair of frames in uniform rotation (25.6).
    Initial,
    /// The recursion from earlier frames (25.7, 25.8).
    Forward,
    /// The recursion from later frames (25.9, 25.10).
    Backward,
    /// A duplicate: the motion of the frame it repeats.
    Repeated,
    /// None was found or it is not to be trusted: the frame stays as it is.
    Untouched,
}

/// The motion of one frame and how far it is to be trusted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameSolution {
    /// The shutter the motion was solved with.
    pub readout: Readout,
    /// The motion through the frame's readout; still where none was found.
    pub path: MotionPath,
    /// Trust in the motion, 0 (untouched) to 1.
    pub confidence: f64,
    /// Where the motion comes from.
    pub origin: Origin,
    /// Correspondences with the frame before it that were measured.
    pub correspondences: usize,
    /// Those of them that follow the motion.
    pub inliers: usize,
    /// Root mean square residual of the measurement constraint 25.4 per inlier, in pixels.
    pub residual: f64,
}

/// Solves the motion of a stream's frames, one after another, in bounded memory.
///
/// Every frame pushed is popped once, in order.
#[derive(Debug)]
pub struct Rectifier {
    settings: Settings,
    readout: Readout,
    waiting: usize,
    solved: VecDeque<FrameSolution>,
}

impl Rectifier {
    /// A rectifier for frames of `width` × `height` pixels, `period` seconds apart.
    ///
    /// `period` is the nominal one; `None` takes it from the times of the frames.
    pub fn new(settings: Settings, width: usize, height: usize, period: Option<f64>) -> Self {
        let readout = Readout::new(
            width,
            height,
            settings.direction,
            settings.readout_time,
            period.unwrap_or(1.0 / 30.0),
        );
        Self { settings, readout, waiting: 0, solved: VecDeque::new() }
    }

    /// Adds the next frame: its luma and its timestamp in seconds.
    ///
    /// Times may fall (reverse playback) or be missing; `duplicate` marks a frame known to repeat
    /// the one before it (repeated pixels are also found by themselves). A luma that is not of the
    /// rectifier's size is taken as a frame in which nothing can be seen.
    pub fn push(&mut self, luma: &Luma<'_>, time: Option<f64>, duplicate: bool) {
        let _ = (luma, time, duplicate);
        self.waiting += 1;
        while self.waiting > self.settings.lookahead {
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
        while self.waiting > 0 {
            self.give_out();
        }
    }

    /// Forgets everything, frames not yet popped too.
    pub fn reset(&mut self) {
        self.waiting = 0;
        self.solved.clear();
    }

    fn give_out(&mut self) {
        self.waiting -= 1;
        self.solved.push_back(FrameSolution {
            readout: self.readout,
            path: MotionPath::STILL,
            confidence: 0.0,
            origin: Origin::Untouched,
            correspondences: 0,
            inliers: 0,
            residual: 0.0,
        });
    }
}
