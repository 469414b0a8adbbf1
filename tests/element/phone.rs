// SPDX-License-Identifier: MIT OR Apache-2.0

//! A real phone clip against its gyroscope, which the rectifier never sees.
//!
//! Needs the folder that the environment variable `RSRECTIFY_DATA` names; skipped, and said so,
//! where it is unset. The gyroscope gives the camera's rotation, the car's translation is not in it:
//! what two frames show at the image centre, measured without any model of the motion within a
//! frame, already differs from it. That difference is the floor that is printed.

use gst::prelude::*;
use nalgebra::Vector2;
use rsrectify::correspond::{Pyramid, Sampler};
use rsrectify::plane::{Luma, Plane, PlaneLayout, SampleFormat};
use rsrectify::readout::{ReadoutDirection, ReadoutTime};
use rsrectify::rectifier::{Duplicate, Estimator, FrameSolution, Rectifier, Settings};
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
    crate::common::init();
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

fn solve(clip: &Clip, settings: Settings) -> Vec<FrameSolution> {
    let mut rectifier = Rectifier::new(settings, WIDTH, HEIGHT, Some(clip.period())).unwrap();
    for (frame, &time) in clip.frames.iter().zip(&clip.times) {
        rectifier.push(&luma(frame), Some(time), Duplicate::Detect).unwrap();
    }
    rectifier.drain();
    std::iter::from_fn(|| rectifier.pop()).collect()
}

/// Velocity at the image centre in px/s while share `share` of the readout has elapsed.
fn velocity_at(solution: &FrameSolution, share: f64) -> Vector2<f64> {
    let near = 1.0 / 64.0;
    let (from, to) = ((share - near).max(0.0), (share + near).min(1.0));
    let moved = solution.motion.path().carry(Vector2::zeros(), from, to);
    moved / ((to - from) * solution.motion.readout().time().max(1e-9))
}

