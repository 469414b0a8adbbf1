//! Stabilisation: the motion of the scene from frame to frame → where each frame is placed in the output, so that the picture
//! moves as a smooth path does.
//!
//! The path of the scene is the sum of the motions between frames, in logarithmic coordinates ([`logarithm`]). The virtual
//! camera follows it smoothed in time ([`kernel`]), with the standard deviation that is asked for where the picture moves to and
//! fro about a place, and less where the window that is shown would leave the picture otherwise ([`width`], [`window`]): at
//! both ends of a pan. The placement of a frame is carried on from that of the frame before by the measured homography, so that
//! the output moves exactly as the smoothed path does from frame to frame, and drawn towards the offset of the smoothed path.

mod kernel;
mod logarithm;
mod width;
mod window;

#[cfg(test)]
mod tests;

use crate::motion::{FrameMotion, rounded_homography};
use kernel::{Pose, SUPPORT, smoothed};
use logarithm::{Coordinates, exponential, logarithm};
use nalgebra::{Matrix3, Vector2};
use std::collections::VecDeque;
use width::Width;
use window::Edges;

/// Seconds in which a changed deviation, and a placement that is not that of the smoothed path, come nearer by 1 − 1/e: as slow
/// as a movement of the hand that nobody takes for shake.
const EASING: f64 = 0.4;
/// Deviation in seconds below which frames stay where they are: it is reached when a placement that is drawn to rest has come
/// within 1/500 of where it was.
const LEAST_DEVIATION: f64 = 1e-4;
/// Halvings with which the share of an offset that keeps the window inside the picture is found.
const HALVINGS: usize = 8;

/// What is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Standard deviation of the smoothing in seconds; 0: none.
    pub deviation: f64,
    /// How far an edge may come into the picture, as a share of its width or height.
    pub margin: f64,
}

/// A frame with the motion of the scene from it to the next one.
#[derive(Clone, Debug)]
struct Frame<T> {
    /// Seconds, never decreasing.
    time: f64,
    /// To the next frame; `None` where the path breaks off.
    to_next: Option<Increment>,
    edges: Edges,
    /// What is placed; `None` once it is given out.
    content: Option<T>,
    /// Logarithm of the width of the smoothing in seconds that keeps the window inside the picture.
    width: Option<Width>,
}

/// The motion of the scene from a frame to the next one, in radii.
#[derive(Clone, Copy, Debug)]
struct Increment {
    /// Time of the next frame.
    until: f64,
    homography: Matrix3<f64>,
    coordinates: Coordinates,
}

/// The placement of the frame that was given out last.
#[derive(Clone, Copy, Debug)]
struct Placed {
    placement: Matrix3<f64>,
    /// Offset of the smoothed path.
    offset: Coordinates,
}

/// A frame as it comes in.
#[derive(Debug)]
pub struct Settled<'a, T> {
    pub content: T,
    pub motion: &'a FrameMotion,
    /// Seconds.
    pub time: f64,
    /// Whether it repeats the frame before.
    pub repeats: bool,
    /// The motion of the scene in pixels to each of the next frames, with the time of that frame, as far as it is known. Of these
    /// only the first counts once the next frame has come.
    pub ahead: Vec<(f64, Matrix3<f64>)>,
}

/// Places the frames of a stream; holds those whose placement waits for later ones.
#[derive(Debug)]
pub struct Stabilizer<T> {
    size: [usize; 2],
    /// Half the frame's width in pixels.
    radius: f64,
    target: Target,
    /// The deviation in use, which comes nearer to that of the target.
    deviation: f64,
    frames: VecDeque<Frame<T>>,
    /// Frames at the front that were given out.
    given: usize,
    /// Motions after the one that follows the last frame, as far as they are known.
    ahead: Vec<Increment>,
    placed: Option<Placed>,
    /// Whether frames are placed, or were since the last restart.
    is_active: bool,
    /// Whether the frame before the first one was not placed.
    starts_from_rest: bool,
    /// Buffer for the poses about a frame.
    poses: Vec<Pose>,
}

impl<T> Stabilizer<T> {
    /// For frames of this width and height.
    pub fn new(size: [usize; 2], target: Target) -> Self {
        Self {
            size,
            radius: size[0].max(2) as f64 / 2.0,
            target,
            deviation: target.deviation,
            frames: VecDeque::new(),
            given: 0,
            ahead: Vec::new(),
            placed: None,
            is_active: target.deviation > 0.0,
            starts_from_rest: false,
            poses: Vec::new(),
        }
    }

    /// Asks for something else from the next frame on, which it comes to gradually.
    pub fn set_target(&mut self, target: Target) {
        self.target = target;
        if target.deviation > 0.0 && !self.is_active {
            (self.is_active, self.starts_from_rest) = (true, true);
        }
    }

