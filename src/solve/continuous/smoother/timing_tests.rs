// SPDX-License-Identifier: MIT OR Apache-2.0

//! Frames that were not exposed when their timestamps say so, or moved after their readout.

use super::film::*;
use super::*;
use crate::solve::continuous::camera::READOUT_BELIEF;
use crate::solve::continuous::data::ScanAxis;
use crate::solve::random::Random;

/// The solutions of frames exposed at these times, with these timestamps, and each moved by so many pixels.
fn solved(
    film: &Film,
    exposed: &[f64],
    stated: &[f64],
    moved: impl Fn(f64) -> Vector2<f64>,
) -> (Vec<Option<FrameSolution>>, Continuous) {
    let mut random = Random(31);
    let [width, height] = film.size();
    let mut continuous = Continuous::new(UNKNOWN, width, height, 1.0);
    let mut solutions = Vec::new();
    for (k, stamp) in stated.iter().enumerate() {
        let found = k.checked_sub(1).map(|before| {
            let [first, second] = [exposed[before], exposed[k]];
            let mut found = film.pair(first, second, &mut random);
            for one in &mut found {
                one.from += moved(first);
                one.to += moved(second);
            }
            found
        });
        push(&mut continuous, found.as_deref(), *stamp);
        if k >= LOOKAHEAD {
            solutions.push(settle(&mut continuous));
        }
    }
    (solutions, continuous)
}

fn as_seen(_: f64) -> Vector2<f64> {
    Vector2::zeros()
}

/// The readout ratio of the last solution in frame periods, and its deviation.
fn last_readout(solutions: &[Option<FrameSolution>]) -> [f64; 2] {
    let last = solutions.last().unwrap().as_ref().unwrap();
    [last.motion.readout().time / PERIOD, last.readout_deviation]
}

fn check_readout(film: &Film, solutions: &[Option<FrameSolution>]) {
    let [found, deviation] = last_readout(solutions);
    assert!((found - film.gamma).abs() < 0.03 && deviation < 0.03, "{found} ± {deviation}");
    let last = solutions.last().unwrap().as_ref().unwrap();
    assert_eq!(last.motion.readout().direction, film.direction());
}

#[test]
fn frames_as_recorded_are_known_as_such() {
    for by_rows in [true, false] {
        let film = Film::new(0.7, by_rows);
        let (solutions, continuous) = solved(&film, &regular(30), &regular(30), as_seen);
        check_readout(&film, &solutions);
        assert_eq!(continuous.timing().stabilised, Some(false));
        assert_eq!(continuous.timing().timeline, Timeline::Stated);
    }
}

#[test]
fn a_path_of_another_readout_or_axis_contradicts_the_first_pairs() {
    for by_rows in [true, false] {
        let film = Film::new(0.7, by_rows);
        let (_, continuous) = solved(&film, &regular(8), &regular(8), as_seen);
        let axis = continuous.posterior.leading().setup.scan_axis;
        let [width, height] = film.size().map(|side| side as f64 / continuous.radius);
        let other = ScanAxis { by_rows: !by_rows, length: if by_rows { width } else { height } };
        let mut timing = Timing::new(NOISE / continuous.radius);
        let mut contradicts = |camera: (ScanAxis, Option<f64>)| {
            timing.update_doubt(latest_pairs(&continuous.frames), camera);
            timing.contradicts_path(0, camera.0)
        };
        let along = [None, Some(0.7), Some(-0.4), Some(0.1)].map(|gamma| contradicts((axis, gamma)));
        assert_eq!(along, [false, false, true, true]);
        assert!(contradicts((other, Some(0.7))) && contradicts((other, Some(-0.3))));
        assert!(!contradicts((axis, Some(0.7))));
    }
}

#[test]
fn of_five_frames_one_is_missing() {
    let film = Film::new(0.7, true);
    let exposed: Vec<f64> = (0..50).filter(|k| k % 5 != 3).map(|k| f64::from(k) * PERIOD).collect();
    let stated: Vec<f64> = (0..exposed.len()).map(|k| 1.25 * k as f64 * PERIOD).collect();
    let (solutions, continuous) = solved(&film, &exposed, &stated, as_seen);
    assert_eq!(continuous.timing().timeline, Timeline::Missing { kept: 4, longer: 2 });
    check_readout(&film, &solutions);
    let worst = film.worst(&solutions[25..], &exposed[25..], 0);
    assert!(worst < 0.15, "{worst} px");
}

