// SPDX-License-Identifier: MIT OR Apache-2.0

//! Whole windows of exact correspondences.

use super::film::*;
use super::*;
use crate::solve::random::Random;

#[test]
fn a_known_camera_s_path_is_found() {
    for (gamma, by_rows) in [(0.9, true), (-0.5, true), (0.7, false), (-1.0, false)] {
        let film = Film::new(gamma, by_rows);
        let stamps = regular(12);
        let (motions, _) = film.solved(film.camera(), &stamps, 1);
        assert_eq!(motions.len(), 12);
        let worst = film.worst(&motions, &stamps, 0);
        assert!(worst < 0.1, "γ = {gamma}: {worst} px");
        let motion = motions[6].as_ref().unwrap();
        assert_eq!(motion.motion.readout().direction, film.direction());
        assert!(motion.confidence > 0.9 && motion.inliers > 700 && (0.05..0.15).contains(&motion.residual));
    }
}

#[test]
fn reverse_playback_finds_the_same_path() {
    let film = Film::new(0.8, true);
    let mut stamps = regular(12);
    stamps.reverse();
    let (motions, _) = film.solved(film.camera(), &stamps, 2);
    let worst = film.worst(&motions, &stamps, 0);
    assert!(worst < 0.1, "{worst} px");
}

#[test]
fn lost_frames_and_uneven_intervals_change_little() {
    let film = Film::new(0.8, true);
    let mut random = Random(3);
    let jittered = regular(18).into_iter().map(|stamp| stamp + 0.2 * PERIOD * random.uniform());
    let stamps: Vec<f64> =
        jittered.enumerate().filter(|(k, _)| ![5, 11, 12].contains(k)).map(|(_, t)| t).collect();
    let (motions, _) = film.solved(film.camera(), &stamps, 4);
    let worst = film.worst(&motions, &stamps, 0);
    assert!(worst < 0.12, "{worst} px");
}

#[test]
fn a_third_of_wild_correspondences_is_survived() {
    let film = Film { wild: Some(3), ..Film::new(0.9, true) };
    let stamps = regular(12);
    let (motions, _) = film.solved(film.camera(), &stamps, 5);
    let worst = film.worst(&motions, &stamps, 0);
    assert!(worst < 0.15, "{worst} px");
    let inliers = motions[6].as_ref().unwrap().inliers;
    assert!((450..=540).contains(&inliers), "{inliers} of 512");
}

/// Estimates readout and focal length without givens.
fn find_camera(gamma: f64, by_rows: bool, frames: usize, seed: u64) {
    let film = Film::new(gamma, by_rows);
    let stamps = regular(frames);
    let (motions, _) = film.solved(UNKNOWN, &stamps, seed);
    let last = motions[frames - 1].as_ref().unwrap();
    assert_eq!(last.motion.readout().direction, film.direction());
    let found = last.motion.readout().time / PERIOD;
    let miss = (found - gamma.abs()).abs();
    assert!(miss < 0.02 && miss < 2.0 * last.readout_deviation, "γ = {gamma}: {found}");
    let FocalLength { widths: focal, deviation } = last.focal_length.unwrap();
    assert!((focal / film.focal - 1.0).abs() < 0.05, "γ = {gamma}: f = {focal}");
    assert!(deviation > 0.0 && (focal - film.focal).abs() < 2.0 * deviation, "γ = {gamma}: ±{deviation}");
    let worst = film.worst(&motions, &stamps, frames - 5);
    assert!(worst < 0.1 && last.confidence > 0.9, "γ = {gamma}: {worst} px, {}", last.confidence);
}

#[test]
fn readout_and_focal_length_of_an_upright_camera_are_found() {
    find_camera(0.9, true, 30, 10);
    find_camera(-0.6, true, 30, 11);
}

#[test]
fn readout_and_focal_length_of_a_camera_on_its_side_are_found() {
    find_camera(0.7, false, 30, 12);
    find_camera(-0.4, false, 60, 13);
}

