// SPDX-License-Identifier: MIT OR Apache-2.0

//! Streams of small frames: any settings, times, pictures, orders of calls.

use super::input::{FORMATS, Random, real, settings, small};
use arbitrary::{Result, Unstructured};
use nalgebra::Vector2;
use rsrectify::correspond::{Pyramid, Sampler};
use rsrectify::motion::image_centre;
use rsrectify::plane::{Luma, Plane, PlaneLayout, PlaneMut, SampleFormat};
use rsrectify::rectifier::{Duplicate, FrameSolution, Rectifier};
use rsrectify::warp::{CpuLevel, SampleGrid, WarpSettings, Warper};

/// Calls in a stream, at most.
const CALLS: usize = 12;

/// - Every frame pushed is popped exactly once, except those that a reset drops; a refused one is not counted.
/// - What is popped is finite, in range, and rectifies a plain picture into the same.
/// - The correspondences that any CPU level measures are finite.
pub fn check(data: &[u8]) {
    let mut u = Unstructured::new(data);
    // Bytes that end make the rest of a case its defaults; they are no failure.
    let _ = stream(&mut u);
}

fn stream(u: &mut Unstructured<'_>) -> Result<()> {
    let settings = settings(u)?;
    let (width, height) = if u.ratio(1, 8)? {
        (u.int_in_range(0..=30)?, u.int_in_range(0..=30)?)
    } else {
        (u.int_in_range(48..=112)?, u.int_in_range(48..=96)?)
    };
    let period = if u.arbitrary()? { Some(real(u, 0.1)?) } else { None };
    let Ok(mut rectifier) = Rectifier::new(settings, width, height, period) else { return Ok(()) };
    let mut scene = Scene::new(u, width, height)?;
    let (mut time, mut pushed, mut popped) = (0.0, 0, 0);
    let mut last: Option<Vec<u8>> = None;
    for _ in 0..CALLS {
        match u.int_in_range(0..=15u8)? {
            13 => rectifier.drain(),
            14 => {
                rectifier.reset();
                pushed = popped;
            }
            15 => {
                let wrong = PlaneLayout::packed(width + 1, height, SampleFormat::U8);
                let bytes = vec![7; (width + 1) * height];
                let luma = Plane::new(&bytes, wrong).map(Luma::from);
                assert!(luma.is_ok_and(|luma| rectifier.push(&luma, Some(time), Duplicate::Detect).is_err()));
            }
            kind => {
                let picture = scene.picture(u, kind)?;
                time += small(u, 0.1)?;
                let stamp = if u.ratio(1, 6)? {
                    None
                } else {
                    Some(if u.ratio(1, 8)? { real(u, 1e3)? } else { time })
                };
                if let Some(last) = last.as_ref().filter(|_| pushed == 1) {
                    measure_on_all_levels(&scene, [last, &picture], settings.grid_columns);
                }
                let duplicate = if u.ratio(1, 8)? { Duplicate::Known } else { Duplicate::Detect };
                assert_eq!(rectifier.push(&scene.luma(&picture), stamp, duplicate), Ok(()));
                pushed += 1;
                last = Some(picture);
            }
        }
        popped += pop_all(&mut rectifier, [width, height]);
        assert!(popped <= pushed && pushed - popped <= settings.lookahead, "{popped} of {pushed}");
        if u.is_empty() {
            break;
        }
    }
    rectifier.drain();
    popped += pop_all(&mut rectifier, [width, height]);
    assert_eq!(popped, pushed);
    Ok(())
}

/// A textured wall before a camera, and how its frames are stored.
struct Scene {
    width: usize,
    height: usize,
    layout: PlaneLayout,
    weights: [f32; 4],
    random: Random,
    /// Values of the wall, repeated.
    wall: Vec<u8>,
    place: [i32; 2],
}

/// Values of the wall along a side.
const WALL: usize = 64;

impl Scene {
    fn new(u: &mut Unstructured<'_>, width: usize, height: usize) -> Result<Self> {
        let format = *u.choose(&FORMATS)?;
        let channels = u.int_in_range(1..=4usize)?;
        let step = channels + u.int_in_range(0..=2usize)?;
        let stride = (width * step + u.int_in_range(0..=9usize)?) * format.bytes();
        let mut weights = [0.0; 4];
        weights[0] = 1.0;
        if u.ratio(1, 3)? {
            for weight in &mut weights {
                // Others are refused.
                *weight = Some(real(u, 1.0)? as f32).filter(|weight| weight.is_finite()).unwrap_or(0.0);
            }
        }
        let mut random = Random::new(u.arbitrary()?);
        let wall = random.bytes(WALL * WALL);
        let layout = PlaneLayout { width, height, stride, step, channels, format };
        Ok(Self { width, height, layout, weights, random, wall, place: [0; 2] })
    }

