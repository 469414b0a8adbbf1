// SPDX-License-Identifier: MIT OR Apache-2.0

//! Cameras with a prior of the readout, right and wrong.

use super::film::*;
use super::*;
use crate::readout::{ReadoutDirection, ReadoutPrior};

/// A camera whose signed readout ratio along rows is expected to be this much, with this deviation.
fn expecting(gamma: f64, deviation: f64) -> Camera {
    let direction = if gamma < 0.0 { ReadoutDirection::BottomToTop } else { ReadoutDirection::TopToBottom };
    let prior = ReadoutPrior::new(gamma.abs() * PERIOD, deviation * PERIOD, Some(direction));
    Camera { readout_prior: Some(prior.unwrap()), ..UNKNOWN }
}

#[test]
fn the_prior_is_applied_from_the_first_frame() {
    // The prior is off by one deviation; the first window of a calm hand hardly constrains γ better.
    for (gamma, expected) in [(0.6, 0.63), (-0.9, -0.87)] {
        let swings =
            Film::new(gamma, true).swings.map(|swings| swings.map(|(cycles, peak)| (cycles, 0.2 * peak)));
        let film = Film { swings, ..Film::new(gamma, true) };
        let stamps = regular(60);
        let first = |camera| {
            let (motions, _) = film.solved(camera, &stamps[..2 + LOOKAHEAD], 41);
            let first = motions[0].clone().unwrap();
            let miss = (first.motion.readout().time / PERIOD - gamma.abs()).abs();
            (miss, first.readout_deviation, first.confidence, film.worst(&motions[..1], &stamps, 0))
        };
        let (miss, deviation, confidence, worst) = first(expecting(expected, 0.03));
        assert!(miss < 0.05 && confidence > 0.9 && worst < 0.2, "γ ± {miss}, {confidence}, {worst} px");
        let unknown = first(UNKNOWN);
        // What is left is the probability of the opposite edge and of the other axis.
        assert!(
            miss < unknown.0 && deviation < unknown.1.min(0.25),
            "{miss} ± {deviation}, without: {unknown:?}"
        );
        let (motions, continuous) = film.solved(expecting(expected, 0.03), &stamps, 41);
        let (readout, deviation) = continuous.belief();
        let found = readout.time / PERIOD;
        assert!((found - gamma.abs()).abs() < 0.035 && deviation < 0.03, "{found} ± {deviation}");
        assert_eq!(readout.direction, film.direction());
        assert!(film.worst(&motions, &stamps, 30) < 0.1);
    }
}

#[test]
fn a_wrong_expectation_is_overruled() {
    for (gamma, by_rows, expected) in
        [(0.9, true, 0.3), (0.3, true, 0.9), (-0.8, true, 0.6), (0.7, false, 0.5), (0.0, true, 0.6)]
    {
        let film = Film::new(gamma, by_rows);
        let (_, continuous) = film.solved(expecting(expected, 0.03), &regular(90), 42);
        let (readout, deviation) = continuous.belief();
        let found = readout.time / PERIOD;
        assert!((found - gamma.abs()).abs() < 0.05, "{gamma}, not {expected}: {found} ± {deviation}");
        assert!(gamma == 0.0 || readout.direction == film.direction(), "{gamma}: {readout:?}");
    }
}

#[test]
fn a_prior_that_contradicts_the_givens_is_ignored() {
    let film = Film::new(-0.8, true);
    let stamps = regular(12);
    let known = Camera { direction: Some(film.direction()), ..UNKNOWN };
    let told = Camera { direction: Some(film.direction()), ..expecting(0.3, 0.01) };
    assert_eq!(film.solved(known, &stamps, 43).1.belief(), film.solved(told, &stamps, 43).1.belief());
    let told = Camera { readout_prior: expecting(-0.3, 0.01).readout_prior, ..film.camera() };
    assert_eq!(film.solved(film.camera(), &stamps, 43).1.belief(), film.solved(told, &stamps, 43).1.belief());
}

#[test]
fn a_time_may_be_expected_from_any_edge() {
    let prior = ReadoutPrior::new(0.8 * PERIOD, 0.03 * PERIOD, None).unwrap();
    let camera = Camera { readout_prior: Some(prior), ..UNKNOWN };
    for (gamma, by_rows) in [(0.8, true), (-0.8, true), (0.8, false)] {
        let film = Film::new(gamma, by_rows);
        let (_, continuous) = film.solved(camera, &regular(30), 44);
        let (readout, deviation) = continuous.belief();
        let found = readout.time / PERIOD;
        assert!((found - 0.8).abs() < 0.03 && deviation < 0.1, "{gamma}: {found} ± {deviation}");
        assert_eq!(readout.direction, film.direction());
    }
}