#[test]
fn parallax_constrains_the_readout() {
    // Three quarters of the motion are parallax; the nearest points move three times as far as the farthest.
    let swings = Film::new(0.8, true).swings.map(|swings| swings.map(|(cycles, peak)| (cycles, 0.2 * peak)));
    let film = Film { swings, sway: 0.2, ..Film::new(0.8, true) };
    let stamps = regular(40);
    let camera = Camera { direction: Some(film.direction()), ..UNKNOWN };
    let (motions, _) = film.solved(camera, &stamps, 27);
    let last = motions[39].as_ref().unwrap();
    let found = last.motion.readout().time / PERIOD;
    assert!(last.residual > 5.0 * film.noise, "what one path leaves is parallax: {} px", last.residual);
    assert!((found - 0.8).abs() < 0.05, "γ = {found} ± {}", last.readout_deviation);
}

#[test]
fn a_translating_camera_constrains_the_readout_from_the_second_frame_on() {
    // In one pair this looks much like a rotation; depth distinguishes them. Half a metre is much before a
    // scene at two to six.
    for (gamma, sway) in [(0.9, 0.4), (-0.6, 0.6)] {
        let film = Film { sway, swings: [[(1.0, 0.0); 2]; 3], ..Film::new(gamma, true) };
        let (motions, _) = film.solved(UNKNOWN, &regular(12), 24);
        for (motion, most) in [(&motions[1], 0.25), (&motions[11], 0.2)] {
            let readout = motion.as_ref().unwrap().motion.readout();
            let miss = (readout.time / PERIOD - gamma.abs()).abs();
            assert!(miss < most && readout.direction == film.direction(), "{readout:?}");
        }
    }
}

#[test]
fn an_unknown_readout_is_acted_upon_from_the_first_frame() {
    for (gamma, by_rows) in [(0.9, true), (-0.9, true), (0.6, true), (-0.6, false)] {
        let film = Film::new(gamma, by_rows);
        let stamps = regular(8);
        let (motions, _) = film.solved(UNKNOWN, &stamps, 15);
        let first = motions[0].as_ref().unwrap();
        assert_eq!(first.motion.readout().direction, film.direction());
        assert!(first.confidence > 0.45, "γ = {gamma}: {}", first.confidence);
        let worst = film.worst(&motions, &stamps, 0);
        assert!(worst < 0.3, "γ = {gamma}: {worst} px");
    }
}

#[test]
fn the_edge_that_is_read_first_shows_in_the_first_window() {
    for (gamma, by_rows) in [(0.8, true), (-0.8, true), (0.8, false), (-0.8, false)] {
        let film = Film::new(gamma, by_rows);
        let camera = Camera { direction: None, ..film.camera() };
        let (motions, continuous) = film.solved(camera, &regular(9), 16);
        assert!(motions.iter().flatten().all(|motion| motion.motion.readout().direction == film.direction()));
        assert_eq!(continuous.posterior.hypotheses.len(), 1, "the other three are given up");
    }
}

#[test]
fn starts_from_both_edges_come_to_one_answer() {
    for gamma in [0.8, -0.5] {
        let film = Film::new(gamma, true);
        let camera =
            Camera { direction: None, readout_time: crate::readout::ReadoutTime::Unknown, ..film.camera() };
        let (motions, continuous) = film.solved(camera, &regular(25), 3);
        let same = continuous
            .posterior
            .hypotheses
            .iter()
            .filter(|one| one.agrees_with(continuous.posterior.leading()));
        assert_eq!(same.count(), 1, "{gamma}");
        let readout = *motions.last().cloned().flatten().unwrap().motion.readout();
        assert_eq!(readout.direction, film.direction());
        assert!((readout.time / PERIOD - gamma.abs()).abs() < 0.02, "{readout:?}");
    }
}

#[test]
fn no_edge_is_dropped_without_motion() {
    // Given a short readout time, the edges differ in the sign of γ; a camera at rest shows neither.
    let film = Film { swings: [[(0.0, 0.0); 2]; 3], ..Film::new(0.08, true) };
    let camera = Camera { direction: None, ..film.camera() };
    let (_, continuous) = film.solved(camera, &regular(12), 3);
    assert_eq!(continuous.posterior.hypotheses.len(), 4);
}

