// SPDX-License-Identifier: MIT OR Apache-2.0

//! Live pipelines: a frame goes out in time, with whatever frame rate the caps claim.

use crate::common::film::launch;
use crate::common::shake::shaken;
use crate::common::*;
use gst::prelude::*;
use gst_check::Harness;

const MS: fn(u64) -> gst::ClockTime = gst::ClockTime::from_mseconds;

/// A harness whose upstream is live with a latency of 10 ms, and whose pipeline was set to the whole latency.
fn live_harness(lookahead: u32, fps: (i32, i32)) -> Harness {
    let mut h = harness(lookahead, &caps("GRAY8", SIZE.0, SIZE.1, gst::Fraction::new(fps.0, fps.1)));
    h.use_testclock();
    h.set_upstream_latency(MS(10));
    distribute_latency(&mut h);
    h
}

/// What a pipeline does when it starts and when it handles a `LATENCY` message.
fn distribute_latency(h: &mut Harness) -> gst::ClockTime {
    let latency = h.query_latency().unwrap();
    h.push_upstream_event(gst::event::Latency::new(latency));
    latency
}

/// Sets the clock, lets those who wait for that time act, and tells which frames have come out: `count` unless
/// something is wrong.
fn at(h: &mut Harness, now: gst::ClockTime, count: usize) -> Vec<gst::Buffer> {
    let clock = h.testclock().unwrap();
    clock.set_time(now);
    let mut out = Vec::new();
    // The limit of ten seconds is for a test that fails; nothing is measured.
    for _ in 0..2000 {
        while clock.next_entry_time().is_some_and(|due| due <= now) {
            clock.process_next_clock_id();
        }
        out.extend(arrived(h));
        if out.len() >= count {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    out
}

fn frame_at(number: usize, pts: gst::ClockTime) -> gst::Buffer {
    let mut frame = shaken(number);
    frame.get_mut().unwrap().set_pts(pts);
    frame
}

#[test]
fn a_frame_goes_out_before_it_is_late_though_the_next_ones_do_not_come() {
    // 4 frames of 33.3 ms are waited for; frames come every 100 ms.
    let mut h = live_harness(4, (30, 1));
    h.push(frame_at(0, MS(0))).unwrap();
    h.push(frame_at(1, MS(100))).unwrap();
    assert!(at(&mut h, MS(140), 0).is_empty(), "10 + 133 ms are not over");
    let out = at(&mut h, MS(150), 1);
    assert_eq!(out.iter().map(|buffer| buffer.pts()).collect::<Vec<_>>(), [Some(MS(0))]);
    h.push(frame_at(2, MS(200))).unwrap();
    let out = at(&mut h, MS(360), 2);
    assert_eq!(out.iter().map(|buffer| buffer.pts()).collect::<Vec<_>>(), [Some(MS(100)), Some(MS(200))]);
}

#[test]
fn a_longer_latency_holds_once_the_pipeline_is_set_to_it() {
    let mut h = live_harness(2, (0, 1));
    let bus = bus(&h);
    let mut out = Vec::new();
    // Whatever the application does, no frame is late.
    for handled in [false, true] {
        let offset = if handled { 3000 } else { 0 };
        for number in 0..30 {
            let pts = MS(offset + 100 * number);
            h.push(frame_at(number as usize, pts)).unwrap();
            out.extend(at(&mut h, pts + MS(99), 0));
        }
        let announced = messages(&bus, gst::MessageType::Latency).len();
        assert_eq!(announced, usize::from(!handled), "told once");
        if !handled {
            // 10 + 67 + 5 ms after its timestamp each frame must be out.
            out.extend(at(&mut h, MS(2999), 30 - out.len()));
            assert_eq!(out.len(), 30);
            assert_eq!(distribute_latency(&mut h), MS(210));
        }
    }
    // Now the last two wait for those that follow them.
    assert_eq!(out.len(), 58);
}

#[test]
fn held_frames_are_rectified_as_far_as_their_motion_is_known() {
    let mut h = live_harness(8, (30, 1));
    let element = h.element().unwrap();
    element.set_property("readout-time", 20_000_000u64);
    element.set_property_from_str("readout-direction", "bottom-to-top");
    // 30 frames a second, but the clock runs so fast that no frame can wait for eight others.
    let mut out = Vec::new();
    for number in 0..30u64 {
        h.push(shaken(number as usize)).unwrap();
        out.extend(at(&mut h, time(number as usize) + MS(400), number as usize + 1 - out.len()));
    }
    let expected: Vec<_> = (0..30).collect();
    assert_eq!(numbers(&out), expected);
    let stats = element.property::<gst::Structure>("stats");
    assert!(stats.get::<u64>("rectified").unwrap() > 25, "{stats:?}");
}

#[test]
fn a_latency_below_what_was_asked_for_is_kept() {
    // 10 + 133 ms are asked for; an interval is kept for the work.
    for (granted, frames) in [(76, 0), (77, 1), (109, 1), (142, 2)] {
        let mut h = live_harness(4, (30, 1));
        h.push_upstream_event(gst::event::Latency::new(MS(granted)));
        let mut out = Vec::new();
        for number in 0..20 {
            h.push(shaken(number)).unwrap();
            // Nobody waits for the timer.
            out.extend(arrived(&mut h));
            assert_eq!(out.len(), (number + 1usize).saturating_sub(frames), "{granted} ms");
        }
        let held = at(&mut h, time(19) + MS(granted) - MS(33), frames);
        out.extend(held);
        assert_eq!(numbers(&out), (0..20).collect::<Vec<_>>(), "{granted} ms");
    }
}

#[test]
fn a_flush_and_a_stop_end_the_wait() {
    let mut h = live_harness(4, (30, 1));
    h.push(frame_at(0, MS(0))).unwrap();
    assert!(h.push_event(gst::event::FlushStart::new()));
    assert!(h.push_event(gst::event::FlushStop::new(true)));
    assert!(at(&mut h, MS(1000), 0).is_empty());
    let element = h.element().unwrap();
    drop(h);
    element.set_state(gst::State::Null).unwrap();
    assert_eq!(element.current_state(), gst::State::Null);
}

/// Plays a live pipeline; how many frames its sink showed and dropped, and how many were rectified.
fn shown_and_dropped(description: &str, latency: Option<gst::ClockTime>) -> (u64, u64, u64) {
    let pipeline = launch(description);
    pipeline.set_latency(latency);
    let (sink, element) = (pipeline.by_name("sink").unwrap(), pipeline.by_name("r").unwrap());
    pipeline.set_state(gst::State::Playing).unwrap();
    let bus = pipeline.bus().unwrap();
    loop {
        let message = bus.timed_pop(gst::ClockTime::from_seconds(60)).expect("nothing happened for a minute");
        match message.view() {
            gst::MessageView::Eos(_) => break,
            gst::MessageView::Latency(_) => pipeline.recalculate_latency().unwrap(),
            gst::MessageView::Error(error) => panic!("{error:?}"),
            _ => (),
        }
    }
    let stats = sink.property::<gst::Structure>("stats");
    let counts = (stats.get::<u64>("rendered").unwrap(), stats.get::<u64>("dropped").unwrap());
    let rectified = element.property::<gst::Structure>("stats").get::<u64>("rectified").unwrap();
    pipeline.set_state(gst::State::Null).unwrap();
    (counts.0, counts.1, rectified)
}

/// Whether the sink of a pipeline shows nearly all of so many frames, rectified: in one of five runs, for the clock is a
/// real one, and a machine with other work may stand still for longer than the sink tolerates. Where frames are held for
/// too long, next to none is shown in any run.
fn shows(description: &str, frames: u64) {
    shows_with(description, frames, None);
}

/// The same in a pipeline that is set to a latency.
fn shows_with(description: &str, frames: u64, latency: Option<gst::ClockTime>) {
    let runs: Vec<_> = (0..5)
        .map(|_| shown_and_dropped(description, latency))
        .inspect(|counts| eprintln!("shown, dropped, rectified: {counts:?}"))
        .take_while(|(shown, _, rectified)| shown.min(rectified) + 3 < frames)
        .collect();
    assert!(runs.len() < 5, "{description}: {runs:?}");
}

/// Frames that are all warped, few a second, and a sink that tolerates 400 ms, so that a machine with other work keeps up.
fn live_pipeline(actual: &str, claimed: &str) -> String {
    format!(
        "videotestsrc is-live=true num-buffers=30 ! video/x-raw,format=I420,width=160,height=120,framerate={actual} \
         ! capssetter caps=video/x-raw,format=I420,framerate={claimed} \
         ! rsrectify name=r lookahead=8 border-mode=crop \
         ! fakesink name=sink sync=true qos=true max-lateness=400000000"
    )
}

#[test]
fn a_true_frame_rate() {
    // Without the latency of 8 frames (800 ms) every frame would come more than 400 ms late.
    shows(&live_pipeline("10/1", "10/1"), 30);
}

#[test]
fn half_the_latency() {
    // 8 frames take 800 ms, the sink asks for another 20: set to 410 ms, every frame would come 390 ms late.
    let pipeline = live_pipeline("10/1", "10/1").replace("max-lateness=400000000", "max-lateness=100000000");
    shows_with(&pipeline, 30, Some(MS(410)));
}

#[test]
fn no_frame_rate() {
    // As VP8, WebRTC and screencasts have it. 8 frames take 1.6 s.
    shows(&live_pipeline("5/1", "0/1"), 30);
}

#[test]
fn half_the_frame_rate() {
    // As a webcam in low light.
    shows(&live_pipeline("5/1", "10/1"), 30);
}

#[test]
fn vp8_over_rtp() {
    shows(
        "videotestsrc is-live=true num-buffers=40 ! video/x-raw,width=160,height=120,framerate=10/1 \
         ! vp8enc deadline=1 ! rtpvp8pay ! rtpjitterbuffer latency=20 ! rtpvp8depay ! vp8dec \
         ! rsrectify name=r lookahead=8 border-mode=crop \
         ! fakesink name=sink sync=true qos=true max-lateness=400000000",
        40,
    );
}
