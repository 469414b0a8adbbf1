// SPDX-License-Identifier: MIT OR Apache-2.0

//! Times of frames in files that state only when packets are decoded, such as AVI.
//!
//! GStreamer gives frames the times of packets in rising order. Where frames are reordered, the first packets come as much earlier as
//! the decoder has to wait for later ones, and what is left out there, to wait, would be a gap between the first frames. So a frame is
//! shown when the packet is decoded that lies as many packets further on as the decoder waits.

use crate::elements::is_of_class;
use gst::prelude::*;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Frames by which the delay is measured: more than any group of reordered ones has.
const MEASURED: usize = 32;
/// How a packet's number goes with it through the decoder.
const NUMBER: &str = "timestamp/x-rsrectify-packet";

/// What has come to a decoder.
#[derive(Default)]
struct Packets {
    /// When each is decoded, rising.
    decoded: Vec<gst::ClockTime>,
    /// Whether some state only that, and whether some state another time as that at which they are shown.
    lack_times: bool,
    have_times: bool,
}

impl Packets {
    fn is_open(&self) -> bool {
        self.lack_times && !self.have_times
    }

    fn add(&mut self, pts: Option<gst::ClockTime>, dts: Option<gst::ClockTime>) {
        self.lack_times |= pts.is_none() && dts.is_some();
        self.have_times |= pts.is_some() && dts.is_some() && pts != dts;
        let is_later = |time: &gst::ClockTime| self.decoded.last().is_none_or(|last| time > last);
        if let Some(time) = dts.filter(is_later) {
            self.decoded.push(time);
        }
    }

    /// The time of the packet that lies `delay` further on than the one at `time`; past the last one they go on as before it.
    fn later(&self, time: gst::ClockTime, delay: usize) -> Option<gst::ClockTime> {
        let place = self.decoded.binary_search(&time).ok()? + delay;
        if let Some(time) = self.decoded.get(place) {
            return Some(*time);
        }
        let [.., before, last] = self.decoded.as_slice() else { return None };
        let past = u64::try_from(place + 1 - self.decoded.len()).ok()?;
        last.checked_add((*last - *before).checked_mul(past)?)
    }
}

type Decoders = Arc<Mutex<HashMap<gst::glib::GString, Packets>>>;

/// Watches the decoders of a pipeline.
#[derive(Clone, Default)]
pub struct Watch(Decoders);

impl Watch {
    /// Those of a pipeline that has not been started.
    pub fn of(pipeline: &gst::Pipeline) -> Self {
        let watch = Self::default();
        let this = watch.clone();
        on_decoders(pipeline, move |decoder, input, _| {
            let (this, name) = (this.clone(), decoder.name());
            input.add_probe(gst::PadProbeType::BUFFER, move |_, info| {
                let mut decoders = this.0.lock().unwrap_or_else(PoisonError::into_inner);
                let packets = decoders.entry(name.clone()).or_default();
                if let Some(buffer) = info.buffer_mut() {
                    let number = packets.decoded.len() as u64;
                    packets.add(buffer.pts(), buffer.dts());
                    let (buffer, caps) = (buffer.make_mut(), gst::Caps::new_empty_simple(NUMBER));
                    let number = gst::ClockTime::from_nseconds(number);
                    gst::ReferenceTimestampMeta::add(buffer, &caps, number, gst::ClockTime::NONE);
                }
                gst::PadProbeReturn::Ok
            });
        });
        watch
    }

    /// Whether the times of the frames that come to a decoder's pad, from outside, are to be mended.
    fn is_open(&self, pad: &gst::Pad) -> bool {
        let inner = pad.downcast_ref::<gst::GhostPad>().and_then(|pad| pad.target());
        let decoder = inner.and_then(|pad| pad.parent_element()).map(|decoder| decoder.name());
        let decoders = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        decoder.and_then(|decoder| decoders.get(&decoder)).is_some_and(Packets::is_open)
    }
}

/// Finds by how many packets a decoder waits.
#[derive(Default)]
pub struct Delay {
    shown: usize,
    longest: usize,
}