#[test]
fn matches_count_by_their_covariance() {
    let film = Film::new(0.8, true);
    let stamps = regular(12);
    let mut random = Random(9);
    let mut solve = |stated: f64| {
        let mut continuous = Continuous::new(film.camera(), SIZE[0], SIZE[1], 1.0);
        for (k, stamp) in stamps.iter().enumerate() {
            let mut pair = k.checked_sub(1).map(|before| film.pair(stamps[before], *stamp, &mut random));
            // Two of three are off by 3 px along x.
            for (_, found) in pair.iter_mut().flatten().enumerate().filter(|(index, _)| index % 3 > 0) {
                found.to.x += 3.0 * random.normal();
                found.covariance.m11 = stated * stated;
            }
            push(&mut continuous, pair.as_deref(), *stamp);
        }
        let motions: Vec<Option<FrameSolution>> = stamps.iter().map(|_| settle(&mut continuous)).collect();
        film.share_left(&motions, &stamps)
    };
    let (told, untold) = (solve(3.0), solve(0.0));
    assert!(told < 0.03 && told < 0.5 * untold, "{told}, {untold}");
}

#[test]
fn matches_on_few_lines_do_not_constrain_the_readout() {
    let film = Film::new(0.9, true);
    let stamps = regular(30);
    let mut random = Random(17);
    let mut continuous = Continuous::new(UNKNOWN, SIZE[0], SIZE[1], 1.0);
    for k in 0..30 {
        let pair = (k > 0).then(|| film.pair(stamps[k - 1], stamps[k], &mut random));
        let pair = pair.map(|mut pair| {
            pair.retain(|found| {
                (200.0..280.0).contains(&found.from.y) && (200.0..280.0).contains(&found.from.x)
            });
            pair
        });
        push(&mut continuous, pair.as_deref(), stamps[k]);
    }
    for motion in (0..30).filter_map(|_| settle(&mut continuous)) {
        assert!(motion.readout_deviation > 0.49 && motion.confidence == 0.0, "{}", motion.readout_deviation);
    }
}

#[test]
fn a_moving_object_does_not_bend_the_path() {
    // Some 10 px from frame to frame, on more than a third of the picture.
    let film = Film { own: 25.0, sway: 0.05, ..Film::new(0.8, true) };
    let stamps = regular(24);
    for camera in [film.camera(), UNKNOWN] {
        let (motions, continuous) = film.solved(camera, &stamps, 3);
        let (readout, _) = continuous.belief();
        assert_eq!(readout.direction, film.direction());
        assert!((readout.time / PERIOD - 0.8).abs() < 0.03, "{readout:?}");
        let worst = film.worst(&motions, &stamps, 4);
        assert!(worst < 0.3, "{worst} px");
    }
}

#[test]
fn a_static_overlay_is_not_taken_for_a_shutter() {
    // One line of writing; the bonnet below a dashcam.
    for (fixed, most) in [(0.06, 0.1), (0.35, 0.6)] {
        // A tenth of the usual shake: the overlay is a pixel or two off.
        let mut film = Film { fixed, noise: 0.05, ..Film::new(0.8, true) };
        film.swings.as_flattened_mut().iter_mut().for_each(|(_, peak)| *peak *= 0.1);
        let stamps = regular(24);
        let (motions, continuous) = film.solved(UNKNOWN, &stamps, 4);
        let (readout, deviation) = continuous.belief();
        assert_eq!(readout.direction, film.direction());
        assert!((readout.time / PERIOD - 0.8).abs() < 2.0 * deviation, "{fixed}: {readout:?} ± {deviation}");
        let left = film.share_left(&motions, &stamps);
        assert!(left < most, "{fixed}: {left}");
    }
}

#[test]
fn a_global_shutter_is_not_corrected() {
    let film = Film::new(0.0, true);
    let stamps = regular(30);
    let (motions, _) = film.solved(UNKNOWN, &stamps, 20);
    // Without distortion, any correction is an error.
    let worst = film.worst(&motions, &stamps, 20);
    assert!(worst < 0.1, "{worst} px");
    for motion in motions.iter().skip(20).flatten() {
        assert!(motion.motion.readout().time / PERIOD < 0.015, "{:?}", motion.motion.readout());
        assert!(motion.confidence < 0.5, "{}", motion.confidence);
    }
}

