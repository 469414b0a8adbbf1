// SPDX-License-Identifier: MIT OR Apache-2.0

//! Encoded frames, kept in a file of their own until all that lies beside them is known.

use super::video::Sample;
use crate::colour::Colour;
use crate::streams::timecode::Timecode;
use anyhow::{Context, Result};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// The frames of a stream in decoding order, their bytes one after another in a file, which is removed at the end.
pub struct EncodedVideo {
    path: PathBuf,
    file: BufWriter<File>,
    samples: Vec<Sample>,
    caps: Option<gst::Caps>,
    colour: Colour,
    timecode: Option<Timecode>,
}

impl EncodedVideo {
    /// Without frames; what their pictures will stand for.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn create(path: PathBuf, colour: Colour) -> Result<Self> {
        let file = File::create(&path).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(Self { path, file: BufWriter::new(file), samples: Vec::new(), caps: None, colour, timecode: None })
    }

    /// Takes the next frame: its bytes as a muxer wants them, and when it is shown, in nanoseconds of the film.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn push(&mut self, buffer: &gst::BufferRef, time: i64) -> Result<()> {
        let bytes = buffer.map_readable()?;
        self.file.write_all(&bytes).with_context(|| format!("cannot write {}", self.path.display()))?;
        self.samples.push(Sample {
            time,
            duration: buffer.duration().map(|duration| duration.nseconds()),
            is_key: !buffer.flags().contains(gst::BufferFlags::DELTA_UNIT),
            size: u32::try_from(bytes.len())?,
        });
        Ok(())
    }

    /// What the encoder states of the stream; the last statement counts, as encoders may complete it with the first frame.
    pub fn set_caps(&mut self, caps: &gst::CapsRef) {
        if self.caps.as_ref().is_none_or(|known| known.as_ref() != caps) {
            self.caps = Some(caps.to_owned());
        }
    }

    /// All frames are there.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn finish(&mut self) -> Result<()> {
        self.file.flush().with_context(|| format!("cannot write {}", self.path.display()))
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn colour(&self) -> Colour {
        self.colour
    }

    /// Notes the timecode of the first frame, as the stream has it.
    pub fn set_timecode(&mut self, timecode: Option<Timecode>) {
        self.timecode = timecode;
    }

    pub fn timecode(&self) -> Option<Timecode> {
        self.timecode
    }

    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    pub fn caps(&self) -> Option<&gst::Caps> {
        self.caps.as_ref()
    }
}

impl Drop for EncodedVideo {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}
