//! Latency, position, quality of service.

mod common;

use common::*;
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
    assert_eq!(latency_of(4, (0, 1)), gst::ClockTime::ZERO, "a variable frame rate says nothing");
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

/// Pushes 10 frames that move, the fifth of which the sink has no use for.
fn late_frames(qos: bool) -> (Vec<gst::Buffer>, Vec<gst::Buffer>, Vec<gst::Message>) {
    let mut h = harness(0, &numbered_caps());
    warp_always(&h);
    h.element().unwrap().set_property("qos", qos);
    let bus = bus(&h);
    let frames: Vec<_> = (0..10).map(numbered).collect();
    for (number, frame) in frames.iter().enumerate() {
        if number == 4 {
            // Late by 0: the frames up to 4 and one frame duration more are lost.
            h.push_upstream_event(gst::event::Qos::new(gst::QOSType::Underflow, 1.2, 0, time(4)));
        }
        h.push(frame.clone()).unwrap();
    }
    (frames, arrived(&mut h), messages(&bus, gst::MessageType::Qos))
}

#[test]
fn a_late_frame_goes_out_as_it_came() {
    let (frames, out, messages) = late_frames(true);
    assert_eq!(numbers(&out), (0..10).collect::<Vec<_>>());
    let untouched: Vec<_> = (0..10).filter(|&i| frames[i].as_ptr() == out[i].as_ptr()).collect();
    assert_eq!(untouched, [4]);
    let gst::MessageView::Qos(message) = messages[0].view() else { unreachable!() };
    assert_eq!((messages.len(), message.timestamp()), (1, Some(time(4))));
}

#[test]
fn qos_can_be_turned_off() {
    let (frames, out, messages) = late_frames(false);
    assert!((0..10).all(|i| frames[i].as_ptr() != out[i].as_ptr()));
    assert!(messages.is_empty());
}

#[test]
fn a_qos_message_says_whether_the_source_is_live() {
    for live in [false, true] {
        let mut h = harness(0, &numbered_caps());
        warp_always(&h);
        let bus = bus(&h);
        let upstream = h.srcpad().unwrap();
        upstream.add_probe(gst::PadProbeType::QUERY_UPSTREAM, move |_, info| {
            if let Some(gst::QueryViewMut::Latency(query)) = info.query_mut().map(|query| query.view_mut()) {
                query.set(live, gst::ClockTime::ZERO, None);
                return gst::PadProbeReturn::Handled;
            }
            gst::PadProbeReturn::Ok
        });
        h.query_latency();
        h.push_upstream_event(gst::event::Qos::new(gst::QOSType::Underflow, 1.2, 0, time(4)));
        h.push(numbered(0)).unwrap();
        let messages = messages(&bus, gst::MessageType::Qos);
        let gst::MessageView::Qos(message) = messages[0].view() else { unreachable!() };
        assert_eq!(message.get().0, live);
    }
}

#[test]
fn qos_events_go_on_upstream() {
    let mut h = harness(0, &numbered_caps());
    h.push_upstream_event(gst::event::Qos::new(gst::QOSType::Underflow, 1.2, 5, time(4)));
    let forwarded = std::iter::from_fn(|| h.try_pull_upstream_event());
    assert_eq!(forwarded.filter(|event| event.type_() == gst::EventType::Qos).count(), 1);
}

#[test]
fn a_live_pipeline_drops_nothing() {
    init();
    // Without the latency of 8 frames (800 ms) every frame would come more than 400 ms late; few frames a second, so that
    // a machine with other work keeps up.
    let pipeline = gst::parse::launch(
        "videotestsrc is-live=true num-buffers=25 ! video/x-raw,width=160,height=120,framerate=10/1 \
         ! rsrectify lookahead=8 ! fakesink name=sink sync=true qos=true max-lateness=400000000",
    )
    .unwrap()
    .downcast::<gst::Pipeline>()
    .unwrap();
    let sink = pipeline.by_name("sink").unwrap();
    run_to_eos(&pipeline);
    let stats = sink.property::<gst::Structure>("stats");
    let counts = (stats.get::<u64>("rendered").unwrap(), stats.get::<u64>("dropped").unwrap());
    pipeline.set_state(gst::State::Null).unwrap();
    assert_eq!(counts, (25, 0));
}
