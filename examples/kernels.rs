// SPDX-License-Identifier: MIT OR Apache-2.0

//! The kernels alone, 640 × 480, for counting their instructions: `scripts/count-kernels`.
//!
//! ```text
//! cargo run --release --example kernels --features unstable -- Scalar|Portable|Avx2|Neon PART ROUNDS
//! ```
//!
//! A part is `pyramid`; `flow`; `analysis`, the flow and the correspondences sampled from it; or a warp of I420: `warp`,
//! `warp10` in 10 bits; or one of BGRA: `warpbgra`. What N + 1 rounds take less what N take is one round. Prints a checksum of the results: it is the
//! same where they are equal to the last digit.

use nalgebra::Vector2;
use rsrectify::CpuLevel;
use rsrectify::correspond::Sampler;
use rsrectify::flow::DenseFlow;
use rsrectify::motion::{FrameMotion, MotionPath, Twist};
use rsrectify::plane::{Luma, Plane, PlaneLayout, PlaneMut, SampleFormat};
use rsrectify::pyramid::{Pyramid, Reducer};
use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};
use rsrectify::warp::{SampleGrid, WarpSettings, Warper};
use std::error::Error;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;

/// Triangular waves of several lengths, turned and shifted, in 1/64 px; in integers, to take few instructions beside the
/// kernels.
fn frame(turn: i32, shift: [i32; 2]) -> Vec<u8> {
    // Cycles of 14 to 160 px: 2048 over the length.
    const WAVES: [[i32; 2]; 6] = [[130, 66], [-60, 85], [50, -20], [31, 40], [-23, 9], [4, 12]];
    let grey = |x: i32, y: i32| {
        let (u, v) = (64 * x - shift[0] + turn * y, 64 * y - shift[1] - turn * x);
        let waves = WAVES.map(|[a, b]| ((((a * u + b * v) >> 8) & 511) - 256).abs());
        (waves.iter().sum::<i32>() / 6).min(255) as u8
    };
    (0..HEIGHT as i32).flat_map(|y| (0..WIDTH as i32).map(move |x| (x, y))).map(|(x, y)| grey(x, y)).collect()
}

fn luma(data: &[u8]) -> Result<Luma<'_>, Box<dyn Error>> {
    Ok(Plane::new(data, PlaneLayout::packed(WIDTH, HEIGHT, SampleFormat::U8))?.into())
}

/// By Fowler, Noll and Vo.
fn print_checksum(words: impl Iterator<Item = u32>) {
    let add = |sum: u64, word: u32| (sum ^ u64::from(word)).wrapping_mul(0x100_0000_01b3);
    println!("checksum {:016x}", words.fold(0xcbf2_9ce4_8422_2325, add));
}

fn motion() -> Result<FrameMotion, Box<dyn Error>> {
    let readout = Readout::new(WIDTH, HEIGHT, ReadoutDirection::TopToBottom, ReadoutTime::Seconds(1.0), 1.0)?;
    Ok(FrameMotion::new(readout, MotionPath::uniform(Twist::new(0.02, 14.0, -7.0), readout.time())))
}

fn warp_interleaved(level: CpuLevel, rounds: usize) -> Result<(), Box<dyn Error>> {
    let mut warper = Warper::with_cpu(level);
    let frame = warper.prepare(&motion()?, &WarpSettings::default());
    let packed = PlaneLayout::packed(WIDTH, HEIGHT, SampleFormat::U8);
    let layout = PlaneLayout { stride: 4 * WIDTH, step: 4, channels: 4, ..packed };
    let data: Vec<u8> = (0..4 * WIDTH * HEIGHT).map(|i| (i % 251) as u8).collect();
    let mut target = data.clone();
    let source = Plane::new(&data, layout)?;
    for _ in 0..rounds {
        frame.warp(&source, &mut PlaneMut::new(&mut target, layout)?, SampleGrid::FULL)?;
    }
    print_checksum(target.into_iter().map(u32::from));
    Ok(())
}

fn warp(level: CpuLevel, format: SampleFormat, rounds: usize) -> Result<(), Box<dyn Error>> {
    let mut warper = Warper::with_cpu(level);
    let frame = warper.prepare(&motion()?, &WarpSettings::default());
    // Words of at most 10 bits where a sample has two bytes.
    let source: Vec<u8> = (0..2 * WIDTH * HEIGHT).map(|i| (i % 4) as u8).collect();
    let mut target = source.clone();
    for _ in 0..rounds {
        for (share, grid) in [(1, SampleGrid::FULL), (2, SampleGrid::CHROMA_420), (2, SampleGrid::CHROMA_420)]
        {
            let layout = PlaneLayout::packed(WIDTH / share, HEIGHT / share, format);
            let (source, mut target) = (Plane::new(&source, layout)?, PlaneMut::new(&mut target, layout)?);
            frame.warp(&source, &mut target, grid)?;
        }
    }
    print_checksum(target.into_iter().map(u32::from));
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [level, part, rounds] = arguments.as_slice() else {
        return Err("give a level of the CPU, a part, and the number of rounds".into());
    };
    let level = CpuLevel::supported().find(|known| known.to_string() == *level);
    let level = level.ok_or("this machine has no such level")?;
    let rounds: usize = rounds.parse()?;
    match part.as_str() {
        "warp" => return warp(level, SampleFormat::U8, rounds),
        "warp10" => return warp(level, SampleFormat::U10, rounds),
        "warpbgra" => return warp_interleaved(level, rounds),
        _ => {}
    }
    let (first, second) = (frame(0, [0, 0]), frame(1, [600, -275]));
    let reducer = Reducer::new(WIDTH, HEIGHT);
    let (mut from, mut to) = (Pyramid::new(), Pyramid::new());
    reducer.build(&luma(&first)?, &mut from);
    reducer.build(&luma(&second)?, &mut to);
    let mut flow = DenseFlow::with_cpu(level, &reducer);
    let mut sampler = Sampler::with_cpu(level, WIDTH, HEIGHT, 32, 24);
    let mut out = Vec::new();
    for _ in 0..rounds {
        match part.as_str() {
            "pyramid" => reducer.build(&luma(&second)?, &mut to),
            "flow" => flow.estimate(&from, &to, |x: Vector2<f64>| x),
            "analysis" => sampler.correspond(&from, &to, |x: Vector2<f64>| x, &mut out),
            _ => return Err(format!("no part is called {part}").into()),
        }
    }
    let cells = flow.forward().cells().iter().chain(flow.backward().cells());
    let flow = cells.flat_map(|cell| [cell.flow[0], cell.flow[1], cell.confidence].map(f32::to_bits));
    let ends = out.iter().flat_map(|found| [found.to.x, found.to.y, found.covariance.m11]);
    print_checksum(flow.chain(ends.map(|value| (value as f32).to_bits())));
    Ok(())
}
