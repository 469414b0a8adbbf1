// SPDX-License-Identifier: MIT OR Apache-2.0

//! Why a motion file cannot be read or written.

use crate::motion::{MeshError, PathError};
use crate::readout::ReadoutError;
use std::io;
use thiserror::Error;

/// Why a motion file cannot be read or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum MotionFileError {
    /// The file cannot be read or written.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The first line is not that of a motion file.
    #[error("not a motion file, or one that was not finished")]
    NotMotion,
    /// A major version that this reader does not know.
    #[error("a motion file of version {major}.{minor}: only versions 1.x can be read, write it anew")]
    Version {
        /// Major version of the file.
        major: u32,
        /// Minor version of the file.
        minor: u32,
    },
    /// A line of the header that is missing or invalid.
    #[error("the header of the motion file does not state {0}")]
    Header(&'static str),
    /// An index that lies outside of the file.
    #[error("the motion file is cut short: its index of {frames} frames should begin at byte {offset}")]
    CutShort {
        /// Frames by the header.
        frames: u64,
        /// Offset of the index by the header.
        offset: u64,
    },
    /// Times of frames that are not those that were written.
    #[error("the motion file is damaged: the times in its index are not those that were written")]
    Times,
    /// A frame that is not in the file.
    #[error("there is no frame {0} in the motion file")]
    NoFrame(usize),
    /// A record that is damaged.
    #[error("the motion file is damaged at frame {frame}: {reason}")]
    Record {
        /// Number of the frame.
        frame: usize,
        /// What is wrong.
        reason: RecordError,
    },
    /// A frame of another shape than those of the clip.
    #[error("frames of {} x {} pixels have another shape than those of the motion file, {} x {}", frame[0], frame[1], file[0], file[1])]
    Shape {
        /// Width and height of the frame that is to be rectified.
        frame: [usize; 2],
        /// Width and height in the file.
        file: [usize; 2],
    },
    /// A clip that players mirror: programs differ in whether they do so before filters.
    #[error(
        "players mirror the clip, programs at different places: apply the motion file by `rsrectify fix` first"
    )]
    Mirrored,
    /// A frame whose time is not after that of the frame before.
    #[error("the frame at {time} ns does not follow the one at {before} ns")]
    Order {
        /// Time of the frame before.
        before: i64,
        /// Time of the frame.
        time: i64,
    },
    /// A motion that cannot be stored.
    #[error("the motion of the frame at {time} ns cannot be stored: {reason}")]
    Unstorable {
        /// Time of the frame.
        time: i64,
        /// What is wrong.
        reason: RecordError,
    },
}

/// What is wrong with the record of a frame.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum RecordError {
    /// It lies outside of the file, or is shorter than it must be.
    #[error("its record is cut short")]
    CutShort,
    /// A kind of path or a readout direction that does not exist in this version.
    #[error("{0} is no readout direction or kind of path")]
    Kind(u8),
    /// A frame, a path or a mesh that is too large.
    #[error("its frame, path or mesh is too large")]
    TooLarge,
    /// Bytes that are not those that were written.
    #[error("its bytes are not those that were written")]
    Checksum,
    /// An element of a homography, or a velocity, that is too large to be stored.
    #[error("a number of its motion is too large")]
    Range,
    /// A picture that is not within its frame.
    #[error("its picture is not within its frame")]
    Area,
    /// A number that is not finite.
    #[error("a number of its motion is not finite")]
    NotFinite,
    /// An invalid readout.
    #[error(transparent)]
    Readout(#[from] ReadoutError),
    /// An invalid path.
    #[error(transparent)]
    Path(#[from] PathError),
    /// An invalid mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}
