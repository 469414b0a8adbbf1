// SPDX-License-Identifier: MIT OR Apache-2.0

//! The flow of frames and events through the element.

use crate::common::*;
use gst::prelude::*;

fn start_segment(rate: f64) -> gst::Event {
    let mut segment = gst::FormattedSegment::<gst::ClockTime>::new();
    segment.set_rate(rate);
    segment.set_stop(time(1000));
    gst::event::Segment::new(&segment)
}

/// A frame with everything a buffer can say of itself.
fn rich_frame(number: usize) -> gst::Buffer {
    let mut buffer = numbered(number);
    let inner = buffer.get_mut().unwrap();
    inner.set_pts(time(number) + gst::ClockTime::from_nseconds(number as u64 % 3 * 1000));
    inner.set_dts(time(number + 1));
    inner.set_duration(FRAME + gst::ClockTime::from_nseconds(number as u64));
    inner.set_offset(number as u64 + 7);
    inner.set_offset_end(number as u64 + 8);
    let flags = [
        gst::BufferFlags::MARKER,
        gst::BufferFlags::CORRUPTED,
        gst::BufferFlags::GAP,
        gst::BufferFlags::DELTA_UNIT,
    ];
    inner.set_flags(flags[number % flags.len()]);
    buffer
}

#[test]
fn every_frame_comes_out_once_with_what_it_says_of_itself() {
    for lookahead in [0, 1, 4, 64] {
        for warp in [false, true] {
            let mut h = harness(lookahead, &numbered_caps());
            if warp {
                warp_always(&h);
            }
            let frames: Vec<_> = (0..20).map(rich_frame).collect();
            for frame in &frames {
                h.push(frame.copy_deep().unwrap()).unwrap();
            }
            assert!(h.push_event(gst::event::Eos::new()));
            let out = arrived(&mut h);
            assert_eq!(out.len(), frames.len(), "lookahead {lookahead}");
            for (input, output) in frames.iter().zip(&out) {
                let says = |b: &gst::Buffer| {
                    (
                        b.pts(),
                        b.dts(),
                        b.duration(),
                        b.offset(),
                        b.offset_end(),
                        b.flags() - gst::BufferFlags::TAG_MEMORY,
                    )
                };
                assert_eq!(says(output), says(input), "lookahead {lookahead}, warp {warp}");
            }
        }
    }
}

#[test]
fn lookahead_frames_are_held() {
    let mut h = harness(3, &numbered_caps());
    for number in 0..10usize {
        h.push(numbered(number)).unwrap();
        assert_eq!(h.buffers_received() as usize, (number + 1).saturating_sub(3));
    }
}

#[test]
fn streams_of_no_and_of_one_frame() {
    let mut h = harness(4, &numbered_caps());
    let log = Log::new(&h);
    assert!(h.push_event(gst::event::Eos::new()));
    assert_eq!(log.take(), ["eos"]);
    let mut h = harness(4, &numbered_caps());
    let log = Log::new(&h);
    h.push(numbered(0)).unwrap();
    assert!(h.push_event(gst::event::Eos::new()));
    assert_eq!(log.take(), ["stream-start", "caps", "segment", "frame 0", "eos"].as_slice()[3..]);
}

#[test]
fn events_that_end_a_stretch_come_after_its_frames() {
    init();
    let gap = gst::event::Gap::builder(time(3)).duration(FRAME).build();
    let events = [
        gst::event::Eos::new(),
        start_segment(1.0),
        gst::event::SegmentDone::new(time(3)),
        gst::event::StreamStart::new("next"),
        gap,
    ];
    for event in events {
        let mut h = harness(8, &numbered_caps());
        let log = Log::new(&h);
        (0..3).for_each(|number| assert!(h.push(numbered(number)).is_ok()));
        let name = event.type_().to_string();
        assert!(log.take().is_empty());
        assert!(h.push_event(event));
        assert_eq!(log.take(), ["frame 0", "frame 1", "frame 2", &name]);
    }
}

#[test]
fn a_drain_query_brings_out_all_frames() {
    let mut h = harness(8, &numbered_caps());
    (0..3).for_each(|number| assert!(h.push(numbered(number)).is_ok()));
    let sink = h.element().unwrap().static_pad("sink").unwrap();
    let _ = sink.query(gst::query::Drain::new().query_mut());
    assert_eq!(numbers(&arrived(&mut h)), [0, 1, 2]);
}

