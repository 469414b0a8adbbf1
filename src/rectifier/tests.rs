//! The queue on pictures whose motion is known in closed form.

use super::*;
use crate::plane::{Plane, PlaneLayout, SampleFormat};
use nalgebra::Vector2;

const WIDTH: usize = 320;
const HEIGHT: usize = 240;
const PERIOD: f64 = 0.04;

/// Smooth detail at three scales, nowhere repeated.
fn texture(x: f64, y: f64) -> f64 {
    128.0
        + 60.0 * noise(x / 4.0, y / 4.0)
        + 60.0 * noise(x / 11.0, y / 11.0)
        + 60.0 * noise(x / 31.0, y / 31.0)
}

/// Noise in −1 to 1 on the integer lattice, smoothly interpolated.
fn noise(x: f64, y: f64) -> f64 {
    let (column, row) = (x.floor(), y.floor());
    let ease = |t: f64| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
    let (u, v) = (ease(x - column), ease(y - row));
    let corner = |i: f64, j: f64| {
        let mixed = ((column + i) * 127.1 + (row + j) * 311.7).sin() * 43758.5453;
        2.0 * (mixed - mixed.floor()) - 1.0
    };
    let upper = corner(0.0, 0.0) * (1.0 - u) + corner(1.0, 0.0) * u;
    let lower = corner(0.0, 1.0) * (1.0 - u) + corner(1.0, 1.0) * u;
    upper * (1.0 - v) + lower * v
}

/// A frame that starts at `time` of a picture that moves by `velocity` px/s, read top to bottom over
/// a whole period.
fn frame(time: f64, velocity: Vector2<f64>) -> Vec<u8> {
    let pixels = (0..HEIGHT).flat_map(|row| (0..WIDTH).map(move |column| (row, column)));
    pixels
        .map(|(row, column)| {
            let exposed = time + PERIOD * (row as f64 + 0.5) / HEIGHT as f64;
            let at = Vector2::new(column as f64, row as f64) - velocity * exposed;
            texture(at.x, at.y).round().clamp(0.0, 255.0) as u8
        })
        .collect()
}

const ESTIMATORS: [Estimator; 2] = [Estimator::Continuous, Estimator::Sequential];

/// A rectifier that knows the shutter of [`frame`].
fn rectifier(estimator: Estimator, lookahead: usize) -> Rectifier {
    let settings = Settings {
        lookahead,
        estimator,
        direction: Some(ReadoutDirection::TopToBottom),
        readout_time: ReadoutTime::WholePeriod,
        ..Settings::default()
    };
    Rectifier::new(settings, WIDTH, HEIGHT, Some(PERIOD))
}

fn push(rectifier: &mut Rectifier, pixels: &[u8], time: f64, duplicate: bool) {
    let layout = PlaneLayout::packed(WIDTH, HEIGHT, SampleFormat::U8);
    rectifier.push(&Luma::from(Plane::new(pixels, layout).unwrap()), Some(time), duplicate);
}

fn pops(rectifier: &mut Rectifier) -> Vec<FrameSolution> {
    std::iter::from_fn(|| rectifier.pop()).collect()
}

const VELOCITY: Vector2<f64> = Vector2::new(180.0, -60.0);

fn assert_velocity(solution: &FrameSolution, velocity: Vector2<f64>) {
    let twist = solution.path.mean_twist();
    let off = (twist.velocity - velocity).norm() * PERIOD;
    assert!(off < 0.1 && (twist.omega * PERIOD).abs() < 5e-4, "{off} px a frame off: {solution:?}");
    assert!(solution.confidence > 0.9, "{solution:?}");
}

#[test]
fn every_frame_comes_out_once_after_the_lookahead() {
    for estimator in ESTIMATORS {
        for lookahead in [0, 1, 4, 64] {
            let mut rectifier = rectifier(estimator, lookahead);
            let mut count = 0;
            for k in 0..10 {
                push(&mut rectifier, &frame(k as f64 * PERIOD, VELOCITY), k as f64 * PERIOD, false);
                let ready = pops(&mut rectifier);
                assert_eq!(ready.len(), usize::from(k >= lookahead), "lookahead {lookahead}, frame {k}");
                count += ready.len();
                ready.iter().filter(|_| k > 0).for_each(|solution| assert_velocity(solution, VELOCITY));
            }
            rectifier.drain();
            assert_eq!(count + pops(&mut rectifier).len(), 10);
        }
    }
}

