// SPDX-License-Identifier: MIT OR Apache-2.0

//! A part of a clip, cut out of the streams that a decoder gives out.
//!
//! An encoder and a muxer cannot be flushed, so that the streams are held until it was gone to the part's first frame, and
//! only then linked. What is analysed around the part is dropped behind the rectifier; what is left begins at time 0.

use crate::part::{self, Part};
use anyhow::{Context, Result, anyhow};
use gst::prelude::*;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// A part of a clip that is cut out of its streams.
pub struct Excerpt {
    part: Part,
    /// The decoder's pads, in the order in which they came, and what holds them.
    held: Mutex<Vec<(gst::Pad, gst::PadProbeId)>>,
}

impl Excerpt {
    pub fn new(part: Part) -> Self {
        Self { part, held: Mutex::default() }
    }

    /// The numbers in the clip of the frames that are to come.
    pub fn frames(&self) -> Range<usize> {
        self.part.frames.clone()
    }

    /// Whether the frame that is shown at this time of the clip is one of them.
    pub fn is_wanted(&self, time: gst::ClockTime) -> bool {
        self.part.wanted.contains(time)
    }

    /// Holds what comes to a pad.
    pub fn hold(&self, pad: &gst::Pad) {
        // Not what flushes: that is to clear the way.
        let data =
            gst::PadProbeType::BUFFER | gst::PadProbeType::BUFFER_LIST | gst::PadProbeType::EVENT_DOWNSTREAM;
        let probe = pad.add_probe(gst::PadProbeType::BLOCK | data, |_, _| gst::PadProbeReturn::Ok);
        if let Some(probe) = probe {
            self.held.lock().unwrap_or_else(PoisonError::into_inner).push((pad.clone(), probe));
        }
    }

    /// Goes to the part, has the pads linked and lets their data go.
    pub fn release(&self, link: impl Fn(&gst::Pad) -> Result<()>) -> Result<()> {
        let held = std::mem::take(&mut *self.held.lock().unwrap_or_else(PoisonError::into_inner));
        let (first, _) = held.first().context("there is no stream in the file")?;
        let (flags, to) = (gst::SeekFlags::FLUSH | gst::SeekFlags::ACCURATE, gst::SeekType::Set);
        let seek = gst::event::Seek::new(1.0, flags, to, self.part.seek_start, to, self.part.seek_end);
        if !first.send_event(seek) {
            return Err(anyhow!("{}", part::NO_SEEK));
        }
        // A muxer takes no more streams once it has data of all that it knows.
        for (pad, _) in &held {
            link(pad)?;
        }
        for (pad, probe) in held {
            pad.remove_probe(probe);
        }
        Ok(())
    }

    /// Drops frames that are not to be analysed, as they leave by a source pad: GStreamer 1.22 complains of what is dropped at
    /// a sink pad.
    pub fn keep_analysed(&self, pad: &gst::Pad) {
        let analysed = self.part.analysed;
        keep(pad, move |segment, time| {
            segment.to_stream_time(time).is_some_and(|time| analysed.contains(time))
        });
    }

    /// Drops data outside of the part, as it comes to a pad.
    pub fn keep_wanted(&self, pad: &gst::Pad) {
        let (wanted, start) = (self.part.wanted, self.part.seek_start);
        keep(pad, move |segment, time| {
            segment.to_running_time(time).is_some_and(|time| wanted.contains(time + start))
        });
    }

    /// Has data pass a pad as if the clip began with the first frame of this one.
    pub fn begin_at_zero(&self, pad: &gst::Pad) -> Result<()> {
        let skipped = self.part.first_time.saturating_sub(self.part.seek_start);
        pad.set_offset(-i64::try_from(skipped.nseconds())?);
        Ok(())
    }
}

/// Drops the buffers of whose presentation time in the segment this is not true; those without a time stay.
fn keep(
    pad: &gst::Pad,
    is_kept: impl Fn(&gst::FormattedSegment<gst::ClockTime>, gst::ClockTime) -> bool + Send + Sync + 'static,
) {
    pad.add_probe(gst::PadProbeType::BUFFER, move |pad, info| {
        let segment = pad.sticky_event::<gst::event::Segment>(0);
        let segment = segment.as_ref().and_then(|event| event.segment().downcast_ref::<gst::ClockTime>());
        let time = info.buffer().and_then(|buffer| buffer.pts());
        match segment.zip(time) {
            Some((segment, time)) if !is_kept(segment, time) => gst::PadProbeReturn::Drop,
            _ => gst::PadProbeReturn::Ok,
        }
    });
}
