//! A sequence in memory: its frames as they arrive, and what is known of each.

use crate::metrics::{Stats, distances};
use crate::scene::{FirstEdge, Frame};
use crate::sequence::{Sequence, Settings};
use crate::truth::Sample;
use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};

/// Truth is sampled every so many pixels.
pub const STEP: usize = 8;

/// A sequence in memory.
pub struct Footage {
    /// What it was rendered from.
    pub sequence: Sequence,
    /// The frames as they arrive.
    pub frames: Vec<Frame>,
    /// The timestamp of each frame in seconds: the start of its readout.
    pub stamps: Vec<f64>,
    /// The truth of each frame.
    pub truth: Vec<FrameTruth>,
}

/// What is known of one frame.
pub struct FrameTruth {
    /// Where every [`STEP`]th pixel belongs at the reference instant, where that can be judged.
    pub samples: Vec<Sample>,
    /// The frame that a global shutter sees at the reference instant.
    pub global: Frame,
}

impl Footage {
    /// Renders a sequence.
    pub fn render(sequence: Sequence) -> Self {
        let count = sequence.settings.frames;
        let truth = |k: usize| FrameTruth {
            samples: sequence.capture(k).samples(STEP),
            global: sequence.renderer().global(sequence.capture(k).reference()).sense(0.0, 0),
        };
        let truth = (0..count).map(truth).collect();
        let frames = sequence.frames().collect();
        let stamps = (0..count).map(|k| sequence.start(k)).collect();
        Self { sequence, frames, stamps, truth }
    }

    /// What determines the footage.
    pub fn settings(&self) -> &Settings {
        &self.sequence.settings
    }

    /// The true shutter.
    pub fn readout(&self) -> Readout {
        let settings = self.settings();
        let time = ReadoutTime::Seconds(settings.readout_time());
        let direction = direction(settings.first);
        Readout::new(settings.width, settings.height, direction, time, 1.0 / settings.fps)
    }

    /// The stretches of frames over which motion can be followed: frames of one take, in order and
    /// each picture once. Every frame that shows a picture of its own is in one of them.
    pub fn runs(&self) -> Vec<Vec<usize>> {
        vec![(0..self.frames.len()).collect()]
    }

    /// The displacement of the footage as it arrives.
    pub fn uncorrected(&self) -> Stats {
        let samples = self.truth.iter().flat_map(|truth| distances(&truth.samples, |pixel| pixel));
        Stats::of(samples.collect())
    }
}

/// What the library calls the edge that is exposed first.
pub fn direction(first: FirstEdge) -> ReadoutDirection {
    match first {
        FirstEdge::Top => ReadoutDirection::TopToBottom,
        FirstEdge::Bottom => ReadoutDirection::BottomToTop,
        FirstEdge::Left => ReadoutDirection::LeftToRight,
        FirstEdge::Right => ReadoutDirection::RightToLeft,
    }
}
