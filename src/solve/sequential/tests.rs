// SPDX-License-Identifier: MIT OR Apache-2.0

//! Links and the window on a flat world that moves by a known twist in each frame period.

use super::link::Link;
use super::link::{FitBuffers, KnownFrame};
use super::window::{MotionCandidate, Window};
use crate::correspond::Correspondence;
use crate::motion::{Twist, image_centre};
use crate::readout::{Readout, ReadoutDirection, ReadoutTime};
use nalgebra::{Matrix2, Vector2};

const PERIOD: f64 = 0.04;
const NOISE: f64 = 0.05;

/// A world that moves by `twists[k]` from k to k + 1 periods, seen through `readout`.
struct World {
    twists: Vec<Twist>,
    readout: Readout,
}

impl World {
    fn new(twists: Vec<Twist>, delay: f64) -> Self {
        let readout =
            Readout::new(640, 480, ReadoutDirection::TopToBottom, ReadoutTime::DelayRows(delay), PERIOD)
                .unwrap();
        Self { twists, readout }
    }

    /// Smooth motion of `frames` frames: rotation and translation of some 6 px a frame, varying from frame to
    /// frame.
    fn wandering(frames: usize, delay: f64) -> Self {
        let twist = |k: usize| {
            let k = k as f64;
            Twist::new(0.5 * (0.9 * k).sin(), 150.0 * (0.7 * k + 1.0).cos(), 90.0 * (1.1 * k).sin())
        };
        Self::new((0..frames).map(twist).collect(), delay)
    }

    /// Moves a centred point from time `from` to time `to`, across changes of the twist.
    fn carry(&self, mut point: Vector2<f64>, from: f64, to: f64) -> Vector2<f64> {
        let last = self.twists.len() as f64 - 1.0;
        let mut now = from;
        while (to - now).abs() > 1e-12 {
            let forward = to > now;
            let index =
                if forward { (now / PERIOD + 1e-9).floor() } else { (now / PERIOD - 1e-9).ceil() - 1.0 };
            let index = index.clamp(0.0, last);
            let end = if forward { to.min((index + 1.0) * PERIOD) } else { to.max(index * PERIOD) };
            let end = if (end - now).abs() < 1e-12 { to } else { end };
            point = self.twists[index as usize].after(end - now).apply(point);
            now = end;
        }
        point
    }

    /// Exact correspondences from frame `k` to frame `l` on a grid of 20 × 15.
    fn correspondences(&self, k: usize, l: usize) -> Vec<Correspondence> {
        let centre = image_centre(self.readout.width, self.readout.height);
        let (start, end) = (k as f64 * PERIOD, l as f64 * PERIOD);
        (0..300)
            .map(|i| {
                let from = Vector2::new(32.0 * f64::from(i % 20) + 15.5, 32.0 * f64::from(i / 20) + 15.5);
                let mut to = from;
                for _ in 0..60 {
                    let exposed = start + self.readout.offset(from.x, from.y);
                    let shown = end + self.readout.offset(to.x, to.y);
                    to = self.carry(from - centre, exposed, shown) + centre;
                }
                Correspondence { from, to, texture: 100.0, residual: 0.0, covariance: Matrix2::zeros() }
            })
            .collect()
    }

    fn link(&self, k: usize, l: usize) -> Link {
        let interval = (l as f64 - k as f64) * PERIOD;
        Link::new(&self.correspondences(k, l), &self.readout, interval, NOISE)
    }

    /// Settles frames `first` to the end with `lookahead`.
    fn settle(&self, first: usize, lookahead: usize) -> Vec<Option<MotionCandidate>> {
        let mut window = Window::default();
        let mut settled = Vec::new();
        for k in first..self.twists.len() {
            window.push((k > first).then(|| self.link(k - 1, k)));
            if k - first >= lookahead {
                settled.push(window.settle());
            }
        }
        settled.extend((0..lookahead.min(self.twists.len() - first)).map(|_| window.settle()));
        settled
    }
}

/// RMS difference in pixels over the picture, over one period.
fn difference(a: Twist, b: Twist) -> f64 {
    let corners = [(-320.0, -240.0), (320.0, -240.0), (-320.0, 240.0), (320.0, 240.0)];
    let squares = corners.map(|(x, y)| {
        let corner = Vector2::new(x, y);
        (a.after(PERIOD).apply(corner) - b.after(PERIOD).apply(corner)).norm_squared()
    });
    (squares.iter().sum::<f64>() / 4.0).sqrt()
}

#[test]
fn uniform_motion_is_found_at_any_delay_and_interval() {
    let twist = Twist::new(0.8, 250.0, -120.0);
    for delay in [0.0, 40.0, 600.0] {
        let world = World::new(vec![twist; 4], delay);
        for (k, l) in [(0, 1), (0, 2), (2, 1)] {
            let fit = world.link(k, l).uniform(&mut FitBuffers::default()).unwrap();
            assert!(difference(fit.twist, twist) < 1e-4, "delay {delay}, {k} to {l}: {fit:?}");
            assert!(fit.energy < 1e-8 && fit.inliers == 300 && fit.confidence > 0.99, "{fit:?}");
        }
    }
}

#[test]
fn a_step_finds_the_next_frame_and_the_one_before() {
    let world = World::wandering(5, 0.0);
    let scratch = &mut FitBuffers::default();
    // The second of a link looked at in reverse playback is the earlier frame.
    for (link, known, k, sought) in [
        (world.link(1, 2), KnownFrame::First, 1, 2),
        (world.link(1, 2), KnownFrame::Second, 2, 1),
        (world.link(2, 1), KnownFrame::First, 2, 1),
        (world.link(2, 1), KnownFrame::Second, 1, 2),
    ] {
        let fit = link.sequential_step(known, world.twists[k], scratch).unwrap();
        let error = difference(fit.twist, world.twists[sought]);
        assert!(error < 1e-4, "{known:?} {k} to {sought}: {error}");
    }
}

