// SPDX-License-Identifier: MIT OR Apache-2.0

//! Motions of a clip's frames, in order → a motion file.

use super::clip::Clip;
use super::error::MotionFileError;
use super::hash::hash;
use super::header::{HEADER_BYTES, Header};
use super::record::MotionRecord;
use std::io::{Seek, SeekFrom, Write};

/// Writes a motion file, frame by frame; only the index is kept in memory.
///
/// Until [`finish`](Self::finish) has been called the file cannot be read.
#[derive(Debug)]
pub struct MotionWriter<W> {
    output: W,
    clip: Clip,
    /// Time and offset of each record.
    index: Vec<(i64, u64)>,
    /// Bytes written so far.
    length: u64,
}

impl<W: Write + Seek> MotionWriter<W> {
    /// Begins a file at the beginning of `output`.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn new(mut output: W, clip: Clip) -> Result<Self, MotionFileError> {
        output.write_all(&[b'\n'; HEADER_BYTES])?;
        Ok(Self { output, clip, index: Vec::new(), length: HEADER_BYTES as u64 })
    }

    /// Adds the next frame.
    ///
    /// # Errors
    /// If its time is not after that of the frame before, its motion cannot be stored, or the file cannot be written.
    pub fn push(&mut self, record: &MotionRecord) -> Result<(), MotionFileError> {
        let time = record.time;
        if let Some((before, _)) = self.index.last().filter(|(before, _)| *before >= time) {
            return Err(MotionFileError::Order { before: *before, time });
        }
        let bytes = record.encode().map_err(|reason| MotionFileError::Unstorable { time, reason })?;
        self.output.write_all(&bytes)?;
        self.index.push((time, self.length));
        self.length += bytes.len() as u64;
        Ok(())
    }

    /// The clip that the file is of, which may be changed until the end.
    pub fn clip_mut(&mut self) -> &mut Clip {
        &mut self.clip
    }

    /// Number of frames so far.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.index.len()
    }

    /// Writes the index and the header; the output, flushed.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn finish(mut self) -> Result<W, MotionFileError> {
        for (time, offset) in &self.index {
            self.output.write_all(&time.to_le_bytes())?;
            self.output.write_all(&offset.to_le_bytes())?;
        }
        let times = hash(self.index.iter().map(|(time, _)| *time));
        let header = Header { clip: self.clip, frames: self.index.len() as u64, times, index: self.length };
        self.output.seek(SeekFrom::Start(0))?;
        self.output.write_all(header.text().as_bytes())?;
        self.output.seek(SeekFrom::End(0))?;
        self.output.flush()?;
        Ok(self.output)
    }
}