impl Delay {
    /// Takes the next frame that comes to a decoder's pad; the delay, once it is known.
    pub fn take(&mut self, watch: &Watch, pad: &gst::Pad, frame: &gst::BufferRef) -> Option<usize> {
        if !watch.is_open(pad) {
            return Some(0);
        }
        let number = frame.iter_meta::<gst::ReferenceTimestampMeta>().find_map(|meta| {
            let is_number = meta.reference().structure(0).is_some_and(|mark| mark.has_name(NUMBER));
            is_number.then(|| usize::try_from(meta.timestamp().nseconds()).ok())?
        });
        self.longest = self.longest.max(number?.saturating_sub(self.shown));
        self.shown += 1;
        (self.shown >= MEASURED).then_some(self.longest)
    }

    /// The longest until now.
    pub fn longest(&self) -> usize {
        self.longest
    }
}

/// Has the frames of clips whose decoder waits `delay` packets come at their times, in a pipeline that has not been started.
pub fn mend(pipeline: &gst::Pipeline, delay: usize) {
    if delay == 0 {
        return;
    }
    on_decoders(pipeline, move |_, input, output| {
        let packets = Arc::new(Mutex::new(Packets::default()));
        let seen = packets.clone();
        let types = gst::PadProbeType::BUFFER | gst::PadProbeType::EVENT_FLUSH;
        input.add_probe(types, move |_, info| {
            let mut packets = seen.lock().unwrap_or_else(PoisonError::into_inner);
            match info.buffer() {
                Some(buffer) => packets.add(buffer.pts(), buffer.dts()),
                // It goes on elsewhere in the clip.
                None => packets.decoded.clear(),
            }
            gst::PadProbeReturn::Ok
        });
        output.add_probe(gst::PadProbeType::BUFFER, move |_, info| {
            let packets = packets.lock().unwrap_or_else(PoisonError::into_inner);
            if packets.is_open()
                && let Some(buffer) = info.buffer_mut()
                && let Some(time) = buffer.pts().and_then(|time| packets.later(time, delay))
            {
                buffer.make_mut().set_pts(time);
            }
            gst::PadProbeReturn::Ok
        });
    });
}

/// Has frames leave by a pad on one line of time, each later than the one before it: edit lists play pieces of a clip one after another,
/// and decoders give several frames one time where those of a file contradict their order. Encoders take neither.
pub fn straighten(pad: &gst::Pad) -> Straightened {
    let straightened = Straightened::default();
    let line = straightened.0.clone();
    let types =
        gst::PadProbeType::BUFFER | gst::PadProbeType::EVENT_DOWNSTREAM | gst::PadProbeType::EVENT_FLUSH;
    pad.add_probe(types, move |_, info| {
        let mut line = line.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(buffer) = info.buffer_mut() {
            let time = line.next(buffer.pts());
            buffer.make_mut().set_pts(time);
            return gst::PadProbeReturn::Ok;
        }
        match info.event().map(|event| event.view()) {
            Some(gst::EventView::Segment(event)) => {
                let Some(segment) = event.segment().downcast_ref::<gst::ClockTime>() else {
                    return gst::PadProbeReturn::Ok;
                };
                line.segment = Some(segment.clone());
                let whole = gst::FormattedSegment::<gst::ClockTime>::new();
                let new = gst::event::Segment::builder(&whole).seqnum(event.seqnum()).build();
                info.data = Some(gst::PadProbeData::Event(new));
            }
            Some(gst::EventView::FlushStop(_)) => (line.segment, line.last) = (None, None),
            _ => {}
        }
        gst::PadProbeReturn::Ok
    });
    straightened
}

/// What was done to the times of frames.
#[derive(Clone, Default)]
pub struct Straightened(Arc<Mutex<Line>>);

impl Straightened {
    /// How many frames came no later than the one before them, and so are shown later than they should be.
    pub fn moved(&self) -> u64 {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).moved
    }
}