#[test]
fn repeated_frames_were_even() {
    let film = Film::new(0.7, false);
    let exposed: Vec<f64> = (0..40).map(|k| 1.2 * f64::from(k) * PERIOD).collect();
    let stated: Vec<f64> = exposed.iter().map(|time| (time / PERIOD + 0.01).floor() * PERIOD).collect();
    let (solutions, continuous) = solved(&film, &exposed, &stated, as_seen);
    assert!(
        matches!(continuous.timing().timeline, Timeline::Even { interval } if (interval - 1.2).abs() < 0.01)
    );
    check_readout(&film, &solutions);
}

/// The solutions of frames that are moved so that the middle of the picture stands still, and their times.
fn stabilised(film: &Film) -> (Vec<f64>, Vec<Option<FrameSolution>>, Continuous) {
    let [width, height] = film.size();
    let centre = image_centre(width, height);
    let late = film.readout().time / 2.0;
    let steady = |t: f64| centre - film.carry(centre, 0.0, t + late);
    let (solutions, continuous) = solved(film, &regular(50), &regular(50), steady);
    (regular(50), solutions, continuous)
}

/// Shaken at 0.1 to 0.25 cycles a frame: of slower leans the changes say little.
const FAST: [[(f64, f64); 2]; 3] =
    [[(4.1, 0.012), (7.3, 0.004)], [(3.7, 0.015), (6.1, 0.005)], [(3.1, 0.012), (5.3, 0.005)]];

#[test]
fn the_lean_of_stabilised_frames_is_told_from_its_changes() {
    for (gamma, by_rows) in [(0.7, true), (-0.8, false)] {
        let film = Film { swings: FAST, ..Film::new(gamma, by_rows) };
        let (stamps, solutions, continuous) = stabilised(&film);
        assert_eq!(continuous.timing().stabilised, Some(true));
        let [mut left, mut whole, mut untouched, mut expected] = [0.0; 4];
        for (solution, stamp) in solutions.iter().zip(&stamps).skip(16) {
            let solution = solution.as_ref().unwrap();
            assert_eq!(solution.confidence, solution.motion.weight());
            // The frames are moved by some pixels, and their leans with them.
            left += film.error(solution.motion.path(), *stamp).powi(2);
            let own = film.error(&MotionPath::STILL, *stamp).powi(2);
            whole += own;
            untouched += if solution.confidence > 0.0 { 0.0 } else { own };
            expected += solution.expected_error.unwrap().powi(2);
        }
        // Of a lean that is nearly 0 little is sure.
        assert!(untouched < 0.1 * whole, "γ = {gamma}: {untouched} of {whole}");
        assert!(left < 0.25 * whole, "γ = {gamma}: {}", (left / whole).sqrt());
        assert!(expected > 0.5 * left && expected < whole, "γ = {gamma}: {expected} of {whole}, left {left}");
    }
}

#[test]
fn stabilised_frames_before_the_verdict_are_in_doubt() {
    let film = Film { swings: FAST, ..Film::new(0.7, true) };
    let (stamps, solutions, _) = stabilised(&film);
    let early: Vec<_> =
        solutions.iter().flatten().take_while(|one| one.timing.stabilised.is_none()).collect();
    assert!(early.len() >= 10, "{}", early.len());
    for (solution, stamp) in early.into_iter().zip(&stamps) {
        assert!(solution.readout_deviation >= READOUT_BELIEF.1, "{}", solution.readout_deviation);
        let [left, whole] = [solution.motion.path(), &MotionPath::STILL].map(|path| film.error(path, *stamp));
        assert!(left < 1.1 * whole, "at {stamp} s: {left} of {whole} px");
        assert_eq!(solution.as_recorded, Some(AsRecorded::UnknownReadout), "not that nothing moved");
    }
}