#[test]
fn a_vibration_above_the_frame_rate_is_followed() {
    // Hand-held, with an engine of 1.7 cycles a frame that shakes it by 3 px.
    let hand = Film::new(0.9, true).swings;
    let swings = [[hand[0][0], (51.0, 0.005)], [hand[1][0], (51.0, 0.005)], [hand[2][0], (0.0, 0.0)]];
    let film = Film { swings, ..Film::new(0.9, true) };
    let stamps = regular(16);
    let (motions, _) = film.solved(film.camera(), &stamps, 25);
    let [mut left, mut whole] = [0.0, 0.0];
    for (motion, stamp) in motions.iter().zip(&stamps).skip(4) {
        left += film.error(motion.as_ref().unwrap().motion.path(), *stamp).powi(2);
        whole += film.error(&MotionPath::STILL, *stamp).powi(2);
    }
    let share = (left / whole).sqrt();
    assert!(share < 0.25, "{share} of the distortion is left");
}

#[test]
fn two_vibrations_at_once_are_learnt_from_the_first_window() {
    // Engines of 1.2 to 2.4 cycles a frame about each axis, and about one alone, so that the others have no
    // prediction to learn.
    let [still, pair] = [[(0.0, 0.0); 2], [(39.0, 0.0066), (69.0, 0.0039)]];
    let all = [pair, [(36.0, 0.0066), (63.0, 0.0039)], [(42.0, 0.0066), (72.0, 0.0039)]];
    for swings in [all, [still, still, pair]] {
        let film = Film { swings, noise: 0.05, ..Film::new(1.0, true) };
        let stamps = regular(12);
        let (motions, _) = film.solved(film.camera(), &stamps, 28);
        let share = film.share_left(&motions, &stamps);
        assert!(share < 0.1, "{swings:?}: {share} of the distortion is left");
    }
}

#[test]
fn a_vibration_beside_a_hand_s_shake_is_learnt() {
    let swings =
        [[(1.4, 0.05), (39.0, 0.0066)], [(1.1, 0.07), (63.0, 0.0039)], [(0.9, 0.05), (42.0, 0.0066)]];
    let film = Film { swings, noise: 0.05, ..Film::new(0.8, true) };
    let stamps = regular(16);
    let (motions, _) = film.solved(film.camera(), &stamps, 29);
    // Another density is tried once the shake is not nearly all that moves.
    let share = film.share_left(&motions[4..], &stamps[4..]);
    assert!(share < 0.03, "{share} of the distortion is left");
}

#[test]
fn a_vibration_constrains_the_readout_and_its_direction() {
    // Sampled once a frame, 1.7 cycles a frame alias to a slower swing; within a frame they do not.
    for gamma in [0.9, -0.9] {
        let swings = [[(51.0, 0.006), (0.0, 0.0)], [(51.0, 0.006), (1.1, 0.03)], [(0.0, 0.0); 2]];
        let film = Film { swings, ..Film::new(gamma, true) };
        let (motions, _) = film.solved(UNKNOWN, &regular(8), 27);
        let first = motions[0].as_ref().unwrap();
        assert_eq!(first.motion.readout().direction, film.direction());
        assert!(
            first.confidence > 0.5 && first.residual < 0.3,
            "{}, {} px",
            first.confidence,
            first.residual
        );
    }
}

#[test]
fn points_are_expected_at_the_continued_motion() {
    let film = Film::new(0.8, true);
    let stamps = regular(9);
    let (mut random, mut misses) = (Random(26), Vec::new());
    let mut continuous = Continuous::new(film.camera(), SIZE[0], SIZE[1], 1.0);
    for k in 0..9 {
        let pair = (k > 0).then(|| film.pair(stamps[k - 1], stamps[k], &mut random));
        if let Some(found) = pair.as_ref().filter(|_| k > 5).and_then(|pair| pair.get(400)) {
            let miss = (continuous.expected(found.from) - found.to).norm();
            misses.push([miss, (found.to - found.from).norm()]);
        }
        push(&mut continuous, pair.as_deref(), stamps[k]);
        settle(&mut continuous);
    }
    assert!(misses.iter().all(|[miss, moved]| miss < moved), "{misses:?}");
}

