//! Whether frames were exposed when their timestamps say so, and stand where the camera saw them.

use std::fmt;

/// What the frames so far say of their timing and placement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct FrameTiming {
    /// Whether the frames were moved after their readout, as by stabilisation in the camera: they are rectified
    /// by the changes of their lean alone, as far as these tell it. `None` if they do not say.
    pub stabilised: Option<bool>,
    /// When the frames were exposed.
    pub timeline: Timeline,
}

impl FrameTiming {
    /// Whether the frames are known to be stabilised.
    #[must_use]
    pub const fn is_stabilised(&self) -> bool {
        matches!(self.stabilised, Some(true))
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
    /// Evenly, so many frame periods apart: frames were repeated and the repetitions are not counted, so that the
    /// stated intervals are uneven.
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
}

impl fmt::Display for Timeline {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stated => write!(f, "as stated"),
            Self::Even { .. } => write!(f, "frames were repeated"),
            Self::Missing { kept, .. } => write!(f, "one frame of {} is missing", kept + 1),
        }
    }
}
