// SPDX-License-Identifier: MIT OR Apache-2.0

//! QuickTime and MP4 files (ISO/IEC 14496-12) as they are written: the video is new, everything else is copied.
//!
//! GStreamer's muxers know the streams that they know. What cameras write beside the video (telemetry, timed metadata,
//! chapters, timecode, who recorded it where and when) is copied box by box instead, and times are stated as they are.

mod assembly;
mod encoded;
mod film;
mod headers;
mod tables;
mod video;

pub use assembly::Assembly;
pub use encoded::EncodedVideo;
pub use film::{Film, Track};
