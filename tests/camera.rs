//! What the element learns of a camera from the picture, and how long it remembers it.
//!
//! The film is a texture, known at every point, that a camera shakes while it reads rows from the
//! bottom up in 0.6 of the frame period: the row exposed at t shows the texture shifted by X(t).

mod common;

use common::*;
use gst::prelude::*;
use gst_check::Harness;

const FPS: f64 = 30.0;
/// Share of the frame period that the readout takes.
const RATIO: f64 = 0.6;
/// Frames after which the camera is known.
const ENOUGH: usize = 24;

/// Where the picture is at a time in seconds: two tones an axis, up to 9 px a frame.
fn shake(time: f64) -> (f64, f64) {
    let tone = |hertz: f64, phase: f64| (std::f64::consts::TAU * hertz * time + phase).sin();
    (10.0 * tone(2.3, 0.0) + 5.0 * tone(4.1, 1.0), 8.0 * tone(2.9, 0.5) + 4.0 * tone(4.7, 2.0))
}

/// Smooth noise that never repeats: random values, −1 to 1, on a lattice of 1 px, with a cubic between.
fn noise(x: f64, y: f64) -> f64 {
    let (column, row) = (x.floor(), y.floor());
    let value = |right: f64, down: f64| {
        let (i, j) = ((column + right) as i64, (row + down) as i64);
        let mixed =
            (i.wrapping_mul(0x9e37_79b9_7f4a_7c15u64 as i64) ^ j.wrapping_mul(0x517c_c1b7_2722_0a95)) as u64;
        let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (mixed >> 40) as f64 / 8_388_608.0 - 1.0
    };
    let ease = |t: f64| t * t * (3.0 - 2.0 * t);
    let (u, v) = (ease(x - column), ease(y - row));
    let across = |down: f64| value(0.0, down) * (1.0 - u) + value(1.0, down) * u;
    across(0.0) * (1.0 - v) + across(1.0) * v
}

/// Frame `number` of the film.
fn shaken(number: usize) -> gst::Buffer {
    let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
    let mut pixels = Vec::with_capacity(width * height);
    for row in 0..height {
        let elapsed = 1.0 - (row as f64 + 0.5) / height as f64;
        let (right, down) = shake((number as f64 + RATIO * elapsed) / FPS);
        let y = row as f64 - down;
        pixels.extend((0..width).map(|column| {
            let x = column as f64 - right;
            (128.0 + 60.0 * noise(x / 7.0, y / 7.0) + 60.0 * noise(x / 23.0, y / 23.0)) as u8
        }));
    }
    let mut buffer = gst::Buffer::from_mut_slice(pixels);
    buffer.get_mut().unwrap().set_pts(time(number));
    buffer
}

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
