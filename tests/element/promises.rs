// SPDX-License-Identifier: MIT OR Apache-2.0

//! Promises of a well-behaved filter that no other test shows.

use crate::common::*;
use gst::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex};

#[test]
fn the_most_latency_grows_by_as_much_as_the_least() {
    let mut h = harness(3, &caps("GRAY8", 64, 48, gst::Fraction::new(25, 1)));
    h.push(flat(&caps("GRAY8", 64, 48, gst::Fraction::new(25, 1)), 0)).unwrap();
    let ms = gst::ClockTime::from_mseconds;
    let most = Arc::new(Mutex::new(None));
    let told = most.clone();
    h.srcpad().unwrap().add_probe(gst::PadProbeType::QUERY_UPSTREAM, move |_, info| {
        match info.query_mut().map(|query| query.view_mut()) {
            Some(gst::QueryViewMut::Latency(query)) => {
                query.set(false, ms(10), *told.lock().unwrap());
                gst::PadProbeReturn::Handled
            }
            _ => gst::PadProbeReturn::Ok,
        }
    });
    let src = h.element().unwrap().static_pad("src").unwrap();
    for upstream in [None, Some(ms(10)), Some(ms(500))] {
        *most.lock().unwrap() = upstream;
        let mut query = gst::query::Latency::new();
        assert!(src.query(query.query_mut()));
        let (_, least, now) = query.result();
        assert_eq!(now.map(|now| now - least), upstream.map(|upstream| upstream - ms(10)));
    }
}

/// An element that plays, between a pad that feeds it and one that calls `chain` with each frame.
struct Bench {
    element: gst::Element,
    upstream: gst::Pad,
    downstream: gst::Pad,
}

impl Bench {
    fn new(
        lookahead: u32,
        chain: impl Fn(&gst::Buffer) -> Result<gst::FlowSuccess, gst::FlowError> + Send + Sync + 'static,
    ) -> Self {
        init();
        let element =
            gst::ElementFactory::make("rsrectify").property("lookahead", lookahead).build().unwrap();
        let upstream = gst::Pad::builder(gst::PadDirection::Src).build();
        let downstream = gst::Pad::builder(gst::PadDirection::Sink)
            .chain_function(move |_, _, buffer| chain(&buffer))
            .event_function(|_, _, _| true)
            .query_function(|pad, parent, query| match query.view_mut() {
                gst::QueryViewMut::Caps(query) => {
                    query.set_result(&query.filter_owned().unwrap_or_else(gst::Caps::new_any));
                    true
                }
                _ => gst::Pad::query_default(pad, parent, query),
            })
            .build();
        upstream.link(&element.static_pad("sink").unwrap()).unwrap();
        element.static_pad("src").unwrap().link(&downstream).unwrap();
        upstream.set_active(true).unwrap();
        downstream.set_active(true).unwrap();
        element.set_state(gst::State::Playing).unwrap();
        let bench = Self { element, upstream, downstream };
        bench.upstream.push_event(gst::event::StreamStart::new("bench"));
        bench.upstream.push_event(gst::event::Caps::new(&numbered_caps()));
        bench.segment();
        bench
    }

    fn segment(&self) {
        let segment = gst::FormattedSegment::<gst::ClockTime>::new();
        self.upstream.push_event(gst::event::Segment::new(&segment));
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.element.set_state(gst::State::Null).unwrap();
    }
}

#[test]
fn a_flush_frees_a_push_that_downstream_blocks() {
    let gate = Arc::new((Mutex::new((0, false)), Condvar::new()));
    let blocked = gate.clone();
    let bench = Bench::new(2, move |_| {
        let mut inside = blocked.0.lock().unwrap();
        inside.0 += 1;
        blocked.1.notify_all();
        // As a sink in preroll: until it is told to flush.
        drop(blocked.1.wait_while(inside, |(_, open)| !*open).unwrap());
        Err(gst::FlowError::Flushing)
    });
    let flushed = gate.clone();
    bench.downstream.add_probe(gst::PadProbeType::EVENT_FLUSH, move |_, _| {
        flushed.0.lock().unwrap().1 = true;
        flushed.1.notify_all();
        gst::PadProbeReturn::Ok
    });
    std::thread::scope(|scope| {
        let pushing = scope.spawn(|| {
            (0..9).try_fold(gst::FlowSuccess::Ok, |_, number| bench.upstream.push(numbered(number)))
        });
        let inside = gate.0.lock().unwrap();
        drop(gate.1.wait_while(inside, |(frames, _)| *frames == 0).unwrap());
        assert!(bench.upstream.push_event(gst::event::FlushStart::new()));
        assert_eq!(pushing.join().unwrap(), Err(gst::FlowError::Flushing));
    });
    assert!(bench.upstream.push_event(gst::event::FlushStop::new(true)));
}

