// SPDX-License-Identifier: MIT OR Apache-2.0

//! The library alone, on planes in memory: luma in, motions out, planes rectified.
//!
//! ```text
//! cargo run --release --example raw_planes                            a picture that sways
//! cargo run --release --example raw_planes -- FRAMES.i420 640 480 30  8-bit 4:2:0 planes from a file
//! ```

use rsrectify::{Duplicate, FrameLayout, Rectifier, SampleFormat, Settings, WarpSettings, Warper};
use std::collections::VecDeque;
use std::error::Error;

/// A frame of 8-bit 4:2:0 video: luma, then two chroma planes of half the size.
struct Frame {
    planes: [Vec<u8>; 3],
    time: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (width, height, rate, frames) = match arguments.as_slice() {
        [] => (640, 480, 30.0, swaying_picture(640, 480, 30.0, 24)),
        [file, width, height, rate] => {
            let (width, height, rate) = (width.parse()?, height.parse()?, rate.parse()?);
            (width, height, rate, frames_of_file(&std::fs::read(file)?, width, height, rate))
        }
        _ => return Err("give no argument, or FILE WIDTH HEIGHT FRAMES_PER_SECOND".into()),
    };

    let layout = FrameLayout::yuv420(width, height, SampleFormat::U8);
    let mut rectifier = Rectifier::new(Settings::default(), width, height, Some(1.0 / rate))?;
    let mut warper = Warper::new();
    let mut waiting = VecDeque::new();
    for frame in frames {
        rectifier.push(&layout.luma(&frame.planes)?, Some(frame.time), Duplicate::Detect)?;
        waiting.push_back(frame);
        give_out(&mut rectifier, &mut warper, &mut waiting, &layout)?;
    }
    rectifier.drain();
    give_out(&mut rectifier, &mut warper, &mut waiting, &layout)
}

/// Rectifies the frames whose motion is known by now.
fn give_out(
    rectifier: &mut Rectifier,
    warper: &mut Warper,
    waiting: &mut VecDeque<Frame>,
    layout: &FrameLayout,
) -> Result<(), Box<dyn Error>> {
    while let Some(solution) = rectifier.pop() {
        let Some(frame) = waiting.pop_front() else { return Err("a motion without a frame".into()) };
        let twist = solution.motion.path().mean_twist();
        println!(
            "{:7.3} s: turns {:+.3} rad/s, moves ({:+7.1}, {:+7.1}) px/s, confidence {:.2}",
            frame.time, twist.omega, twist.velocity.x, twist.velocity.y, solution.confidence
        );
        let mut rectified = frame.planes.clone();
        let prepared = warper.prepare(&solution.motion, &WarpSettings::default());
        prepared.warp_frame(layout, &frame.planes, &mut rectified)?;
        // `rectified` would go to a screen or an encoder here.
    }
    Ok(())
}

fn frames_of_file(bytes: &[u8], width: usize, height: usize, rate: f64) -> Vec<Frame> {
    let (luma, chroma) = (width * height, width.div_ceil(2) * height.div_ceil(2));
    let frames = bytes.chunks_exact((luma + 2 * chroma).max(1)).enumerate();
    frames
        .map(|(k, frame)| {
            let (y, uv) = frame.split_at(luma);
            let (u, v) = uv.split_at(chroma);
            Frame { planes: [y.to_vec(), u.to_vec(), v.to_vec()], time: k as f64 / rate }
        })
        .collect()
}

/// What a camera that sways sideways at 1.5 Hz records of a textured wall when its rows are read
/// one after another through the whole frame period.
fn swaying_picture(width: usize, height: usize, rate: f64, count: usize) -> Vec<Frame> {
    let sway = |time: f64| 30.0 * (1.5 * std::f64::consts::TAU * time).sin();
    let wall = |x: f64, y: f64| {
        let value =
            (x * 0.11).sin() * (y * 0.13).cos() + (x * 0.031 + y * 0.047).sin() + (x * 0.27 - y * 0.2).cos();
        (128.0 + 36.0 * value) as u8
    };
    let frame = |k: usize| {
        let time = k as f64 / rate;
        let row = |y: usize| {
            let exposed = time + (y as f64 + 0.5) / height as f64 / rate;
            (0..width).map(move |x| wall(x as f64 - sway(exposed), y as f64))
        };
        let grey = vec![128; width.div_ceil(2) * height.div_ceil(2)];
        Frame { planes: [(0..height).flat_map(row).collect(), grey.clone(), grey], time }
    };
    (0..count).map(frame).collect()
}
