//! The estimator against cameras that are known in closed form.

use super::*;
use crate::motion::image_centre;
use crate::readout::{Readout, ReadoutTime};
use crate::solve::random::Random;
use nalgebra::{Matrix2, Rotation2};
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
        let readout =
            Readout::new(width, height, self.direction, ReadoutTime::Seconds(self.time), PERIOD).unwrap();
        let cells =
            (0..768).map(|cell| Vector2::new((cell % 32 * 20) as f64 + 9.5, (cell / 32 * 20) as f64 + 9.5));
        let pair = |from: Vector2<f64>| {
            let place = self.place(from, first + readout.offset(from.x, from.y));
            // The row in which the point arrives decides when, and the other way round.
            let mut to = from;
            for _ in 0..8 {
                to = self.seen(place, second + readout.offset(to.x, to.y));
            }
            let to = to + Vector2::new(random.normal(), random.normal()) * self.noise;
            Correspondence { from, to, texture: 1.0, residual: 0.0, covariance: Matrix2::zeros() }
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

#[test]
fn a_shutter_without_readout_is_found_global() {
    let camera = Camera::shaken(ReadoutDirection::TopToBottom, 0.0);
    let found = camera.film(&regular(60), 3).estimate().unwrap();
    assert_eq!(found.verdict, Verdict::Global);
    assert!(found.time < 0.02 * PERIOD && found.confidence > 0.8, "{found:?}");
}

#[test]
fn without_acceleration_nothing_is_known() {
    let still = Camera { swings: Default::default(), ..Camera::shaken(ReadoutDirection::TopToBottom, 0.02) };
    let found = still.film(&regular(60), 4).estimate().unwrap();
    assert_eq!(found.verdict, Verdict::Unknown);
    assert!(found.standard_error > 0.3 * PERIOD, "{found:?}");
    // A swing of 1000 seconds and 57 000 pixels is a steady pan, 12 pixels a frame.
    let steady = Camera { swings: [[(0.001, 57e3), (0.0, 0.0)], still.swings[1], still.swings[2]], ..still };
    let found = steady.film(&regular(60), 5).estimate().unwrap();
    assert_eq!(found.verdict, Verdict::Unknown, "{found:?}");
}

#[test]
fn what_moves_on_its_own_does_not_mislead() {
    let camera = Camera::shaken(ReadoutDirection::BottomToTop, 0.8 * PERIOD);
    let (stamps, mut random) = (regular(60), Random(8));
    let mut estimator = ShutterEstimator::new(SIZE[0], SIZE[1]);
    for (index, stamps) in stamps.windows(2).enumerate() {
        let mut pairs = camera.pairs(stamps[0], stamps[1], &mut random);
        let own = Vector2::new(25.0, 12.0) * (0.3 * index as f64).sin();
        for pair in pairs.iter_mut().filter(|pair| (pair.from - Vector2::new(200.0, 300.0)).norm() < 130.0) {
            pair.to += own;
        }
        estimator.push(&pairs, stamps[1] - stamps[0]);
    }
    let found = estimator.estimate().unwrap();
    assert_eq!(found.direction, ReadoutDirection::BottomToTop);
    assert!((found.time / PERIOD - 0.8).abs() < 0.03, "{found:?}");
}

#[test]
fn errors_are_as_large_as_they_are_said_to_be() {
    // Mean square of error over standard error, over many short films of noisy points.
    let (mut squares, mut count) = (0.0, 0.0);
    for seed in 0..24 {
        let ratio = 0.3 + 0.025 * seed as f64;
        let mut camera = Camera::shaken(ReadoutDirection::TopToBottom, ratio * PERIOD);
        camera.noise = 2.0;
        camera.swings = camera.swings.map(|kind| kind.map(|(cycles, peak)| (cycles, 0.15 * peak)));
        let found = camera.film(&regular(30), 100 + seed).estimate().unwrap();
        let truth = Vector2::new(0.0, ratio * PERIOD);
        for axis in 0..2 {
            squares += (found.times[axis] - truth[axis]).powi(2) / found.covariance[(axis, axis)];
            count += 1.0;
        }
    }
    let ratio = squares / count;
    assert!((0.2..2.0).contains(&ratio), "{ratio}");
}

#[test]
fn knowledge_outlives_cuts_and_rest() {
    let camera = Camera::shaken(ReadoutDirection::LeftToRight, 0.6 * PERIOD);
    let mut estimator = camera.film(&regular(60), 9);
    let before = estimator.estimate().unwrap();
    estimator.reset_pair();
    let still = Camera { swings: Default::default(), ..camera };
    let mut random = Random(10);
    for _ in 0..330 {
        estimator.push(&still.pairs(0.0, PERIOD, &mut random), PERIOD);
    }
    let after = estimator.estimate().unwrap();
    assert_eq!((before.verdict, after.verdict), (Verdict::Rolling, Verdict::Rolling));
    assert_eq!(after.direction, ReadoutDirection::LeftToRight);
    assert!((after.time / PERIOD - 0.6).abs() < 0.03, "{after:?}");
    assert!(after.standard_error < 1.1 * before.standard_error, "{before:?} {after:?}");
}

#[test]
fn nonsense_is_survived() {
    let mut estimator = ShutterEstimator::new(0, 0);
    assert_eq!(estimator.estimate(), None);
    let pair = |x: f64| Correspondence {
        from: Vector2::new(x, x),
        to: Vector2::new(x, 2.0 * x),
        texture: 1.0,
        residual: 0.0,
        covariance: Matrix2::zeros(),
    };
    for strange in [f64::NAN, f64::INFINITY, 0.0, 1e300] {
        let pairs = vec![pair(strange); 100];
        for interval in [PERIOD, 0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300] {
            for _ in 0..20 {
                estimator.push(&pairs, interval);
                estimator.push(&[], interval);
            }
        }
    }
    let said =
        estimator.estimate().is_none_or(|found| found.time.is_finite() && found.confidence.is_finite());
    assert!(said);
}

#[test]
fn derivatives_of_polynomials_are_exact_at_any_spacing() {
    let times = [-1.3, -0.9, -0.2, 0.0, 0.4, 1.1, 1.5, 2.3, 2.4];
    // f = t⁸ − 3t³ + 2t at t = 0.4.
    let value = |t: f64| t.powi(8) - 3.0 * t.powi(3) + 2.0 * t;
    let t = 0.4f64;
    let expected =
        [8.0 * t.powi(7) - 9.0 * t.powi(2) + 2.0, 56.0 * t.powi(6) - 18.0 * t, 336.0 * t.powi(5) - 18.0];
    for (weights, expected) in derivative::weights(&times, t).iter().zip(expected) {
        let found: f64 = times.iter().zip(weights).map(|(t, weight)| weight * value(*t)).sum();
        assert!((found - expected).abs() < 1e-9, "{found} {expected}");
    }
}

#[test]
fn motions_do_not_distort_and_a_lean_does() {
    let grid =
        (0..768).map(|cell| Vector2::new((cell % 32) as f64 / 16.0 - 1.0, (cell / 32) as f64 / 16.0 - 0.75));
    let field = |way: &dyn Fn(Vector2<f64>) -> Vector2<f64>| {
        let points: Vec<Moved> = grid.clone().map(|middle| Moved { middle, way: way(middle) }).collect();
        robust_field(&points, 1e-9, &mut Vec::new()).unwrap()
    };
    for kind in 0..6 {
        let found = field(&|at| field::generators(at)[kind] * 0.1);
        let expected = Vector6::from_fn(|row, _| if row == kind { 0.1 } else { 0.0 });
        assert!((found.motion() - expected).norm() < 1e-4, "{found:?}");
        assert!(found.distortion().norm() < 1e-4, "{found:?}");
    }
    // Each row further to the right than the one above, and nearer to it.
    let leant = field(&|at| Vector2::new(0.02 * at.y, -0.01 * at.y));
    assert!((leant.distortion() - Vector2::new(0.02, -0.01)).norm() < 1e-5);
}
