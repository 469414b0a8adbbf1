// SPDX-License-Identifier: MIT OR Apache-2.0

//! A motion file → the motion of any frame, by its time.

use super::clip::Clip;
use super::error::{MotionFileError, RecordError};
use super::hash::hash;
use super::header::{HEADER_BYTES, Header};
use super::record::{FIXED_BYTES, MotionRecord};
use super::source::Source;
use crate::motion::FrameMotion;
use std::fs::File;
use std::path::Path;
use std::sync::Mutex;

/// Bytes of an entry of the index.
const ENTRY_BYTES: u64 = 16;
/// Tolerance of a frame's time as a share of the interval between frames: a frame is meant from a quarter of it before its time
/// on. Programs round times to their clock, mostly to a millisecond; a clip shown at twice its frame rate still shows each frame twice.
const TOLERANCE: i64 = 4;
/// Interval between frames, in nanoseconds, that is assumed of a file with one frame: that of 25 frames a second.
const LONE_INTERVAL: i64 = 40_000_000;
/// Ratio by which the shape of a proxy may differ: their sides are rounded to even numbers or to blocks of 16, and 1080 rows may
/// be coded as 1088.
const SHAPE_TOLERANCE: f64 = 1.02;
/// Bytes that are read of a record before its length is known: most are shorter.
const USUAL_RECORD: u64 = 4096;

/// A motion file that can be read at any frame, from any thread.
#[derive(Debug)]
pub struct MotionFile {
    source: Source,
    header: Header,
    /// Time and offset of each record, by rising time.
    index: Vec<(i64, u64)>,
    /// Median interval between frames in nanoseconds.
    interval: i64,
}

impl MotionFile {
    /// Opens a file. Its index is read and checked; records are read when they are asked for.
    ///
    /// # Errors
    /// If the file cannot be read, is no motion file or is damaged.
    pub fn open(path: &Path) -> Result<Self, MotionFileError> {
        let file = File::open(path)?;
        let length = file.metadata()?.len();
        Self::new(Source::File(Mutex::new(file), length))
    }

