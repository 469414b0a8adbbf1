//! The readout time and direction from the picture alone, as pairs of frames come.
//!
//! # Theory
//!
//! With t = t_k + T·s(x) the exposure time and Ξⱼ(t) the path of generator φⱼ, the displacement from one
//! frame to the next at the middle x of the two ends of a correspondence is, for small motions,
//!
//! D(x) = Σⱼ φⱼ(x)·[Ξⱼ(t_{k+1} + T·s(x′)) − Ξⱼ(t_k + T·s(x))],
//!
//! and so, with s counted from the centre, σ its gradient and δⁿ the change of the n-th derivative of
//! a path from frame k to frame k + 1,
//!
//! D = Σⱼ φⱼ·[ΔΞⱼ + T·s·δ¹Ξⱼ + T²s²/2·δ²Ξⱼ + T³s³/6·δ³Ξⱼ] + (T/Δt)·(σ·D)·D,
//!
//! the last term because the second exposure is later by the rows that the point has crossed. A
//! translation, roll, zoom or change of perspective moves rows and columns alike; a shutter
//! does not. With the place z = x + iy, the displacement d = dx + i·dy at the centre and g = T·σ as a
//! complex number, the first term leans the picture by
//!
//! h = (∂dx/∂y + ∂dy/∂x) + i·(∂dy/∂y − ∂dx/∂x) = −i·g·δ¹d:
//!
//! two equations a pair for the two numbers of g, so that rows and columns, forwards and backwards
//! are one question. It takes acceleration to answer it, in any direction. Depth leans the picture too:
//! inverse depth with the slope p gives h = −i·p·d. That goes with the velocity, so that it can be told
//! apart; but where depth is more than a slope it is noise, and the errors say so.
//!
//! # State
//!
//! Bounded and plain: some 30 numbers for each of the last 160 pairs, and two times with their covariance
//! for all before them. [`push`](ShutterEstimator::push) costs a dozen weighted fits of six terms to the
//! points of the pair; [`estimate`](ShutterEstimator::estimate) no more than that, whatever their number.
//!
//! | step | file |
//! |---|---|
//! | correspondences of a pair → robust quadratic field → six numbers of its motion, two of its distortion | `field` |
//! | what a readout and depth make of a motion, for a frame size | `chart` |
//! | derivatives of the path at the frames, at any spacing | `derivative` |
//! | pairs → linear equations; both sides are smoothed over five pairs, which takes out what is too fast for the derivatives | `equations` |
//! | robust regression, with errors that are correlated | `regression` |
//! | two times with their errors → direction and probability | `decision` |

mod chart;
mod decision;
mod derivative;
mod equations;
mod field;
mod regression;
#[cfg(test)]
mod tests;

use crate::correspond::Correspondence;
use crate::readout::ReadoutDirection;
use crate::solve::median::median;
use chart::{Chart, Times};
use equations::{Builder, Equation, Pair};
use field::{Moved, ripple, robust_field};
use nalgebra::{Matrix2, Vector2, Vector6};
use regression::{Gaussian, regress};
use std::collections::VecDeque;

/// Pairs that are kept one by one.
const HISTORY: usize = 160;
/// Of them, how many are summed up when there are more.
const SETTLED: usize = 80;
/// Rounds of linearisation.
const ROUNDS: usize = 4;
/// Standard deviation of a correspondence in pixels below which the spread is not believed.
const NOISE: f64 = 0.05;
/// Standard deviation in pixels at the frame's edge of the points of a still picture.
const FLOOR: f64 = 0.02;
/// As a stretch is settled that brings the share x of what is known, what was known before keeps
/// (1 − x) to this power of its weight: some five stretches that tell as much are remembered, for the
/// errors of the model are the same in all of them, and a rest makes nothing forgotten.
const FORGETTING: f64 = 1.2;

/// What can be said of a camera's shutter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Not known yet: there was too little acceleration, or what was seen fits no shutter.
    Unknown,
    /// A readout too short to matter: its direction says nothing.
    Global,
    /// Lines are read one after another.
    Rolling,
}

/// What is known of a camera's readout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadoutEstimate {
    /// What it comes to.
    pub verdict: Verdict,
    /// Which edge is read first, most probably.
    pub direction: ReadoutDirection,
    /// Readout time T in seconds by that direction, at least 0 and at most a frame period.
    pub time: f64,
    /// Standard error of the time in seconds, before it was held to its limits.
    pub standard_error: f64,
    /// Probability, 0 to 1, that the camera reads in that direction; if the verdict is
    /// [`Global`](Verdict::Global), that it reads along that axis or not at all.
    pub confidence: f64,
    /// Time from column 0 to the last, and from row 0 to the last, in seconds and with sign, where
    /// neither axis is ruled out.
    pub times: Vector2<f64>,
    /// Covariance of `times` in seconds squared.
    pub covariance: Matrix2<f64>,
}

