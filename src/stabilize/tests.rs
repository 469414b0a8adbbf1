// SPDX-License-Identifier: MIT OR Apache-2.0

//! The virtual camera against closed forms.

use super::*;
use crate::motion::{MotionPath, project};
use crate::readout::Readout;
use nalgebra::{Vector2, matrix};
use std::f64::consts::TAU;

const SIZE: [usize; 2] = [1920, 1080];
const PERIOD: f64 = 1.0 / 30.0;

fn still() -> FrameMotion {
    FrameMotion::new(Readout::global_shutter(SIZE[0], SIZE[1]), MotionPath::STILL)
}

/// Where the scene's origin is seen at a time, and how it is turned.
type Scene<'a> = &'a dyn Fn(f64) -> [f64; 3];

/// From scene to frame.
fn pose([x, y, turn]: [f64; 3]) -> Matrix3<f64> {
    let (sin, cos) = turn.sin_cos();
    matrix![cos, -sin, x; sin, cos, y; 0.0, 0.0, 1.0]
}

/// The poses in the output of frames of a scene, each after `lookahead` later ones; before a frame `breaks`, the path breaks off.
fn steadied(
    scene: Scene<'_>,
    frames: usize,
    target: Target,
    lookahead: usize,
    breaks: Option<usize>,
) -> Vec<Matrix3<f64>> {
    let mut stabilizer = Stabilizer::new(SIZE, target);
    let motion = still();
    let time = |k: usize| k as f64 * PERIOD;
    let mut placements = Vec::new();
    for k in 0..frames {
        let to_next = pose(scene(time(k + 1))) * pose(scene(time(k))).try_inverse().unwrap();
        let is_joined = k + 1 < frames && breaks != Some(k + 1);
        let ahead = if is_joined { vec![(time(k + 1), to_next)] } else { Vec::new() };
        stabilizer.push(Settled { content: k, motion: &motion, time: time(k), repeats: false, ahead });
        while stabilizer.waiting() > lookahead {
            placements.extend(stabilizer.pop());
        }
    }
    placements.extend(std::iter::from_fn(|| stabilizer.pop()));
    assert!(placements.iter().enumerate().all(|(k, (content, _))| *content == k));
    let placed = |(k, placement): (usize, Option<Matrix3<f64>>)| {
        placement.unwrap_or_else(Matrix3::identity) * pose(scene(time(k)))
    };
    placements.into_iter().map(placed).collect()
}

/// Second differences of a point's position in the output, RMS from one frame to another.
fn jitter(poses: &[Matrix3<f64>], from: usize, to: usize) -> f64 {
    let at = |k: usize| project(&poses[k], Vector2::new(700.0, -300.0));
    let squares = (from..to).map(|k| (at(k + 1) - at(k) * 2.0 + at(k - 1)).norm_squared());
    (squares.sum::<f64>() / (to - from) as f64).sqrt()
}

const TARGET: Target = Target { deviation: 0.5, margin: 0.1 };

/// Shaken in hand, by up to 30 px and 1°, at 2 to 7 cycles a second.
fn shake(t: f64) -> [f64; 3] {
    [
        20.0 * (TAU * 2.3 * t).sin() + 8.0 * (TAU * 6.7 * t).sin(),
        18.0 * (TAU * 3.1 * t + 1.0).sin() + 6.0 * (TAU * 5.3 * t).sin(),
        0.012 * (TAU * 2.7 * t).sin(),
    ]
}

/// A pan by 900 px within a second and a half from 3 s on.
fn pan(t: f64) -> f64 {
    600.0 * (t - 3.0).clamp(0.0, 1.5)
}

#[test]
fn a_shaken_picture_becomes_steady() {
    let poses = steadied(&shake, 180, TARGET, 60, None);
    let before: Vec<_> = (0..180).map(|k| pose(shake(k as f64 * PERIOD))).collect();
    let share = jitter(&poses, 30, 150) / jitter(&before, 30, 150);
    assert!(share < 0.01, "{share}");
}