/// Frames on one line of time.
#[derive(Default)]
struct Line {
    moved: u64,
    /// The piece of the clip that is played.
    segment: Option<gst::FormattedSegment<gst::ClockTime>>,
    last: Option<gst::ClockTime>,
    interval: gst::ClockTime,
}

impl Line {
    /// The next frame's time on the line, given that in its piece of the clip: of one without a time, as long after the last as that
    /// after the one before.
    fn next(&mut self, time: Option<gst::ClockTime>) -> Option<gst::ClockTime> {
        /// The clock of Matroska: what lies closer together could come out as one.
        const APART: gst::ClockTime = gst::ClockTime::from_mseconds(1);
        let running = match (&self.segment, time) {
            (Some(segment), Some(time)) => match segment.to_running_time_full(time)? {
                gst::Signed::Positive(time) => Some(time),
                gst::Signed::Negative(_) => Some(gst::ClockTime::ZERO),
            },
            (None, time) => time,
            (_, None) => self.last.map(|last| last + self.interval.max(APART)),
        };
        let earliest = self.last.map_or(gst::ClockTime::ZERO, |last| last + APART);
        let is_late = |time: gst::ClockTime| self.last.is_some_and(|last| time <= last);
        self.moved += u64::from(running.is_some_and(is_late));
        let time = running.filter(|time| !is_late(*time)).unwrap_or(earliest);
        if let Some(last) = self.last {
            self.interval = time - last;
        }
        self.last = Some(time);
        Some(time)
    }
}

/// Calls back with each decoder of video that a pipeline gets, and its pads.
fn on_decoders(
    pipeline: &gst::Pipeline,
    call: impl Fn(&gst::Element, &gst::Pad, &gst::Pad) + Send + Sync + 'static,
) {
    pipeline.connect_deep_element_added(move |_, _, element| {
        let is_decoder = is_of_class(element, "Decoder") && !is_of_class(element, "Audio");
        if let Some((input, output)) = element.static_pad("sink").zip(element.static_pad("src"))
            && is_decoder
        {
            call(element, &input, &output);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_of_a_clip_come_one_after_another() {
        let ms = gst::ClockTime::from_mseconds;
        let piece = |start: u64, stop: u64, base: u64| {
            let mut segment = gst::FormattedSegment::<gst::ClockTime>::new();
            segment.set_start(ms(start));
            segment.set_stop(ms(stop));
            segment.set_base(ms(base));
            segment
        };
        let mut line = Line::default();
        let mut shown = |piece: gst::FormattedSegment<gst::ClockTime>, times: &[Option<u64>]| {
            line.segment = Some(piece);
            times.iter().map(|time| line.next(time.map(ms)).unwrap().mseconds()).collect::<Vec<_>>()
        };
        // A frame without a time, two of one time, then a piece from the beginning again.
        let first = [Some(500), Some(540), None, Some(620), Some(620), Some(660)];
        assert_eq!(shown(piece(500, 700, 0), &first), [0, 40, 80, 120, 121, 160]);
        assert_eq!(shown(piece(100, 200, 200), &[Some(100), Some(140)]), [200, 240]);
        assert_eq!(line.moved, 1);
    }

    #[test]
    fn frames_are_shown_as_much_later_as_the_decoder_waits() {
        let ms = gst::ClockTime::from_mseconds;
        let mut packets = Packets::default();
        // A gap after the first, which is left out to wait.
        packets.add(Some(ms(0)), Some(ms(0)));
        for time in [66, 100, 133, 166] {
            packets.add(None, Some(ms(time)));
        }
        assert!(packets.is_open());
        let later = |time: u64| packets.later(ms(time), 2).map(gst::ClockTime::mseconds);
        let shown = [0, 66, 100, 133, 166].map(later);
        assert_eq!(shown, [100, 133, 166, 199, 232].map(Some));
        assert_eq!(later(50), None);
        // Files that state the times of some frames state them.
        packets.add(Some(ms(233)), Some(ms(200)));
        assert!(!packets.is_open());
    }
}
