// SPDX-License-Identifier: MIT OR Apache-2.0

//! Exact correspondences of cameras in closed form, and their solutions.

use super::*;
use crate::motion::generators::Model;
use crate::readout::{Readout, ReadoutDirection, ReadoutTime};
use crate::solve::random::Random;
use nalgebra::{Matrix2, Rotation3, Vector3};
use std::f64::consts::TAU;

/// Width and height of a frame whose rows are read one after another; otherwise the frame is turned.
pub const SIZE: [usize; 2] = [640, 480];
pub const PERIOD: f64 = 1.0 / 30.0;
pub const LOOKAHEAD: usize = 4;
/// Mean square of the gradient of any frame.
const SHARPNESS: f64 = 100.0;

/// A camera that turns about its centre, pitch, yaw and roll each a sum of swings.
pub struct Film {
    /// Signed readout ratio; negative: from the bottom or the right.
    pub gamma: f64,
    pub by_rows: bool,
    /// In frame widths.
    pub focal: f64,
    /// Cycles a second and peak in radians, per axis.
    pub swings: [[(f64, f64); 2]; 3],
    /// Standard deviation of the correspondences in pixels.
    pub noise: f64,
    /// Interval of outliers among the correspondences.
    pub wild: Option<usize>,
    /// Metres that the camera moves aside, to and fro, before a scene of 2 to 6 metres' depth.
    pub sway: f64,
    /// Peak displacement in pixels of an object over the middle three fifths of the picture along both axes.
    pub own: f64,
    /// Share of the lines, the lowest, that show a static overlay.
    pub fixed: f64,
    /// Seconds of rest at first, if any; then the camera accelerates for a fifth of a second.
    pub rest: Option<f64>,
}

impl Film {
    /// Shaken in hand: some 6 px RMS of rolling-shutter distortion at γ = 1.
    pub fn new(gamma: f64, by_rows: bool) -> Self {
        let swings = [[(1.4, 0.05), (3.1, 0.014)], [(1.1, 0.07), (2.7, 0.016)], [(0.9, 0.05), (2.3, 0.02)]];
        Self {
            gamma,
            by_rows,
            focal: 0.9,
            swings,
            noise: 0.1,
            wild: None,
            sway: 0.0,
            own: 0.0,
            fixed: 0.0,
            rest: None,
        }
    }

    /// Width and height of a frame: lines lie along its longer side.
    pub fn size(&self) -> [usize; 2] {
        let [width, height] = SIZE;
        if self.by_rows { [width, height] } else { [height, width] }
    }

    /// Centre of the picture in pixels.
    fn centre(&self) -> Vector2<f64> {
        let [width, height] = self.size();
        image_centre(width, height)
    }

    pub fn direction(&self) -> ReadoutDirection {
        match (self.by_rows, self.gamma < 0.0) {
            (true, false) => ReadoutDirection::TopToBottom,
            (true, true) => ReadoutDirection::BottomToTop,
            (false, false) => ReadoutDirection::LeftToRight,
            (false, true) => ReadoutDirection::RightToLeft,
        }
    }

    pub fn readout(&self) -> Readout {
        Readout {
            width: self.size()[0],
            height: self.size()[1],
            direction: self.direction(),
            time: self.gamma.abs() * PERIOD,
        }
    }

    pub fn camera(&self) -> Camera {
        Camera {
            model: Model::Auto,
            direction: Some(self.direction()),
            readout_time: ReadoutTime::Seconds(self.readout().time),
            readout_prior: None,
            focal_length: Some(self.focal),
        }
    }

    /// Time in seconds of the camera's motion, slowed down at first.
    fn elapsed(&self, t: f64) -> f64 {
        const START: f64 = 0.2;
        let Some(rest) = self.rest else { return t };
        let since = (t - rest).max(0.0);
        if since < START { since * since / (2.0 * START) } else { since - START / 2.0 }
    }

    pub fn turn(&self, t: f64) -> Rotation3<f64> {
        let t = self.elapsed(t);
        let swing = |(axis, swings): (usize, &[(f64, f64); 2])| -> f64 {
            let swing = |(phase, (cycles, peak)): (usize, &(f64, f64))| {
                peak * (TAU * cycles * t + 1.3 * phase as f64 + axis as f64).sin()
            };
            swings.iter().enumerate().map(swing).sum()
        };
        let mut angles = self.swings.iter().enumerate().map(swing);
        let mut next = || angles.next().unwrap_or(0.0);
        Rotation3::new(Vector3::new(next(), next(), next()))
    }

    /// Where the camera is, in metres.
    pub fn place(&self, t: f64) -> Vector3<f64> {
        let swing = |cycles: f64, phase: f64| self.sway * (TAU * cycles * self.elapsed(t) + phase).sin();
        Vector3::new(swing(1.6, 0.3), swing(1.1, 1.9), 0.4 * swing(0.7, 4.0))
    }

    /// Where a point (pixels) seen at time `from` is at time `to`.
    pub fn carry(&self, pixel: Vector2<f64>, from: f64, to: f64) -> Vector2<f64> {
        let (centre, focal) = (self.centre(), self.focal * self.size()[0] as f64);
        let ray = self.turn(from).inverse() * (pixel - centre).push(focal).normalize();
        // The scene is this far from the origin in each direction; the ray meets it where both agree.
        let depth = |direction: Vector3<f64>| {
            3.0 / (1.0 + 0.5 * (7.0 * direction.x).sin() * (9.0 * direction.y + 2.0 * direction.x).cos())
        };
        let place = self.place(from);
        let mut point = place + ray * depth(ray);
        for _ in 0..20 {
            let off = depth(point.normalize()) - point.norm();
            point += ray * off;
            if off.abs() < 1e-12 {
                break;
            }
        }
        let ray = self.turn(to) * (point - self.place(to));
        centre + ray.xy() * (focal / ray.z)
    }