#[test]
fn a_pan_stays_a_pan() {
    let shaken = |t: f64| {
        let [x, y, turn] = shake(t);
        [x + pan(t), y, turn]
    };
    let poses = steadied(&shaken, 240, TARGET, 60, None);
    let x = |k: usize| project(&poses[k], Vector2::zeros()).x;
    for k in 0..240 {
        let lag = x(k) - pan(k as f64 * PERIOD);
        // The margin is 192 px.
        assert!(lag.abs() < 150.0, "frame {k}: {lag}");
    }
    // In the middle it is in time, and soon after its end it is over.
    assert!((x(112) - pan(112.0 * PERIOD)).abs() < 40.0, "{}", x(112) - pan(112.0 * PERIOD));
    assert!((x(175) - 900.0).abs() < 20.0 && (x(65) - 0.0).abs() < 10.0, "{} {}", x(175), x(65));
    let most = (0..240).map(x).fold(0.0, f64::max);
    // A filter of the fourth order without ringing beyond a twentieth.
    assert!(most < 925.0, "overshoot: {most}");
    let steady = jitter(&poses, 20, 220);
    let before: Vec<_> = (0..240).map(|k| pose(shaken(k as f64 * PERIOD))).collect();
    assert!(steady < 0.15 * jitter(&before, 20, 220), "{steady}");
}

#[test]
fn the_window_stays_inside_the_picture() {
    for (margin, speed) in [(0.02, 900.0), (0.05, 2500.0), (0.1, 300.0), (0.0, 500.0)] {
        let scene = |t: f64| {
            let [x, y, turn] = shake(t);
            [3.0 * x + speed * (t - 2.0).clamp(0.0, 1.0), 3.0 * y, 2.0 * turn]
        };
        let poses = steadied(&scene, 200, Target { margin, ..TARGET }, 60, None);
        for (k, shown) in poses.iter().enumerate() {
            let placement = shown * pose(scene(k as f64 * PERIOD)).try_inverse().unwrap();
            let inside = Edges::new(&still(), 960.0).inside(&scaled(&placement, [1.0 / 960.0; 2]));
            // Three rows are border where there is no margin at all.
            assert!(inside <= margin.max(3.0 / 1080.0) + 1e-4, "margin {margin}, frame {k}: {inside}");
        }
    }
}

#[test]
fn what_the_window_does_not_hold_is_shaken_no_more_than_it_must_be() {
    // Of 60 px to and fro the window holds 0.9 of its 38.4 px but three at the edge: what is left of the shake is at most
    // what a picture that is moved by so much against it leaves.
    let scene = |t: f64| [60.0 * (TAU * 2.0 * t).sin(), 0.0, 0.0];
    let poses = steadied(&scene, 180, Target { margin: 0.02, ..TARGET }, 60, None);
    let before: Vec<_> = (0..180).map(|k| pose(scene(k as f64 * PERIOD))).collect();
    let share = jitter(&poses, 30, 150) / jitter(&before, 30, 150);
    assert!(share < (60.0 - (0.9 * 38.4 - 3.0)) / 60.0, "{share}");
}

#[test]
fn nothing_is_drawn_across_a_cut() {
    // Another scene that stands still 400 px aside.
    let scene = |t: f64| if t < 2.99 { [300.0 * t, 0.0, 0.0] } else { [0.0; 3] };
    let poses = steadied(&scene, 180, TARGET, 60, Some(90));
    for (k, shown) in poses.iter().enumerate().skip(90) {
        assert!(project(shown, Vector2::zeros()).norm() < 1e-2, "frame {k}");
    }
    // A pan that ends with the scene goes on to its end.
    for (k, shown) in poses.iter().enumerate().take(90) {
        let lag = project(shown, Vector2::zeros()).x - 300.0 * k as f64 * PERIOD;
        assert!(lag.abs() < 70.0, "frame {k}: {lag}");
    }
}

#[test]
fn without_later_frames_it_is_smoothed_by_those_before() {
    let poses = steadied(&shake, 180, TARGET, 0, None);
    let before: Vec<_> = (0..180).map(|k| pose(shake(k as f64 * PERIOD))).collect();
    let share = jitter(&poses, 30, 150) / jitter(&before, 30, 150);
    assert!(share < 0.35, "{share}");
}