#[test]
fn other_events_keep_their_place_between_frames() {
    let mut h = harness(2, &numbered_caps());
    let log = Log::new(&h);
    h.push_event(marker("before"));
    h.push(numbered(0)).unwrap();
    h.push(numbered(1)).unwrap();
    h.push_event(marker("between"));
    h.push_event(gst::event::Tag::new(gst::TagList::new()));
    (2..5).for_each(|number| assert!(h.push(numbered(number)).is_ok()));
    h.push_event(marker("last"));
    h.push_event(gst::event::Eos::new());
    let order =
        ["before", "frame 0", "frame 1", "between", "tag", "frame 2", "frame 3", "frame 4", "last", "eos"];
    assert_eq!(log.take(), order);
}

#[test]
fn out_of_band_events_do_not_wait() {
    let mut h = harness(4, &numbered_caps());
    let log = Log::new(&h);
    h.push(numbered(0)).unwrap();
    h.push_event(gst::event::CustomDownstreamOob::new(gst::Structure::new_empty("urgent")));
    assert_eq!(log.take(), ["custom-downstream-oob"]);
}

#[test]
fn a_flush_drops_frames_but_not_sticky_events() {
    let mut h = harness(4, &numbered_caps());
    let log = Log::new(&h);
    h.push(numbered(0)).unwrap();
    let mut tags = gst::TagList::new();
    tags.get_mut().unwrap().add::<gst::tags::Title>(&"a title", gst::TagMergeMode::Append);
    h.push_event(gst::event::Tag::new(tags));
    h.push(numbered(1)).unwrap();
    h.push_event(gst::event::FlushStart::new());
    h.push_event(gst::event::FlushStop::new(true));
    assert_eq!(log.take(), ["flush-start", "flush-stop"]);
    h.push_event(start_segment(1.0));
    (50..53).for_each(|number| assert!(h.push(numbered(number)).is_ok()));
    h.push_event(gst::event::Eos::new());
    assert_eq!(numbers(&arrived(&mut h)), [50, 51, 52]);
    let src = h.element().unwrap().static_pad("src").unwrap();
    let tag = src.sticky_event::<gst::event::Tag>(0).expect("the tag is kept");
    assert_eq!(tag.tag().get::<gst::tags::Title>().unwrap().get(), "a title");
}

#[test]
fn new_caps_come_after_the_frames_of_the_old_ones() {
    let mut h = harness(4, &numbered_caps());
    let log = Log::new(&h);
    let fps = gst::Fraction::new(30, 1);
    let changes = [
        caps("GRAY8", 64, 48, fps),
        caps("I420", 64, 48, fps),
        caps("I420", 64, 48, gst::Fraction::new(25, 1)),
    ];
    let mut number = 0;
    h.push(numbered(number)).unwrap();
    for caps in &changes {
        assert!(h.push_event(gst::event::Caps::new(caps)));
        for _ in 0..2 {
            number += 1;
            h.push(flat(caps, number)).unwrap();
        }
    }
    h.push_event(gst::event::Eos::new());
    let order = [
        "stream-start",
        "caps",
        "segment",
        "frame 0",
        "caps",
        "frame 1",
        "frame 2",
        "caps",
        "frame 3",
        "frame 4",
        "caps",
        "frame 5",
        "frame 6",
        "eos",
    ];
    let log = log.take();
    assert_eq!(log, order[order.len() - log.len()..], "{log:?}");
    assert!(log.len() >= order.len() - 3);
    assert_eq!(arrived(&mut h).len(), 7);
}

#[test]
fn the_same_caps_twice_change_nothing() {
    let mut h = harness(2, &numbered_caps());
    h.push(numbered(0)).unwrap();
    h.push(numbered(1)).unwrap();
    let other = caps("I420", 64, 48, gst::Fraction::new(30, 1));
    assert!(h.push_event(gst::event::Caps::new(&numbered_caps())));
    assert_eq!(h.buffers_received(), 0, "the frames go on waiting");
    h.push(numbered(2)).unwrap();
    assert!(h.push_event(gst::event::Caps::new(&other)));
    assert!(h.push_event(gst::event::Caps::new(&numbered_caps())));
    (3..6).for_each(|number| assert!(h.push(numbered(number)).is_ok()));
    h.push_event(gst::event::Eos::new());
    assert_eq!(numbers(&arrived(&mut h)), [0, 1, 2, 3, 4, 5]);
}