#[test]
fn without_lookahead_the_first_frame_stays_as_it_is() {
    for estimator in ESTIMATORS {
        let mut rectifier = rectifier(estimator, 0);
        push(&mut rectifier, &frame(0.0, VELOCITY), 0.0, false);
        let first = rectifier.pop().unwrap();
        assert_eq!((first.origin, first.confidence), (Origin::Untouched, 0.0));
        assert!(first.path.is_still());
    }
}

#[test]
fn reverse_playback_finds_the_same_motion() {
    for estimator in ESTIMATORS {
        let mut rectifier = rectifier(estimator, 3);
        for k in (0..8).rev() {
            push(&mut rectifier, &frame(k as f64 * PERIOD, VELOCITY), k as f64 * PERIOD, false);
        }
        rectifier.drain();
        pops(&mut rectifier).iter().for_each(|solution| assert_velocity(solution, VELOCITY));
    }
}

#[test]
fn a_dropped_frame_changes_nothing() {
    for estimator in ESTIMATORS {
        let mut rectifier = rectifier(estimator, 3);
        for k in [0, 1, 3, 4, 5, 8, 9] {
            push(&mut rectifier, &frame(k as f64 * PERIOD, VELOCITY), k as f64 * PERIOD, false);
        }
        rectifier.drain();
        pops(&mut rectifier).iter().for_each(|solution| assert_velocity(solution, VELOCITY));
    }
}

#[test]
fn a_duplicate_repeats_its_frame_s_motion() {
    for estimator in ESTIMATORS {
        for marked in [false, true] {
            let mut rectifier = rectifier(estimator, 4);
            for k in 0..12 {
                // Every second frame repeats the one before, as 25 frames a second do in a project of 50.
                let shown = (k / 2 * 2) as f64 * PERIOD / 2.0;
                push(&mut rectifier, &frame(shown, VELOCITY), k as f64 * PERIOD / 2.0, marked && k % 2 == 1);
            }
            rectifier.drain();
            let solutions = pops(&mut rectifier);
            assert_eq!(solutions.len(), 12);
            for pair in solutions.chunks(2) {
                assert_velocity(&pair[0], VELOCITY);
                assert_eq!((pair[1].origin, &pair[1].path), (Origin::Repeated, &pair[0].path));
            }
        }
    }
}

#[test]
fn a_duplicate_is_corrected_as_much_as_its_frame() {
    for (origin, weight) in [(Origin::Continuous, 0.5), (Origin::Forward, 1.0)] {
        let rectifier = rectifier(Estimator::default(), 4);
        let readout = rectifier.readout();
        let path = MotionPath::STILL;
        // Half of what is trusted in full.
        let settled = Settled {
            readout,
            path,
            confidence: 0.25,
            origin,
            inliers: 700,
            residual: 1.0,
            readout_deviation: 0.0,
        };
        for repeats in [false, true] {
            let frame = Waiting { readout, correspondences: 0, repeats };
            assert_eq!(rectifier.solution(&frame, &settled).weight, weight, "{origin:?}, repeats: {repeats}");
        }
    }
}

#[test]
fn a_camera_that_stops_is_still_after_a_few_frames() {
    for estimator in ESTIMATORS {
        let mut rectifier = rectifier(estimator, 2);
        for k in 0..16 {
            let shown = frame((k as f64).min(6.0) * PERIOD, VELOCITY);
            push(&mut rectifier, &shown, k as f64 * PERIOD, false);
        }
        rectifier.drain();
        let last = pops(&mut rectifier).pop().unwrap();
        assert!(last.path.mean_twist().velocity.norm() * PERIOD < 0.05, "{last:?}");
    }
}

