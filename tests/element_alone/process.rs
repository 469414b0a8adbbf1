// SPDX-License-Identifier: MIT OR Apache-2.0

//! What is counted over the whole process: its memory, its threads, complaints of GStreamer.

use crate::common::*;
use gst::prelude::*;
use std::time::Duration;

#[test]
fn a_meta_of_a_smaller_frame_is_no_programming_error() {
    let complaints = std::sync::Arc::new(std::sync::Mutex::new(Vec::new()));
    let noted = complaints.clone();
    gst::glib::log_set_default_handler(move |_, level, text| {
        if matches!(level, gst::glib::LogLevel::Critical) {
            noted.lock().unwrap().push(text.to_string());
        }
    });
    let caps = caps("NV12", 64, 48, gst::Fraction::new(30, 1));
    for (width, height) in [(63, 48), (64, 47), (1, 1)] {
        for lookahead in [0, 2] {
            let mut h = harness(lookahead, &caps);
            let mut frame = speckled(&caps, 0);
            let flags = gst_video::VideoFrameFlags::empty();
            let format = gst_video::VideoFormat::Nv12;
            gst_video::VideoMeta::add(frame.get_mut().unwrap(), flags, format, width, height).unwrap();
            assert_eq!(h.push(frame), Err(gst::FlowError::Error), "{width}x{height}");
        }
    }
    gst::glib::log_unset_default_handler();
    let complaints = complaints.lock().unwrap();
    assert!(!complaints.iter().any(|text| text.contains("gst_video_frame_map")), "{complaints:?}");
}

/// Resident memory of this process, in kilobytes.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
#[cfg(target_os = "linux")]
fn a_long_film_takes_no_more_memory_than_a_short_one() {
    let caps = caps("I420", 64, 48, gst::Fraction::new(30, 1));
    let mut h = harness(8, &caps);
    h.element().unwrap().set_property("post-messages", true);
    let mut push = |numbers: std::ops::Range<usize>| {
        for number in numbers {
            h.push(speckled(&caps, number)).unwrap();
            arrived(&mut h);
        }
        resident()
    };
    let early = push(0..200);
    let late = push(200..1500);
    // Other tests may run beside it.
    assert!(late < early + 60_000, "{early} kB have become {late} kB");
}

/// Worker threads of this process, which only an element with `threads` makes: other tests run beside this one.
#[cfg(target_os = "linux")]
fn workers() -> usize {
    let tasks = std::fs::read_dir("/proc/self/task").unwrap().flatten();
    let names = tasks.filter_map(|task| std::fs::read_to_string(task.path().join("comm")).ok());
    let number = |name: &String| name.strip_prefix("rsrectify-").and_then(|rest| rest.chars().next());
    names.filter(|name| number(name).is_some_and(|digit| digit.is_ascii_digit())).count()
}

#[test]
#[cfg(target_os = "linux")]
fn its_threads_end_when_it_stops() {
    let mut h = harness(2, &numbered_caps());
    h.element().unwrap().set_property("threads", 5u32);
    (0..5).for_each(|number| assert!(h.push(numbered(number)).is_ok()));
    assert_eq!(workers(), 5);
    h.element().unwrap().set_state(gst::State::Null).unwrap();
    for _ in 0..1000 {
        if workers() == 0 {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("{} threads live on", workers());
}
