// SPDX-License-Identifier: MIT OR Apache-2.0

//! Processor time that the filter takes for a frame.
//!
//! ```text
//! cargo run --release -p frei0r-plugin-rsrectify --example frame_time -- [WIDTH HEIGHT [FRAMES]]
//! ```
//!
//! 3840 × 2160 and 100 frames, unless others are given. The frames are shaken, with a mesh of residual velocities as of a scene with
//! parallax. Linux only: what other programs take at the same time does not count.

use frei0r_rsrectify::Filter;
use nalgebra::Matrix3;
use rsrectify::motion::file::{Clip, MotionRecord, MotionWriter};
use rsrectify::motion::{FrameMotion, MotionPath, ResidualField, ResidualMesh, SampledPath};
use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};
use std::error::Error;
use std::ffi::CString;
use std::fs::{self, File};

const PERIOD: f64 = 0.04;

fn motion(width: usize, height: usize) -> Result<FrameMotion, Box<dyn Error>> {
    let readout =
        Readout::new(width, height, ReadoutDirection::TopToBottom, ReadoutTime::Seconds(0.03), PERIOD)?;
    let path: Vec<_> = (0..=32)
        .map(|index| {
            let share = f64::from(index) / 32.0;
            let (sin, cos) = (0.01 * (3.0 * share).sin()).sin_cos();
            let shift = 0.01 * width as f64 * (5.0 * share).cos();
            Matrix3::new(cos, -sin, shift, sin, cos, 0.3 * shift, 0.0, 0.0, 1.0)
        })
        .collect();
    let (columns, rows) = (120, 68);
    let spacing = [width as f64 / columns as f64, height as f64 / rows as f64];
    let origin = [(spacing[0] - width as f64) / 2.0, (spacing[1] - height as f64) / 2.0];
    let velocity = |node: usize| {
        let (x, y) = ((node % columns) as f32, (node / columns) as f32);
        [12.0 * (x / 9.0 + y / 7.0).sin(), 5.0 * (x / 5.0).cos() * (y / 11.0).sin()]
    };
    let mesh = ResidualMesh { columns, rows, origin, spacing };
    let field = ResidualField::new(mesh, (0..columns * rows).map(velocity).collect())?;
    let path = MotionPath::from(SampledPath::new(&path, readout.time())?).with_residual(field);
    Ok(FrameMotion::new(readout, path))
}

/// Nanoseconds for which this thread has run.
fn processor_time() -> Result<u64, Box<dyn Error>> {
    let text = fs::read_to_string("/proc/thread-self/schedstat")?;
    Ok(text.split(' ').next().ok_or("no time")?.parse()?)
}

fn main() -> Result<(), Box<dyn Error>> {
    let numbers = std::env::args().skip(1).map(|text| text.parse()).collect::<Result<Vec<usize>, _>>()?;
    let number = |index: usize, default| numbers.get(index).copied().unwrap_or(default);
    let (width, height, frames) = (number(0, 3840), number(1, 2160), number(2, 100));
    let path = std::env::temp_dir().join(format!("rsrectify-frame-time-{}.motion", std::process::id()));
    let mut writer = MotionWriter::new(File::create(&path)?, Clip::default())?;
    for frame in 0..frames {
        let time = (frame as f64 * PERIOD * 1e9) as i64;
        writer.push(&MotionRecord::new(time, motion(width, height)?))?;
    }
    writer.finish()?;
    let filter = Filter::new(width, height);
    filter.set_text(0, &CString::new(path.to_string_lossy().into_owned())?);
    fs::remove_file(&path)?;
    let bytes = filter.frame_bytes().ok_or("too large")?;
    let input: Vec<u8> =
        (0..bytes).map(|index| (index / 4 % 251) as u8 ^ (index / (4 * width)) as u8).collect();
    let mut output = vec![0; bytes];
    filter.update(0.0, &input, &mut output);
    if output == input {
        return Err("the frame stayed as it is".into());
    }
    let start = processor_time()?;
    for frame in 1..frames {
        filter.update(frame as f64 * PERIOD, &input, &mut output);
    }
    let time = (processor_time()? - start) as f64 * 1e-6 / (frames - 1).max(1) as f64;
    println!("{width} x {height}: {time:.1} ms of processor time a frame");
    Ok(())
}
