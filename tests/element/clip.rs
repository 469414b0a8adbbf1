// SPDX-License-Identifier: MIT OR Apache-2.0

//! A numbered clip in whole pipelines: every frame by its picture, not only by its timestamp.

use crate::common::film::{FRAMES, Film, film, launch, shown};
use crate::common::*;
use gst::prelude::*;
use std::path::Path;
use std::sync::LazyLock;

/// The film decoded through `filter` into an appsink, paused at its start.
fn player(film: &Path, filter: &str) -> (gst::Pipeline, gst_app::AppSink) {
    let pipeline = launch(&format!(
        "filesrc location={} ! decodebin ! videoconvert ! {filter} ! videoconvert ! video/x-raw,format=GRAY8 \
         ! appsink name=out sync=false max-buffers=200",
        film.display()
    ));
    let sink = pipeline.by_name("out").unwrap().downcast::<gst_app::AppSink>().unwrap();
    pipeline.set_state(gst::State::Paused).unwrap();
    wait_for(&pipeline, gst::MessageType::AsyncDone);
    (pipeline, sink)
}

/// The numbers that come until the stream or segment ends.
fn play(pipeline: &gst::Pipeline, sink: &gst_app::AppSink, until: gst::MessageType) -> Vec<usize> {
    pipeline.set_state(gst::State::Playing).unwrap();
    let mut numbers = Vec::new();
    if until == gst::MessageType::SegmentDone {
        // The demuxer says so before the decoder has given out its last frames, and a filter that waits for many has not
        // begun then.
        wait_for(pipeline, until);
        let first = sink.try_pull_sample(gst::ClockTime::from_seconds(60));
        let next = || sink.try_pull_sample(gst::ClockTime::from_seconds(1));
        numbers.extend(first.into_iter().chain(std::iter::from_fn(next)).map(|sample| shown(&sample)));
    } else {
        numbers.extend(std::iter::from_fn(|| sink.pull_sample().ok()).map(|sample| shown(&sample)));
    }
    numbers
}

/// What each filter of a film shows after a seek.
fn after_seek(film: &Film, filter: &str, seek: &Seek) -> Vec<usize> {
    let (pipeline, sink) = player(&film.0, filter);
    let flags = gst::SeekFlags::FLUSH | gst::SeekFlags::ACCURATE | seek.flags;
    let (start, stop) =
        (gst::ClockTime::from_mseconds(seek.start), seek.stop.map(gst::ClockTime::from_mseconds));
    let stop_type = if stop.is_some() { gst::SeekType::Set } else { gst::SeekType::End };
    let stop = stop.unwrap_or(gst::ClockTime::ZERO);
    pipeline.seek(seek.rate, flags, gst::SeekType::Set, start, stop_type, stop).unwrap();
    let segment = seek.flags.contains(gst::SeekFlags::SEGMENT);
    let until = if segment { gst::MessageType::SegmentDone } else { gst::MessageType::Eos };
    let numbers = play(&pipeline, &sink, until);
    pipeline.set_state(gst::State::Null).unwrap();
    numbers
}

struct Seek {
    rate: f64,
    start: u64,
    stop: Option<u64>,
    flags: gst::SeekFlags,
}

const NONE: gst::SeekFlags = gst::SeekFlags::empty();
const SEEKS: [Seek; 7] = [
    Seek { rate: 1.0, start: 0, stop: None, flags: NONE },
    Seek { rate: 1.0, start: 700, stop: None, flags: NONE },
    Seek { rate: 1.0, start: 500, stop: Some(1200), flags: NONE },
    Seek { rate: 2.0, start: 300, stop: None, flags: NONE },
    Seek { rate: 1.0, start: 400, stop: Some(1500), flags: gst::SeekFlags::SEGMENT },
    Seek { rate: -1.0, start: 0, stop: Some(1000), flags: NONE },
    Seek { rate: -1.0, start: 500, stop: Some(1800), flags: NONE },
];

static FILTERS: LazyLock<Vec<String>> = LazyLock::new(|| {
    ["lookahead=0", "", "lookahead=64", "border-mode=crop"].map(|n| format!("rsrectify {n}")).to_vec()
});

