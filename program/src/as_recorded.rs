// SPDX-License-Identifier: MIT OR Apache-2.0

//! Why a frame of a clip keeps its picture.

use rsrectify::rectifier::{self, FrameSolution};
use std::fmt;

/// Why a frame keeps its picture. Displayed in words, without a comma.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AsRecorded {
    /// Its motion was to be found.
    Analysed(rectifier::AsRecorded),
    /// None of the correction that was found was to be applied.
    NotApplied,
    /// It was to have a motion from a motion file, which has none for it, or one without a correction.
    Given { has_motion: bool },
}

impl AsRecorded {
    /// A frame that keeps its picture though this was found of it.
    pub fn analysed(solution: &FrameSolution) -> Self {
        solution.as_recorded.map_or(Self::NotApplied, Self::Analysed)
    }
}

impl fmt::Display for AsRecorded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Analysed(reason) => reason.fmt(f),
            Self::NotApplied => f.write_str("no correction was asked for"),
            Self::Given { has_motion: false } => f.write_str("the motion file does not have them"),
            Self::Given { has_motion: true } => f.write_str("the motion file has no correction of them"),
        }
    }
}