#[test]
fn callbacks_of_the_application_may_call_the_element() {
    let element: Arc<Mutex<Option<gst::Element>>> = Arc::default();
    let calls = Arc::new(AtomicUsize::new(0));
    let call = {
        let (element, calls) = (element.clone(), calls.clone());
        move || {
            let Some(element) = element.lock().unwrap().clone() else { return };
            let strength = element.property::<f64>("strength");
            element.set_property("strength", strength);
            let _ = element.property::<gst::Structure>("stats");
            let src = element.static_pad("src").unwrap();
            src.query(gst::query::Latency::new().query_mut());
            src.query_position::<gst::ClockTime>();
            src.send_event(gst::event::Qos::new(gst::QOSType::Underflow, 1.0, 1, time(1)));
            calls.fetch_add(1, Ordering::SeqCst);
        }
    };
    let on_frame = call.clone();
    let bench = Bench::new(2, move |_| {
        on_frame();
        Ok(gst::FlowSuccess::Ok)
    });
    let bus = gst::Bus::new();
    let messages: Arc<Mutex<Vec<gst::MessageType>>> = Arc::default();
    let noted = messages.clone();
    bus.set_sync_handler(move |_, message| {
        noted.lock().unwrap().push(message.type_());
        call();
        gst::BusSyncReply::Drop
    });
    bench.element.set_bus(Some(&bus));
    bench.element.set_property("post-messages", true);
    *element.lock().unwrap() = Some(bench.element.clone());
    for number in 0..6 {
        assert!(bench.upstream.push(numbered(number)).is_ok());
    }
    let slower = caps("GRAY8", SIZE.0, SIZE.1, gst::Fraction::new(25, 1));
    assert!(bench.upstream.push_event(gst::event::Caps::new(&slower)));
    assert_eq!(bench.downstream.current_caps(), Some(slower));
    bench.upstream.push_event(gst::event::Eos::new());
    *element.lock().unwrap() = None;
    let messages = messages.lock().unwrap();
    let count = |kind| messages.iter().filter(|&&message| message == kind).count();
    assert_eq!((count(gst::MessageType::Element), count(gst::MessageType::Latency)), (6, 1));
    assert!(calls.load(Ordering::SeqCst) >= 13);
    bench.element.set_bus(None);
    bus.unset_sync_handler();
}

#[test]
fn what_downstream_answers_goes_upstream_without_an_error_of_the_element() {
    for answer in [gst::FlowError::Eos, gst::FlowError::NotLinked, gst::FlowError::Error] {
        let bench = Bench::new(0, move |_| Err(answer));
        let bus = gst::Bus::new();
        bench.element.set_bus(Some(&bus));
        assert_eq!(bench.upstream.push(numbered(0)), Err(answer));
        assert!(bus.pop_filtered(&[gst::MessageType::Error, gst::MessageType::Warning]).is_none());
        bench.element.set_bus(None);
    }
}

#[test]
fn events_and_queries_that_it_does_not_know_go_on() {
    let mut h = harness(2, &numbered_caps());
    let unknown = || gst::Structure::new_empty("unheard-of");
    h.push_upstream_event(gst::event::CustomUpstream::new(unknown()));
    let came =
        std::iter::from_fn(|| h.try_pull_upstream_event()).filter(|event| event.has_name("unheard-of"));
    assert_eq!(came.count(), 1);
    let asked = Arc::new(AtomicUsize::new(0));
    for pad in [h.srcpad().unwrap(), h.sinkpad().unwrap()] {
        let asked = asked.clone();
        pad.add_probe(gst::PadProbeType::QUERY_BOTH | gst::PadProbeType::PUSH, move |_, info| {
            if info.query().is_some_and(|query| query.type_() == gst::QueryType::Custom) {
                asked.fetch_add(1, Ordering::SeqCst);
            }
            gst::PadProbeReturn::Ok
        });
    }
    for pad in ["src", "sink"] {
        let pad = h.element().unwrap().static_pad(pad).unwrap();
        pad.query(gst::query::Custom::new(unknown()).query_mut());
    }
    assert_eq!(asked.load(Ordering::SeqCst), 2);
}

#[test]
fn a_renegotiation_that_fails_says_so() {
    let mut h = harness(0, &numbered_caps());
    h.push(numbered(0)).unwrap();
    let refuses = Arc::new(AtomicBool::new(true));
    let now = refuses.clone();
    h.sinkpad().unwrap().add_probe(gst::PadProbeType::QUERY_DOWNSTREAM, move |_, info| {
        match info.query_mut().map(|query| query.view_mut()) {
            Some(gst::QueryViewMut::Caps(query)) if now.load(Ordering::SeqCst) => {
                query.set_result(&gst::Caps::new_empty());
                gst::PadProbeReturn::Handled
            }
            _ => gst::PadProbeReturn::Ok,
        }
    });
    h.push_upstream_event(gst::event::Reconfigure::new());
    assert_eq!(h.push(numbered(1)), Err(gst::FlowError::NotNegotiated));
    // It is tried again with the next frame.
    assert_eq!(h.push(numbered(2)), Err(gst::FlowError::NotNegotiated));
    refuses.store(false, Ordering::SeqCst);
    assert!(h.push(numbered(3)).is_ok());
    assert_eq!(numbers(&arrived(&mut h)), [0, 3]);
}

#[test]
fn a_frame_that_others_hold_is_not_written_to() {
    for lookahead in [0, 3] {
        let mut h = harness(lookahead, &numbered_caps());
        warp_always(&h);
        let frames: Vec<_> = (0..8).map(numbered).collect();
        frames.iter().for_each(|frame| assert!(h.push(frame.clone()).is_ok()));
        h.push_event(gst::event::Eos::new());
        assert_eq!(arrived(&mut h).len(), 8);
        for (number, frame) in frames.iter().enumerate() {
            assert!(frame.map_readable().unwrap().as_slice() == numbered_pixels(number), "frame {number}");
        }
    }
}

#[test]
fn upstream_may_not_leave_the_cropping_to_it() {
    let h = harness(2, &numbered_caps());
    let mut query = gst::query::Allocation::new(Some(&numbered_caps()), true);
    assert!(h.element().unwrap().static_pad("sink").unwrap().query(query.query_mut()));
    assert!(query.find_allocation_meta::<gst_video::VideoMeta>().is_some());
    assert!(query.find_allocation_meta::<gst_video::VideoCropMeta>().is_none());
}

#[test]
fn it_logs_under_its_own_name() {
    let mut h = harness(0, &numbered_caps());
    h.push(numbered(0)).unwrap();
    assert!(gst::DebugCategory::get("rsrectify").is_some());
}
