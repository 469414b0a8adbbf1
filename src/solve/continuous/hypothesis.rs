//! One way in which the sensor may be read, with a solver of its own.

use super::pair::Pair;
use super::solver::{Solver, Tempo};
use crate::readout::ReadoutDirection;
use crate::solve::median::median;

/// Residuals of less than so many times the least noise are nothing but noise.
pub(super) const NOTICEABLE: f64 = 4.0;
/// Steps to the first path, and to each one after it, at most.
const STEPS: [usize; 2] = [12, 4];
/// A step that changes the displacements at the frame by less than this share of the least noise (root mean
/// square) is the last.
const SETTLED: f64 = 0.3;
/// Or γ by less than this.
const SETTLED_READOUT: f64 = 0.01;
/// A path that leaves more than this share of the mean squared displacement is tried at another tempo.
const UNEXPLAINED: f64 = 0.05;
/// The faster tempo must leave less than this share of what the calm one does (standard deviations).
const WORTH_VIBRATING: f64 = 0.5;
/// Readout ratios from which a vibration is looked for where the readout is unknown.
const READOUTS: [f64; 4] = [0.9, 0.5, -0.5, -0.9];
/// A readout ratio that is known worse than this may be anything.
const VAGUE: f64 = 0.2;
/// Frames from one trial of another tempo to the next.
const TRIAL: usize = 15;
/// Independent measurements in a pair, two coordinates each: the weight of its residuals' logarithm.
const WEIGHT: f64 = 50.0;

/// Pairs that follow one another, around a frame.
#[derive(Clone, Copy)]
pub(super) struct Stretch<'a> {
    pub pairs: &'a [&'a Pair],
    /// Number of those before the frame.
    pub past: usize,
}

impl<'a> Stretch<'a> {
    /// The part of it that a path of this tempo is fitted to.
    pub fn of_tempo(self, tempo: Tempo) -> Self {
        let skipped = self.past.saturating_sub(tempo.past());
        Self { pairs: self.pairs.get(skipped..).unwrap_or_default(), past: self.past - skipped }
    }

    /// Indices of the pairs that the frame is in.
    pub fn beside(self) -> impl Iterator<Item = usize> + Clone {
        let count = self.pairs.len();
        [self.past.checked_sub(1), Some(self.past)].into_iter().flatten().filter(move |index| *index < count)
    }

    /// Mean square distance by which points moved in the pairs that the frame is in, in squared units of the radius.
    pub fn moved(self, tempo: Tempo) -> f64 {
        let stretch = self.of_tempo(tempo);
        stretch
            .beside()
            .filter_map(|index| stretch.pairs.get(index))
            .map(|pair| pair.moved())
            .fold(0.0, f64::max)
    }

    /// Index of the pair that the frame begins; without lookahead, of the one that it ends.
    pub fn own(self) -> usize {
        self.past.min(self.pairs.len().saturating_sub(1))
    }

    /// The middle one of the intervals between the pairs' frames, in frame periods; a readout takes no longer.
    pub fn usual_interval(self) -> f64 {
        let mut intervals: Vec<f64> =
            self.pairs.iter().map(|pair| (pair.stamps[1] - pair.stamps[0]).abs()).collect();
        if intervals.is_empty() { 1.0 } else { median(&mut intervals) }
    }
}

/// A way in which the sensor may be read.
#[derive(Clone, Debug)]
pub(super) struct Hypothesis {
    /// Which edge is first, where γ is known to be positive or negative.
    pub direction: ReadoutDirection,
    /// The least and the greatest γ, in intervals between frames.
    pub signs: [f64; 2],
    pub solver: Solver,
    /// Logarithm of its likelihood, up to a constant.
    pub score: f64,
    /// The same by the rough estimate.
    pub rough: f64,
    /// Frames since another tempo was tried.
    since_trial: usize,
}

impl Hypothesis {
    /// A hypothesis that nothing speaks for or against yet. While the readout is sought, a path that fits badly means
    /// little: only after some frames may it be a vibration.
    pub fn new(direction: ReadoutDirection, signs: [f64; 2], solver: Solver, known: bool) -> Self {
        Self { direction, signs, solver, score: 0.0, rough: 0.0, since_trial: if known { TRIAL } else { 0 } }
    }

    /// Logarithm of the likelihood, up to a constant.
    pub fn likelihood(&self) -> f64 {
        self.score + self.rough
    }

    /// Fits the path to a stretch.
    pub fn settle(&mut self, stretch: Stretch<'_>, starts: bool) {
        if starts {
            self.solver.restart();
        }
        if stretch.pairs.is_empty() {
            return;
        }
        let settled = iterate(&mut self.solver, stretch, STEPS[usize::from(!starts)]);
        self.try_tempo(stretch);
        let seen = stretch.of_tempo(self.solver.tempo);
        if settled {
            self.solver.remember(1.0 / seen.pairs.len() as f64);
        }
        if let Some(sigma) = self.solver.sigma(seen.own()).filter(|sigma| sigma.is_finite()) {
            self.score -= WEIGHT * self.solver.trust() * sigma.max(self.solver.noise).ln();
        }
    }

    /// Goes over to another tempo where that is worth it.
    fn try_tempo(&mut self, stretch: Stretch<'_>) {
        self.since_trial += 1;
        let tempo = self.solver.tempo;
        let sigma_of = |solver: &Solver| solver.sigma(stretch.of_tempo(solver.tempo).own());
        let (Some(sigma), Some(pair)) = (sigma_of(&self.solver), stretch.pairs.get(stretch.own())) else {
            return;
        };
        let moved = pair.moved() * self.solver.radius * self.solver.radius;
        let wanted = tempo == Tempo::Vibrating || 2.0 * sigma * sigma > UNEXPLAINED * moved;
        if self.since_trial < TRIAL || !wanted || sigma < NOTICEABLE * self.solver.noise {
            return;
        }
        self.since_trial = 0;
        let vague = tempo == Tempo::Calm && self.solver.readout_deviation() > VAGUE;
        let starts = if vague { &READOUTS[..] } else { &[] };
        let trials = starts.iter().map(Some).chain([None]).map(|readout| {
            let mut other = self.solver.at_tempo(tempo.other());
            let [low, high] = other.limits[0];
            other.shared[0] = readout.map_or(other.shared[0], |readout| readout.clamp(low, high));
            iterate(&mut other, stretch, STEPS[0]);
            (sigma_of(&other).unwrap_or(f64::INFINITY), other)
        });
        let Some((others, other)) = trials.min_by(|a, b| a.0.total_cmp(&b.0)) else { return };
        let (fast, calm) = if tempo == Tempo::Calm { (others, sigma) } else { (sigma, others) };
        if (fast < WORTH_VIBRATING * calm) == (tempo == Tempo::Calm) {
            self.solver = other;
        }
    }
}

/// Steps until nothing changes any more at the frame, at most so many; whether that came to pass.
fn iterate(solver: &mut Solver, stretch: Stretch<'_>, steps: usize) -> bool {
    let stretch = stretch.of_tempo(solver.tempo);
    for _ in 0..steps {
        let before = solver.shared[0];
        if !solver.step(stretch.pairs) {
            solver.restart();
            continue;
        }
        let change = stretch.beside().map(|index| solver.moved(index)).fold(0.0, f64::max);
        let moved = (solver.shared[0] - before).abs();
        if change < SETTLED * solver.noise && moved < SETTLED_READOUT {
            solver.cover(stretch.pairs);
            return true;
        }
    }
    solver.cover(stretch.pairs);
    false
}