#[test]
fn a_film_from_start_to_end() {
    let film = film("play");
    for filter in FILTERS.iter() {
        let (pipeline, sink) = player(&film.0, filter);
        assert_eq!(
            play(&pipeline, &sink, gst::MessageType::Eos),
            (0..FRAMES).collect::<Vec<_>>(),
            "{filter}"
        );
        pipeline.set_state(gst::State::Null).unwrap();
    }
}

#[test]
fn every_seek_shows_what_it_shows_without_the_element() {
    let film = film("seek");
    for seek in &SEEKS {
        let truth = after_seek(&film, "identity", seek);
        assert!(truth.len() > 15, "{truth:?}");
        for filter in FILTERS.iter() {
            assert_eq!(after_seek(&film, filter, seek), truth, "{filter}, rate {}", seek.rate);
        }
    }
}

#[test]
fn scrubbing_always_shows_the_right_first_frame() {
    let film = film("scrub");
    let (pipeline, sink) = player(&film.0, "rsrectify");
    for step in 0..20 {
        let number = step * 23 % (FRAMES - 1);
        let target = time(number) + gst::ClockTime::from_mseconds(5);
        pipeline.seek_simple(gst::SeekFlags::FLUSH | gst::SeekFlags::ACCURATE, target).unwrap();
        wait_for(&pipeline, gst::MessageType::AsyncDone);
        assert_eq!(shown(&sink.pull_preroll().unwrap()), number);
    }
    pipeline.set_state(gst::State::Null).unwrap();
}

#[test]
fn streams_of_different_sizes_one_after_another() {
    let pipeline = launch(
        "concat name=c ! rsrectify ! appsink name=out sync=false \
         videotestsrc num-buffers=11 ! video/x-raw,format=I420,width=64,height=48,framerate=30/1 ! c. \
         videotestsrc num-buffers=7 ! video/x-raw,format=NV12,width=66,height=50,framerate=25/1 ! c. \
         videotestsrc num-buffers=5 ! video/x-raw,format=NV12,width=66,height=50,framerate=25/1 ! c.",
    );
    let sink = pipeline.by_name("out").unwrap().downcast::<gst_app::AppSink>().unwrap();
    pipeline.set_state(gst::State::Playing).unwrap();
    let widths: Vec<i32> = std::iter::from_fn(|| sink.pull_sample().ok())
        .map(|sample| sample.caps().unwrap().structure(0).unwrap().get("width").unwrap())
        .collect();
    pipeline.set_state(gst::State::Null).unwrap();
    assert_eq!(widths, [vec![64; 11], vec![66; 12]].concat());
}

#[test]
fn a_branch_beside_one_without_the_element() {
    let pipeline = launch(
        "videotestsrc num-buffers=40 ! video/x-raw,format=I420,width=320,height=240,framerate=30/1 ! tee name=t \
         t. ! queue ! rsrectify lookahead=8 ! m. t. ! queue ! m. \
         compositor name=m sink_1::xpos=320 ! appsink name=out sync=false",
    );
    let sink = pipeline.by_name("out").unwrap().downcast::<gst_app::AppSink>().unwrap();
    pipeline.set_state(gst::State::Playing).unwrap();
    let count = std::iter::from_fn(|| sink.pull_sample().ok()).count();
    pipeline.set_state(gst::State::Null).unwrap();
    assert_eq!(count, 40);
}

#[test]
fn many_states_in_a_row() {
    let pipeline = launch("videotestsrc ! rsrectify lookahead=8 border-mode=crop ! fakesink sync=true");
    use gst::State::{Null, Paused, Playing, Ready};
    for state in [Playing, Paused, Ready, Paused, Null, Playing, Ready, Playing].repeat(4) {
        pipeline.set_state(state).unwrap();
    }
    let (result, state, _) = pipeline.state(gst::ClockTime::from_seconds(30));
    pipeline.set_state(Null).unwrap();
    assert!(result.is_ok() && state == Playing);
}
