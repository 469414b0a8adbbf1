// SPDX-License-Identifier: MIT OR Apache-2.0

//! What went into the element and what came out: each item has a number, counted up by the streaming
//! thread, so that any loss, double or change of order shows at once.

use gst::prelude::*;
use gst_video::{VideoFrameExt, VideoFrameRef, VideoInfo, VideoMeta};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What a frame says of itself, and what it travels under.
#[derive(Clone, Debug)]
pub struct FrameFacts {
    /// Timestamps.
    pub pts: Option<gst::ClockTime>,
    /// Decoding timestamp.
    pub dts: Option<gst::ClockTime>,
    /// Duration.
    pub duration: Option<gst::ClockTime>,
    /// Any number: the element has no business with it.
    pub offset_end: u64,
    /// Flags of the buffer.
    pub flags: gst::BufferFlags,
    /// Caps in force.
    pub caps: gst::Caps,
    /// Segment in force.
    pub segment: gst::Seqnum,
    /// Stream in force.
    pub stream: String,
    /// The value of every byte of the picture, if it has one colour and the settings leave it so.
    pub shade: Option<u8>,
    /// Whether a downstream without `GstVideoMeta` must find the default layout.
    pub default_layout: bool,
    /// Whether it has no memory.
    pub empty: bool,
}

#[derive(Debug)]
enum Content {
    Frame(FrameFacts),
    Event(gst::Seqnum),
}

#[derive(Debug)]
struct Item {
    content: Content,
    arrived: bool,
    /// Whether it may be missing: it was refused, or downstream failed.
    excused: bool,
}

#[derive(Debug, Default)]
struct Books {
    items: Vec<Item>,
    /// First item of the stretch since the last flush or stop.
    start: usize,
    /// Number of the last item that came out.
    last: Option<usize>,
    frames_out: u64,
    tally: Tally,
    faults: Vec<String>,
}

/// Counts of one sequence.
#[derive(Clone, Copy, Debug, Default, serde::Serialize, serde::Deserialize)]
pub struct Tally {
    /// Frames pushed.
    pub frames: u64,
    /// Frames that did not come out though nothing excuses it.
    pub lost: u64,
    /// Frames that came out twice.
    pub doubled: u64,
    /// Frames that came out changed, out of order, or after the flush that should have dropped them.
    pub changed: u64,
}

/// The books of one sequence.
#[derive(Debug, Default)]
pub struct Ledger(Mutex<Books>);

impl Ledger {
    fn books(&self) -> MutexGuard<'_, Books> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The number of the next frame, entered into the books by [`Self::frame_sent`].
    pub fn next_number(&self) -> usize {
        self.books().items.len()
    }

    /// Enters a frame that is about to be pushed.
    pub fn frame_sent(&self, facts: FrameFacts) -> usize {
        let mut books = self.books();
        books.tally.frames += 1;
        books.items.push(Item { content: Content::Frame(facts), arrived: false, excused: false });
        books.items.len() - 1
    }

    /// Enters a serialised event that is about to be pushed.
    pub fn event_sent(&self, event: &gst::Event) -> usize {
        let mut books = self.books();
        let number = books.items.len();
        books.items.push(Item { content: Content::Event(event.seqnum()), arrived: false, excused: false });
        number
    }

    /// An item that need not come out.
    pub fn excuse(&self, number: usize) {
        if let Some(item) = self.books().items.get_mut(number) {
            item.excused = true;
        }
    }

    /// Downstream has failed: what waits is lost by right.
    pub fn excuse_waiting(&self) {
        let mut books = self.books();
        let start = books.start;
        books.items[start..].iter_mut().for_each(|item| item.excused = true);
    }

    /// Notes something that must not be.
    pub fn fault(&self, what: impl Into<String>) {
        self.books().faults.push(what.into());
    }

    /// A frame has come out at `pad`.
    pub fn frame_arrived(&self, pad: &gst::Pad, buffer: &gst::BufferRef, takes_meta: bool) {
        let number = buffer.offset() as usize;
        let mut books = self.books();
        books.frames_out += 1;
        let Some(Content::Frame(facts)) = books.items.get(number).map(|item| &item.content) else {
            books.faults.push(format!("a frame came out that never went in: {buffer:?}"));
            return;
        };
        let facts = facts.clone();
        books.arrived(number, "frame");
        for what in differences(&facts, pad, buffer, takes_meta) {
            books.tally.changed += 1;
            books.faults.push(format!("frame {number}: {what}"));
        }
    }

    /// A serialised event has come out.
    pub fn event_arrived(&self, event: &gst::Event) {
        let mut books = self.books();
        let is_it = |item: &Item| matches!(item.content, Content::Event(seqnum) if seqnum == event.seqnum());
        let Some(number) = books.items.iter().rposition(is_it) else { return };
        // A sticky event that a flush or a failure has overtaken is still true afterwards, and told then.
        let overtaken = number < books.start || books.items[number].excused;
        if !(event.is_sticky() && overtaken) {
            books.arrived(number, event.type_().name().as_str());
        }
    }

