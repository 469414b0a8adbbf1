//! The times of Matroska files.
//!
//! GStreamer's demuxer lets its first segment start at the first frame that it finds and counts it as time 0, then goes on with
//! segments of the whole file: the first frame of a clip that begins later than 0 would come too early.

use gst::prelude::*;

/// Has Matroska's demuxers in a bin give their frames the times that the file states.
pub fn correct(decoder: &gst::Bin) {
    decoder.connect_element_added(|_, element| {
        if element.factory().is_some_and(|factory| factory.name() == "matroskademux") {
            element.connect_pad_added(|_, pad| {
                pad.add_probe(gst::PadProbeType::EVENT_DOWNSTREAM, correct_segment);
            });
        }
    });
}

fn correct_segment(_: &gst::Pad, info: &mut gst::PadProbeInfo<'_>) -> gst::PadProbeReturn {
    let new = info.event().and_then(|event| {
        let gst::EventView::Segment(segment) = event.view() else { return None };
        let mut time = segment.segment().downcast_ref::<gst::ClockTime>()?.clone();
        // After a seek to a time both are that time.
        let is_shifted =
            time.start() > Some(gst::ClockTime::ZERO) && time.time() == Some(gst::ClockTime::ZERO);
        if !is_shifted || time.base() != Some(gst::ClockTime::ZERO) {
            return None;
        }
        time.set_start(gst::ClockTime::ZERO);
        time.set_position(gst::ClockTime::ZERO);
        Some(gst::event::Segment::builder(&time).seqnum(event.seqnum()).build())
    });
    if let Some(event) = new {
        info.data = Some(gst::PadProbeData::Event(event));
    }
    gst::PadProbeReturn::Ok
}
