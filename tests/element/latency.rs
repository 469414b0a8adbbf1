// SPDX-License-Identifier: MIT OR Apache-2.0

//! Latency, position, quality of service.

use crate::common::*;
use gst::prelude::*;

const MS: fn(u64) -> gst::ClockTime = gst::ClockTime::from_mseconds;

fn latency_of(lookahead: u32, fps: (i32, i32)) -> gst::ClockTime {
    let caps = caps("GRAY8", 64, 48, gst::Fraction::new(fps.0, fps.1));
    let mut h = harness(lookahead, &caps);
    h.push(flat(&caps, 0)).unwrap();
    h.query_latency().unwrap()
}

#[test]
fn latency_is_the_lookahead_rounded_up() {
    assert_eq!(latency_of(0, (30, 1)), gst::ClockTime::ZERO);
    // 4 / 30 s = 133 333 333.3 ns
    assert_eq!(latency_of(4, (30, 1)), gst::ClockTime::from_nseconds(133_333_334));
    assert_eq!(latency_of(3, (30_000, 1001)), gst::ClockTime::from_nseconds(100_100_000));
    assert_eq!(latency_of(64, (25, 1)), MS(2560));
    // Where the caps do not tell, 30 frames a second are assumed.
    assert_eq!(latency_of(4, (0, 1)), gst::ClockTime::from_nseconds(4 * 33_333_334));
}

#[test]
fn latency_adds_to_that_of_upstream() {
    let mut h = harness(3, &caps("GRAY8", 64, 48, gst::Fraction::new(25, 1)));
    h.set_upstream_latency(MS(7));
    assert_eq!(h.query_latency().unwrap(), MS(127));
}

#[test]
fn without_upstream_there_is_no_latency_to_tell() {
    init();
    let element = gst::ElementFactory::make("rsrectify").build().unwrap();
    let src = element.static_pad("src").unwrap();
    assert!(!src.query(gst::query::Latency::new().query_mut()));
}

#[test]
fn a_change_of_latency_is_announced_once() {
    let at = |fps| caps("GRAY8", 64, 48, gst::Fraction::new(fps, 1));
    init();
    let mut h = gst_check::Harness::new("rsrectify");
    let bus = bus(&h);
    h.set_src_caps(at(25));
    let announced = || messages(&bus, gst::MessageType::Latency).len();
    assert_eq!(announced(), 1);
    assert!(h.push_event(gst::event::Caps::new(&at(25))));
    assert!(h.push_event(gst::event::Caps::new(&caps("I420", 64, 48, gst::Fraction::new(25, 1)))));
    (0..9).for_each(|number| assert!(h.push(flat(&h_caps(&h), number)).is_ok()));
    assert_eq!(announced(), 0, "the same latency");
    assert!(h.push_event(gst::event::Caps::new(&at(50))));
    assert_eq!(announced(), 1);
    h.element().unwrap().set_property("lookahead", 2u32);
    assert!(h.push_event(gst::event::Caps::new(&at(25))));
    assert_eq!(announced(), 0, "2 frames at 25 take as long as 4 at 50");
    assert_eq!(h.query_latency().unwrap(), MS(80));
}

fn h_caps(h: &gst_check::Harness) -> gst::Caps {
    h.element().unwrap().static_pad("sink").unwrap().current_caps().unwrap()
}

#[test]
fn position_is_that_of_the_last_frame_out() {
    let mut h = harness(2, &numbered_caps());
    let position = |h: &gst_check::Harness| {
        h.element().unwrap().static_pad("src").unwrap().query_position::<gst::ClockTime>()
    };
    (0..5).for_each(|number| assert!(h.push(numbered(number)).is_ok()));
    assert_eq!(position(&h), Some(time(2)));
}

#[test]
fn the_latency_grows_to_that_of_the_frames_that_come() {
    for fps in [(0, 1), (30, 1)] {
        let mut h = harness(4, &caps("GRAY8", 64, 48, gst::Fraction::new(fps.0, fps.1)));
        let bus = bus(&h);
        for number in 0..30 {
            let mut frame = flat(&h_caps(&h), 0);
            frame.get_mut().unwrap().set_pts(MS(100) * number);
            h.push(frame).unwrap();
        }
        assert_eq!(messages(&bus, gst::MessageType::Latency).len(), 1, "{fps:?}");
        assert_eq!(h.query_latency(), Some(MS(400)), "{fps:?}");
    }
}

