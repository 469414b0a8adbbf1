//! A real phone clip against its gyroscope, which the rectifier never sees.
//!
//! Needs the folder that the environment variable `RSRECTIFY_DATA` names; skipped, and said so,
//! where it is unset. The gyroscope gives the camera's rotation, the car's translation is not in it:
//! what two frames show at the image centre, measured without any model of the motion within a
//! frame, already differs from it. That difference is the floor that is printed.

mod common;

use gst::prelude::*;
use nalgebra::Vector2;
use rsrectify::correspond::{Pyramid, Sampler};
use rsrectify::plane::{Luma, Plane, PlaneLayout, SampleFormat};
use rsrectify::rectifier::{FrameSolution, Rectifier, Settings};
use std::path::{Path, PathBuf};

const WIDTH: usize = 800;
const HEIGHT: usize = 600;
/// Focal lengths in pixels.
const FOCAL: Vector2<f64> = Vector2::new(573.85, 575.04);
/// Fast rotation is what is left after a running mean over this many seconds is taken away.
const SLOW: f64 = 0.3;
/// Curves are sampled at this interval: every 18th row.
const STEP: f64 = 1e-3;

fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("RSRECTIFY_DATA").map(PathBuf::from);
    if folder.is_none() {
        eprintln!("skipped: RSRECTIFY_DATA does not name the folder with the phone clip");
    }
    folder
}

/// The numbers of a table with one heading line.
fn table(path: &Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines().skip(1).map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect()
}

/// The luma of every frame, without padding.
fn decode(clip: &Path) -> Vec<Vec<u8>> {
    common::init();
    let pipeline = gst::parse::launch(&format!(
        "filesrc location=\"{}\" ! decodebin ! videoconvert ! video/x-raw,format=GRAY8 ! appsink name=out sync=false",
        clip.display()
    ));
    let pipeline = pipeline.unwrap().downcast::<gst::Pipeline>().unwrap();
    let out = pipeline.by_name("out").unwrap().downcast::<gst_app::AppSink>().unwrap();
    pipeline.set_state(gst::State::Playing).unwrap();
    let frames = std::iter::from_fn(|| {
        let sample = out.pull_sample().ok()?;
        let map = sample.buffer()?.map_readable().ok()?;
        Some(map.as_slice().chunks(WIDTH).take(HEIGHT).flatten().copied().collect())
    });
    let frames = frames.collect();
    pipeline.set_state(gst::State::Null).unwrap();
    frames
}

fn luma(pixels: &[u8]) -> Luma<'_> {
    Luma::from(Plane::new(pixels, PlaneLayout::packed(WIDTH, HEIGHT, SampleFormat::U8)).unwrap())
}

/// Velocity at the image centre in px/s from the three rates of the table (rad/s): on its axes the
/// ray (0, 0, 1) goes to (w_x·dt, −w_y·dt, 1).
fn centre_velocity(rate: &[f64]) -> Vector2<f64> {
    Vector2::new(FOCAL.x * rate[0], -FOCAL.y * rate[1])
}

/// Position in pixels at every `STEP` from 0 on, given the velocity at a time.
fn integrate(duration: f64, velocity: impl Fn(f64) -> Vector2<f64>) -> Vec<Vector2<f64>> {
    let count = (duration / STEP) as usize;
    cumulative((0..count).map(|i| velocity((i as f64 + 0.5) * STEP) * STEP))
}

/// The sum of the steps so far, after each.
fn cumulative(steps: impl Iterator<Item = Vector2<f64>>) -> Vec<Vector2<f64>> {
    let positions = steps.scan(Vector2::zeros(), |sum, step| {
        *sum += step;
        Some(*sum)
    });
    positions.collect()
}

/// What a curve sampled at `interval` has besides its running mean.
fn high_pass(curve: &[Vector2<f64>], interval: f64) -> Vec<Vector2<f64>> {
    let half = (SLOW / 2.0 / interval).round() as usize;
    (half..curve.len() - half)
        .map(|i| {
            let around = &curve[i - half..=i + half];
            curve[i] - around.iter().sum::<Vector2<f64>>() / around.len() as f64
        })
        .collect()
}

