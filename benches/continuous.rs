// SPDX-License-Identifier: MIT OR Apache-2.0

//! Time of the continuous estimator for a settled frame of 1920×1080, and of the residual field, on one
//! core and on two.

#![allow(missing_docs)]

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Matrix2, Vector2};
use rayon::ThreadPoolBuilder;
use rsrectify::correspond::Correspondence;
use rsrectify::flow::{Cell, FlowField};
use rsrectify::motion::Model;
use rsrectify::motion::image_centre;
use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};
use rsrectify::solve::continuous::{Camera, Continuous};
use rsrectify::solve::residual::{FrameFlow, LocalMotions, ResidualSolver, Still};
use std::f64::consts::TAU;

const WIDTH: usize = 1920;
const HEIGHT: usize = 1080;
const PERIOD: f64 = 1.0 / 30.0;
/// Share of the period in which the sensor is read.
const GAMMA: f64 = 0.7;
/// Full-frame pixels to an analysed one.
const SCALE: f64 = 2.0;
/// Frames after which the motion repeats.
const CYCLE: usize = 120;
/// Frames that the estimator waits for.
const AHEAD: usize = 4;
/// Frames before the clock starts: the readout is found by then.
const BEFORE: usize = 60;

/// What hands do: where a point is seen at `time`, in frame periods.
fn shaken(point: Vector2<f64>, time: f64) -> Vector2<f64> {
    let wave = |cycles: f64, phase: f64| (TAU * (cycles * time / CYCLE as f64) + phase).sin();
    let shift = Vector2::new(
        40.0 * wave(5.0, 0.0) + 12.0 * wave(19.0, 1.0),
        25.0 * wave(7.0, 2.0) + 9.0 * wave(23.0, 0.5),
    );
    let (sin, cos) = (0.01 * wave(9.0, 0.7)).sin_cos();
    Vector2::new(cos * point.x - sin * point.y, sin * point.x + cos * point.y) + shift
}

/// Where the point seen at `from` of frame `frame` is seen `ahead` frames on; `depth` times as fast as the rest.
fn seen(from: Vector2<f64>, frame: usize, depth: f64) -> Vector2<f64> {
    let centre = image_centre(WIDTH, HEIGHT);
    let time = |frame: usize, y: f64| frame as f64 + GAMMA * (y + 0.5) / HEIGHT as f64;
    let start = time(frame, from.y);
    let mut to = from;
    for _ in 0..8 {
        let moved = shaken(from - centre, time(frame + 1, to.y)) - shaken(from - centre, start);
        to = from + depth * moved;
    }
    to
}

/// The correspondences of a pair on a grid: everything moves `far` times as far as the camera shakes, and what
/// is in the middle `near` times.
fn pair(frame: usize, (columns, rows): (usize, usize), [far, near]: [f64; 2]) -> Vec<Correspondence> {
    let cell = Vector2::new(WIDTH as f64 / columns as f64, HEIGHT as f64 / rows as f64);
    (0..columns * rows)
        .map(|index| {
            let place = Vector2::new((index % columns) as f64 + 0.5, (index / columns) as f64 + 0.5);
            let from = place.component_mul(&cell);
            let is_near = (from - image_centre(WIDTH, HEIGHT)).norm() < 0.25 * WIDTH as f64;
            let phase = (index * 7 + frame * 13) as f64 * 12.9898;
            let error =
                Vector2::new(phase.sin(), (phase * 1.7).cos()) * if index % 20 == 0 { 15.0 } else { 0.06 };
            let to = seen(from, frame, if is_near { near } else { far }) + error;
            Correspondence { from, to, texture: 100.0, residual: 1.0, covariance: Matrix2::zeros() }
        })
        .collect()
}

/// The flow to a neighbour as the residual field sees it, of a path that stands still: what is in the middle moves.
fn flow(direction: f64) -> FlowField {
    let side = 8.0 * SCALE;
    let columns = (WIDTH as f64 / side).ceil() as usize;
    let rows = (HEIGHT as f64 / side).ceil() as usize;
    let cell = |index: usize| {
        let at = Vector2::new((index % columns) as f64, (index / columns) as f64) * side;
        let is_near = (at - image_centre(WIDTH, HEIGHT)).norm() < 0.25 * WIDTH as f64;
        let moved = if is_near { 12.0 * direction } else { 0.0 };
        Cell { flow: [moved as f32, 0.0], confidence: 0.9, information: [10.0, 1.0, 5.0] }
    };
    FlowField::new(columns, side, (0..columns * rows).map(cell).collect()).expect("the rows are complete")
}

/// An estimator that has seen `BEFORE` frames, and the next frame's number.
fn estimator(pairs: &[Vec<Correspondence>], readout_time: ReadoutTime) -> (Continuous, usize) {
    let direction = (readout_time != ReadoutTime::Unknown).then_some(ReadoutDirection::TopToBottom);
    let camera =
        Camera { model: Model::Auto, direction, readout_time, readout_prior: None, focal_length: None };
    let mut estimator = Continuous::new(camera, WIDTH, HEIGHT, SCALE);
    for frame in 0..BEFORE {
        push(&mut estimator, pairs, frame);
        if frame >= AHEAD {
            estimator.settle(&mut LocalMotions::default());
        }
    }
    (estimator, BEFORE)
}

fn push(estimator: &mut Continuous, pairs: &[Vec<Correspondence>], frame: usize) {
    let found = frame.checked_sub(1).map(|first| pairs[first % CYCLE].as_slice());
    estimator.push(found, frame as f64 * PERIOD, PERIOD, 100.0);
}

fn bench(criterion: &mut Criterion) {
    let pairs: Vec<_> = (0..CYCLE).map(|frame| pair(frame, (32, 24), [1.0, 1.0])).collect();
    let fields = [-PERIOD, PERIOD].map(|interval| flow(interval.signum()));
    let readout = Readout::new(
        WIDTH,
        HEIGHT,
        ReadoutDirection::TopToBottom,
        ReadoutTime::Seconds(GAMMA * PERIOD),
        PERIOD,
    )
    .expect("a readout");
    for threads in [1, 2] {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be started");
        let mut group = criterion.benchmark_group(format!("{threads} threads"));
        for (name, time) in [("known", readout.time()), ("unknown", 0.0)] {
            let time = if time > 0.0 { ReadoutTime::Seconds(time) } else { ReadoutTime::Unknown };
            let (mut estimator, mut frame) = estimator(&pairs, time);
            group.bench_function(format!("continuous, readout {name}"), |bencher| {
                bencher.iter(|| {
                    push(&mut estimator, &pairs, frame);
                    frame += 1;
                    pool.install(|| estimator.settle(&mut LocalMotions::default()))
                })
            });
        }
        let mut residual = ResidualSolver::default();
        let [before, after] = &fields;
        let flows =
            [FrameFlow { field: before, interval: -PERIOD }, FrameFlow { field: after, interval: PERIOD }];
        group.bench_function("residual field", |bencher| {
            bencher.iter(|| pool.install(|| residual.solve(&readout, &flows, &Still).velocities[0]))
        });
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
