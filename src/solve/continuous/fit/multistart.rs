// SPDX-License-Identifier: MIT OR Apache-2.0

//! Fits from several starts side by side, as a fit may end in a local optimum.
//!
//! They advance with each new frame, which spreads their cost.

use super::gauss_newton::fit;
use super::posterior::Posterior;
use super::setup::Setup;
use crate::parallel::*;
use crate::solve::continuous::data::PairWindow;
use crate::solve::continuous::trajectory::KnotDensity;

/// Steps, at most, to the first path and to each later one. The first number holds until γ has converged, as
/// the splines imitate the shutter while γ is wrong. It is spread over frames, for live streams.
pub const STEPS: [usize; 2] = [12, 4];
/// Pairs times steps with a frame, at most: two from each of three starts over ten pairs when the first frame is
/// due. Later, when the current path takes none of the first steps, half as many more. With half of either, the
/// variances of the smoothness are not learnt before the starts are compared.
const PAIR_STEPS: [usize; 2] = [64, 96];
/// Fewest pairs of a window by whose evidence fits are compared.
pub const COMPARED_PAIRS: usize = 8;
/// Log odds above which a readout ratio or smoothness is preferred to another.
pub const DECISIVE_LOG_ODDS: f64 = 5.0;

/// A fit from one start.
#[derive(Clone, Debug)]
struct Candidate {
    posterior: Posterior,
    /// γ of the start.
    start: f64,
    /// Steps on windows that constrain a readout.
    steps: usize,
}

impl Candidate {
    /// Takes so many steps.
    fn advance(&mut self, window: PairWindow<'_>, steps: usize, setup: &Setup) {
        let mut setup = *setup;
        if window.is_short() {
            setup.camera.hold_gamma(self.start);
        }
        let start = std::mem::take(&mut self.posterior);
        (self.posterior, _) = fit(window, start, &setup, steps);
        self.steps += if window.is_short() { 0 } else { steps };
    }
}

/// Fits from several starts.
#[derive(Clone, Debug)]
pub struct Multistart {
    candidates: Vec<Candidate>,
    is_narrowed: bool,
}

impl Multistart {
    /// From several γ, with the knot density and model of a posterior.
    pub fn new(posterior: &Posterior, setup: &Setup, starts: &[f64]) -> Self {
        let mut fresh = posterior.clone();
        fresh.restart();
        Self::of(&fresh, clamped(setup, starts))
    }

    /// From several γ and that of the posterior, at another knot density.
    pub fn with_density(posterior: &Posterior, setup: &Setup, density: KnotDensity, starts: &[f64]) -> Self {
        let starts = clamped(setup, starts).chain([posterior.shared.gamma]);
        Self::of(&posterior.with_density(density), starts)
    }

    fn of(fresh: &Posterior, starts: impl Iterator<Item = f64>) -> Self {
        let candidate = |start| {
            let mut posterior = fresh.clone();
            posterior.shared.gamma = start;
            Candidate { posterior, start, steps: 0 }
        };
        Self { candidates: starts.map(candidate).collect(), is_narrowed: false }
    }

    /// Fewest steps of a candidate.
    fn steps(&self) -> usize {
        self.candidates.iter().map(|candidate| candidate.steps).min().unwrap_or(0)
    }

    /// Whether all have taken enough steps to be compared.
    pub fn is_done(&self) -> bool {
        self.steps() >= STEPS[0]
    }

    /// Steps that the chosen one has yet to take.
    pub fn steps_left(&self) -> usize {
        STEPS[0].saturating_sub(self.steps()).max(STEPS[1])
    }

    /// Steps with this frame, so that its cost is about that of others.
    pub fn pace(&self, window: PairWindow<'_>, starts: bool) -> usize {
        let pairs = window.pairs.len() * self.candidates.len();
        (PAIR_STEPS[usize::from(!starts)] / pairs.max(1)).clamp(1, STEPS[0])
    }

    /// Advances each by so many steps, on a window that grows.
    pub fn prepare(&mut self, window: PairWindow<'_>, steps: usize, setup: &Setup) {
        self.advance(window, steps, setup);
        if window.is_short() {
            // So few pairs do not show which generators are needed.
            self.candidates.iter_mut().for_each(|one| one.posterior.smoothness.restart());
        }
        if window.pairs.len() >= COMPARED_PAIRS && !self.is_narrowed {
            self.is_narrowed = true;
            self.narrow(window, setup);
        }
    }

    /// Advances each by so many steps.
    pub fn advance(&mut self, window: PairWindow<'_>, steps: usize, setup: &Setup) {
        self.candidates.par_iter_mut().for_each(|candidate| candidate.advance(window, steps, setup));
    }

    /// Advances the one with the fewest steps by a step.
    pub fn advance_one(&mut self, window: PairWindow<'_>, setup: &Setup) {
        if let Some(last) = self.candidates.iter_mut().min_by_key(|candidate| candidate.steps) {
            last.advance(window, 1, setup);
        }
    }

    /// Drops candidates that come to a γ of greater evidence, or are ruled out.
    fn narrow(&mut self, window: PairWindow<'_>, setup: &Setup) {
        let ranked = self.by_evidence(window, setup);
        let Some(most) = ranked.first().map(|(evidence, _)| *evidence) else { return };
        for (evidence, one) in ranked {
            let is_new = |other: &Candidate| {
                other.posterior.has_other_readout(&one.posterior)
                    && one.posterior.log_odds(most - evidence, setup) <= DECISIVE_LOG_ODDS
            };
            if self.candidates.iter().all(is_new) {
                self.candidates.push(one);
            }
        }
    }

    /// The posteriors, that of the greatest evidence first.
    pub fn ranked(
        mut self,
        window: PairWindow<'_>,
        setup: &Setup,
    ) -> impl Iterator<Item = Posterior> + use<> {
        let ranked = self.by_evidence(window, setup).into_iter();
        ranked.filter(|(evidence, _)| evidence.is_finite()).map(|(_, one)| one.posterior)
    }

    /// Takes the candidates with their log evidence, the greatest first; −∞ where there is none.
    fn by_evidence(&mut self, window: PairWindow<'_>, setup: &Setup) -> Vec<(f64, Candidate)> {
        let all = std::mem::take(&mut self.candidates).into_par_iter().map(|mut one| {
            let evidence = one.posterior.log_evidence(window.pairs, setup);
            (evidence.unwrap_or(f64::NEG_INFINITY), one)
        });
        let mut ranked: Vec<(f64, Candidate)> = all.collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        ranked
    }
}

/// Starts within the limits of γ.
fn clamped(setup: &Setup, starts: &[f64]) -> impl Iterator<Item = f64> {
    let [low, high] = setup.camera.limits.gamma;
    starts.iter().map(move |start| start.clamp(low, high))
}