#[test]
fn a_restart_forgets_the_path_and_keeps_the_camera() {
    let film = Film::new(0.8, true);
    let stamps = regular(30);
    let (_, mut continuous) = film.solved(UNKNOWN, &stamps, 30);
    continuous.restart();
    assert!(settle(&mut continuous).is_none());
    let mut random = Random(31);
    let later: Vec<f64> = (0..3).map(|k| 77.0 + k as f64 * PERIOD).collect();
    for k in 0..3 {
        let found = (k > 0).then(|| film.pair(later[k - 1], later[k], &mut random));
        push(&mut continuous, found.as_deref(), later[k]);
    }
    let motions: Vec<_> = (0..3).map(|_| settle(&mut continuous)).collect();
    let first = motions[0].as_ref().unwrap();
    assert!(
        (first.motion.readout().time / PERIOD - 0.8).abs() < 0.02 && first.confidence > 0.9,
        "{:?}",
        *first.motion.readout()
    );
    let worst = film.worst(&motions, &later, 0);
    assert!(worst < 0.12, "{worst} px");
}

/// Signed readout ratio and its stated deviation at a cut to another camera, and `frames` later.
fn found_after_a_cut(before: f64, after: f64, frames: usize, seed: u64) -> [(f64, f64); 2] {
    let [before, after] = [before, after].map(|ratio| Film::new(ratio, true));
    let mut random = Random(seed);
    let mut continuous = Continuous::new(UNKNOWN, SIZE[0], SIZE[1], 1.0);
    let stamps = regular(40 + frames);
    let mut found = Vec::new();
    for (k, stamp) in stamps.iter().enumerate() {
        let film = if k < 40 { &before } else { &after };
        // At the cut, none are found.
        let pair = k.checked_sub(1).map(|last| match k {
            40 => Vec::new(),
            _ => film.pair(stamps[last], *stamp, &mut random),
        });
        push(&mut continuous, pair.as_deref(), *stamp);
        if k >= LOOKAHEAD {
            settle(&mut continuous);
            let (_, deviation) = continuous.belief();
            found.push((continuous.posterior.leading().gamma(), deviation));
        }
    }
    [found[40], found[found.len() - 1]]
}

#[test]
fn another_camera_after_a_cut_is_noticed() {
    let [_, (ratio, deviation)] = found_after_a_cut(0.8, -0.6, 50, 31);
    assert!((ratio + 0.6).abs() < 0.05 && deviation < 0.05, "{ratio} ± {deviation}");
    // A readout that differs less explains shake nearly as well; the stated deviation covers it where it is
    // not found.
    let mut found = 0;
    for (before, after, seed) in
        [(0.9, 0.5, 31), (0.9, 0.5, 37), (-0.4, -0.9, 31), (-0.4, -0.9, 34), (-0.4, -0.9, 35)]
    {
        let [_, (ratio, deviation)] = found_after_a_cut(before, after, 50, seed);
        assert!((ratio - after).abs() < 3.0 * deviation, "{before}, {after}: {ratio} ± {deviation}");
        found += usize::from((ratio - after).abs() < 0.05);
    }
    assert!(found >= 4, "{found} of 5");
}

#[test]
fn the_same_camera_after_a_cut_is_known_all_the_time() {
    let [at_cut, later] = found_after_a_cut(0.7, 0.7, 50, 31);
    for (ratio, deviation) in [at_cut, later] {
        assert!((ratio - 0.7).abs() < 0.02, "{ratio} ± {deviation}");
    }
    // One cut in twenty leads to a camera of any readout, 0 ± 0.5.
    let other = (0.05 * (0.7_f64.powi(2) + 0.5_f64.powi(2))).sqrt();
    assert!(at_cut.1 < 1.1 * other && later.1 < 0.04, "{at_cut:?} {later:?}");
}