#[test]
fn what_is_asked_for_comes_gradually() {
    let mut stabilizer = Stabilizer::new(SIZE, Target { deviation: 0.0, margin: 0.1 });
    assert!(!stabilizer.is_active());
    stabilizer.set_target(TARGET);
    assert!(stabilizer.is_active());
    let motion = still();
    let scene = |k: usize| pose([12.0 * (0.4 * k as f64).sin(), 0.0, 0.0]);
    let mut before: Option<f64> = None;
    for k in 0..400 {
        if k == 200 {
            stabilizer.set_target(Target { deviation: 0.0, margin: 0.1 });
        }
        let ahead = vec![((k + 1) as f64 * PERIOD, scene(k + 1) * scene(k).try_inverse().unwrap())];
        let time = k as f64 * PERIOD;
        stabilizer.push(Settled { content: k, motion: &motion, time, repeats: false, ahead });
        if stabilizer.waiting() <= 40 {
            continue;
        }
        let (own, placement) = stabilizer.pop().unwrap();
        let offset = placement.map_or(0.0, |placement| placement[(0, 2)] / placement[(2, 2)]);
        // The scene itself moves by at most 4.8 px a frame.
        let step = offset - before.unwrap_or(0.0);
        assert!(step.abs() < 6.0, "frame {own}: {step}");
        before = Some(offset);
        match own {
            0 => assert!(offset.abs() < 1e-3),
            120..155 => assert!((offset + scene(own)[(0, 2)]).abs() < 2.0, "frame {own}: {offset}"),
            300.. => assert!(placement.is_none(), "frame {own}: {offset}"),
            _ => {}
        }
    }
}

#[test]
fn repeated_frames_are_placed_where_they_are_shown() {
    // Each frame is shown twice: the picture moves every other frame only, the output every time.
    let mut stabilizer = Stabilizer::new(SIZE, Target { deviation: 0.5, margin: 0.3 });
    let motion = still();
    let mut seen = Vec::new();
    for k in 0..240 {
        let repeats = k % 2 == 1;
        let shift = Matrix3::new(1.0, 0.0, 4.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        let ahead = if repeats { Vec::new() } else { vec![((k + 2) as f64 / 60.0, shift)] };
        stabilizer.push(Settled { content: k, motion: &motion, time: f64::from(k) / 60.0, repeats, ahead });
        if stabilizer.waiting() > 100 {
            let (own, placement) = stabilizer.pop().unwrap();
            seen.push(f64::from(own / 2) * 4.0 + placement.unwrap()[(0, 2)]);
        }
    }
    // After the beginning, where there are frames on one side only.
    let steps: Vec<f64> = seen.windows(2).map(|pair| pair[1] - pair[0]).skip(80).collect();
    assert!(steps.iter().all(|step| (step - 2.0).abs() < 0.1), "{steps:?}");
}

#[test]
fn unusual_motions_are_survived() {
    let motion = still();
    for bad in
        [Matrix3::zeros(), Matrix3::repeat(f64::NAN), Matrix3::identity() * 1e300, pose([1e9, -1e9, 3.0])]
    {
        for deviation in [0.0, 1e-9, 0.5, 10.0] {
            let mut stabilizer = Stabilizer::new([0, 0], Target { deviation, margin: 0.5 });
            for (k, time) in [0.0, 1.0, 1.0, -4.0, 1e9, 1e9 + 0.1, 1e300, 2.0].into_iter().enumerate() {
                let ahead = vec![(time + 0.1, if k % 3 == 1 { bad } else { Matrix3::identity() }); 3];
                stabilizer.push(Settled { content: (), motion: &motion, time, repeats: k % 4 == 2, ahead });
            }
            while let Some(((), placement)) = stabilizer.pop() {
                assert!(placement.is_none_or(|placement| placement.iter().all(|value| value.is_finite())));
            }
        }
    }
}