/// Finds the readout as pairs of frames come.
#[derive(Clone, Debug)]
pub struct ShutterEstimator {
    chart: Chart,
    history: VecDeque<Pair>,
    settled: Option<Gaussian>,
    run: u64,
    builder: Builder,
    points: Vec<Moved>,
    errors: Vec<f64>,
    bends: Vec<Vector6<f64>>,
    equations: Vec<Equation>,
}

impl ShutterEstimator {
    /// For frames of `width` × `height` pixels.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            chart: Chart::new(width, height),
            history: VecDeque::with_capacity(HISTORY),
            settled: None,
            run: 0,
            builder: Builder::default(),
            points: Vec::new(),
            errors: Vec::new(),
            bends: Vec::new(),
            equations: Vec::new(),
        }
    }

    /// Takes the correspondences, in full-frame pixels, from the last frame to one `interval` seconds
    /// later. Too few correspondences, or an interval that is not positive, are a gap.
    pub fn push(&mut self, correspondences: &[Correspondence], interval: f64) {
        self.points.clear();
        self.points.extend(correspondences.iter().map(|pair| self.chart.place(pair)));
        let field = robust_field(&self.points, NOISE / self.chart.unit, &mut self.errors);
        let Some(field) = field.filter(|_| interval.is_finite() && interval > 0.0) else {
            self.reset_pair();
            return;
        };
        if self.history.len() >= HISTORY {
            self.settle();
        }
        let stretch = [0, 1].map(|axis| self.chart.stretch(&field, axis));
        let ripple = [0, 1].map(|axis| ripple(&self.points, &field, axis));
        self.history.push_back(Pair { run: self.run, interval, field: field.into(), stretch, ripple });
    }

    /// The next pair does not follow the last one: a cut, or a gap.
    pub fn reset_pair(&mut self) {
        self.run += 1;
    }

    /// What is known so far; `None` before the first ten pairs or so that follow each other.
    ///
    /// Solves anew for the last 160 pairs; asking after every pair is allowed, but seldom of use.
    pub fn estimate(&mut self) -> Option<ReadoutEstimate> {
        let period = self.period()?;
        let recent = self.solve(self.history.len(), period);
        let found = match (recent, self.settled.map(|settled| settled.scaled(1.0 / period))) {
            (Some(recent), Some(settled)) => recent.fused(&settled)?,
            (recent, settled) => recent.or(settled)?,
        };
        decision::decide(&found, period)
    }

    /// The usual interval between frames in seconds.
    fn period(&mut self) -> Option<f64> {
        self.errors.clear();
        self.errors.extend(self.history.iter().map(|pair| pair.interval));
        (!self.errors.is_empty()).then(|| median(&mut self.errors))
    }

    /// The readout times in periods, from the oldest `count` pairs.
    fn solve(&mut self, count: usize, period: f64) -> Option<Gaussian> {
        let pairs = &self.history.make_contiguous()[..count];
        self.bends.clear();
        self.bends.resize(count, Vector6::zeros());
        let mut times = Times::zeros();
        let mut found = None;
        for _ in 0..ROUNDS {
            self.equations.clear();
            let mut start = 0;
            for run in pairs.chunk_by(|a, b| a.run == b.run) {
                let bends = &mut self.bends[start..start + run.len()];
                self.builder.run(&self.chart, run, period, times, bends, &mut self.equations);
                start += run.len();
            }
            let ripple =
                [0, 1].map(|axis| pairs.iter().map(|pair| pair.ripple[axis]).sum::<f64>() / count as f64);
            found = Some(regress(&self.equations, FLOOR / self.chart.unit, ripple)?);
            times = found.map_or(times, |found| found.mean.map(|time| time.clamp(-1.0, 1.0)));
        }
        found
    }

    /// Sums up the oldest pairs and forgets them.
    fn settle(&mut self) {
        if let Some(period) = self.period()
            && let Some(found) = self.solve(SETTLED, period)
        {
            let found = found.scaled(period);
            self.settled = match self.settled {
                None => Some(found),
                Some(before) => found.fused(&before.faded(&found, FORGETTING)).or(Some(before)),
            };
        }
        self.history.drain(..SETTLED.min(self.history.len()));
    }
}