#[test]
fn each_side_of_a_gap_is_solved_by_itself() {
    let film = Film::new(0.9, true);
    let stamps = regular(10);
    let mut random = Random(40);
    let mut continuous = Continuous::new(film.camera(), SIZE[0], SIZE[1], 1.0);
    for k in 0..10 {
        // Nothing joins frame 4 to 5, and frame 9 to 8.
        let found = (k % 5 != 0 && k < 9).then(|| film.pair(stamps[k - 1], stamps[k], &mut random));
        push(&mut continuous, found.as_deref(), stamps[k]);
    }
    let motions: Vec<_> = (0..10).map(|_| settle(&mut continuous)).collect();
    let worst = film.worst(&motions[..9], &stamps, 0);
    assert!(worst < 0.12, "{worst} px");
    assert!(motions[9].is_none() && settle(&mut continuous).is_none());
}

/// What comes of pairs that are all `found`, at these instants.
fn fed(camera: Camera, found: &[Correspondence], stamps: &[f64]) -> Vec<Option<FrameSolution>> {
    let mut continuous = Continuous::new(camera, SIZE[0], SIZE[1], 1.0);
    for (k, &stamp) in stamps.iter().enumerate() {
        push(&mut continuous, (k > 0).then_some(found), stamp);
        let expected = continuous.expected(Vector2::new(10.0, 400.0));
        assert!(expected.iter().all(|coordinate| coordinate.is_finite()));
    }
    stamps.iter().map(|_| settle(&mut continuous)).collect()
}

fn assert_finite(motion: &FrameSolution) {
    for share in [0.0, 0.3, 1.0] {
        let moved = motion.motion.path().carry(Vector2::new(200.0, -150.0), share, 0.5);
        assert!(moved.iter().all(|coordinate| coordinate.is_finite()), "{motion:?}");
    }
    assert!(
        (0.0..=1.0).contains(&motion.confidence) && motion.motion.readout().time.is_finite(),
        "{motion:?}"
    );
    assert!(motion.readout_deviation.is_finite(), "{motion:?}");
}

#[test]
fn too_few_correspondences_give_no_solution() {
    let film = Film::new(0.9, true);
    let found = film.pair(0.0, PERIOD, &mut Random(50));
    assert!(fed(UNKNOWN, &found[..15], &regular(6)).iter().all(Option::is_none));
    assert!(fed(UNKNOWN, &[], &regular(6)).iter().all(Option::is_none));
    fed(film.camera(), &found[..16], &regular(6)).iter().flatten().for_each(assert_finite);
}

#[test]
fn solutions_are_finite_for_any_input() {
    let film = Film::new(0.9, true);
    let good = film.pair(0.0, PERIOD, &mut Random(60));
    let replaced = |every: usize, with: Vector2<f64>| {
        let mut found = good.clone();
        found.iter_mut().step_by(every).for_each(|found| found.to = with);
        found
    };
    let mapped = |map: &dyn Fn(Vector2<f64>) -> Vector2<f64>| -> Vec<Correspondence> {
        good.iter().map(|found| Correspondence { to: map(found.from), ..*found }).collect()
    };
    let point = Vector2::new(320.0, 100.0);
    let one = good.iter().map(|found| Correspondence { from: point, to: point, ..*found }).collect();
    let feeds: Vec<Vec<Correspondence>> = vec![
        replaced(3, Vector2::new(f64::NAN, 1.0)),
        replaced(3, Vector2::new(f64::INFINITY, f64::NEG_INFINITY)),
        replaced(1, Vector2::new(f64::NAN, f64::NAN)),
        replaced(1, Vector2::new(1e300, -1e300)),
        one,
        mapped(&|_| point),
        mapped(&|from| from + Vector2::new(5000.0, -4000.0)),
        mapped(&|from| from * 50.0),
        mapped(&|from| from * -1.0),
        mapped(&|from| from),
    ];
    // The last ones are as far from each other as f64 goes, and not a number.
    let far = [0.0, 1e12, f64::MAX, f64::NAN];
    for found in &feeds {
        for (camera, stamps) in
            [(UNKNOWN, &regular(3)[..]), (film.camera(), &regular(3)), (UNKNOWN, &[1.0; 2]), (UNKNOWN, &far)]
        {
            fed(camera, found, stamps).iter().flatten().for_each(assert_finite);
        }
    }
}
