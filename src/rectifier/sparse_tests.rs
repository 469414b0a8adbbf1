// SPDX-License-Identifier: MIT OR Apache-2.0

//! Streams with fewer frames than the nominal rate, or uneven ones: the number of unknowns follows the number
//! of frames.

use super::film::{HEIGHT, PERIOD, VELOCITY, WIDTH, assert_velocity, frame, pops, push};
use super::*;
use crate::readout::{ReadoutDirection, ReadoutTime};

const FRAMES: usize = 22;

/// Pushes frames with these times in seconds and a nominal period; returns the largest number of unknowns,
/// and the solutions.
///
/// A time-lapse of [`frame`]: the picture moves from frame to frame by the motion of one [`PERIOD`].
fn unknowns(times: &[f64], period: Option<f64>, readout_time: ReadoutTime) -> (usize, Vec<FrameSolution>) {
    let direction = Some(ReadoutDirection::TopToBottom);
    let settings = Settings { lookahead: 4, direction, readout_time, ..Settings::default() };
    let mut rectifier = Rectifier::new(settings, WIDTH, HEIGHT, period).unwrap();
    let mut most = 0;
    for (k, time) in times.iter().enumerate() {
        push(&mut rectifier, &frame(k as f64 * PERIOD, VELOCITY), *time, Duplicate::Detect);
        most = most.max(rectifier.engine.unknowns());
    }
    rectifier.drain();
    (most, pops(&mut rectifier))
}

/// Times of frames at these intervals, repeated cyclically.
fn times(intervals: &[f64]) -> Vec<f64> {
    let intervals = intervals.iter().cycle().take(FRAMES - 1);
    let later = intervals.scan(0.0, |time, interval| {
        *time += interval;
        Some(*time)
    });
    std::iter::once(0.0).chain(later).collect()
}

const NOMINAL: f64 = 1.0 / 30.0;
const KNOWN: ReadoutTime = ReadoutTime::Seconds(0.02);
/// What is stated of a stream: two of the four combinations of readout and frame period, so that successive streams have all four.
const STATED: [[(ReadoutTime, Option<f64>); 2]; 2] = [
    [(ReadoutTime::Unknown, Some(NOMINAL)), (KNOWN, None)],
    [(ReadoutTime::Unknown, None), (KNOWN, Some(NOMINAL))],
];

#[test]
fn sparse_frames_take_as_many_unknowns_as_with_their_true_rate() {
    for (interval, stated) in [0.1, 0.5, 5.0].into_iter().zip(STATED.into_iter().cycle()) {
        for (readout_time, claimed) in stated {
            let (expected, truth) = unknowns(&times(&[interval]), Some(interval), readout_time);
            let (found, solutions) = unknowns(&times(&[interval]), claimed, readout_time);
            assert_eq!(solutions.len(), FRAMES);
            // The first interval may be a hole among frames at the nominal rate.
            let allowed = if interval > 0.5 { 0 } else { 16 * expected / 10 };
            assert!(found <= expected + allowed, "{interval} s, {claimed:?}: {found} of {expected}");
            // After the spacing is estimated, the motion is the same.
            for (solution, truth) in solutions.iter().zip(&truth).skip(12) {
                let [found, expected] =
                    [solution, truth].map(|one| one.motion.path().mean_twist().velocity * interval);
                assert!((found - expected).norm() < 0.1, "{interval} s: {found:?} {expected:?}");
                assert_eq!(solution.origin, truth.origin);
            }
        }
    }
}

#[test]
fn uneven_frames_take_few_unknowns() {
    let evenly = |readout_time| (readout_time, unknowns(&times(&[NOMINAL]), Some(NOMINAL), readout_time).0);
    let even = [ReadoutTime::Unknown, KNOWN].map(evenly);
    let streams = [
        &[0.1, 2.0, NOMINAL][..],
        &[NOMINAL, 0.5],
        &[NOMINAL, NOMINAL, 0.5],
        &[0.4, NOMINAL, 0.2, 1.0, 0.1, 3.0, NOMINAL],
        &[NOMINAL, 4.0 * NOMINAL, 4.0 * NOMINAL],
    ];
    for (intervals, stated) in streams.into_iter().zip(STATED.into_iter().cycle()) {
        for ((readout_time, claimed), (of, even)) in stated.into_iter().zip(even) {
            assert_eq!(readout_time, of);
            let (found, solutions) = unknowns(&times(intervals), claimed, readout_time);
            assert_eq!(solutions.len(), FRAMES);
            assert!(found <= 3 * even, "{intervals:?}, {claimed:?}: {found} beside {even}");
        }
    }
}

#[test]
fn frames_that_come_faster_again_take_few_unknowns() {
    let slow = times(&[5.0]);
    let last = slow[FRAMES - 1];
    let fast = (1..FRAMES).map(|k| last + k as f64 * NOMINAL);
    let all: Vec<f64> = slow.iter().copied().chain(fast).collect();
    let (even, _) = unknowns(&times(&[NOMINAL]), Some(NOMINAL), KNOWN);
    let (found, solutions) = unknowns(&all, Some(NOMINAL), KNOWN);
    assert_eq!(solutions.len(), all.len());
    assert!(found <= 3 * even, "{found} beside {even}");
    assert!(solutions[all.len() - 4..].iter().all(|solution| solution.confidence > 0.5));
}

#[test]
fn one_hole_among_even_frames_changes_no_motion() {
    for hole in [0.2, 0.5, 3.0] {
        let settings = Settings {
            lookahead: 4,
            direction: Some(ReadoutDirection::TopToBottom),
            readout_time: ReadoutTime::Seconds(PERIOD),
            ..Settings::default()
        };
        let mut rectifier = Rectifier::new(settings, WIDTH, HEIGHT, Some(PERIOD)).unwrap();
        // Slow enough for the flow after the hole.
        let velocity = 0.2 * VELOCITY;
        for k in 0..FRAMES {
            let time = k as f64 * PERIOD + if k > FRAMES / 2 { hole } else { 0.0 };
            push(&mut rectifier, &frame(time, velocity), time, Duplicate::Detect);
            assert_eq!(rectifier.clock.spacing(), PERIOD);
        }
        rectifier.drain();
        pops(&mut rectifier).iter().for_each(|solution| assert_velocity(solution, velocity));
    }
}
