//! Sound that begins a little before the video, in MPEG transport and program streams.
//!
//! Their demuxers let all streams begin with the first time that they find, mostly that of the video, so that what is earlier in
//! another stream would be cut off.

use gst::prelude::*;

/// How much earlier a stream may begin: multiplexers do not hold data back for longer.
const EARLIEST: gst::ClockTime = gst::ClockTime::from_seconds(1);
const DEMUXERS: [&str; 2] = ["tsdemux", "mpegpsdemux"];

/// Has all streams of a pipeline that has not been started keep what is a little earlier than the first time that its demuxer finds; all
/// come as much later, and `on_kept` is called.
pub fn keep(pipeline: &gst::Pipeline, on_kept: impl Fn() + Send + Sync + 'static) {
    pipeline.connect_deep_element_added(move |_, _, element| {
        let name = element.factory().map(|factory| factory.name());
        if name.is_some_and(|name| DEMUXERS.contains(&name.as_str())) {
            on_kept();
            element.connect_pad_added(|_, pad| begin_earlier(pad));
        }
    });
}

fn begin_earlier(pad: &gst::Pad) {
    pad.add_probe(gst::PadProbeType::EVENT_DOWNSTREAM, |_, info| {
        let new = info.event().and_then(|event| {
            let gst::EventView::Segment(segment) = event.view() else { return None };
            let mut segment = segment.segment().downcast_ref::<gst::ClockTime>()?.clone();
            let start = segment.start()?;
            segment.set_start(start.saturating_sub(EARLIEST));
            segment.set_position(segment.start());
            Some(gst::event::Segment::builder(&segment).seqnum(event.seqnum()).build())
        });
        if let Some(event) = new {
            info.data = Some(gst::PadProbeData::Event(event));
        }
        gst::PadProbeReturn::Ok
    });
}
