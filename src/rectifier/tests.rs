// SPDX-License-Identifier: MIT OR Apache-2.0

//! The rectifier on pictures whose motion is known in closed form.

use super::film::*;
use super::*;
use crate::motion::{FrameMotion, MotionPath};
use crate::plane::{Plane, PlaneLayout, SampleFormat};
use crate::readout::{ReadoutDirection, ReadoutTime};
use nalgebra::Vector2;
use proptest::prelude::*;

const ESTIMATORS: [Estimator; 2] = [Estimator::Continuous, Estimator::Sequential];

/// A rectifier with the shutter of [`frame`] given.
fn rectifier(estimator: Estimator, lookahead: usize) -> Rectifier {
    let settings = Settings {
        lookahead,
        estimator,
        direction: Some(ReadoutDirection::TopToBottom),
        readout_time: ReadoutTime::WholePeriod,
        ..Settings::default()
    };
    Rectifier::new(settings, WIDTH, HEIGHT, Some(PERIOD)).unwrap()
}

/// How a frame is pushed, by whether it is marked as a duplicate.
fn kind(is_known: bool) -> Duplicate {
    if is_known { Duplicate::Known } else { Duplicate::Detect }
}

#[test]
fn every_frame_comes_out_once_after_the_lookahead() {
    for estimator in ESTIMATORS {
        for lookahead in [0, 1, 4, 64] {
            let mut rectifier = rectifier(estimator, lookahead);
            let mut count = 0;
            for k in 0..10 {
                push(
                    &mut rectifier,
                    &frame(k as f64 * PERIOD, VELOCITY),
                    k as f64 * PERIOD,
                    Duplicate::Detect,
                );
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
fn solutions_carry_number_and_timestamp_of_their_frame() {
    let grey = [128; WIDTH * HEIGHT];
    // The clock fills in what is missing and what stands still; the solutions do not.
    let stated = [Some(7.0), Some(7.0), None, Some(f64::NAN), Some(6.5), Some(1e6), Some(1e6 + PERIOD)];
    let expected = stated.map(|time| time.filter(|time| !time.is_nan()));
    for (estimator, stabilization) in ESTIMATORS.into_iter().flat_map(|one| [(one, 0.0), (one, 0.5)]) {
        let mut rectifier = rectifier(estimator, 3);
        rectifier.set_stabilization(stabilization, 0.1);
        let mut fill = |times: &[Option<f64>]| {
            for time in times {
                let plane = Plane::new(&grey, PlaneLayout::packed(WIDTH, HEIGHT, SampleFormat::U8)).unwrap();
                rectifier.push(&Luma::from(plane), *time, Duplicate::Detect).unwrap();
            }
            rectifier.drain();
            let solved = rectifier.solved.iter();
            solved.map(|solution| (solution.index, solution.time)).collect::<Vec<_>>()
        };
        fill(&stated[..4]);
        let all: Vec<_> = expected.into_iter().enumerate().collect();
        assert_eq!(fill(&stated[4..]), all, "a drain does not start the numbers anew");
        rectifier.reset();
        push(&mut rectifier, &grey, 3.0, Duplicate::Detect);
        let first = rectifier.pop_early().unwrap();
        assert_eq!((first.index, first.time), (0, Some(3.0)));
    }
}

#[test]
fn without_lookahead_the_first_frame_stays_as_it_is() {
    for estimator in ESTIMATORS {
        let mut rectifier = rectifier(estimator, 0);
        push(&mut rectifier, &frame(0.0, VELOCITY), 0.0, Duplicate::Detect);
        let first = rectifier.pop().unwrap();
        assert_eq!((first.origin, first.confidence), (Origin::Untouched, 0.0));
        assert!(first.motion.path().is_still());
    }
}

#[test]
fn reverse_playback_finds_the_same_motion() {
    for estimator in ESTIMATORS {
        let mut rectifier = rectifier(estimator, 3);
        for k in (0..8).rev() {
            push(&mut rectifier, &frame(k as f64 * PERIOD, VELOCITY), k as f64 * PERIOD, Duplicate::Detect);
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
            push(&mut rectifier, &frame(k as f64 * PERIOD, VELOCITY), k as f64 * PERIOD, Duplicate::Detect);
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
                // Every second frame is a duplicate, as with 25 frames a second in a project of 50.
                let shown = (k / 2 * 2) as f64 * PERIOD / 2.0;
                push(
                    &mut rectifier,
                    &frame(shown, VELOCITY),
                    k as f64 * PERIOD / 2.0,
                    kind(marked && k % 2 == 1),
                );
            }
            rectifier.drain();
            let solutions = pops(&mut rectifier);
            assert_eq!(solutions.len(), 12);
            for pair in solutions.chunks(2) {
                assert_velocity(&pair[0], VELOCITY);
                assert_eq!((pair[1].origin, &pair[1].motion), (Origin::Repeated, &pair[0].motion));
            }
        }
    }
}

#[test]
fn a_duplicate_is_corrected_as_much_as_its_frame() {
    let mut rectifier = rectifier(Estimator::default(), 4);
    let readout = rectifier.readout();
    let motion = FrameMotion::new(readout, MotionPath::STILL).with_weight(0.5);
    let found = FrameSolution {
        index: 6,
        time: Some(0.24),
        confidence: 0.5,
        expected_error: Some(2.5),
        region_errors: vec![3.0, 4.0, 0.0, 0.0],
        correspondences: 740,
        inliers: 700,
        residual: 1.0,
        begins_shot: true,
        as_recorded: Some(AsRecorded::NothingMoved),
        ..FrameSolution::new(motion, Origin::Continuous)
    };
    rectifier.last = Some(found.clone());
    rectifier.waiting.push_back(Waiting {
        index: 7,
        stated: Some(0.28),
        time: 0.28,
        readout,
        correspondences: 0,
        repeats: true,
        begins_shot: false,
    });
    let solution = rectifier.pop_early().unwrap();
    let own = FrameSolution { index: 7, time: Some(0.28), begins_shot: false, ..found };
    assert_eq!(solution, FrameSolution { origin: Origin::Repeated, ..own });
}

#[test]
fn a_camera_that_stops_is_still_after_a_few_frames() {
    for estimator in ESTIMATORS {
        let mut rectifier = rectifier(estimator, 2);
        for k in 0..16 {
            let shown = frame((k as f64).min(6.0) * PERIOD, VELOCITY);
            push(&mut rectifier, &shown, k as f64 * PERIOD, Duplicate::Detect);
        }
        rectifier.drain();
        let last = pops(&mut rectifier).pop().unwrap();
        assert!(last.motion.path().mean_twist().velocity.norm() * PERIOD < 0.05, "{last:?}");
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
            push(&mut rectifier, &shown, time, Duplicate::Detect);
        }
        for k in 12..15 {
            push(&mut rectifier, &vec![16; WIDTH * HEIGHT], k as f64 * PERIOD, Duplicate::Detect);
        }
        rectifier.drain();
        let solutions = pops(&mut rectifier);
        solutions[..6].iter().for_each(|solution| assert_velocity(solution, VELOCITY));
        solutions[6..12].iter().for_each(|solution| assert_velocity(solution, other));
        assert!(solutions[12].motion.path().is_still() && solutions[12].confidence == 0.0);
    }
}

#[test]
fn a_drain_starts_anew_and_a_reset_forgets() {
    for estimator in ESTIMATORS {
        let mut rectifier = rectifier(estimator, 5);
        for k in 0..3 {
            push(&mut rectifier, &frame(k as f64 * PERIOD, VELOCITY), k as f64 * PERIOD, Duplicate::Detect);
        }
        rectifier.drain();
        push(&mut rectifier, &frame(0.0, -VELOCITY), 3.0 * PERIOD, Duplicate::Detect);
        push(&mut rectifier, &frame(PERIOD, -VELOCITY), 4.0 * PERIOD, Duplicate::Detect);
        rectifier.drain();
        let solutions = pops(&mut rectifier);
        assert_eq!(solutions.len(), 5);
        solutions[..3].iter().for_each(|solution| assert_velocity(solution, VELOCITY));
        solutions[3..].iter().for_each(|solution| assert_velocity(solution, -VELOCITY));
        push(&mut rectifier, &frame(0.0, VELOCITY), 0.0, Duplicate::Detect);
        rectifier.reset();
        rectifier.drain();
        assert_eq!(pops(&mut rectifier).len(), 0);
    }
}

#[test]
fn frames_that_cannot_be_analysed_are_counted_all_the_same() {
    for (width, height) in [(1, 1), (2, 9), (17, 3), (40, 30)] {
        let mut rectifier = Rectifier::new(Settings::default(), width, height, None).unwrap();
        let pixels: Vec<u8> = (0..width * height).map(|i| (i * 37 % 251) as u8).collect();
        let layout = PlaneLayout::packed(width, height, SampleFormat::U8);
        for _ in 0..7 {
            rectifier
                .push(&Luma::from(Plane::new(&pixels, layout).unwrap()), None, Duplicate::Detect)
                .unwrap();
        }
        rectifier.drain();
        assert_eq!(pops(&mut rectifier).len(), 7);
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
        let mut rectifier = Rectifier::new(settings, width, height, None).unwrap();
        let layout = PlaneLayout::packed(width, height, SampleFormat::U8);
        for step in 0..4 {
            let shown = |i: usize| texture((i % width + 2 * step) as f64, (i / width + step) as f64) as u8;
            let pixels: Vec<u8> = (0..width * height).map(shown).collect();
            let luma = Luma::from(Plane::new(&pixels, layout).unwrap());
            rectifier.push(&luma, Some(0.03 * step as f64), Duplicate::Detect).unwrap();
        }
        rectifier.drain();
        let solutions = pops(&mut rectifier);
        assert_eq!(solutions.len(), 4, "{width}x{height}");
        assert!(
            solutions.iter().all(|s| s.motion.path().mean_twist().is_finite() && s.confidence.is_finite())
        );
    }
}

#[test]
fn a_frame_of_another_size_is_refused_and_not_counted() {
    for estimator in ESTIMATORS {
        let mut rectifier = rectifier(estimator, 2);
        let small = PlaneLayout::packed(WIDTH, HEIGHT - 1, SampleFormat::U8);
        for k in 0..6 {
            let time = k as f64 * PERIOD;
            let pixels = frame(time, VELOCITY);
            let refused = rectifier.push(
                &Luma::from(Plane::new(&pixels, small).unwrap()),
                Some(time + 9.0),
                Duplicate::Detect,
            );
            let (found, expected) = ([WIDTH, HEIGHT - 1], [WIDTH, HEIGHT]);
            assert_eq!(refused, Err(PushError::Size { found, expected }));
            push(&mut rectifier, &pixels, time, Duplicate::Detect);
        }
        rectifier.drain();
        let solutions = pops(&mut rectifier);
        assert_eq!(solutions.len(), 6);
        // The refused frame does not affect the motion.
        solutions.iter().for_each(|solution| assert_velocity(solution, VELOCITY));
    }
}

#[test]
fn an_invalid_readout_is_refused() {
    for readout_time in [ReadoutTime::Seconds(f64::NAN), ReadoutTime::DelayRows(-1.0)] {
        let settings = Settings { readout_time, ..Settings::default() };
        assert!(Rectifier::new(settings, WIDTH, HEIGHT, None).is_err());
    }
}

#[test]
fn inliers_are_some_of_the_correspondences_of_the_same_pair() {
    for estimator in ESTIMATORS {
        let mut rectifier = rectifier(estimator, 3);
        for k in 0..16 {
            let time = k as f64 * PERIOD;
            // Every third frame has texture in its upper quarter only, so that some pairs have few
            // correspondences and some many; one frame is a duplicate, one is black.
            let mut pixels = frame(if k == 8 { time - PERIOD } else { time }, VELOCITY);
            match k {
                12 => pixels.fill(16),
                _ if k % 3 == 2 => pixels[WIDTH * HEIGHT / 4..].fill(128),
                _ => (),
            }
            push(&mut rectifier, &pixels, time, kind(k == 8));
        }
        rectifier.drain();
        let solutions = pops(&mut rectifier);
        for (k, FrameSolution { inliers, correspondences, .. }) in solutions.iter().enumerate() {
            assert!(inliers <= correspondences, "{estimator:?} {k}: {inliers} of {correspondences}");
        }
        assert!(solutions.iter().any(|solution| solution.inliers > 500));
    }
}

#[test]
fn kept_correspondences_separate_inliers_from_an_independently_moving_patch() {
    let patch = |at: Vector2<f64>| (100.0..180.0).contains(&at.x) && (60.0..140.0).contains(&at.y);
    for lookahead in [0, 3] {
        let mut settings = rectifier(Estimator::Continuous, lookahead).settings;
        settings.keep_correspondences = true;
        let mut keeping = Rectifier::new(settings, WIDTH, HEIGHT, Some(PERIOD)).unwrap();
        for k in 0..12 {
            let time = k as f64 * PERIOD;
            let [mut pixels, other] = [VELOCITY, -VELOCITY].map(|velocity| frame(time, velocity));
            let places = (0..WIDTH * HEIGHT).map(|k| Vector2::new((k % WIDTH) as f64, (k / WIDTH) as f64));
            for (place, (pixel, other)) in places.zip(pixels.iter_mut().zip(other)) {
                *pixel = if patch(place) { other } else { *pixel };
            }
            push(&mut keeping, &pixels, time, Duplicate::Detect);
        }
        keeping.drain();
        let solutions = pops(&mut keeping);
        assert_eq!((solutions.len(), solutions[0].fitted.is_empty()), (12, lookahead == 0));
        for solution in &solutions[3..] {
            // The patch's edge moves between two frames: only points far from it are checked.
            let near = |found: &FittedCorrespondence, side: f64| {
                (found.position - Vector2::new(140.0, 100.0)).amax() < side
            };
            let fitted = || solution.fitted.iter();
            let inside: Vec<_> = fitted().filter(|one| near(one, 25.0)).collect();
            let outside: Vec<_> = fitted().filter(|one| !near(one, 60.0)).collect();
            assert!(inside.len() > 20 && outside.len() > 400, "{} {}", inside.len(), outside.len());
            let followed = outside.iter().filter(|one| one.is_inlier).count();
            assert!(followed > outside.len() * 9 / 10, "{followed} of {}", outside.len());
            assert!(inside.iter().all(|one| !one.is_inlier));
            // A point that moves down by d is exposed d rows later: d = v·P·(1 + d_y/N).
            let speed = VELOCITY * PERIOD / (1.0 - VELOCITY.y * PERIOD / HEIGHT as f64);
            for one in outside.iter().filter(|one| one.is_inlier) {
                assert!((one.displacement - speed).norm() < 0.5, "{one:?}");
                assert!(one.residual.norm() < 0.5, "{one:?}");
            }
            let off = |one: &&&FittedCorrespondence| (one.residual + 2.0 * VELOCITY * PERIOD).norm() < 1.0;
            assert!(inside.iter().filter(off).count() > inside.len() / 2);
        }
    }
    let mut silent = rectifier(Estimator::Continuous, 3);
    (0..6).for_each(|k| {
        let time = k as f64 * PERIOD;
        push(&mut silent, &frame(time, VELOCITY), time, Duplicate::Detect);
    });
    silent.drain();
    assert!(pops(&mut silent).iter().all(|solution| solution.fitted.is_empty()));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    /// For any motion and any visible part of each frame: rows after `seen` are flat, and the picture jumps
    /// by `cuts` seconds.
    #[test]
    fn inliers_never_outnumber_the_correspondences(
        (vx, vy) in (-400.0..400.0, -400.0..400.0),
        frames in proptest::collection::vec((0..=HEIGHT, 0..12u32, any::<bool>()), 6..10),
        sequential in any::<bool>(),
        lookahead in 0..5usize,
    ) {
        let estimator = ESTIMATORS[usize::from(sequential)];
        let mut rectifier = rectifier(estimator, lookahead);
        let mut cuts = 0.0;
        for (k, &(seen, jump, duplicate)) in frames.iter().enumerate() {
            cuts += if jump == 0 { 50.0 } else { 0.0 };
            let time = k as f64 * PERIOD;
            let mut pixels = frame(time + cuts, Vector2::new(vx, vy));
            pixels[seen * WIDTH..].fill(90);
            push(&mut rectifier, &pixels, time, kind(duplicate && jump == 1));
        }
        rectifier.drain();
        let solutions = pops(&mut rectifier);
        prop_assert_eq!(solutions.len(), frames.len());
        for solution in solutions {
            prop_assert!(solution.inliers <= solution.correspondences, "{solution:?}");
        }
    }
}

#[test]
fn a_readout_that_is_given_has_no_deviation() {
    for estimator in ESTIMATORS {
        let mut rectifier = rectifier(estimator, 2);
        push(&mut rectifier, &vec![16; WIDTH * HEIGHT], 0.0, Duplicate::Detect);
        for k in 1..6 {
            push(&mut rectifier, &frame(k as f64 * PERIOD, VELOCITY), k as f64 * PERIOD, Duplicate::Detect);
        }
        rectifier.drain();
        assert!(pops(&mut rectifier).iter().all(|solution| solution.readout_deviation == 0.0));
    }
}

#[test]
fn a_focal_length_near_zero_still_gives_a_motion() {
    for focal in [f64::MIN_POSITIVE, 1e-9] {
        let settings = Settings {
            focal_length: Some(focal),
            direction: Some(ReadoutDirection::TopToBottom),
            readout_time: ReadoutTime::WholePeriod,
            ..Settings::default()
        };
        let mut rectifier = Rectifier::new(settings, WIDTH, HEIGHT, Some(PERIOD)).unwrap();
        for k in 0..8 {
            push(&mut rectifier, &frame(k as f64 * PERIOD, VELOCITY), k as f64 * PERIOD, Duplicate::Detect);
        }
        rectifier.drain();
        pops(&mut rectifier).iter().for_each(|solution| assert_velocity(solution, VELOCITY));
    }
}