    /// All that went in must have come out.
    pub fn all_is_out(&self, after: &str) {
        let mut books = self.books();
        let end = books.items.len();
        books.settle(end, after);
    }

    /// A flush or a stop: what has not come out may be missing, but nothing before what has.
    pub fn end_stretch(&self, by: &str) {
        let mut books = self.books();
        let end = books.last.map_or(0, |last| last + 1);
        books.settle(end, by);
        books.start = books.items.len();
    }

    /// The counts and the faults.
    pub fn close(&self) -> (Tally, Vec<String>) {
        let mut books = self.books();
        (books.tally, std::mem::take(&mut books.faults))
    }
}

impl Books {
    fn arrived(&mut self, number: usize, what: &str) {
        let doubled = std::mem::replace(&mut self.items[number].arrived, true);
        if doubled {
            self.tally.doubled += 1;
            self.faults.push(format!("{what} {number} came out twice"));
        } else if number < self.start {
            self.tally.changed += 1;
            self.faults.push(format!("{what} {number} came out after the flush or stop that drops it"));
        } else if self.last.is_some_and(|last| number < last) {
            self.tally.changed += 1;
            self.faults.push(format!("{what} {number} came out after {}", self.last.unwrap_or(0)));
        }
        self.last = self.last.max(Some(number));
    }

    /// Counts what is missing before item `end`.
    fn settle(&mut self, end: usize, at: &str) {
        for number in self.start..end.max(self.start) {
            let item = &mut self.items[number];
            if !item.arrived && !item.excused {
                // Each is counted once.
                item.excused = true;
                let is_frame = matches!(item.content, Content::Frame(_));
                let what = match &item.content {
                    Content::Frame(facts) if facts.empty => "empty frame",
                    Content::Frame(_) => "frame",
                    Content::Event(_) => "event",
                };
                self.tally.lost += u64::from(is_frame);
                self.faults.push(format!("{what} {number} is missing at {at}"));
            }
        }
    }
}

/// In what a frame that has come out at `pad` differs from the one that went in.
fn differences(facts: &FrameFacts, pad: &gst::Pad, buffer: &gst::BufferRef, takes_meta: bool) -> Vec<String> {
    let mut found = Vec::new();
    let mut check = |name: &str, same: bool, now: &dyn std::fmt::Debug, then: &dyn std::fmt::Debug| {
        if !same {
            found.push(format!("{name} is {now:?}, was {then:?}"));
        }
    };
    check("pts", buffer.pts() == facts.pts, &buffer.pts(), &facts.pts);
    check("dts", buffer.dts() == facts.dts, &buffer.dts(), &facts.dts);
    check("duration", buffer.duration() == facts.duration, &buffer.duration(), &facts.duration);
    check("offset end", buffer.offset_end() == facts.offset_end, &buffer.offset_end(), &facts.offset_end);
    let flags = |flags: gst::BufferFlags| flags - gst::BufferFlags::TAG_MEMORY;
    check("flags", flags(buffer.flags()) == flags(facts.flags), &buffer.flags(), &facts.flags);
    let caps = pad.current_caps();
    check("caps", caps.as_ref() == Some(&facts.caps), &caps, &facts.caps);
    let segment = pad.sticky_event::<gst::event::Segment>(0).map(|event| event.seqnum());
    check("segment", segment == Some(facts.segment), &segment, &facts.segment);
    let stream = pad.stream_id();
    check("stream", stream.as_deref() == Some(&facts.stream), &stream, &facts.stream);
    let Ok(info) = VideoInfo::from_caps(&facts.caps) else { return found };
    if facts.default_layout && !takes_meta {
        let laid_out = buffer.meta::<VideoMeta>().is_none_or(|meta| {
            meta.offset() == &info.offset()[..meta.n_planes() as usize]
                && meta.stride() == &info.stride()[..meta.n_planes() as usize]
        });
        check("layout of the planes", laid_out, &buffer.meta::<VideoMeta>(), &"the default of the caps");
        check("size", buffer.size() == info.size(), &buffer.size(), &info.size());
    }
    if let Some(shade) = facts.shade {
        let seen = samples(buffer, &info);
        check("picture", seen.iter().all(|&seen| seen == shade), &seen, &shade);
    }
    found
}

/// The first byte of some samples: the corners and the middle of the first and last component.
fn samples(buffer: &gst::BufferRef, info: &VideoInfo) -> Vec<u8> {
    let Ok(frame) = VideoFrameRef::from_buffer_ref_readable(buffer, info) else { return Vec::new() };
    let mut seen = Vec::new();
    for component in [0, info.n_components() - 1] {
        let plane = info.comp_plane(component as u8);
        let (width, height) =
            (info.comp_width(component as u8) as usize, info.comp_height(component as u8) as usize);
        let stride = frame.plane_stride()[plane as usize] as usize;
        let (offset, step) =
            (info.comp_poffset(component as u8) as usize, info.comp_pstride(component as u8) as usize);
        for (x, y) in [(0, 0), (width / 2, height / 2), (width - 1, height - 1)] {
            let data = frame.plane_data(plane).ok();
            seen.extend(data.and_then(|data| data.get(y * stride + offset + x * step)));
        }
    }
    seen
}
