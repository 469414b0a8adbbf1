// SPDX-License-Identifier: MIT OR Apache-2.0

//! Stabilisation: the motion of the scene from frame to frame → where each frame is placed in the output, so that the picture
//! moves as a smooth path does.
//!
//! The path of the scene is the sum of the motions between frames, in logarithmic coordinates ([`logarithm`]). The path of the
//! virtual camera is the one of least acceleration near it ([`plan`]), planned anew with each frame as far as later frames are
//! known, and nearer to it where the window that is shown would leave the picture otherwise ([`window`]). The placement of a
//! frame is carried on from that of the frame before by the measured homography, so that the output moves exactly as the planned
//! path does from frame to frame, and drawn towards the offset of that path.

mod logarithm;
mod plan;
mod window;

#[cfg(test)]
mod tests;

use crate::motion::{FrameMotion, rounded_homography, scaled};
use logarithm::{Coordinates, exponential, logarithm};
use nalgebra::Matrix3;
use plan::{Planner, Point};
use std::collections::VecDeque;
use window::Edges;

/// Seconds in which a changed deviation, and a placement that is not that of the planned path, come nearer by 1 − 1/e: as slow
/// as a movement of the hand that nobody takes for shake.
const EASING: f64 = 0.4;
/// Deviation in seconds below which frames stay where they are: it is reached when a placement that is drawn to rest has come
/// within 1/500 of where it was.
const LEAST_DEVIATION: f64 = 1e-4;
/// Deviations over which later frames count: at twice that, 1/100 of the filter's response is left.
pub const SUPPORT: f64 = 2.65;
/// Share of the margin up to which the planned path may go: the rest is for what differs from the plan.
pub const PLANNED_SHARE: f64 = 0.9;
/// Plans for a frame, and for the first one of a scene, each with the holds by the one before.
const PLANS: usize = 2;
const FIRST_PLANS: usize = 16;
/// Factor of the strength of a hold from plan to plan, its least and its largest.
const TIGHTER: f64 = 2.0;
const LEAST_HOLD: f64 = 16.0;
const MAX_WEIGHT: f64 = 1e6;
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
    /// Offset of the planned path, once it is given out.
    offset: Coordinates,
    /// Where the planned path is held, so that the window stays inside the picture: the offset, and how strongly.
    held: Coordinates,
    weight: f64,
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
    /// Offset of the planned path.
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
    planner: Planner,
    /// Buffers: the frames that are planned, and their places.
    points: Vec<Point>,
    places: Vec<Coordinates>,
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
            planner: Planner::default(),
            points: Vec::new(),
            places: Vec::new(),
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
            let increment = |(at, motion): (f64, Matrix3<f64>)| {
                let homography = scaled(&motion, [1.0 / self.radius; 2]);
                let homography = homography / homography.determinant().cbrt();
                let coordinates = logarithm(&homography)?;
                Some(Increment { until: time + (at - frame.time).abs(), homography, coordinates })
            };
            self.ahead.clear();
            self.ahead.extend(frame.ahead.into_iter().map_while(increment));
            to_next = (!self.ahead.is_empty()).then(|| self.ahead.remove(0));
        }
        self.frames.push_back(Frame {
            time,
            to_next,
            edges: Edges::new(frame.motion, self.radius),
            content: Some(frame.content),
            offset: Coordinates::zeros(),
            held: Coordinates::zeros(),
            weight: 1.0,
        });
    }

    /// Places the first frame that waits: its content, and the placement in pixels.
    pub fn pop(&mut self) -> Option<(T, Option<Matrix3<f64>>)> {
        let own = self.given;
        let content = self.frames.get_mut(own)?.content.take();
        let placement = self.place(own);
        self.given += 1;
        self.forget();
        let [width, height] = self.size;
        let in_pixels = |placement: Matrix3<f64>| {
            rounded_homography(&scaled(&placement, [self.radius; 2]), width, height)
        };
        content.map(|content| (content, placement.map(in_pixels)))
    }

    /// Drops frames that the plan does not depend on: it takes the last two.
    fn forget(&mut self) {
        while self.given > 2 {
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
            // On with the planned path, and nearer to it.
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

    /// The offset of the planned path from a frame; it is kept with the frame.
    fn offset(&mut self, own: usize) -> Coordinates {
        let before = self.before(own);
        self.collect(own);
        let plans = if before[0].is_some() { PLANS } else { FIRST_PLANS };
        for _ in 0..plans {
            self.planner.plan(&self.points, before, self.deviation, &mut self.places);
            self.hold(own);
        }
        let offset = self.places.first().copied().unwrap_or_default();
        if let Some(frame) = self.frames.get_mut(own) {
            frame.offset = offset;
        }
        offset
    }

    /// The places of the two frames before, seen from a frame, with their times; the nearest first.
    fn before(&self, own: usize) -> [Option<(f64, Coordinates)>; 2] {
        let mut path = Coordinates::zeros();
        let mut places = [None; 2];
        for (back, slot) in places.iter_mut().enumerate() {
            let frame = own.checked_sub(back + 1).and_then(|index| self.frames.get(index));
            let Some((frame, increment)) = frame.and_then(|frame| Some((frame, frame.to_next?))) else {
                break;
            };
            path -= increment.coordinates;
            *slot = Some((frame.time, path + frame.offset));
        }
        places
    }

    /// Collects the frames from one on, joined with it, whose paths are known.
    fn collect(&mut self, own: usize) {
        self.points.clear();
        let Some(first) = self.frames.get(own) else { return };
        let until = first.time + SUPPORT * self.deviation;
        let mut path = Coordinates::zeros();
        let mut beyond = None;
        for frame in self.frames.iter().skip(own) {
            if frame.time > until {
                return;
            }
            let (held, weight) = (frame.held, frame.weight);
            self.points.push(Point { time: frame.time, path, held, weight });
            beyond = frame.to_next;
            let Some(increment) = beyond else { break };
            path += increment.coordinates;
        }
        // Frames that have not come, to which the motion is expected; the path up to the first of them is summed up already.
        let Some(first) = beyond else { return };
        let mut next = Some(first);
        let mut ahead = self.ahead.iter();
        while let Some(increment) = next.filter(|increment| increment.until <= until) {
            self.points.push(Point { time: increment.until, path, held: Coordinates::zeros(), weight: 1.0 });
            next = ahead.next().copied();
            path += next.map_or(Coordinates::zeros(), |increment| increment.coordinates);
        }
    }

    /// Holds the plan at the edge of what the margin allows where it goes beyond, and lets go where that is needed no more.
    fn hold(&mut self, own: usize) {
        let most = PLANNED_SHARE * self.target.margin;
        let planned = self.points.iter_mut().zip(&self.places);
        for ((point, place), frame) in planned.zip(self.frames.iter_mut().skip(own)) {
            let offset = place - point.path;
            let rest = frame.edges.rest;
            let excess = (frame.edges.inside_by(&offset) - rest) / (most - rest);
            let excess = if most > rest && excess.is_finite() { excess } else { f64::INFINITY };
            if excess > 1.0 {
                point.held = offset / excess;
                point.weight = (point.weight * TIGHTER).clamp(LEAST_HOLD, MAX_WEIGHT);
            } else {
                point.weight = (point.weight / TIGHTER).max(1.0);
                point.held = if point.weight > 1.0 { offset } else { Coordinates::zeros() };
            }
            (frame.held, frame.weight) = (point.held, point.weight);
        }
    }

    /// The placement, nearer to none where the window would leave the picture.
    fn bounded(&self, own: usize, placement: Matrix3<f64>) -> Option<Matrix3<f64>> {
        let edges = &self.frames.get(own)?.edges;
        let most = self.target.margin.max(edges.rest);
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