    /// Opens a file whose bytes are in memory: read, or mapped by the caller.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn from_bytes(bytes: impl AsRef<[u8]> + Send + Sync + 'static) -> Result<Self, MotionFileError> {
        Self::new(Source::Bytes(Box::new(bytes)))
    }

    fn new(source: Source) -> Result<Self, MotionFileError> {
        let header = Header::parse(&source.read(0, HEADER_BYTES as u64)?)?;
        let Header { frames, index: offset, .. } = header;
        let cut_short = MotionFileError::CutShort { frames, offset };
        let length = frames.checked_mul(ENTRY_BYTES);
        let is_inside = |length: &u64| offset.checked_add(*length).is_some_and(|end| end <= source.length());
        let Some(length) = length.filter(is_inside) else { return Err(cut_short) };
        let bytes = source.read(offset, length)?;
        let (entries, rest) = bytes.as_chunks::<8>();
        let (pairs, odd) = entries.as_chunks::<2>();
        if pairs.len() as u64 != frames || !odd.is_empty() || !rest.is_empty() {
            return Err(cut_short);
        }
        let entry = |[time, offset]: &[[u8; 8]; 2]| (i64::from_le_bytes(*time), u64::from_le_bytes(*offset));
        let index: Vec<_> = pairs.iter().map(entry).collect();
        let is_rising = index.windows(2).all(|pair| pair[0].0 < pair[1].0);
        if !is_rising || hash(index.iter().map(|(time, _)| *time)) != header.times {
            return Err(MotionFileError::Times);
        }
        let mut intervals: Vec<i64> =
            index.windows(2).map(|pair| pair[1].0.saturating_sub(pair[0].0)).collect();
        intervals.sort_unstable();
        let interval = intervals.get(intervals.len() / 2).copied().unwrap_or(LONE_INTERVAL);
        drop(bytes);
        Ok(Self { source, header, index, interval })
    }

    /// The clip that the file was written of.
    #[must_use]
    pub fn clip(&self) -> &Clip {
        &self.header.clip
    }

    /// Number of frames.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.index.len()
    }

    /// When a frame is shown, in nanoseconds of the clip.
    #[must_use]
    pub fn time(&self, frame: usize) -> Option<i64> {
        self.index.get(frame).map(|(time, _)| *time)
    }

    /// Median interval between frames in nanoseconds.
    #[must_use]
    pub fn interval(&self) -> i64 {
        self.interval
    }

    /// The frame that is shown at a time, in nanoseconds of the clip: the last one that begins at most a quarter of
    /// the interval between frames after it. `None` before the first frame, and more than an interval after the last.
    #[must_use]
    pub fn at(&self, time: i64) -> Option<usize> {
        let next = self.index.partition_point(|(begin, _)| *begin <= time);
        if let Some(begin) = self.time(next) {
            // A frame may be shown for longer than usual: what is early is so by usual intervals.
            let before = next.checked_sub(1).and_then(|last| self.time(last));
            let interval = before.map_or(self.interval, |last| begin.saturating_sub(last).min(self.interval));
            if begin.saturating_sub(time) <= interval / TOLERANCE {
                return Some(next);
            }
            return next.checked_sub(1);
        }
        let last = next.checked_sub(1)?;
        let age = time.saturating_sub(self.time(last)?);
        (age < self.interval - self.interval / TOLERANCE).then_some(last)
    }

    /// The motion of the frame that is shown at a time (see [`at`](Self::at)), scaled to `width` × `height` pixels, which may
    /// be square where those of the clip are not; `None` where there is none.
    ///
    /// # Errors
    /// If its record cannot be read or is damaged, or is of frames of another shape.
    pub fn motion(&self, time: i64, size: [usize; 2]) -> Result<Option<FrameMotion>, MotionFileError> {
        let Some(frame) = self.at(time) else { return Ok(None) };
        fitted(&self.record(frame)?.motion, size, self.clip().pixel_ratio()).map(Some)
    }

    /// The same of a frame that a program has turned upright, as [`Clip::turned`] states it; a frame of another shape than turned ones
    /// counts as not turned.
    ///
    /// # Errors
    /// As [`motion`](Self::motion), and if the clip is [mirrored](Clip::mirrored).
    pub fn upright_motion(
        &self,
        time: i64,
        size: [usize; 2],
    ) -> Result<Option<FrameMotion>, MotionFileError> {
        let clip = self.clip();
        if clip.mirrored {
            return Err(MotionFileError::Mirrored);
        }
        let Some(frame) = self.at(time) else { return Ok(None) };
        let motion = self.record(frame)?.motion;
        let quarters = clip.turned / 90;
        let turned = (0..quarters).fold(motion.clone(), |motion, _| motion.turned());
        let ratio = clip.pixel_ratio();
        let upright_ratio = if quarters.is_multiple_of(2) { ratio } else { 1.0 / ratio };
        fitted(&turned, size, upright_ratio).or_else(|_| fitted(&motion, size, ratio)).map(Some)
    }

    /// The record of a frame.
    ///
    /// # Errors
    /// If there is no such frame, or its record cannot be read or is damaged.
    pub fn record(&self, frame: usize) -> Result<MotionRecord, MotionFileError> {
        let (time, offset) = *self.index.get(frame).ok_or(MotionFileError::NoFrame(frame))?;
        let at_frame = |reason| MotionFileError::Record { frame, reason };
        let mut bytes = self.source.read(offset, USUAL_RECORD)?;
        let length = bytes.first_chunk::<4>().map(|length| u32::from_le_bytes(*length));
        let length = length.ok_or(at_frame(RecordError::CutShort))?;
        if u64::from(length) > USUAL_RECORD {
            bytes = self.source.read(offset, length.into())?;
        }
        if (length as usize) < FIXED_BYTES {
            return Err(at_frame(RecordError::CutShort));
        }
        MotionRecord::decode(time, &bytes).map_err(at_frame)
    }
}

/// The motion scaled to frames of another size, with pixels as in the clip or square ones in place of those that have this
/// ratio of width to height.
fn fitted(
    motion: &FrameMotion,
    [width, height]: [usize; 2],
    pixel_ratio: f64,
) -> Result<FrameMotion, MotionFileError> {
    let file = motion.area().frame();
    let ratio = (width * file[1]) as f64 / (height * file[0]) as f64;
    // Not of frames without pixels: 0 or NaN.
    let is_like = |expected: f64| (1.0 / SHAPE_TOLERANCE..SHAPE_TOLERANCE).contains(&(ratio / expected));
    (is_like(1.0) || is_like(pixel_ratio))
        .then(|| motion.scaled_to(width, height))
        .ok_or(MotionFileError::Shape { frame: [width, height], file })
}