#[test]
fn the_readout_of_a_pan_that_was_evenly_slowed_down_is_uncertain() {
    let swings = [[(0.9, 0.004), (1.9, 0.001)], [(1.2, 0.12), (2.7, 0.002)], [(0.9, 0.004), (2.3, 0.001)]];
    let film = Film { swings, ..Film::new(0.7, true) };
    let [width, height] = film.size();
    let centre = image_centre(width, height);
    let late = film.readout().time / 2.0;
    let run = |share: f64| {
        let slowed = |t: f64| (centre - film.carry(centre, 0.0, t + late)) * share;
        solved(&film, &regular(50), &regular(50), slowed)
    };
    // What the curvature neglects of wide turns is some hundredths of γ.
    let [found, deviation] = last_readout(&run(0.0).0);
    assert!((found - film.gamma).abs() < 0.01 && deviation < 0.06, "{found} ± {deviation}");
    let (solutions, continuous) = run(0.25);
    let [found, deviation] = last_readout(&solutions);
    assert!(found > film.gamma + 0.1 && deviation > 0.5 * (found - film.gamma), "{found} ± {deviation}");
    let likeliest = continuous.posterior().unwrap().hypotheses[0];
    assert!(likeliest.deviation > 0.5 * (found - film.gamma) * PERIOD);
    assert_eq!(continuous.timing().stabilised, None);
}

#[test]
fn stabilised_frames_say_nothing_of_the_readout() {
    let (_, solutions, continuous) = stabilised(&Film::new(0.7, true));
    assert!(last_readout(&solutions)[1] >= READOUT_BELIEF.1);
    let hypotheses = continuous.posterior().unwrap().hypotheses;
    assert!(hypotheses.iter().all(|one| one.deviation >= READOUT_BELIEF.1 * PERIOD));
}

#[test]
fn frames_that_are_said_to_be_stabilised_are_left_until_their_lean_is_known() {
    let film = Film::new(0.7, true);
    let [width, height] = film.size();
    let mut continuous = Continuous::new(UNKNOWN, width, height, 1.0).with_stabilised(Some(true));
    let mut random = Random(3);
    let stamps = regular(8);
    for (k, stamp) in stamps.iter().enumerate() {
        let found = k.checked_sub(1).map(|before| film.pair(stamps[before], *stamp, &mut random));
        push(&mut continuous, found.as_deref(), *stamp);
    }
    for solution in (0..8).filter_map(|_| settle(&mut continuous)) {
        assert_eq!((solution.confidence, solution.motion.weight()), (0.0, 0.0));
        assert_eq!(solution.timing.stabilised, Some(true));
    }
}

/// Frames of each of two shots.
const SHOT: usize = 50;

/// The solutions of two shots, each stabilised or as recorded.
fn two_shots(films: [&Film; 2], are_stabilised: [bool; 2]) -> (Vec<Option<FrameSolution>>, Continuous) {
    let [width, height] = films[0].size();
    let mut continuous = Continuous::new(UNKNOWN, width, height, 1.0);
    let (mut random, mut solutions) = (Random(31), Vec::new());
    let stamps = regular(2 * SHOT);
    for (k, stamp) in stamps.iter().enumerate() {
        let film = films[k / SHOT];
        let centre = image_centre(width, height);
        let late = film.readout().time / 2.0;
        let steady = |t: f64| {
            (centre - film.carry(centre, 0.0, t + late)) * f64::from(u8::from(are_stabilised[k / SHOT]))
        };
        let found = k.checked_sub(1).map(|before| {
            if k == SHOT {
                return Vec::new();
            }
            let mut found = film.pair(stamps[before], *stamp, &mut random);
            for one in &mut found {
                one.from += steady(stamps[before]);
                one.to += steady(*stamp);
            }
            found
        });
        push(&mut continuous, found.as_deref(), *stamp);
        if k >= LOOKAHEAD {
            solutions.push(settle(&mut continuous));
        }
    }
    (solutions, continuous)
}

#[test]
fn each_shot_of_a_film_has_a_verdict_of_its_own() {
    let film = Film::new(0.7, true);
    for are_stabilised in [[true, false], [false, true]] {
        let (solutions, continuous) = two_shots([&film, &film], are_stabilised);
        let verdict = |frame: usize| solutions[frame].as_ref().map(|one| one.timing.stabilised);
        // The last frame of the first shot is settled when the second one has begun.
        assert_eq!(verdict(SHOT - 1), Some(Some(are_stabilised[0])));
        assert_eq!(continuous.timing().stabilised, Some(are_stabilised[1]));
        if !are_stabilised[1] {
            check_readout(&film, &solutions);
        }
    }
}

