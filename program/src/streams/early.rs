// SPDX-License-Identifier: MIT OR Apache-2.0

//! Sound that begins a little before the video, in MPEG transport and program streams.
//!
//! Their demuxers let all streams begin with the first time that they find, mostly that of the video, so that what is earlier in
//! another stream would be cut off.

use gst::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// How much earlier a stream may begin: multiplexers do not hold data back for longer.
const EARLIEST: gst::ClockTime = gst::ClockTime::from_seconds(1);
const DEMUXERS: [&str; 2] = ["tsdemux", "mpegpsdemux"];

/// By how many nanoseconds all streams come later.
pub type Later = Arc<AtomicU64>;

/// Has all streams of a pipeline that has not been started keep what is a little earlier than the first time that its demuxer finds; all
/// come as much later, which is noted in `later`, and `on_kept` is called.
pub fn keep(pipeline: &gst::Pipeline, later: &Later, on_kept: impl Fn() + Send + Sync + 'static) {
    let noted = later.clone();
    pipeline.connect_deep_element_added(move |_, _, element| {
        let name = element.factory().map(|factory| factory.name());
        if name.is_some_and(|name| DEMUXERS.contains(&name.as_str())) {
            on_kept();
            let noted = noted.clone();
            element.connect_pad_added(move |_, pad| begin_earlier(pad, noted.clone()));
        }
    });
}

fn begin_earlier(pad: &gst::Pad, later: Later) {
    pad.add_probe(gst::PadProbeType::EVENT_DOWNSTREAM, move |_, info| {
        let new = info.event().and_then(|event| {
            let gst::EventView::Segment(segment) = event.view() else { return None };
            let mut segment = segment.segment().downcast_ref::<gst::ClockTime>()?.clone();
            let start = segment.start()?;
            segment.set_start(start.saturating_sub(EARLIEST));
            later.store(start.min(EARLIEST).nseconds(), Ordering::Relaxed);
            segment.set_position(segment.start());
            Some(gst::event::Segment::builder(&segment).seqnum(event.seqnum()).build())
        });
        if let Some(event) = new {
            info.data = Some(gst::PadProbeData::Event(event));
        }
        gst::PadProbeReturn::Ok
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    #[test]
    fn a_second_before_the_first_time_is_kept() {
        gst::init().unwrap();
        let segments = Arc::new(Mutex::new(Vec::new()));
        let seen = segments.clone();
        let sink = gst::Pad::builder(gst::PadDirection::Sink)
            .event_function(move |_, _, event| {
                if let gst::EventView::Segment(event) = event.view() {
                    seen.lock().unwrap().push(event.segment().clone());
                }
                true
            })
            .build();
        let source = gst::Pad::new(gst::PadDirection::Src);
        sink.set_active(true).unwrap();
        source.set_active(true).unwrap();
        source.link(&sink).unwrap();
        let later = Later::default();
        begin_earlier(&source, later.clone());
        assert!(source.push_event(gst::event::StreamStart::new("stream")));
        let ms = gst::ClockTime::from_mseconds;
        for start in [5000, 700] {
            let mut segment = gst::FormattedSegment::<gst::ClockTime>::new();
            segment.set_start(ms(start));
            segment.set_time(ms(0));
            assert!(source.push_event(gst::event::Segment::new(&segment)));
        }
        let segments = segments.lock().unwrap();
        let running = |number: usize, time| {
            let segment: &gst::Segment = &segments[number];
            segment.downcast_ref::<gst::ClockTime>().unwrap().to_running_time(ms(time))
        };
        // All come later by as much.
        assert_eq!(
            [4000, 4960, 5000].map(|time| running(0, time)),
            [0, 960, 1000].map(|time| Some(ms(time)))
        );
        assert_eq!(running(0, 3999), None);
        assert_eq!(later.load(Ordering::Relaxed), ms(700).nseconds(), "that of the last segment");
        assert_eq!([0, 700].map(|time| running(1, time)), [0, 700].map(|time| Some(ms(time))));
    }
}