    /// The next frame: the wall shifted, row by row too, something that covers a part of it, noise, or nothing.
    fn picture(&mut self, u: &mut Unstructured<'_>, kind: u8) -> Result<Vec<u8>> {
        let len = self.layout.required_bytes().unwrap_or(0);
        let mut bytes = vec![0; len];
        match kind {
            10 => return Ok(self.random.bytes(len)),
            11 => {
                bytes.fill(u.arbitrary()?);
                return Ok(bytes);
            }
            _ => (),
        }
        for place in &mut self.place {
            *place += i32::from(u.arbitrary::<i8>()?) / 16;
        }
        let slant = i32::from(u.arbitrary::<i8>()?);
        let hidden = if kind == 12 { u.int_in_range(0..=self.height)? } else { 0 };
        let sample = self.layout.format.bytes();
        for (x, y) in (0..self.height).flat_map(|y| (0..self.width).map(move |x| (x, y))) {
            let shift = self.place[0] + slant * y as i32 / 2048;
            let value =
                if y < hidden { 90 } else { self.wall_at([x as i32 + shift, y as i32 + self.place[1]]) };
            let format = self.layout.format;
            let word = (value << (format.bits() - 8)) << format.shift();
            for channel in 0..self.layout.channels {
                let at = y * self.layout.stride + (x * self.layout.step + channel) * sample;
                bytes[at..at + sample].copy_from_slice(&word.to_le_bytes()[..sample]);
            }
        }
        Ok(bytes)
    }

    /// The wall at a pixel: linear between its values, which are four pixels apart.
    fn wall_at(&self, at: [i32; 2]) -> u16 {
        let [x, y] = at.map(|at| at.rem_euclid(4 * WALL as i32) as usize);
        let value = |dx: usize, dy: usize| {
            let weight = [4 - x % 4, x % 4][dx] * [4 - y % 4, y % 4][dy];
            weight as u16 * u16::from(self.wall[(y / 4 + dy) % WALL * WALL + (x / 4 + dx) % WALL])
        };
        (value(0, 0) + value(1, 0) + value(0, 1) + value(1, 1)) / 16
    }

    fn luma<'a>(&self, bytes: &'a [u8]) -> Luma<'a> {
        match Plane::new(bytes, self.layout) {
            Ok(plane) => match Luma::weighted(plane, self.weights) {
                Ok(luma) => luma,
                Err(error) => panic!("{error}"),
            },
            Err(error) => panic!("{error}"),
        }
    }
}

/// What each level measures is sound; that all measure the same but for rounding is for pictures on which rounding does not
/// choose between displacements that fit alike.
fn measure_on_all_levels(scene: &Scene, pictures: [&Vec<u8>; 2], grid: usize) {
    for level in CpuLevel::supported() {
        let mut sampler = Sampler::with_cpu(level, scene.width, scene.height, grid, grid);
        let pyramids = pictures.map(|picture| {
            let mut pyramid = Pyramid::new();
            sampler.build(&scene.luma(picture), &mut pyramid);
            pyramid
        });
        let [first, second] = &pyramids;
        let mut found = Vec::new();
        sampler.correspond(first, second, |point| point, &mut found);
        for found in found {
            let numbers = found.from.iter().chain(&found.to).copied();
            let numbers = numbers.chain([found.texture.into(), found.residual.into()]);
            assert!(numbers.into_iter().all(f64::is_finite), "{found:?}");
        }
    }
}

/// Pops what there is, looks at it, and counts it.
fn pop_all(rectifier: &mut Rectifier, size: [usize; 2]) -> usize {
    let solutions = std::iter::from_fn(|| rectifier.pop());
    solutions.inspect(|solution| verify(solution, size)).count()
}

fn verify(solution: &FrameSolution, [width, height]: [usize; 2]) {
    let FrameSolution { motion, confidence, correspondences, inliers, residual, readout_deviation, .. } =
        solution;
    assert!(solution.expected_error.is_none_or(|error| error >= 0.0), "{:?}", solution.expected_error);
    assert!(solution.region_errors.iter().all(|error| *error >= 0.0), "{:?}", solution.region_errors);
    let readout = motion.readout();
    assert_eq!(motion.area().frame(), [width, height]);
    assert_eq!(motion.area().size(), [readout.width(), readout.height()]);
    assert!(readout.time().is_finite() && readout.time() >= 0.0, "{readout:?}");
    assert!((0.0..=1.0).contains(confidence), "{confidence}");
    assert!((0.0..=1.0).contains(&motion.weight()), "{}", motion.weight());
    assert!(inliers <= correspondences, "{inliers} of {correspondences}");
    assert!(residual.is_finite() && *residual >= 0.0, "{residual}");
    assert!(readout_deviation.is_finite() && *readout_deviation >= 0.0, "{readout_deviation}");
    assert!(motion.path().mean_twist().is_finite(), "{:?}", motion.path().mean_twist());
    let centre = image_centre(width, height);
    for (x, y) in [(0.0, 0.0), (width as f64 - 1.0, height as f64 / 2.0)] {
        let point = Vector2::new(x, y) - centre;
        let moved = motion.path().carry(point, readout.share(x, y), 0.5);
        assert!(moved.iter().all(|coordinate| coordinate.is_finite()), "{point} moves to {moved}");
    }
    let plain = vec![77; width * height];
    let mut rectified = vec![0; width * height];
    let layout = PlaneLayout::packed(width, height, SampleFormat::U8);
    let (source, target) = (Plane::new(&plain, layout), PlaneMut::new(&mut rectified, layout));
    let mut warper = Warper::new();
    let frame = warper.prepare(motion, &WarpSettings::default());
    if let (Ok(source), Ok(mut target)) = (source, target) {
        assert_eq!(frame.warp(&source, &mut target, SampleGrid::FULL), Ok(()));
    }
    assert_eq!(rectified, plain);
}