#[test]
fn a_verdict_lapses_in_a_shot_that_does_not_confirm_it() {
    let film = Film::new(0.7, true);
    let still = Film { swings: [[(1.0, 0.0); 2]; 3], ..Film::new(0.7, true) };
    let (solutions, continuous) = two_shots([&film, &still], [true, false]);
    let verdicts: Vec<_> = solutions.iter().flatten().map(|one| one.timing.stabilised).collect();
    assert!(verdicts.iter().filter(|verdict| **verdict == Some(true)).count() > SHOT / 2);
    assert_eq!(continuous.timing().stabilised, None);
}

/// The solutions of so many frames, sharp after a cut before frame `cut`; those before it are blends of two, five of six of them.
fn blended(frames: usize, cut: usize) -> (Vec<Option<FrameSolution>>, Continuous) {
    let film = Film::new(0.7, true);
    let [width, height] = film.size();
    let (mut continuous, mut random) = (Continuous::new(UNKNOWN, width, height, 1.0), Random(31));
    let mut solutions = Vec::new();
    for (k, stamp) in regular(frames).into_iter().enumerate() {
        let found = (k > 0)
            .then(|| if k == cut { Vec::new() } else { film.pair(stamp - PERIOD, stamp, &mut random) });
        let share = if k < cut { (k % 6) as f64 / 6.0 } else { 0.0 };
        continuous.push(found.as_deref(), stamp, PERIOD, 200.0 * (1.0 - 2.0 * share * (1.0 - share)));
        solutions.push(settle(&mut continuous));
    }
    (solutions, continuous)
}

#[test]
fn blends_of_the_shot_before_do_not_leave_the_next_one_as_it_is() {
    let (solutions, continuous) = blended(2 * SHOT, SHOT);
    assert!(solutions[SHOT - 1].is_none());
    assert_eq!(continuous.timing().timeline, Timeline::Stated);
    assert!(solutions.last().unwrap().is_some());
}

#[test]
fn another_stretch_has_lost_the_count_of_frames() {
    let film = Film::new(0.7, true);
    let exposed: Vec<f64> = (0..40).filter(|k| k % 4 != 3).map(|k| f64::from(k) * PERIOD).collect();
    let stated: Vec<f64> = (0..exposed.len()).map(|k| 4.0 / 3.0 * k as f64 * PERIOD).collect();
    let (_, mut continuous) = solved(&film, &exposed, &stated, as_seen);
    assert!(matches!(continuous.timing().timeline, Timeline::Missing { kept: 3, .. }));
    continuous.restart();
    assert_eq!(continuous.timing().timeline, Timeline::Stated);
}

#[test]
fn blends_stay_as_they_are_and_say_nothing_of_the_readout() {
    let (solutions, continuous) = blended(30, 30);
    assert_eq!(continuous.timing().timeline, Timeline::Blended { period: 6 });
    let known: Vec<bool> = solutions.iter().map(Option::is_some).collect();
    let first = FrameTiming::FRAMES - 1;
    assert!(
        known[1..first].iter().all(|known| *known) && known[first..].iter().all(|known| !known),
        "{known:?}"
    );
    assert_eq!(continuous.belief().1, READOUT_BELIEF.1);
}

#[test]
fn a_shake_too_fast_for_the_shifts_to_tell_its_velocity_is_corrected() {
    // 0.3 to 0.8 cycles a frame.
    let swings =
        [[(9.4, 0.007), (18.3, 0.004)], [(11.1, 0.006), (20.1, 0.004)], [(13.9, 0.004), (22.9, 0.003)]];
    let film = Film { swings, ..Film::new(0.6, true) };
    let stamps = regular(40 + LOOKAHEAD);
    for camera in [UNKNOWN, film.camera()] {
        let (motions, _) = film.solved(camera, &stamps, 3);
        let left = film.share_left(&motions, &stamps);
        assert!(left < 0.08, "{left}");
    }
}
