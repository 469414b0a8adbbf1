// SPDX-License-Identifier: MIT OR Apache-2.0

//! Cameras whose readout is unknown or hardly shows.

use super::film::*;
use super::*;
use crate::solve::continuous::fit::DECISIVE_LOG_ODDS;

#[test]
fn a_camera_at_rest_is_not_corrected() {
    let film = Film { rest: Some(40.0 * PERIOD), ..Film::new(0.8, true) };
    // The last frame to be settled has only still ones ahead.
    let (motions, continuous) = film.solved(UNKNOWN, &regular(40), 5);
    for motion in motions {
        let motion = motion.expect("what is still is measured");
        let error = film.error(motion.motion.path(), 0.0);
        assert!(motion.confidence == 0.0 && error < 0.01, "{}, {error} px", motion.confidence);
        assert!(motion.readout_deviation > 0.49, "{}", motion.readout_deviation);
    }
    let (_, deviation) = continuous.belief();
    assert!(deviation > 0.49, "{deviation}");
}

#[test]
fn a_camera_that_moves_after_a_rest_is_found_as_if_it_had_moved_at_once() {
    let pan = [[(0.0, 0.0); 2], [(0.2, 0.8), (0.0, 0.0)], [(0.0, 0.0); 2]];
    let shake = Film::new(0.8, true).swings;
    for (gamma, swings, rest) in [(0.8, shake, 40), (-0.6, shake, 40), (0.8, pan, 30)] {
        let film = Film { swings, rest: Some(rest as f64 * PERIOD), ..Film::new(gamma, true) };
        let stamps = regular(rest + 36);
        let (motions, continuous) = film.solved(UNKNOWN, &stamps, 5);
        let (readout, deviation) = continuous.belief();
        let miss = (readout.time / PERIOD - gamma.abs()).abs();
        assert!(
            miss < 0.1 && readout.direction == film.direction(),
            "γ = {gamma}: {readout:?} ± {deviation}"
        );
        let later = rest + 10;
        let left = film.share_left(&motions[later..], &stamps[later..]);
        assert!(left < 0.1, "γ = {gamma}: {left} of the distortion is left");
    }
}

#[test]
fn errors_are_no_larger_than_expected_and_not_far_below() {
    let films = [(0.1, 0.0, true), (0.5, 0.0, true), (0.1, 0.05, true), (0.1, 0.0, false), (0.5, 0.0, false)];
    for (noise, sway, is_known) in films {
        let film = Film { noise, sway, ..Film::new(0.8, true) };
        let stamps = regular(30);
        let camera = if is_known { film.camera() } else { UNKNOWN };
        let (motions, _) = film.solved(camera, &stamps, 7);
        let frames = motions.iter().flatten().zip(&stamps).skip(LOOKAHEAD);
        let squares = frames.map(|(motion, stamp)| {
            let expected = motion.region_errors.iter().map(|error| error * error).sum::<f64>();
            [film.error(motion.motion.path(), *stamp).powi(2), expected / motion.region_errors.len() as f64]
        });
        let [left, expected] = squares.fold([0.0; 2], |[a, b], [left, expected]| [a + left, b + expected]);
        let ratio = (left / expected).sqrt();
        // All that the path does not explain is taken for errors that neighbours share, so that pure noise
        // makes for errors of a fifth of what is expected.
        assert!((0.1..1.3).contains(&ratio), "noise {noise}, sway {sway}, known {is_known}: {ratio}");
    }
}

#[test]
fn a_smoothness_of_greater_evidence_is_taken_over() {
    let film = Film::new(0.8, true);
    let (_, mut continuous) = film.solved(film.camera(), &regular(20), 5);
    let pairs: Vec<&FramePair> =
        continuous.frames.iter().filter_map(|entry| entry.to_next.as_ref()).collect();
    let window = PairWindow { pairs: &pairs[pairs.len() - 6..], past: 4 };
    let camera = &mut continuous.posterior;
    camera.settle(window, Break::Gap);
    // What was learnt while the camera stood still.
    let mut still = camera.leading().clone();
    still.posterior.restart();
    still.posterior.smoothness = still.posterior.smoothness.restarted(1e-7);
    let most = camera.hypotheses[0].log_evidence(window).unwrap();
    let least = still.log_evidence(window).unwrap();
    assert!(least < most - DECISIVE_LOG_ODDS, "{least} {most}");
    let learnt = still.posterior.smoothness.clone();
    camera.hypotheses[0].try_smoothness(&learnt, most, window);
    assert!(camera.hypotheses[0].log_evidence(window).unwrap() >= most);
    camera.hypotheses.push(still);
    camera.settle(window, Break::None);
    let [least, most] = [f64::min, f64::max].map(|of| {
        let evidence = camera.hypotheses.iter_mut().map(|one| one.log_evidence(window).unwrap());
        evidence.reduce(of).unwrap()
    });
    assert!(camera.hypotheses.len() == 2 && least > most - DECISIVE_LOG_ODDS, "{least} of {most}");
}

#[test]
fn rivals_rest_while_nothing_moves() {
    let film = Film { rest: Some(1.0), ..Film::new(0.8, true) };
    let (_, continuous) = film.solved(UNKNOWN, &regular(25), 43);
    let [leading, rivals @ ..] = &continuous.posterior.hypotheses[..] else { panic!("none") };
    assert!(!rivals.is_empty() && !rivals.iter().any(Hypothesis::has_path));
    let deviation = leading.setup.camera.gamma_deviation();
    assert!(!leading.constrains_gamma() && (deviation - 0.5).abs() < 1e-9, "±{deviation} from noise");
    let (motions, continuous) = film.solved(UNKNOWN, &regular(60), 43);
    let last = motions[59].as_ref().unwrap();
    let found = last.motion.readout().time / PERIOD;
    assert!((found - 0.8).abs() < 0.03 && last.confidence > 0.9, "{found}, {}", last.confidence);
    assert_eq!(continuous.posterior.hypotheses.len(), 1);
}

#[test]
fn each_readout_that_a_window_allows_is_kept_until_it_is_ruled_out() {
    // A calm hand.
    let swings = Film::new(0.5, true).swings.map(|swings| swings.map(|(cycles, peak)| (cycles, 0.3 * peak)));
    let film = Film { swings, ..Film::new(0.5, true) };
    let by_rows = |frames| -> Vec<f64> {
        let (_, continuous) = film.solved(UNKNOWN, &regular(frames), 44);
        let hypotheses = continuous.posterior.hypotheses.iter();
        hypotheses.filter(|one| one.scan.by_rows).map(Hypothesis::gamma).collect()
    };
    let first = by_rows(5);
    assert!(first.len() == 2 && first[0] > 0.4 && first[1] < -0.1, "{first:?}");
    let later = by_rows(14);
    assert!(later.len() == 1 && (later[0] - 0.5).abs() < 0.1, "{later:?}");
}
