// SPDX-License-Identifier: MIT OR Apache-2.0

//! The element put into a pipeline that plays, and taken out again.
//!
//! `insert` and `remove` are shown in docs/gstreamer.md: change both.

use crate::common::film::{launch, shown};
use crate::common::*;
use gst::prelude::*;

/// Puts `filter` behind `pad`, a source pad of a playing pipeline.
fn insert(pad: &gst::Pad, filter: &gst::Element) {
    let filter = filter.clone();
    pad.add_probe(gst::PadProbeType::BLOCK_DOWNSTREAM, move |pad, _| {
        let next = pad.peer().expect("linked");
        let bin = pad.parent_element().and_then(|element| element.parent());
        let bin = bin.and_downcast::<gst::Bin>().expect("in a bin");
        bin.add(&filter).expect("in no other bin");
        pad.unlink(&next).expect("were linked");
        pad.link(&filter.static_pad("sink").expect("has one")).expect("same caps");
        filter.static_pad("src").expect("has one").link(&next).expect("same caps");
        filter.sync_state_with_parent().expect("starts");
        gst::PadProbeReturn::Remove
    });
}

/// Takes `filter` out again; the frames that it holds go on first.
fn remove(filter: &gst::Element) {
    let filter = filter.clone();
    let sink = filter.static_pad("sink").expect("has one");
    let pad = sink.peer().expect("linked");
    pad.add_probe(gst::PadProbeType::BLOCK_DOWNSTREAM, move |pad, _| {
        let source = filter.static_pad("src").expect("has one");
        let next = source.peer().expect("linked");
        // The end of the stream lets the element give out what it holds; it must not go any further.
        source.add_probe(gst::PadProbeType::EVENT_DOWNSTREAM, |_, info| match info.event() {
            Some(event) if event.type_() == gst::EventType::Eos => gst::PadProbeReturn::Drop,
            _ => gst::PadProbeReturn::Ok,
        });
        sink.send_event(gst::event::Eos::new());
        pad.unlink(&sink).expect("were linked");
        source.unlink(&next).expect("were linked");
        pad.link(&next).expect("same caps");
        let bin = filter.parent().and_downcast::<gst::Bin>().expect("in a bin");
        bin.remove(&filter).expect("was in it");
        filter.set_state(gst::State::Null).expect("stops");
        gst::PadProbeReturn::Remove
    });
}

/// A pipeline that shows what it is given; its source, the pad behind which elements are put, its sink.
fn pipeline() -> (gst::Pipeline, gst_app::AppSrc, gst::Pad, gst_app::AppSink) {
    let pipeline = launch(
        "appsrc name=in format=time max-buffers=2 block=true ! identity name=before ! appsink name=out sync=false",
    );
    let named = |name| pipeline.by_name(name).unwrap();
    let input = named("in").downcast::<gst_app::AppSrc>().unwrap();
    input.set_caps(Some(&numbered_caps()));
    let output = named("out").downcast::<gst_app::AppSink>().unwrap();
    let pad = named("before").static_pad("src").unwrap();
    pipeline.set_state(gst::State::Playing).unwrap();
    (pipeline, input, pad, output)
}

fn rectifier() -> gst::Element {
    gst::ElementFactory::make("rsrectify").build().unwrap()
}

fn frames(filter: &gst::Element) -> u64 {
    filter.property::<gst::Structure>("stats").get("frames").unwrap()
}

/// The numbers of the next frames, as the picture shows them and as their time tells.
fn pull(output: &gst_app::AppSink, count: usize) -> Vec<usize> {
    let sample = |_| output.try_pull_sample(gst::ClockTime::from_seconds(60)).expect("a frame");
    let number = |sample: gst::Sample| {
        let number = numbers(&[sample.buffer_owned().unwrap()])[0];
        assert_eq!(shown(&sample), number);
        number
    };
    (0..count).map(sample).map(number).collect()
}

#[test]
fn an_element_put_in_and_taken_out_loses_no_frame() {
    let (pipeline, input, pad, output) = pipeline();
    let push = |frames: std::ops::Range<usize>| {
        frames.for_each(|number| assert!(input.push_buffer(numbered(number)).is_ok()));
    };
    push(0..20);
    assert_eq!(pull(&output, 20), Vec::from_iter(0..20));
    let filter = rectifier();
    insert(&pad, &filter);
    push(20..60);
    // The element holds four frames.
    assert_eq!(pull(&output, 36), Vec::from_iter(20..56));
    remove(&filter);
    push(60..100);
    input.end_of_stream().unwrap();
    assert_eq!(pull(&output, 44), Vec::from_iter(56..100));
    wait_for(&pipeline, gst::MessageType::Eos);
    assert_eq!(frames(&filter), 40);
    assert!(filter.parent().is_none() && filter.current_state() == gst::State::Null);
    pipeline.set_state(gst::State::Null).unwrap();
}

#[test]
fn elements_put_in_and_taken_out_at_any_time_lose_no_frame() {
    const FRAMES: usize = 300;
    let (pipeline, input, pad, output) = pipeline();
    let pusher = std::thread::spawn(move || {
        for number in 0..FRAMES {
            input.push_buffer(numbered(number)).unwrap();
        }
        input.end_of_stream().unwrap();
    });
    let wait = |until: &dyn Fn() -> bool| {
        while !until() && !pusher.is_finished() {
            std::thread::sleep(std::time::Duration::from_micros(300));
        }
    };
    let mut used = 0;
    while !pusher.is_finished() {
        let filter = rectifier();
        insert(&pad, &filter);
        wait(&|| frames(&filter) > used % 7);
        if filter.parent().is_some() {
            remove(&filter);
            wait(&|| filter.parent().is_none());
            used += 1;
        }
    }
    pusher.join().unwrap();
    assert_eq!(pull(&output, FRAMES), Vec::from_iter(0..FRAMES));
    wait_for(&pipeline, gst::MessageType::Eos);
    pipeline.set_state(gst::State::Null).unwrap();
    assert!(used > 20, "only {used} elements were put in");
}

/// The text between two lines of this file.
fn code() -> &'static str {
    let this = include_str!("inserting.rs");
    let start = this.find("/// Puts `filter` behind").unwrap();
    let end = this.find("/// A pipeline that shows").unwrap();
    this[start..end].trim_end()
}

#[test]
fn the_documents_show_the_code_that_is_tested() {
    let documents = include_str!("../../docs/gstreamer.md");
    assert!(documents.contains(&format!("```rust\n{}\n```", code())));
}
