// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the element learns of a camera from the picture, and how long it remembers it.

use crate::common::shake::{FPS, RATIO, shaken};
use crate::common::*;
use gst::prelude::*;
use gst_check::Harness;

/// Frames after which the camera is known.
const ENOUGH: usize = 24;

fn push(h: &mut Harness, numbers: std::ops::Range<usize>) {
    numbers.for_each(|number| assert!(h.push(shaken(number)).is_ok()));
}

/// A harness that has seen enough of the film to know the camera.
fn experienced() -> Harness {
    let mut h = harness(0, &numbered_caps());
    push(&mut h, 0..ENOUGH);
    h
}

/// What is known of the readout: signed share of the period (negative: from the bottom), deviation.
fn known(h: &Harness) -> (f64, f64) {
    let stats = h.element().unwrap().property::<gst::Structure>("stats");
    let direction = stats.value("readout-direction").unwrap().serialize().unwrap();
    let sign = if direction == "bottom-to-top" { -1.0 } else { 1.0 };
    let seconds = stats.get::<u64>("readout-time").unwrap() as f64 * 1e-9;
    (sign * seconds * FPS, stats.get("readout-deviation").unwrap())
}

/// What is known at the first frame of a new stretch, before that can tell anything.
fn first_of_stretch(h: &mut Harness, from: usize) -> (f64, f64) {
    push(h, from..from + 1);
    known(h)
}

fn is_right((ratio, deviation): (f64, f64)) -> bool {
    (ratio + RATIO).abs() < 0.05 && deviation < 0.05
}

#[test]
fn the_readout_is_found_and_outlives_cuts_holes_and_seeks() {
    let mut h = experienced();
    assert!(is_right(known(&h)), "{:?}", known(&h));
    // A hole in time.
    assert!(is_right(first_of_stretch(&mut h, 600)));
    // A mark of discontinuity.
    let mut marked = shaken(700);
    marked.get_mut().unwrap().set_flags(gst::BufferFlags::DISCONT);
    h.push(marked).unwrap();
    assert!(is_right(first_of_stretch(&mut h, 701)));
    // A seek.
    let segment = gst::FormattedSegment::<gst::ClockTime>::new();
    h.push_event(gst::event::FlushStart::new());
    h.push_event(gst::event::FlushStop::new(true));
    h.push_event(gst::event::Segment::new(&segment));
    assert!(is_right(first_of_stretch(&mut h, 30)));
    // The same stream again, and the same caps.
    let src = h.element().unwrap().static_pad("src").unwrap();
    let id = src.stream_id().unwrap();
    h.push_event(gst::event::StreamStart::new(&id));
    h.push_event(gst::event::Caps::new(&numbered_caps()));
    h.push_event(gst::event::Segment::new(&segment));
    assert!(is_right(first_of_stretch(&mut h, 90)));
}

#[test]
fn another_stream_may_be_of_another_camera() {
    let mut h = experienced();
    h.push_event(gst::event::StreamStart::new("another"));
    h.push_event(gst::event::Segment::new(&gst::FormattedSegment::<gst::ClockTime>::new()));
    let (_, deviation) = first_of_stretch(&mut h, 600);
    assert!(deviation > 0.1, "{deviation}");
}

#[test]
fn new_caps_and_new_settings_start_anew() {
    let mut h = experienced();
    h.push_event(gst::event::Caps::new(&caps("GRAY8", SIZE.0, SIZE.1, gst::Fraction::new(25, 1))));
    let (_, deviation) = first_of_stretch(&mut h, 600);
    assert!(deviation > 0.1, "{deviation}");
    for (name, value) in
        [("model", "rotation"), ("focal-length", "0.8"), ("readout-direction", "bottom-to-top")]
    {
        let mut h = experienced();
        h.element().unwrap().set_property_from_str(name, value);
        let (_, deviation) = first_of_stretch(&mut h, ENOUGH);
        assert!(deviation > 0.1, "{name}: {deviation}");
    }
}

#[test]
fn what_was_given_is_not_sought() {
    let mut h = experienced();
    h.element().unwrap().set_property("readout-time", 12_000_000u64);
    h.element().unwrap().set_property_from_str("readout-direction", "bottom-to-top");
    let (ratio, deviation) = first_of_stretch(&mut h, ENOUGH);
    assert!((ratio + 0.36).abs() < 1e-3 && deviation < 1e-3, "{ratio} ± {deviation}");
    h.element().unwrap().set_property_from_str("estimator", "sequential");
    push(&mut h, ENOUGH + 1..ENOUGH + 5);
    assert!((known(&h).0 + 0.36).abs() < 1e-6);
    assert_eq!(numbers(&arrived(&mut h)), (0..ENOUGH + 5).collect::<Vec<_>>());
}