    /// Displacement in pixels of a point by the object's own motion.
    pub fn own(&self, pixel: Vector2<f64>, t: f64) -> Vector2<f64> {
        let off = (pixel - self.centre()).abs();
        let [width, height] = self.size().map(|side| side as f64);
        let is_inside = off.x < 0.3 * width && off.y < 0.3 * height;
        let peak = if is_inside { self.own } else { 0.0 };
        Vector2::new((TAU * 2.3 * t).sin(), (TAU * 1.7 * t + 1.0).sin()) * peak
    }

    /// The correspondences between the frames that start at two instants, in pixels.
    pub fn pair(&self, first: f64, second: f64, random: &mut Random) -> Vec<Correspondence> {
        let readout = self.readout();
        let [columns, rows] = self.size().map(|side| side / 20);
        let cell = |cell: usize| [cell % columns, cell / columns].map(|place| (place * 20) as f64 + 9.5);
        let cells = (0..columns * rows).map(|index| Vector2::from(cell(index)));
        let pair = |(index, from): (usize, Vector2<f64>)| {
            let exposed = first + readout.offset(from.x, from.y);
            // Fixed point: the exposure time depends on the line, and the line on the time.
            let mut to = from;
            for _ in 0..12 {
                let arrives = second + readout.offset(to.x, to.y);
                let before = to;
                to = self.carry(from, exposed, arrives) + self.own(from, arrives) - self.own(from, exposed);
                if (to - before).norm() < 1e-9 {
                    break;
                }
            }
            if from.y > (1.0 - self.fixed) * self.size()[1] as f64 {
                to = from;
            }
            to += Vector2::new(random.normal(), random.normal()) * self.noise;
            if self.wild.is_some_and(|every| index % every == 0) {
                to = from + Vector2::new(random.uniform() - 0.5, random.uniform() - 0.5) * 80.0;
            }
            Correspondence { from, to, texture: 1.0, residual: 0.0, covariance: Matrix2::zeros() }
        };
        cells.enumerate().map(pair).collect()
    }

    /// The solutions of frames at these timestamps with these givens.
    pub fn solved(
        &self,
        camera: Camera,
        stamps: &[f64],
        seed: u64,
    ) -> (Vec<Option<FrameSolution>>, Continuous) {
        let mut random = Random(seed);
        let [width, height] = self.size();
        let mut continuous = Continuous::new(camera, width, height, 1.0);
        let mut motions = Vec::new();
        for (k, &stamp) in stamps.iter().enumerate() {
            let found = k.checked_sub(1).map(|before| self.pair(stamps[before], stamp, &mut random));
            push(&mut continuous, found.as_deref(), stamp);
            if k >= LOOKAHEAD {
                motions.push(settle(&mut continuous));
            }
        }
        motions.extend((0..LOOKAHEAD.min(stamps.len())).map(|_| settle(&mut continuous)));
        (motions, continuous)
    }

    /// Root mean square error in pixels of the points of a frame that a path moves to the middle of the
    /// readout.
    pub fn error(&self, path: &MotionPath, stamp: f64) -> f64 {
        let (centre, time) = (self.centre(), self.readout().time);
        let [width, height] = self.size().map(|side| side as f64);
        let mut squares = Vec::new();
        for index in [0, 5, 11, 16, 20, 27, 32] {
            let share = index as f64 / 32.0;
            let line = if self.gamma < 0.0 { 1.0 - share } else { share };
            for across in [0.05, 0.5, 0.95] {
                let at = if self.by_rows { [across, line] } else { [line, across] };
                let pixel = Vector2::new(at[0] * width - 0.5, at[1] * height - 0.5);
                let shown = path.carry(pixel - centre, share, 0.5);
                let truth = self.carry(pixel, stamp + time * share, stamp + time / 2.0);
                squares.push((shown + centre - truth).norm_squared());
            }
        }
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    }

    /// Root mean square error over that of uncorrected frames.
    pub fn share_left(&self, solutions: &[Option<FrameSolution>], stamps: &[f64]) -> f64 {
        let [mut left, mut whole] = [0.0, 0.0];
        for (solution, stamp) in solutions.iter().zip(stamps) {
            let still = self.error(&MotionPath::STILL, *stamp);
            let error = solution.as_ref().map_or(still, |s| self.error(s.motion.path(), *stamp));
            left += error.powi(2);
            whole += still.powi(2);
        }
        (left / whole).sqrt()
    }

    /// The worst error from frame `first` on.
    pub fn worst(&self, motions: &[Option<FrameSolution>], stamps: &[f64], first: usize) -> f64 {
        let frames = motions.iter().zip(stamps).skip(first);
        let errors = frames.map(|(motion, stamp)| {
            motion.as_ref().map_or(f64::INFINITY, |m| self.error(m.motion.path(), *stamp))
        });
        errors.fold(0.0, f64::max)
    }
}

/// Adds a frame with its correspondences to the one before, if it has any.
pub fn push(continuous: &mut Continuous, found: Option<&[Correspondence]>, stamp: f64) {
    continuous.push(found, stamp, PERIOD, SHARPNESS);
}

/// Settles a frame without flow.
pub fn settle(continuous: &mut Continuous) -> Option<FrameSolution> {
    continuous.settle(&mut LocalMotions::default())
}

pub const UNKNOWN: Camera = Camera {
    model: Model::Auto,
    direction: None,
    readout_time: ReadoutTime::Unknown,
    readout_prior: None,
    focal_length: None,
};

pub fn regular(count: usize) -> Vec<f64> {
    (0..count).map(|k| k as f64 * PERIOD).collect()
}