    /// Whether frames are to be pushed here.
    pub fn is_active(&self) -> bool {
        self.is_active
    }

    /// Frames that wait.
    pub fn waiting(&self) -> usize {
        self.frames.len() - self.given
    }

    /// Drops the frames; the next one is placed without regard to those before.
    pub fn restart(&mut self) {
        self.frames.clear();
        self.given = 0;
        self.ahead.clear();
        self.placed = None;
        self.deviation = self.target.deviation;
        self.is_active = self.target.deviation > 0.0;
        self.starts_from_rest = false;
    }

    /// Adds the next frame.
    pub fn push(&mut self, frame: Settled<'_, T>) {
        let mut to_next = None;
        let mut time = frame.time;
        if let Some(last) = self.frames.back_mut() {
            // In reverse playback, time runs the other way.
            time = last.time + (frame.time - last.time).abs();
            if frame.repeats {
                let still = Increment {
                    until: time,
                    homography: Matrix3::identity(),
                    coordinates: Coordinates::zeros(),
                };
                to_next = last.to_next.replace(still);
            }
        }
        if !frame.repeats {
            let scaled = |factor: f64| Matrix3::new_nonuniform_scaling(&Vector2::new(factor, factor));
            let (scale, unscale) = (scaled(self.radius), scaled(1.0 / self.radius));
            let increment = |(at, motion): (f64, Matrix3<f64>)| {
                let homography = unscale * motion * scale;
                let homography = homography / homography.determinant().cbrt();
                let coordinates = logarithm(&homography)?;
                Some(Increment { until: time + (at - frame.time).abs(), homography, coordinates })
            };
            self.ahead.clear();
            self.ahead.extend(frame.ahead.into_iter().map_while(increment));
            to_next = (!self.ahead.is_empty()).then(|| self.ahead.remove(0));
        }
        let edges = Edges::new(frame.motion, self.radius);
        self.frames.push_back(Frame { time, to_next, edges, content: Some(frame.content), width: None });
    }

    /// Places the first frame that waits: its content, and the placement in pixels.
    pub fn pop(&mut self) -> Option<(T, Option<Matrix3<f64>>)> {
        let own = self.given;
        let content = self.frames.get_mut(own)?.content.take();
        let placement = self.place(own);
        self.given += 1;
        self.forget();
        let [width, height] = self.size;
        let scaled = |factor: f64| Matrix3::new_nonuniform_scaling(&Vector2::new(factor, factor));
        let in_pixels = |placement: Matrix3<f64>| {
            let exact = scaled(self.radius) * placement * scaled(1.0 / self.radius);
            rounded_homography(&exact, width, height)
        };
        content.map(|content| (content, placement.map(in_pixels)))
    }

    /// Drops frames that no later one's smoothing reaches.
    fn forget(&mut self) {
        let reach = SUPPORT * self.deviation.max(self.target.deviation);
        while self.given > 1
            && let (Some(first), Some(next)) = (self.frames.front(), self.frames.get(self.given - 1))
            && next.time - first.time > reach
        {
            self.frames.pop_front();
            self.given -= 1;
        }
    }

    /// The placement of a frame in radii; `None` where it stays.
    fn place(&mut self, own: usize) -> Option<Matrix3<f64>> {
        let before = own.checked_sub(1).and_then(|index| self.frames.get(index));
        let (joined, interval) = before.map_or((None, 0.0), |before| {
            let interval = self.frames.get(own).map_or(0.0, |frame| frame.time - before.time);
            (before.to_next, interval)
        });
        let nearer = 1.0 - (-interval / EASING).exp();
        let placed = self.placed.filter(|_| before.is_some());
        self.deviation = match placed {
            Some(_) => self.deviation + nearer * (self.target.deviation - self.deviation),
            None if self.starts_from_rest => 0.0,
            None => self.target.deviation,
        };
        self.starts_from_rest = false;
        if self.target.deviation <= 0.0 && self.deviation < LEAST_DEVIATION {
            (self.deviation, self.placed) = (0.0, None);
            return None;
        }
        let is_alone = joined.is_none() && self.frames.get(own)?.to_next.is_none();
        let offset = if is_alone { Coordinates::zeros() } else { self.offset(own) };
        let placement = match (placed, joined) {
            // On with the smoothed path, and nearer to it.
            (Some(Placed { placement, offset: last }), Some(increment)) => {
                let moved = exponential(&(offset - last + increment.coordinates));
                let back = increment.homography.try_inverse()?;
                drawn(&(moved * placement * back), &offset, nearer)
            }
            // Nothing tells how the frame moves: it comes to rest.
            (Some(Placed { placement, .. }), None) if is_alone => drawn(&placement, &offset, nearer),
            // Another scene.
            _ => exponential(&offset),
        };
        let placement = self.bounded(own, placement)?;
        self.placed = Some(Placed { placement, offset });
        Some(placement)
    }