/// Velocity at the image centre at any time; between two readouts it goes over from one to the next.
fn velocity(clip: &Clip, solutions: &[FrameSolution], time: f64) -> Vector2<f64> {
    let k = index_at(&clip.times, time);
    let (since, readout) = (time - clip.times[k], solutions[k].motion.readout().time());
    match solutions.get(k + 1) {
        Some(next) if since > readout => {
            let share = (since - readout) / (clip.times[k + 1] - clip.times[k] - readout);
            velocity_at(&solutions[k], 1.0).lerp(&velocity_at(next, 0.0), share)
        }
        _ => velocity_at(&solutions[k], (since / readout.max(1e-9)).min(1.0)),
    }
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

/// The clip and what the gyroscope makes of it.
struct Clip {
    frames: Vec<Vec<u8>>,
    /// Seconds, of each frame's first row.
    times: Vec<f64>,
    /// Position in pixels by the gyroscope at every `STEP`.
    reference: Vec<Vector2<f64>>,
}

impl Clip {
    fn load(data: &Path) -> Self {
        let folder = data.join("phone");
        let frames = decode(&folder.join("phone.mp4"));
        let times: Vec<f64> = table(&folder.join("frames.csv")).iter().map(|row| row[1]).collect();
        assert_eq!((frames.len(), times.len()), (103, 103));
        let gyro = table(&folder.join("gyro.csv"));
        let gyro_times: Vec<f64> = gyro.iter().map(|row| row[3]).collect();
        let by_gyro = |time: f64| centre_velocity(&gyro[index_at(&gyro_times, time)]);
        let reference = integrate(times[102], by_gyro);
        Self { frames, times, reference }
    }

    /// The same as a dashcam shows it: the lowest lines, from `first` on, are those of the first frame throughout, with
    /// writing on them.
    fn with_bonnet(mut self, first: usize) -> Self {
        let letter = |index: usize| [235, 16][(index % WIDTH / 6 * 7 + index / WIDTH / 5 * 3) % 4 / 2];
        let bonnet: Vec<u8> =
            self.frames[0].iter().enumerate().map(|(i, &grey)| grey / 2 + letter(i) / 2).collect();
        for frame in &mut self.frames {
            frame[first * WIDTH..].copy_from_slice(&bonnet[first * WIDTH..]);
        }
        self
    }

    fn duration(&self) -> f64 {
        self.times[self.times.len() - 1]
    }

    fn period(&self) -> f64 {
        self.duration() / (self.times.len() - 1) as f64
    }

    /// Fast displacement of the estimate less that of the gyroscope, in px RMS.
    fn difference(&self, solutions: &[FrameSolution]) -> f64 {
        let estimated = integrate(self.duration(), |time| velocity(self, solutions, time));
        difference(&high_pass(&estimated, STEP), &high_pass(&self.reference, STEP))
    }
}

#[test]
fn fast_rotation_agrees_with_the_gyroscope() {
    let Some(data) = data() else { return };
    let clip = Clip::load(&data);
    let fast = rms(high_pass(&clip.reference, STEP));

    // Without a model within the frame: from the middle of one frame to the middle of the next.
    let shown = cumulative(displacements_at_centre(&clip.frames).into_iter());
    let (reference, period) = (&clip.reference, clip.period());
    let at = |k: usize| {
        reference[((clip.times[k] + period / 2.0) / STEP).min(reference.len() as f64 - 1.0) as usize]
    };
    let turned = cumulative((0..102).map(|k| at(k + 1) - at(k)));
    let (shown, turned) = (high_pass(&shown, period), high_pass(&turned, period));
    let (floor, turned) = (difference(&shown, &turned), rms(turned));
    println!("fast rotation by the gyroscope: {fast:.2} px RMS at the image centre, per row");
    println!("between frames, without any model: {floor:.2} of {turned:.2} px");
    assert!(floor < 0.15 * turned, "the axes or clocks do not fit: {floor} of {turned} px");

    // The paper's, told the readout that the phone states: the whole period.
    let mut paper = Settings::default();
    paper.estimator = Estimator::Sequential;
    let paper = clip.difference(&solve(&clip, paper));
    println!("sequential, readout given: {paper:.2} px");
    assert!(paper < 0.45 * fast, "{paper} of {fast} px");

    // The default, told nothing.
    let solutions = solve(&clip, Settings::default());
    for solution in solutions.iter().step_by(10).chain(solutions.last()) {
        println!(
            "readout {:.1} ms ± {:.1} {:?}, confidence {:.2}",
            1e3 * solution.motion.readout().time(),
            1e3 * solution.readout_deviation * period,
            solution.motion.readout().direction(),
            solution.confidence
        );
    }
    let found = *solutions[102].motion.readout();
    let default = clip.difference(&solutions);
    println!("default, nothing given: {default:.2} px; readout ratio {:.2}", found.time() / period);
    let mut known = Settings::default();
    known.readout_time = ReadoutTime::Seconds(found.time());
    known.direction = Some(found.direction());
    println!("the same from the first frame on: {:.2} px", clip.difference(&solve(&clip, known)));
    assert_eq!(found.direction(), ReadoutDirection::TopToBottom);
    assert!((0.72..=1.0).contains(&(found.time() / period)), "{found:?}");
    assert!(default < 0.5 * paper, "{default} of {paper} px");
}

#[test]
fn what_is_fixed_to_the_frame_does_not_disturb() {
    let Some(data) = data() else { return };
    // A line of writing; a bonnet over a third of the picture.
    for first in [564, 400] {
        let clip = Clip::load(&data).with_bonnet(first);
        let solutions = solve(&clip, Settings::default());
        let (found, difference) = (*solutions[102].motion.readout(), clip.difference(&solutions));
        println!(
            "fixed from line {first}: {difference:.2} px; readout ratio {:.2}",
            found.time() / clip.period()
        );
        assert_eq!(found.direction(), ReadoutDirection::TopToBottom);
        // Half of what the paper's method leaves of the whole picture.
        assert!(difference < 0.585, "{difference} px");
    }
}
