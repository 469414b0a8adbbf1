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
//! are one question. It takes acceleration to answer it, in any direction. Depth leans the picture too: inverse
//! depth with the slope p gives h = −i·p·d. That goes with the velocity, so that it can be told apart.
//!
//! | step | file |
//! |---|---|
//! | correspondences of a pair → robust quadratic field, 12 numbers: 6 of the motion, 6 of the distortion that no motion has | `field` |
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

use crate::correspond::Correspondence;
use crate::readout::ReadoutDirection;
use chart::{Chart, Times};
use equations::{Builder, Equation, Pair};
use field::{Moved, ripple, robust_field};
use nalgebra::Vector6;
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
/// Standard deviation in pixels at the frame's edge of what a tracker makes of a still picture.
const FLOOR: f64 = 0.02;
/// What is settled keeps this share of its weight as the next stretch is.
const REMEMBERED: f64 = 0.8;

/// What is known of a camera's readout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadoutEstimate {
    /// Which edge is read first, most probably.
    pub direction: ReadoutDirection,
    /// Readout time T in seconds; 0 for a global shutter.
    pub time: f64,
    /// Standard error of the time in seconds.
    pub standard_error: f64,
    /// Probability, 0 to 1, that the direction is right, or of a global shutter.
    pub confidence: f64,
    /// Raw, debugging: signed time by rows and its error, by columns and error, in periods.
    pub raw: [f64; 4],
    /// Probabilities.
    pub probability: [f64; 3],
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
    /// later.
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

    /// What is known so far; `None` if nothing is.
    pub fn estimate(&mut self) -> Option<ReadoutEstimate> {
        let period = self.period()?;
        let recent = self.solve(self.history.len(), period);
        let in_periods = |settled: Gaussian| Gaussian {
            mean: settled.mean / period,
            covariance: settled.covariance / (period * period),
        };
        let found = match (recent, self.settled.map(in_periods)) {
            (Some(recent), Some(settled)) => recent.fused(&settled)?,
            (recent, settled) => recent.or(settled)?,
        };
        let weighed = decision::weigh(&found)?;
        let best = (0..3).max_by(|a, b| weighed.probability[*a].total_cmp(&weighed.probability[*b]))?;
        let (time, error) =
            if best < 2 { (weighed.time[best], weighed.error[best]) } else { (0.0, weighed.error[0]) };
        let direction = match (best, time < 0.0) {
            (1, false) => ReadoutDirection::LeftToRight,
            (1, true) => ReadoutDirection::RightToLeft,
            (_, false) => ReadoutDirection::TopToBottom,
            (_, true) => ReadoutDirection::BottomToTop,
        };
        Some(ReadoutEstimate {
            direction,
            time: time.abs() * period,
            standard_error: error * period,
            confidence: weighed.probability[best],
            raw: [
                found.mean.y,
                found.covariance[(1, 1)].sqrt(),
                found.mean.x,
                found.covariance[(0, 0)].sqrt(),
            ],
            probability: weighed.probability,
        })
    }

    /// The usual interval between frames in seconds.
    fn period(&mut self) -> Option<f64> {
        self.errors.clear();
        self.errors.extend(self.history.iter().map(|pair| pair.interval));
        let middle = self.errors.len() / 2;
        (!self.errors.is_empty()).then(|| *self.errors.select_nth_unstable_by(middle, f64::total_cmp).1)
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
            let ripple = [0, 1].map(|axis| pairs.iter().map(|pair| pair.ripple[axis]).sum::<f64>() / count as f64);
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
            let found =
                Gaussian { mean: found.mean * period, covariance: found.covariance * period * period };
            self.settled = match self.settled {
                None => Some(found),
                Some(before) => {
                    let faded = Gaussian { covariance: before.covariance / REMEMBERED, ..before };
                    found.fused(&faded).or(self.settled)
                }
            };
        }
        self.history.drain(..SETTLED.min(self.history.len()));
    }
}