#[test]
fn a_hole_drains_and_its_mark_stays_on_its_frame() {
    let mut h = harness(4, &numbered_caps());
    let mut sent = 0;
    for number in (0..3).chain(100..103) {
        let mut frame = numbered(number);
        if number == 0 || number == 100 {
            frame.get_mut().unwrap().set_flags(gst::BufferFlags::DISCONT);
        }
        h.push(frame).unwrap();
        sent += 1;
        assert_eq!(h.buffers_received(), if sent > 3 { 3 } else { 0 });
    }
    h.push_event(gst::event::Eos::new());
    let out = arrived(&mut h);
    assert_eq!(numbers(&out), [0, 1, 2, 100, 101, 102]);
    let marked: Vec<_> = out.iter().map(|b| b.flags().contains(gst::BufferFlags::DISCONT)).collect();
    assert_eq!(marked, [true, false, false, true, false, false]);
}

#[test]
fn reverse_playback_keeps_its_lookahead_across_groups_of_pictures() {
    let mut h = harness(4, &numbered_caps());
    h.push_event(start_segment(-1.0));
    for (sent, number) in (0..30).rev().enumerate() {
        let mut frame = numbered(number);
        if (number + 1) % 5 == 0 {
            frame.get_mut().unwrap().set_flags(gst::BufferFlags::DISCONT);
        }
        h.push(frame).unwrap();
        assert_eq!(h.buffers_received() as usize, (sent + 1).saturating_sub(4));
    }
    h.push_event(gst::event::Eos::new());
    assert_eq!(numbers(&arrived(&mut h)), (0..30).rev().collect::<Vec<_>>());
}

#[test]
fn frames_without_timestamps_come_out_too() {
    for fps in [gst::Fraction::new(30, 1), gst::Fraction::new(0, 1)] {
        let caps = caps("GRAY8", SIZE.0, SIZE.1, fps);
        let mut h = harness(2, &caps);
        for number in 0..5 {
            h.push(gst::Buffer::from_mut_slice(numbered_pixels(number))).unwrap();
        }
        h.push_event(gst::event::Eos::new());
        let out = arrived(&mut h);
        assert_eq!(out.len(), 5);
        assert!(out.iter().all(|buffer| buffer.pts().is_none() && buffer.duration().is_none()));
    }
}

#[test]
fn readout_settings_that_change_lose_no_frame() {
    let mut h = harness(4, &numbered_caps());
    let element = h.element().unwrap();
    for number in 0..30usize {
        match number {
            10 => element.set_property("readout-time", 20_000_000u64),
            15 => element.set_property_from_str("readout-direction", "bottom-to-top"),
            20 => element.set_property("inter-frame-delay", 1e9),
            21 => element.set_property("threads", 2u32),
            25 => element.set_property("lookahead", 9u32),
            _ => (),
        }
        h.push(numbered(number)).unwrap();
    }
    assert_eq!(h.buffers_received(), 26, "lookahead waits for new caps");
    h.push_event(gst::event::Eos::new());
    assert_eq!(numbers(&arrived(&mut h)), (0..30).collect::<Vec<_>>());
}

#[test]
fn stopped_and_started_again_it_knows_nothing_of_before() {
    init();
    let element = gst::ElementFactory::make("rsrectify").property("lookahead", 2u32).build().unwrap();
    for _ in 0..3 {
        let mut h = gst_check::Harness::with_element(&element, Some("sink"), Some("src"));
        h.set_src_caps(numbered_caps());
        h.play();
        (0..5).for_each(|number| assert!(h.push(numbered(number)).is_ok()));
        assert_eq!(numbers(&arrived(&mut h)), [0, 1, 2], "frames held are forgotten at the stop");
        assert_eq!(element.property::<gst::Structure>("stats").get::<u64>("frames").unwrap(), 3);
        element.set_state(gst::State::Null).unwrap();
    }
}

#[test]
fn every_order_of_states() {
    use gst::State::{Null, Paused, Playing, Ready};
    init();
    let element = gst::ElementFactory::make("rsrectify").build().unwrap();
    for state in [Ready, Null, Paused, Ready, Paused, Playing, Ready, Playing, Paused, Null, Playing, Null] {
        element.set_state(state).unwrap();
    }
}

