//! The estimator against cameras that are known in closed form.

use super::*;
use crate::motion::image_centre;
use crate::readout::{Readout, ReadoutTime};
use nalgebra::Rotation2;
use std::f64::consts::TAU;

const SIZE: [usize; 2] = [640, 480];
const PERIOD: f64 = 1.0 / 30.0;

/// A picture that moves as x = c + R(roll(t))·(X − c) + shift(t), read over `time` seconds.
struct Camera {
    direction: ReadoutDirection,
    time: f64,
    /// Cycles a second and peak (pixels; radians for the roll) along x, along y and in roll.
    swings: [[(f64, f64); 2]; 3],
    /// Standard deviation of the correspondences in pixels.
    noise: f64,
}

impl Camera {
    fn shaken(direction: ReadoutDirection, time: f64) -> Self {
        let swings = [[(1.1, 40.0), (2.7, 9.0)], [(1.4, 30.0), (3.1, 8.0)], [(0.9, 0.05), (2.3, 0.02)]];
        Self { direction, time, swings, noise: 0.1 }
    }

    fn swing(&self, kind: usize, t: f64) -> f64 {
        let sum =
            |(phase, (cycles, peak)): (usize, &(f64, f64))| peak * (TAU * cycles * t + phase as f64).sin();
        self.swings[kind].iter().enumerate().map(sum).sum()
    }

    /// Where a place of the scene is seen at an instant.
    fn seen(&self, place: Vector2<f64>, t: f64) -> Vector2<f64> {
        let centre = image_centre(SIZE[0], SIZE[1]);
        let shift = Vector2::new(self.swing(0, t), self.swing(1, t));
        centre + Rotation2::new(self.swing(2, t)) * (place - centre) + shift
    }

    /// The place of the scene that is seen somewhere at an instant.
    fn place(&self, seen: Vector2<f64>, t: f64) -> Vector2<f64> {
        let centre = image_centre(SIZE[0], SIZE[1]);
        let shift = Vector2::new(self.swing(0, t), self.swing(1, t));
        centre + Rotation2::new(-self.swing(2, t)) * (seen - centre - shift)
    }

    /// The correspondences between the frames that start at two instants.
    fn pairs(&self, first: f64, second: f64, random: &mut Random) -> Vec<Correspondence> {
        let [width, height] = SIZE;
        let readout = Readout::new(width, height, self.direction, ReadoutTime::Seconds(self.time), PERIOD);
        let cells =
            (0..768).map(|cell| Vector2::new((cell % 32 * 20) as f64 + 9.5, (cell / 32 * 20) as f64 + 9.5));
        let pair = |from: Vector2<f64>| {
            let place = self.place(from, first + readout.offset(from.x, from.y));
            // The row in which the point arrives decides when, and the other way round.
            let mut to = from;
            for _ in 0..30 {
                to = self.seen(place, second + readout.offset(to.x, to.y));
            }
            let to = to + Vector2::new(random.normal(), random.normal()) * self.noise;
            Correspondence { from, to, texture: 1.0, residual: 0.0 }
        };
        cells.map(pair).collect()
    }

    fn film(&self, stamps: &[f64], seed: u64) -> ShutterEstimator {
        let mut random = Random(seed);
        let mut estimator = ShutterEstimator::new(SIZE[0], SIZE[1]);
        for stamps in stamps.windows(2) {
            estimator.push(&self.pairs(stamps[0], stamps[1], &mut random), stamps[1] - stamps[0]);
        }
        estimator
    }
}

/// SplitMix64.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Sum of twelve uniform numbers: nearly normal.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

fn regular(count: usize) -> Vec<f64> {
    (0..count).map(|k| k as f64 * PERIOD).collect()
}

#[test]
fn a_shaken_camera_tells_its_readout_in_all_four_directions() {
    use ReadoutDirection::{BottomToTop, LeftToRight, RightToLeft, TopToBottom};
    let cases = [(TopToBottom, 0.9), (BottomToTop, 0.6), (LeftToRight, 0.8), (RightToLeft, 0.3)];
    for (seed, (direction, ratio)) in cases.into_iter().enumerate() {
        let camera = Camera::shaken(direction, ratio * PERIOD);
        let found = camera.film(&regular(60), seed as u64).estimate().unwrap();
        assert_eq!(found.direction, direction, "{found:?}");
        assert!((found.time / PERIOD - ratio).abs() < 0.015, "{ratio}: {found:?}");
        assert!(found.standard_error / PERIOD < 0.02 && found.confidence > 0.95, "{found:?}");
    }
}

#[test]
fn lost_frames_and_uneven_intervals_change_nothing() {
    let mut random = Random(5);
    let jittered = regular(80).into_iter().map(|stamp| stamp + 0.25 * PERIOD * random.uniform());
    let stamps: Vec<f64> =
        jittered.enumerate().filter(|(k, _)| k % 13 != 7).map(|(_, stamp)| stamp).collect();
    let camera = Camera::shaken(ReadoutDirection::TopToBottom, 0.7 * PERIOD);
    let found = camera.film(&stamps, 6).estimate().unwrap();
    assert_eq!(found.direction, ReadoutDirection::TopToBottom);
    assert!((found.time / PERIOD - 0.7).abs() < 0.02, "{found:?}");
}