#[test]
fn an_error_is_passed_on_by_half_or_a_quarter() {
    let twist = Twist::new(0.0, 100.0, 50.0);
    let error = Twist::new(0.0, 8.0, -4.0);
    for (delay, expected) in [(0.0, -0.5), (480.0 / 0.42 - 480.0, -0.25)] {
        let world = World::new(vec![twist; 3], delay);
        for known in [KnownFrame::First, KnownFrame::Second] {
            let wrong = Twist::from_vector(twist.to_vector() + error.to_vector());
            let fit = world.link(0, 1).sequential_step(known, wrong, &mut FitBuffers::default()).unwrap();
            let passed_on =
                (fit.twist.velocity - twist.velocity).dot(&error.velocity) / error.velocity.norm_squared();
            assert!((passed_on - expected).abs() < 0.06, "delay {delay}, {known:?}: {passed_on}");
        }
    }
}

#[test]
fn a_third_of_the_points_may_move_on_their_own() {
    let twist = Twist::new(0.3, 200.0, -80.0);
    let world = World::new(vec![twist; 2], 0.0);
    let mut correspondences = world.correspondences(0, 1);
    for c in correspondences.iter_mut().filter(|c| c.from.x > 420.0) {
        c.to += Vector2::new(-14.0, 9.0);
    }
    let moving = correspondences.iter().filter(|c| c.from.x > 420.0).count();
    assert!((90..=110).contains(&moving), "{moving}");
    let link = Link::new(&correspondences, &world.readout, PERIOD, NOISE);
    let fit = link.uniform(&mut FitBuffers::default()).unwrap();
    assert!(difference(fit.twist, twist) < 0.1, "{fit:?}");
    assert_eq!(fit.inliers, 300 - moving);
}

#[test]
fn points_without_a_common_motion_are_not_trusted() {
    let world = World::new(vec![Twist::ZERO; 2], 0.0);
    let mut correspondences = world.correspondences(0, 1);
    for (i, c) in correspondences.iter_mut().enumerate() {
        c.to += Vector2::new((i as f64 * 12.9898).sin(), (i as f64 * 78.233).sin()) * 60.0;
    }
    let link = Link::new(&correspondences, &world.readout, PERIOD, NOISE);
    assert!(link.uniform(&mut FitBuffers::default()).is_none_or(|fit| fit.confidence == 0.0));
    let few = Link::new(&world.correspondences(0, 1)[..10], &world.readout, PERIOD, NOISE);
    assert_eq!(few.uniform(&mut FitBuffers::default()), None);
    let none = Link::new(&[], &world.readout, PERIOD, NOISE);
    assert_eq!(none.uniform(&mut FitBuffers::default()), None);
}

#[test]
fn the_window_leaves_a_fifth_of_what_uniform_rotation_leaves() {
    for delay in [0.0, 40.0] {
        let world = World::wandering(40, delay);
        let rms = |errors: Vec<f64>| (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let uniform = |k: usize| world.link(k, k + 1).uniform(&mut FitBuffers::default()).unwrap().twist;
        let uniform = rms((3..39).map(|k| difference(uniform(k), world.twists[k])).collect());
        for lookahead in [0, 1, 4, 12, 64] {
            let settled = world.settle(0, lookahead);
            assert_eq!(settled.len(), 40);
            assert_eq!(settled[0].is_none(), lookahead == 0, "lookahead {lookahead}");
            let error = |k: usize| difference(settled[k].unwrap().fit.twist, world.twists[k]);
            let left = rms((3..40).map(error).collect());
            assert!(left < 0.2 * uniform, "delay {delay}, lookahead {lookahead}: {left} of {uniform} px");
        }
    }
}

/// The slowest mode of the recursion, a shear of rotation and translation along the rows, shrinks
/// by 0.91 a frame at γ = 1 and by 0.36 at γ = 0.42 on this picture.
#[test]
fn twenty_frames_forget_where_the_stream_was_started() {
    for (delay, lookahead) in [(0.0, 0), (0.0, 4), (40.0, 4), (480.0 / 0.42 - 480.0, 4), (40.0, 12)] {
        let world = World::wandering(60, delay);
        let whole = world.settle(0, lookahead);
        for first in [1, 7, 23] {
            let part = world.settle(first, lookahead);
            for k in first + 20..60 {
                let (a, b) = (whole[k].unwrap().fit.twist, part[k - first].unwrap().fit.twist);
                let apart = difference(a, b);
                assert!(
                    apart < 0.1,
                    "delay {delay}, lookahead {lookahead}, start {first}, frame {k}: {apart}"
                );
            }
        }
    }
}

#[test]
fn each_side_of_a_cut_is_solved_alone() {
    let world = World::wandering(20, 0.0);
    let mut window = Window::default();
    let mut settled = Vec::new();
    for k in 0..20 {
        window.push((k > 0 && k != 9).then(|| world.link(k - 1, k)));
    }
    settled.extend((0..20).map(|_| window.settle().unwrap().fit.twist));
    let alone = world.settle(9, 64);
    for k in 9..20 {
        assert_eq!(settled[k], alone[k - 9].unwrap().fit.twist, "frame {k}");
    }
    assert_eq!(window.settle(), None);
}
