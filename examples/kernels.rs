//! The kernels alone, 640 × 480, for counting their instructions: `scripts/count-kernels`.
//!
//! ```text
//! cargo run --release --example kernels --features unstable -- Scalar|Portable|Avx2|Neon PART ROUNDS
//! ```
//!
//! A part is `pyramid`; `flow`; `analysis`, the flow and the correspondences sampled from it; or a warp of I420: `warp`,
//! `warp10` in 10 bits. What N + 1 rounds take less what N take is one round.

use nalgebra::Vector2;
use rsrectify::CpuLevel;
use rsrectify::correspond::Sampler;
use rsrectify::flow::DenseFlow;
use rsrectify::motion::{FrameMotion, MotionPath, Twist};
use rsrectify::plane::{Luma, Plane, PlaneLayout, PlaneMut, SampleFormat};
use rsrectify::pyramid::{Pyramid, Reducer};
use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};
use rsrectify::warp::{Placement, WarpSettings, Warper};
use std::error::Error;
use std::f64::consts::TAU;
use std::hint::black_box;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const CHROMA: Placement = Placement { scale: [2.0, 2.0], offset: [0.0, 0.5] };

/// Waves of several lengths, turned by 0.02 rad and shifted.
fn frame(turn: f64, shift: [f64; 2]) -> Vec<u8> {
    let grey = |x: f64, y: f64| {
        let waves = (0..10).map(f64::from).map(|wave| {
            let (sin, cos) = (wave * 2.4).sin_cos();
            (8.0 + 0.5 * wave) * (TAU * (cos * x + sin * y) / (14.0 * 1.5f64.powf(wave)) + wave).sin()
        });
        (128.0 + waves.sum::<f64>()).clamp(0.0, 255.0) as u8
    };
    let moved = |x: f64, y: f64| grey(x - shift[0] + turn * y, y - shift[1] - turn * x);
    (0..WIDTH * HEIGHT).map(|i| moved((i % WIDTH) as f64, (i / WIDTH) as f64)).collect()
}

fn luma(data: &[u8]) -> Result<Luma<'_>, Box<dyn Error>> {
    Ok(Plane::new(data, PlaneLayout::packed(WIDTH, HEIGHT, SampleFormat::U8))?.into())
}

fn warp(level: CpuLevel, format: SampleFormat, rounds: usize) -> Result<(), Box<dyn Error>> {
    let readout = Readout::new(WIDTH, HEIGHT, ReadoutDirection::TopToBottom, ReadoutTime::Seconds(1.0), 1.0)?;
    let motion = FrameMotion::new(readout, MotionPath::uniform(Twist::new(0.02, 14.0, -7.0), readout.time()));
    let mut warper = Warper::with_cpu(level);
    let frame = warper.prepare(&motion, &WarpSettings::default());
    // Words of at most 10 bits where a sample has two bytes.
    let source: Vec<u8> = (0..2 * WIDTH * HEIGHT).map(|i| (i % 4) as u8).collect();
    let mut target = source.clone();
    for _ in 0..rounds {
        for (share, placement) in [(1, Placement::FULL), (2, CHROMA), (2, CHROMA)] {
            let layout = PlaneLayout::packed(WIDTH / share, HEIGHT / share, format);
            let (source, mut target) = (Plane::new(&source, layout)?, PlaneMut::new(&mut target, layout)?);
            frame.warp(&source, &mut target, placement, [0; 4])?;
        }
        black_box(&target);
    }
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
        _ => {}
    }
    let (first, second) = (frame(0.0, [0.0, 0.0]), frame(0.02, [9.4, -4.3]));
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
    black_box((&flow, &out));
    Ok(())
}
