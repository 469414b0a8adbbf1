// SPDX-License-Identifier: MIT OR Apache-2.0

//! Where the streams of a clip go, and where the video of the file comes from.

use super::excerpt::Excerpt;
use super::routes::Audio;
use crate::output::container::Container;
use std::path::Path;
use std::sync::Arc;

/// Where the streams of a clip go.
pub struct Destination<'a> {
    /// The file; `None` for the standard output.
    pub output: Option<&'a Path>,
    pub container: Container,
    /// What becomes of the audio.
    pub audio: Audio,
    /// The part of the clip that is wanted, where that is not all of it.
    pub excerpt: Option<Arc<Excerpt>>,
}

/// Where the video of the file comes from.
pub enum Video {
    /// A branch that takes the clip's decoded frames.
    Decoded(gst::Bin),
    /// A branch with frames of its own; the clip's are dropped.
    Replaced(gst::Bin),
    /// Not from the pipeline; the clip's frames are dropped.
    Elsewhere,
}
