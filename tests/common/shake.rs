// SPDX-License-Identifier: MIT OR Apache-2.0

//! A film by a shaken camera whose readout is known.
//!
//! It shows a texture, known at every point, while the rows are read from the bottom up in 0.6 of the frame
//! period: the row exposed at t shows the texture shifted by X(t).

use super::{FRAME, SIZE, film, numbered_caps, time, wait_for};
use gst::prelude::*;
use std::path::Path;

/// Frames a second.
pub const FPS: f64 = 30.0;
/// Share of the frame period that the readout takes.
pub const RATIO: f64 = 0.6;

/// Where the picture is at a time in seconds: two tones an axis, up to 9 px a frame.
pub fn shake(time: f64) -> (f64, f64) {
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
pub fn shaken(number: usize) -> gst::Buffer {
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

/// Writes `seconds` of the film into an MP4 file.
pub fn write_shaken(path: &Path, seconds: f64) {
    write_film(path, (seconds * FPS) as usize, shaken);
}

/// Writes so many frames of any film of this kind into an MP4 file.
pub fn write_film(path: &Path, frames: usize, frame: impl Fn(usize) -> gst::Buffer) {
    let pipeline = film::launch(&format!(
        "appsrc name=in format=time ! videoconvert ! x264enc quantizer=15 pass=qual vbv-buf-capacity=0 key-int-max=30 \
         speed-preset=ultrafast ! mp4mux ! filesink location={}",
        path.display()
    ));
    let input = pipeline.by_name("in").unwrap().downcast::<gst_app::AppSrc>().unwrap();
    input.set_caps(Some(&numbered_caps()));
    pipeline.set_state(gst::State::Playing).unwrap();
    for number in 0..frames {
        let mut buffer = frame(number);
        // Without a duration the last frame is not shown.
        buffer.get_mut().unwrap().set_duration(FRAME);
        assert!(input.push_buffer(buffer).is_ok());
    }
    input.end_of_stream().unwrap();
    wait_for(&pipeline, gst::MessageType::Eos);
    pipeline.set_state(gst::State::Null).unwrap();
}