    /// The offset of the smoothed path from a frame.
    fn offset(&mut self, own: usize) -> Coordinates {
        let width = self.width(own);
        let mut poses = std::mem::take(&mut self.poses);
        self.collect(own, SUPPORT * width, &mut poses);
        let offset = smoothed(&poses, width);
        self.poses = poses;
        offset
    }

    /// The width in seconds of the smoothing of a frame: changed slowly from frame to frame.
    fn width(&mut self, own: usize) -> f64 {
        let Some(time) = self.frames.get(own).map(|frame| frame.time) else { return 0.0 };
        let reach = width::REACH * self.deviation;
        let mut poses = std::mem::take(&mut self.poses);
        let mut sum = width::SoftLeast::default();
        for index in self.run(own, reach) {
            let Some(at) = self.frames.get(index).map(|frame| frame.time - time) else { continue };
            // It is found once when the frame comes near, and once more, when the frames after it are known.
            let known = self.frames.get(index).and_then(|frame| frame.width).filter(|_| index != own);
            let width = known.unwrap_or_else(|| {
                self.collect(index, SUPPORT * self.deviation, &mut poses);
                let frame = self.frames.get(index);
                let inside = |offset: &Coordinates| frame.map_or(0.0, |frame| frame.edges.inside_by(offset));
                Width::of(&poses, self.deviation, self.target.margin, inside)
            });
            if let Some(frame) = self.frames.get_mut(index) {
                frame.width = Some(width);
            }
            sum.add(width, at / reach);
        }
        self.poses = poses;
        sum.width().min(self.deviation)
    }

    /// The frames about one, joined with it, at most `reach` seconds away.
    fn run(&self, own: usize, reach: f64) -> std::ops::RangeInclusive<usize> {
        let time = |index: usize| self.frames.get(index).map_or(f64::INFINITY, |frame| frame.time);
        let here = time(own);
        let is_joined = |index: usize| self.frames.get(index).is_some_and(|frame| frame.to_next.is_some());
        let (mut first, mut last) = (own, own);
        while first > 0 && is_joined(first - 1) && here - time(first - 1) <= reach {
            first -= 1;
        }
        while is_joined(last) && time(last + 1) - here <= reach {
            last += 1;
        }
        first..=last
    }

    /// The poses of the frames about one, seen from it, at most `reach` seconds away.
    fn collect(&self, own: usize, reach: f64, poses: &mut Vec<Pose>) {
        poses.clear();
        let Some(frame) = self.frames.get(own) else { return };
        let run = self.run(own, reach);
        let step = |index: usize| self.frames.get(index).and_then(|frame| frame.to_next);
        let time = |index: usize| self.frames.get(index).map_or(0.0, |other| other.time - frame.time);
        let mut path = Coordinates::zeros();
        for index in (*run.start()..own).rev() {
            path -= step(index).map_or(Coordinates::zeros(), |step| step.coordinates);
            poses.push(Pose { time: time(index), path });
        }
        path = Coordinates::zeros();
        poses.push(Pose { time: 0.0, path });
        for index in own..*run.end() {
            path += step(index).map_or(Coordinates::zeros(), |step| step.coordinates);
            poses.push(Pose { time: time(index + 1), path });
        }
        let last = *run.end();
        let beyond = step(last).filter(|_| last + 1 == self.frames.len());
        let Some(beyond) = beyond else { return };
        // The next frame has not come, but the motions up to it and after it are expected.
        for increment in std::iter::once(&beyond).chain(&self.ahead) {
            let time = increment.until - frame.time;
            if time > reach {
                break;
            }
            path += increment.coordinates;
            poses.push(Pose { time, path });
        }
    }

    /// The placement, nearer to none where the window would leave the picture.
    fn bounded(&self, own: usize, placement: Matrix3<f64>) -> Option<Matrix3<f64>> {
        let edges = &self.frames.get(own)?.edges;
        let most = self.target.margin.max(edges.inside(&Matrix3::identity()));
        if edges.inside(&placement) <= most {
            return Some(placement);
        }
        let whole = logarithm(&placement)?;
        let [mut within, mut beyond] = [0.0, 1.0];
        for _ in 0..HALVINGS {
            let share = (within + beyond) / 2.0;
            *(if edges.inside_by(&(whole * share)) <= most { &mut within } else { &mut beyond }) = share;
        }
        Some(exponential(&(whole * within)))
    }
}

/// A placement moved towards that of an offset by a share of what they differ.
fn drawn(placement: &Matrix3<f64>, offset: &Coordinates, share: f64) -> Matrix3<f64> {
    let wanted = exponential(offset);
    let off = placement.try_inverse().and_then(|back| logarithm(&(wanted * back)));
    match off {
        Some(off) => exponential(&(off * share)) * placement,
        None => wanted,
    }
}