#[test]
fn black_frames_and_cuts_have_no_motion_of_the_other_side() {
    for estimator in ESTIMATORS {
        let mut rectifier = rectifier(estimator, 3);
        let other = Vector2::new(-150.0, 100.0);
        for k in 0..12 {
            let time = k as f64 * PERIOD;
            let shown = if k < 6 { frame(time, VELOCITY) } else { frame(time + 900.0, other) };
            push(&mut rectifier, &shown, time, false);
        }
        for k in 12..15 {
            push(&mut rectifier, &vec![16; WIDTH * HEIGHT], k as f64 * PERIOD, false);
        }
        rectifier.drain();
        let solutions = pops(&mut rectifier);
        solutions[..6].iter().for_each(|solution| assert_velocity(solution, VELOCITY));
        solutions[6..12].iter().for_each(|solution| assert_velocity(solution, other));
        assert!(solutions[12].path.is_still() && solutions[12].confidence == 0.0);
    }
}

#[test]
fn a_drain_starts_anew_and_a_reset_forgets() {
    for estimator in ESTIMATORS {
        let mut rectifier = rectifier(estimator, 5);
        for k in 0..3 {
            push(&mut rectifier, &frame(k as f64 * PERIOD, VELOCITY), k as f64 * PERIOD, false);
        }
        rectifier.drain();
        push(&mut rectifier, &frame(0.0, -VELOCITY), 3.0 * PERIOD, false);
        push(&mut rectifier, &frame(PERIOD, -VELOCITY), 4.0 * PERIOD, false);
        rectifier.drain();
        let solutions = pops(&mut rectifier);
        assert_eq!(solutions.len(), 5);
        solutions[..3].iter().for_each(|solution| assert_velocity(solution, VELOCITY));
        solutions[3..].iter().for_each(|solution| assert_velocity(solution, -VELOCITY));
        push(&mut rectifier, &frame(0.0, VELOCITY), 0.0, false);
        rectifier.reset();
        rectifier.drain();
        assert_eq!(pops(&mut rectifier).len(), 0);
    }
}

#[test]
fn frames_that_cannot_be_analysed_are_counted_all_the_same() {
    for (width, height) in [(1, 1), (2, 9), (17, 3), (40, 30)] {
        let mut rectifier = Rectifier::new(Settings::default(), width, height, None);
        let pixels: Vec<u8> = (0..width * height).map(|i| (i * 37 % 251) as u8).collect();
        let layout = PlaneLayout::packed(width, height, SampleFormat::U8);
        for _ in 0..7 {
            rectifier.push(&Luma::from(Plane::new(&pixels, layout).unwrap()), None, false);
        }
        // One that is not of the announced size, too.
        let wrong = PlaneLayout::packed(1, 1, SampleFormat::U8);
        rectifier.push(&Luma::from(Plane::new(&pixels, wrong).unwrap()), None, false);
        rectifier.drain();
        assert_eq!(pops(&mut rectifier).len(), 8);
    }
}

#[test]
fn any_size_and_any_grid() {
    let sides = [0, 1, 2, 3, 7, 8, 13, 16, 17, 18, 19, 25, 33, 47, 64, 97];
    for (index, (width, height)) in
        sides.iter().flat_map(|&width| sides.map(|height| (width, height))).enumerate()
    {
        let (grid_columns, grid_rows) = ([0, 1, 2, 5, 32][index % 5], [3, 32, 0, 1][index % 4]);
        let settings = Settings { grid_columns, grid_rows, lookahead: index % 3, ..Settings::default() };
        let mut rectifier = Rectifier::new(settings, width, height, None);
        let layout = PlaneLayout::packed(width, height, SampleFormat::U8);
        for step in 0..4 {
            let shown = |i: usize| texture((i % width + 2 * step) as f64, (i / width + step) as f64) as u8;
            let pixels: Vec<u8> = (0..width * height).map(shown).collect();
            let luma = Luma::from(Plane::new(&pixels, layout).unwrap());
            rectifier.push(&luma, Some(0.03 * step as f64), false);
        }
        rectifier.drain();
        let solutions = pops(&mut rectifier);
        assert_eq!(solutions.len(), 4, "{width}x{height}");
        assert!(solutions.iter().all(|s| s.path.mean_twist().is_finite() && s.confidence.is_finite()));
    }
}