#[test]
fn a_drain_that_fails_drops_the_rest() {
    let mut h = harness(4, &numbered_caps());
    (0..3).for_each(|number| assert!(h.push(numbered(number)).is_ok()));
    let sink = h.sinkpad().unwrap();
    sink.set_active(false).unwrap();
    h.push_event(gst::event::Gap::builder(time(3)).build());
    sink.set_active(true).unwrap();
    h.push_event(gst::event::FlushStart::new());
    h.push_event(gst::event::FlushStop::new(true));
    h.push_event(start_segment(1.0));
    h.push(numbered(7)).unwrap();
    h.push_event(gst::event::Eos::new());
    assert_eq!(numbers(&arrived(&mut h)), [7]);
}

#[test]
fn a_frame_before_caps_is_not_negotiated() {
    init();
    let mut h = gst_check::Harness::new("rsrectify");
    h.push_event(gst::event::StreamStart::new("stream"));
    h.push_event(start_segment(1.0));
    assert_eq!(h.push(numbered(0)), Err(gst::FlowError::NotNegotiated));
}

#[test]
fn a_message_for_each_frame() {
    let mut h = harness(2, &numbered_caps());
    let bus = bus(&h);
    h.element().unwrap().set_property("post-messages", true);
    (0..5).for_each(|number| assert!(h.push(numbered(number)).is_ok()));
    h.push_event(gst::event::Eos::new());
    let messages = messages(&bus, gst::MessageType::Element);
    let times: Vec<_> = messages
        .iter()
        .map(|message| {
            let s = message.structure().unwrap();
            assert_eq!(s.name(), "rsrectify");
            assert!(s.get::<f64>("confidence").is_ok() && s.get::<f64>("omega").is_ok());
            // A frame that keeps its picture has the reason.
            let is_kept = s.get::<f64>("applied").unwrap() == 0.0;
            assert_eq!(s.get::<String>("as-recorded").is_ok(), is_kept, "{s}");
            assert_eq!(s.get::<gst::ClockTime>("stream-time"), s.get::<gst::ClockTime>("timestamp"));
            s.get::<gst::ClockTime>("timestamp").unwrap()
        })
        .collect();
    assert_eq!(times, (0..5).map(time).collect::<Vec<_>>());
    let stats = h.element().unwrap().property::<gst::Structure>("stats");
    assert_eq!(stats.get::<u64>("frames").unwrap(), 5);
    // Frames that have nothing to do with each other tell nothing of the readout, and that is what is said.
    assert!(stats.get::<u64>("readout-time").unwrap() <= 33_333_334);
    assert!(stats.get::<f64>("readout-deviation").unwrap() > 0.3, "{stats}");
}

/// Lets a property of the element follow a curve through points in time.
fn animate(
    element: &gst::Element,
    property: &str,
    mode: gst_controller::InterpolationMode,
    points: &[(usize, f64)],
) {
    use gst_controller::prelude::*;
    let curve = gst_controller::InterpolationControlSource::new();
    curve.set_mode(mode);
    points.iter().for_each(|&(number, value)| assert!(curve.set(time(number), value)));
    let binding = gst_controller::DirectControlBinding::new_absolute(element, property, &curve);
    element.add_control_binding(&binding).unwrap();
}

#[test]
fn properties_follow_their_curves_at_the_time_of_the_frame_given_out() {
    use gst_controller::InterpolationMode;
    let mut h = harness(3, &numbered_caps());
    let element = h.element().unwrap();
    let curves = [("strength", 1.0), ("crop", 40.0), ("reference-row", 0.5)];
    for (property, end) in curves {
        animate(&element, property, InterpolationMode::Linear, &[(0, 0.0), (30, end)]);
    }
    let colours = [(0, f64::from(0xff11_2233u32)), (10, f64::from(0x8044_5566u32))];
    animate(&element, "border-color", InterpolationMode::None, &colours);
    for number in 0..20usize {
        h.push(numbered(number)).unwrap();
        if let Some(out) = number.checked_sub(3) {
            for (property, end) in curves {
                let (value, wanted): (f64, _) = (element.property(property), end * out as f64 / 30.0);
                assert!((value - wanted).abs() < 1e-6, "frame {out}: {property} is {value}");
            }
            let colour = if out < 10 { 0xff11_2233u32 } else { 0x8044_5566 };
            assert_eq!(element.property::<u32>("border-color"), colour, "frame {out}");
        }
    }
}

