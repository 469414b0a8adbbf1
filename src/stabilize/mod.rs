// SPDX-License-Identifier: MIT OR Apache-2.0

//! Stabilisation: the motion of the scene from frame to frame → where each frame is placed in the output, so that the picture
//! moves as a smooth path does.
//!
//! The path of the scene is the sum of the motions between frames, in logarithmic coordinates ([`logarithm`]). The path of the
//! virtual camera is the one of least acceleration near it ([`plan`]) with which the window that is shown stays inside the
//! picture ([`window`], [`bound`]), planned anew with each frame as far as later frames are known.
//!
//! A plan changes the placements that the plan before has found. Motions do not commute; but of placements that are
//! nearly right, the steps of the output and the edges are known exactly, and the changes are so small that they do.

mod band;
mod bound;
mod logarithm;
mod plan;
mod window;

#[cfg(test)]
mod tests;

use crate::motion::{FrameMotion, rounded_homography, scaled};
use bound::{Bound, Limit, Ways};
use logarithm::{Coordinates, exponential, logarithm};
use nalgebra::Matrix3;
use plan::{Planner, Point, stiffness};
use std::collections::VecDeque;
use window::Edges;

/// Seconds in which a changed deviation, and a placement that comes to rest, come nearer by 1 − 1/e: as slow as a movement of the
/// hand that nobody takes for shake.
const EASING: f64 = 0.4;
/// Deviation in seconds below which frames stay where they are: it is reached when a placement that is drawn to rest has come
/// within 1/500 of where it was.
const LEAST_DEVIATION: f64 = 1e-4;
/// Deviations over which later frames count: at twice that, 1/100 of the filter's response is left.
pub const SUPPORT: f64 = 2.65;
/// Share of the margin up to which the planned path may go: the rest is for what differs from the plan.
pub const PLANNED_SHARE: f64 = 0.9;
/// Plans for the first frame of a scene, each around the one before: nothing is guessed of its placements.
const FIRST_PLANS: usize = 4;
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
    /// Its placement by the last plan, if there was one.
    planned: Option<Matrix3<f64>>,
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
    /// The motion of the output from the frame before, as it was planned.
    step: Option<Coordinates>,
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
    bound: Bound,
    /// Buffers: the frames that are planned, the points of their edges, and how their places change.
    points: Vec<Point>,
    limits: Vec<Limit>,
    changes: Vec<Coordinates>,
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
            bound: Bound::default(),
            points: Vec::new(),
            limits: Vec::new(),
            changes: Vec::new(),
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
            planned: None,
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
        let placed = self.placed.take().filter(|_| before.is_some());
        self.deviation = match placed {
            Some(_) => self.deviation + nearer * (self.target.deviation - self.deviation),
            None if self.starts_from_rest => 0.0,
            None => self.target.deviation,
        };
        self.starts_from_rest = false;
        if self.target.deviation <= 0.0 && self.deviation < LEAST_DEVIATION {
            self.deviation = 0.0;
            return None;
        }
        let is_alone = joined.is_none() && self.frames.get(own)?.to_next.is_none();
        let joined = placed.zip(joined);
        let planned = match (placed, is_alone) {
            // Nothing tells how the frame moves: it comes to rest.
            (Some(Placed { placement, .. }), true) => {
                exponential(&(logarithm(&placement).unwrap_or_default() * (1.0 - nearer)))
            }
            (None, true) => Matrix3::identity(),
            _ => self.planned(own, joined),
        };
        // A window that leaves the picture nevertheless is put back, but goes on as planned.
        let step = joined.and_then(|(placed, motion)| moved(&placed.placement, &motion, &planned));
        let placement = self.bounded(own, planned)?;
        self.placed = Some(Placed { placement, step });
        Some(placement)
    }

    /// The placement of a frame by a new plan, given that of the frame before with the motion from it, in the same scene.
    fn planned(&mut self, own: usize, joined: Option<(Placed, Increment)>) -> Matrix3<f64> {
        let time = |back: usize| Some(self.frames.get(own.checked_sub(back)?)?.time);
        // Places are counted from that of the frame before.
        let before = joined.map_or([None; 2], |(placed, _)| {
            [time(1).zip(Some(Coordinates::zeros())), time(2).zip(placed.step.map(|step| -step))]
        });
        let plans = if joined.is_some() { 1 } else { FIRST_PLANS };
        for _ in 0..plans {
            self.guess(own, joined);
            self.planner.plan(&self.points, before, self.deviation, &mut self.changes);
            let motions = self.frames.iter().skip(own).take(self.points.len());
            let motions = motions.filter_map(|frame| Some(frame.to_next?.coordinates));
            let ways = Ways::new(motions, self.size[1] as f64 / self.size[0].max(1) as f64);
            let stiffness = stiffness(self.deviation);
            self.bound.keep(self.planner.rows(), &self.limits, &ways, stiffness, &mut self.changes);
            for (frame, change) in self.frames.iter_mut().skip(own).zip(&self.changes) {
                let changed = frame.planned.map(|planned| exponential(change) * planned);
                // What is too far away for logarithms is not planned.
                frame.planned = changed.filter(|changed| logarithm(changed).is_some()).or(frame.planned);
            }
        }
        self.frames.get(own).and_then(|frame| frame.planned).unwrap_or_else(Matrix3::identity)
    }

    /// Collects the frames from one on, joined with it, whose motions are known, with their places by the last plan. Frames that it
    /// does not have are guessed to be placed as the one before.
    fn guess(&mut self, own: usize, joined: Option<(Placed, Increment)>) {
        self.points.clear();
        self.limits.clear();
        let Some(first) = self.frames.get(own) else { return };
        let until = first.time + SUPPORT * self.deviation;
        let most = PLANNED_SHARE * self.target.margin;
        let mut from = joined.map_or_else(Matrix3::identity, |(placed, _)| placed.placement);
        let mut motion = joined.map(|(_, increment)| increment);
        let mut place = Coordinates::zeros();
        let mut add =
            |time: f64, edges: &Edges, from: &Matrix3<f64>, to: &Matrix3<f64>, motion: Option<Increment>| {
                if let Some(motion) = motion {
                    place += moved(from, &motion, to).unwrap_or(motion.coordinates);
                }
                let frame = self.points.len();
                self.points.push(Point { time, place, offset: logarithm(to).unwrap_or_default() });
                let limits = edges.beyond(to, most.max(edges.rest));
                self.limits.extend(limits.map(|(beyond, outwards)| Limit { frame, beyond, outwards }));
            };
        for frame in self.frames.iter_mut().skip(own) {
            if frame.time > until {
                return;
            }
            let to = *frame.planned.get_or_insert(from);
            add(frame.time, &frame.edges, &from, &to, motion);
            from = to;
            motion = frame.to_next;
            if motion.is_none() {
                return;
            }
        }
        // Frames that have not come, to which the motion is expected, with the edges of the last one.
        let Some(last) = self.frames.back() else { return };
        let ahead = motion.into_iter().chain(self.ahead.iter().copied());
        for increment in ahead.take_while(|increment| increment.until <= until) {
            add(increment.until, &last.edges, &from, &from, Some(increment));
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

/// The motion of the output from a frame to the next one, given their placements.
fn moved(from: &Matrix3<f64>, motion: &Increment, to: &Matrix3<f64>) -> Option<Coordinates> {
    logarithm(&(to * motion.homography * from.try_inverse()?))
}
