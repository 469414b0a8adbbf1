// SPDX-License-Identifier: MIT OR Apache-2.0

//! Whether frames were exposed when their timestamps say so, and stand where the camera saw them.

use std::fmt;

/// Timing and placement of the frames, as estimated so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct FrameTiming {
    /// Whether the frames were moved after their readout, as by stabilisation in the camera: they are then rectified only as
    /// far as their lean can be estimated from its changes. `None`: undecided.
    pub stabilised: Option<bool>,
    /// When the frames were exposed.
    pub timeline: Timeline,
}

impl FrameTiming {
    /// Number of moving frames that a verdict takes. With a lookahead of as many it holds from the first frame on.
    pub const FRAMES: usize = 18;

    /// From whether frames were moved after their readout, and when they were exposed.
    #[must_use]
    pub const fn new(stabilised: Option<bool>, timeline: Timeline) -> Self {
        Self { stabilised, timeline }
    }

    /// Whether the frames are known to be stabilised.
    #[must_use]
    pub const fn is_stabilised(&self) -> bool {
        matches!(self.stabilised, Some(true))
    }

    /// Whether the frames are blends of two exposures: they are left as they are.
    #[must_use]
    pub const fn is_blended(&self) -> bool {
        matches!(self.timeline, Timeline::Blended { .. })
    }

    /// `yes`, `no` or `undecided`.
    #[must_use]
    pub const fn stabilised_name(&self) -> &'static str {
        match self.stabilised {
            Some(true) => "yes",
            Some(false) => "no",
            None => "undecided",
        }
    }
}

/// The times of the frames relative to their timestamps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum Timeline {
    /// As stated.
    #[default]
    Stated,
    /// Evenly spaced: frames were repeated and the repetitions are not counted, so that the stated intervals are uneven.
    Even {
        /// Frame periods from one distinct frame to the next.
        interval: f64,
    },
    /// One frame was dropped after every `kept` frames and the rest spread evenly: the pair numbered `longer`, and
    /// every `kept`th after it, lasts twice as long as the others.
    Missing {
        /// Frames kept in a row.
        kept: usize,
        /// Number of the first pair over a missing frame, below `kept`.
        longer: usize,
    },
    /// As stated, but the frames are blends of two exposures each, all but one in `period`.
    Blended {
        /// Frames to a repetition.
        period: usize,
    },
}

impl fmt::Display for Timeline {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stated => write!(f, "as stated"),
            Self::Even { .. } => write!(f, "frames were repeated"),
            Self::Missing { kept, .. } => write!(f, "one frame of {} is missing", kept + 1),
            Self::Blended { period } => write!(f, "all frames but one in {period} are blends of two"),
        }
    }
}