fn rms(values: impl IntoIterator<Item = Vector2<f64>>) -> f64 {
    let (sum, count) =
        values.into_iter().fold((0.0, 0.0), |(sum, count), v| (sum + v.norm_squared(), count + 1.0));
    f64::sqrt(sum / count)
}

fn difference(a: &[Vector2<f64>], b: &[Vector2<f64>]) -> f64 {
    rms(a.iter().zip(b).map(|(a, b)| a - b))
}

/// The index of the last of the rising `times` that is not after `time`.
fn index_at(times: &[f64], time: f64) -> usize {
    times.partition_point(|&t| t <= time).saturating_sub(1)
}

fn solve(frames: &[Vec<u8>], times: &[f64], settings: Settings) -> Vec<FrameSolution> {
    let period = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
    let mut rectifier = Rectifier::new(settings, WIDTH, HEIGHT, Some(period));
    for (frame, &time) in frames.iter().zip(times) {
        rectifier.push(&luma(frame), Some(time), false);
    }
    rectifier.drain();
    std::iter::from_fn(|| rectifier.pop()).collect()
}

/// Median displacement from each frame to the next of the points near the image centre.
fn displacements_at_centre(frames: &[Vec<u8>]) -> Vec<Vector2<f64>> {
    let mut sampler = Sampler::new(WIDTH, HEIGHT, 32, 24);
    let (mut before, mut now, mut found) = (Pyramid::default(), Pyramid::default(), Vec::new());
    let mut moved = Vec::new();
    for frame in frames {
        sampler.build(&luma(frame), &mut now);
        sampler.correspond(&before, &now, |point| point, &mut found);
        found.retain(|c| (c.from - Vector2::new(400.0, 300.0)).norm() < 130.0);
        if !moved.is_empty() || !found.is_empty() {
            let median = |axis: usize| {
                let mut values: Vec<f64> = found.iter().map(|c| c.to[axis] - c.from[axis]).collect();
                values.sort_by(f64::total_cmp);
                values.get(values.len() / 2).copied().unwrap_or(0.0)
            };
            moved.push(Vector2::new(median(0), median(1)));
        }
        std::mem::swap(&mut before, &mut now);
    }
    moved
}

#[test]
fn fast_rotation_agrees_with_the_gyroscope() {
    let Some(data) = data() else { return };
    let folder = data.join("phone");
    let frames = decode(&folder.join("phone.mp4"));
    let times: Vec<f64> = table(&folder.join("frames.csv")).iter().map(|row| row[1]).collect();
    assert_eq!((frames.len(), times.len()), (103, 103));
    let gyro = table(&folder.join("gyro.csv"));
    let gyro_times: Vec<f64> = gyro.iter().map(|row| row[3]).collect();
    let by_gyro = |time: f64| centre_velocity(&gyro[index_at(&gyro_times, time)]);

    let duration = times[102];
    let reference = integrate(duration, by_gyro);
    let fast = high_pass(&reference, STEP);
    let solutions = solve(&frames, &times, Settings::default());
    let estimated = integrate(duration, |time| solutions[index_at(&times, time)].path.mean_twist().velocity);
    let left = difference(&high_pass(&estimated, STEP), &fast);

    // Without a model within the frame: from the middle of one frame to the middle of the next.
    let moved = displacements_at_centre(&frames);
    let shown = cumulative(moved.into_iter());
    let middle = solutions[0].readout.time / 2.0;
    let at = |k: usize| reference[((times[k] + middle) / STEP).min(reference.len() as f64 - 1.0) as usize];
    let turned = cumulative((0..102).map(|k| at(k + 1) - at(k)));
    let period = duration / 102.0;
    let (shown, turned) = (high_pass(&shown, period), high_pass(&turned, period));
    let floor = difference(&shown, &turned);

    let (fast, turned) = (rms(fast), rms(turned));
    println!("fast rotation by the gyroscope: {fast:.2} px RMS at the image centre, per row");
    println!(
        "estimated against it: {left:.2} px; between frames, without any model: {floor:.2} of {turned:.2} px"
    );
    assert!(floor < 0.15 * turned, "the axes or clocks do not fit: {floor} of {turned} px");
    assert!(left < 0.45 * fast, "{left} of {fast} px");
}
