// SPDX-License-Identifier: MIT OR Apache-2.0

//! A part of a clip: the frames that are asked for, and those around them that tell how the camera moves.

use crate::index::FrameIndex;
use crate::input::Clip;
use crate::interruption::Interruption;
use anyhow::{Result, bail};
use clap::Args;
use std::ops::Range;
use std::path::PathBuf;

/// Which frames of a clip are wanted.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Part of the clip")]
pub struct PartOptions {
    /// Only frames A to B of the clip, counted from 0, B not among them; without A from the first, without B to the last.
    #[arg(long, value_name = "A:B", value_parser = range)]
    pub frames: Option<FrameRange>,
    /// Frames before these that are analysed too, because a motion is estimated from earlier frames, too. `fix` looks ahead of
    /// these, too; what `measure` finds is the same whatever follows.
    #[arg(long, value_name = "FRAMES", default_value_t = HALO, requires = "frames")]
    pub halo: usize,
    /// What `rsrectify index` has written for the clip; without it the clip is read to its end first.
    #[arg(long, value_name = "FILE", requires = "frames")]
    pub index: Option<PathBuf>,
}

/// The error of a file in which it cannot be gone to a frame.
pub const NO_SEEK: &str = "the file does not allow to begin at a frame: rewrite it as MP4 or MKV";

/// Frames from the first one to before the end; `None` for the last frame's end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameRange {
    pub first: usize,
    pub end: Option<usize>,
}

/// Frames after which a path hardly depends on what was before them: docs/batch.md has the measurements.
const HALO: usize = 60;

/// Refuses a part of other than its number of frames.
pub fn check_count(came: usize, expected: usize) -> Result<()> {
    if came != expected {
        bail!(
            "{came} frames came where there should be {expected}: the clip is damaged, or its index of another one"
        );
    }
    Ok(())
}

fn range(text: &str) -> Result<FrameRange, String> {
    let (first, end) = text.split_once(':').ok_or("not of the form A:B")?;
    let number = |text: &str| match text {
        "" => Ok(None),
        text => text.parse().map(Some).map_err(|_| format!("{text} is no frame number")),
    };
    let (first, end) = (number(first)?.unwrap_or(0), number(end)?);
    if end.is_some_and(|end| end <= first) {
        return Err("there is no frame between them".to_owned());
    }
    Ok(FrameRange { first, end })
}

/// Times between which frames are shown; without an end, up to the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    start: gst::ClockTime,
    end: Option<gst::ClockTime>,
}

impl Span {
    /// The times of frames of an indexed clip: from midway after the frame before them, as what decoders state may differ by
    /// a nanosecond, to midway before the frame after them.
    fn of(index: &FrameIndex, frames: &Range<usize>) -> Self {
        let start = time_before(index, frames.start, 2).unwrap_or_default();
        Self { start, end: time_before(index, frames.end, 2) }
    }

    /// Whether what is shown from this time on is in it.
    pub fn contains(&self, time: gst::ClockTime) -> bool {
        time >= self.start && self.end.is_none_or(|end| time < end)
    }
}

/// A part of a clip.
#[derive(Clone, Debug)]
pub struct Part {
    /// The frames that are asked for.
    pub frames: Range<usize>,
    /// Their times.
    pub wanted: Span,
    /// Those of the frames that are analysed.
    pub analysed: Span,
    /// Where to begin with decoding: at the clip's first frame, or after the frame before the first that is analysed.
    pub seek_start: gst::ClockTime,
    /// The time of the first frame that is no longer analysed.
    pub seek_end: Option<gst::ClockTime>,
    /// When the first frame that is asked for is shown.
    pub first_time: gst::ClockTime,
}

impl PartOptions {
    /// The part of a clip that is meant, of which so many frames are looked ahead; `None` for all of it.
    pub fn of(&self, clip: &Clip, lookahead: usize, interruption: &Interruption) -> Result<Option<Part>> {
        let Some(frames) = self.frames else { return Ok(None) };
        let file = clip.only_file("--frames")?;
        let index = FrameIndex::given_or_of(self.index.as_deref(), file, interruption)?;
        Part::new(&index, frames, [self.halo, lookahead]).map(Some)
    }
}