#[test]
fn a_processing_deadline_is_latency() {
    init();
    let mut h = gst_check::Harness::new("rsrectify");
    h.element().unwrap().set_property("processing-deadline", MS(15).nseconds());
    h.set_src_caps(caps("GRAY8", 64, 48, gst::Fraction::new(25, 1)));
    assert_eq!(h.query_latency(), Some(MS(175)));
}

/// Plays a shaken film whose frames are shown so much too late (milliseconds): which frames are the buffers that came,
/// after the first ten in which the motion is found, and the QoS messages.
fn played_late(lateness: impl Fn(usize) -> i64, count: usize, qos: bool) -> (Vec<usize>, Vec<gst::Message>) {
    let mut h = harness(0, &numbered_caps());
    let element = h.element().unwrap();
    element.set_property("readout-time", (shake::RATIO / shake::FPS * 1e9) as u64);
    element.set_property_from_str("readout-direction", "bottom-to-top");
    element.set_property("qos", qos);
    let bus = bus(&h);
    let frames: Vec<_> = (0..count).map(shake::shaken).collect();
    for (number, frame) in frames.iter().enumerate() {
        h.push(frame.clone()).unwrap();
        let late = 1_000_000 * lateness(number);
        h.push_upstream_event(gst::event::Qos::new(gst::QOSType::Underflow, 1.2, late, time(number)));
    }
    let out = arrived(&mut h);
    assert_eq!(numbers(&out), (0..count).collect::<Vec<_>>());
    let untouched = (10..count).filter(|&i| frames[i].as_ptr() == out[i].as_ptr()).collect();
    (untouched, messages(&bus, gst::MessageType::Qos))
}

#[test]
fn lateness_that_does_not_grow_changes_nothing() {
    for late in [0, 1, 3, 15] {
        let (untouched, messages) = played_late(|number| late + number as i64 % 2, 100, true);
        assert_eq!((untouched.len(), messages.len()), (0, 0), "{late} ms");
    }
}

#[test]
fn overload_stops_the_work_and_time_brings_it_back() {
    // Ten milliseconds later with each frame, until nothing is worked on; then early.
    let lateness = |number: usize| if number < 30 { 10 * number as i64 } else { -1000 };
    let (untouched, messages) = played_late(lateness, 120, true);
    let (first, last) = (untouched[0], untouched[untouched.len() - 1]);
    assert!((12..30).contains(&first), "{untouched:?}");
    assert!((38..60).contains(&last), "a second or so: {untouched:?}");
    assert_eq!(untouched.len(), last - first + 1, "in one piece: {untouched:?}");
    let gst::MessageView::Qos(message) = messages[0].view() else { unreachable!() };
    assert_eq!(message.timestamp(), Some(time(first)));
    // The first frame after the pause has none before it from which its motion could be told.
    assert_eq!(messages.len() + 1, untouched.len());
}

#[test]
fn overload_leaves_the_crop_as_it_is() {
    let mut h = harness(0, &numbered_caps());
    h.element().unwrap().set_property_from_str("border-mode", "crop");
    let frame = shake::shaken(0);
    for number in 0..40 {
        let mut again = frame.copy_deep().unwrap();
        again.get_mut().unwrap().set_pts(time(number));
        h.push(again).unwrap();
        let late = 10_000_000 * number as i64;
        h.push_upstream_event(gst::event::Qos::new(gst::QOSType::Underflow, 1.2, late, time(number)));
    }
    let late = h.element().unwrap().property::<gst::Structure>("stats").get::<u64>("late").unwrap();
    assert!(late > 10, "{late}");
    let out = arrived(&mut h);
    let pixels = |number: usize| out[number].map_readable().unwrap().to_vec();
    assert!(pixels(39) == pixels(5) && pixels(39) != frame.map_readable().unwrap().as_slice());
}

#[test]
fn qos_can_be_turned_off() {
    let (untouched, messages) = played_late(|number| 10 * number as i64, 60, false);
    assert_eq!((untouched.len(), messages.len()), (0, 0));
}

#[test]
fn qos_events_go_on_upstream() {
    let mut h = harness(0, &numbered_caps());
    h.push_upstream_event(gst::event::Qos::new(gst::QOSType::Underflow, 1.2, 5, time(4)));
    let forwarded = std::iter::from_fn(|| h.try_pull_upstream_event());
    assert_eq!(forwarded.filter(|event| event.type_() == gst::EventType::Qos).count(), 1);
}