#[test]
fn an_animated_crop_is_that_of_the_frame_given_out() {
    let mut h = harness(3, &numbered_caps());
    let element = h.element().unwrap();
    element.set_property_from_str("border-mode", "crop");
    animate(&element, "crop", gst_controller::InterpolationMode::None, &[(0, 0.0), (10, 20.0)]);
    (0..20).for_each(|number| assert!(h.push(panned(0, number)).is_ok()));
    h.push_event(gst::event::Eos::new());
    let same = panned(0, 0);
    let same = same.map_readable().unwrap();
    let out = arrived(&mut h);
    let first = out.iter().position(|frame| frame.map_readable().unwrap().as_slice() != same.as_slice());
    assert_eq!((out.len(), first), (20, Some(10)));
}

/// A texture that moves 3 px to the right a step.
fn panned(step: usize, number: usize) -> gst::Buffer {
    let (width, height) = SIZE;
    let pixel = |i: u32| {
        let (x, y) = (f64::from(i % width) - 3.0 * step as f64, f64::from(i / width));
        let waves =
            (0.23 * x + 0.11 * y).sin() + (0.17 * x - 0.29 * y).sin() + (0.051 * x * 0.9 + 0.4 * y).sin();
        (128.0 + 35.0 * waves) as u8
    };
    let mut buffer = gst::Buffer::from_mut_slice((0..width * height).map(pixel).collect::<Vec<_>>());
    buffer.get_mut().unwrap().set_pts(time(number));
    buffer
}

#[test]
fn a_frame_flagged_as_repeated_is_no_motion_of_its_own() {
    let mut h = harness(2, &numbered_caps());
    let bus = bus(&h);
    h.element().unwrap().set_property("post-messages", true);
    for (number, step) in [0, 1, 2, 3, 3, 4, 5, 6].into_iter().enumerate() {
        let mut frame = panned(step, number);
        if number == 4 {
            frame.get_mut().unwrap().set_flags(gst::BufferFlags::GAP);
        }
        h.push(frame).unwrap();
    }
    h.push_event(gst::event::Eos::new());
    let messages = messages(&bus, gst::MessageType::Element);
    let origin = |message: &gst::Message| message.structure().unwrap().get::<String>("origin").unwrap();
    let origins: Vec<_> = messages.iter().map(origin).collect();
    assert_eq!(origins.iter().position(|origin| origin == "repeated"), Some(4), "{origins:?}");
    let count = |message: &gst::Message, name| message.structure().unwrap().get::<u32>(name).unwrap();
    let counts = |message| [count(message, "inliers"), count(message, "correspondences")];
    let counts: Vec<_> = messages.iter().map(counts).collect();
    assert!(counts.iter().all(|[inliers, all]| inliers <= all) && counts[4][0] > 100, "{counts:?}");
    assert!(arrived(&mut h)[4].flags().contains(gst::BufferFlags::GAP));
}

#[test]
fn stats_tell_the_time_of_each_stage() {
    let mut h = harness(2, &numbered_caps());
    let stats = |h: &gst_check::Harness| h.element().unwrap().property::<gst::Structure>("stats");
    let stages = ["correspond-ms", "solve-ms", "warp-ms"];
    let times = |stats: &gst::Structure| stages.map(|stage| stats.get::<f64>(stage).unwrap());
    assert_eq!(times(&stats(&h)), [0.0; 3]);
    (0..8).for_each(|number| assert!(h.push(panned(number, number)).is_ok()));
    // Other settings mean another rectifier: the time that the first one took still counts.
    h.element().unwrap().set_property("readout-time", 20_000_000u64);
    (8..12).for_each(|number| assert!(h.push(panned(number, number)).is_ok()));
    h.push_event(gst::event::Eos::new());
    let stats = stats(&h);
    assert_eq!(stats.get::<u64>("frames").unwrap(), 12);
    assert!(times(&stats).iter().all(|ms| *ms > 0.0 && *ms < 10_000.0), "{stats}");
}
