// SPDX-License-Identifier: MIT OR Apache-2.0

//! Why a frame keeps its picture.

use super::frame_timing::Timeline;
use std::fmt;

/// Why a frame keeps its picture: the reasons of the table in `docs/method.md`, "When nothing is applied", as far as they can be
/// inferred from the solution of the frame. Displayed in words.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum AsRecorded {
    /// The frames are blends of two exposures, all but one in `period`.
    Blended {
        /// Frames to a repetition.
        period: usize,
    },
    /// No motion was found: too few points were found again in the frames before and after, or there is none.
    NoMotion,
    /// The frames were moved after their readout, and their lean is too uncertain.
    Stabilised,
    /// The readout was not known.
    UnknownReadout,
    /// Nothing moved.
    NothingMoved,
    /// The readout takes so little time that the rows are as good as exposed at once.
    GlobalShutter,
    /// The error that is expected of the correction is as large as the correction.
    Uncertain,
}

impl fmt::Display for AsRecorded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words = match self {
            Self::Blended { period } => return Timeline::Blended { period: *period }.fmt(f),
            Self::NoMotion => "no motion was found",
            Self::Stabilised => "the frames were moved after their readout",
            Self::UnknownReadout => "the readout was not known",
            Self::NothingMoved => "nothing moved",
            Self::GlobalShutter => "the rows are as good as exposed at once",
            Self::Uncertain => "the correction was too uncertain",
        };
        f.write_str(words)
    }
}