impl Part {
    /// Frames of an indexed clip and so many before and after them.
    pub fn new(index: &FrameIndex, range: FrameRange, [before, after]: [usize; 2]) -> Result<Self> {
        let frames = range.first..range.end.unwrap_or(index.frames);
        let Some(first_time) = index.time(frames.start).filter(|_| frames.end <= index.frames) else {
            bail!("there are no frames {} to {}: the clip has {}", frames.start, frames.end, index.frames);
        };
        let end = frames.end.saturating_add(after).min(index.frames);
        let analysed = frames.start.saturating_sub(before)..end;
        Ok(Self {
            wanted: Span::of(index, &frames),
            analysed: Span::of(index, &analysed),
            seek_start: match analysed.start {
                // Some demuxers count from elsewhere before the first frame.
                0 => index.time(0).unwrap_or_default(),
                start => time_before(index, start, 4).unwrap_or_default(),
            },
            seek_end: index.time(analysed.end),
            first_time,
            frames,
        })
    }
}

/// A time after the last frame before `frame`, by this fraction of the interval between them; 0 for the first frame, `None`
/// beyond the last.
fn time_before(index: &FrameIndex, frame: usize, fraction: u64) -> Option<gst::ClockTime> {
    let Some(last) = frame.checked_sub(1) else { return Some(gst::ClockTime::ZERO) };
    let last = index.time(last)?;
    Some(last + (index.time(frame)? - last) / fraction)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn index() -> FrameIndex {
        let times_ns = [0, 40, 80, 200, 240, 280].to_vec();
        FrameIndex {
            clip: "a".to_owned(),
            bytes: 0,
            frames: times_ns.len(),
            times_ns,
            start_ns: 0,
            sha256: String::new(),
        }
    }

    #[test]
    fn frames_are_told_by_times_midway_between_them() {
        let part = Part::new(&index(), FrameRange { first: 2, end: Some(4) }, [1, 1]).unwrap();
        let contained = |span: Span| {
            index()
                .times_ns
                .into_iter()
                .filter(|time| span.contains(gst::ClockTime::from_nseconds(*time)))
                .collect()
        };
        let (wanted, analysed): (Vec<u64>, Vec<u64>) = (contained(part.wanted), contained(part.analysed));
        assert_eq!((wanted, analysed), (vec![80, 200], vec![40, 80, 200, 240]));
        // Frame 0, decoded too if it is shown until 40, begins at 10 then, which is not analysed.
        assert_eq!(part.seek_start.nseconds(), 10);
        assert!(!part.analysed.contains(part.seek_start));
        assert_eq!(part.seek_end.map(gst::ClockTime::nseconds), Some(280));
        assert_eq!(part.first_time.nseconds(), 80);
    }

    #[test]
    fn a_halo_ends_where_the_clip_does() {
        let whole = Part::new(&index(), FrameRange { first: 0, end: None }, [9, 9]).unwrap();
        assert_eq!((whole.frames.clone(), whole.seek_end), (0..6, None));
        assert_eq!((whole.wanted, whole.seek_start.nseconds()), (whole.analysed, 0));
        let last = Part::new(&index(), FrameRange { first: 5, end: Some(6) }, [0, 0]).unwrap();
        assert!(last.wanted.contains(gst::ClockTime::from_nseconds(280)) && last.seek_end.is_none());
        assert!(Part::new(&index(), FrameRange { first: 5, end: Some(7) }, [0, 0]).is_err());
        assert!(Part::new(&index(), FrameRange { first: 6, end: None }, [0, 0]).is_err());
    }

    #[test]
    fn ranges_are_read() {
        assert_eq!(range("3:7"), Ok(FrameRange { first: 3, end: Some(7) }));
        assert_eq!(
            (range(":"), range("4:")),
            (Ok(FrameRange { first: 0, end: None }), Ok(FrameRange { first: 4, end: None }),)
        );
        for wrong in ["3", "7:3", "3:3", "a:b", "-1:3", ""] {
            assert!(range(wrong).is_err(), "{wrong}");
        }
    }
}
