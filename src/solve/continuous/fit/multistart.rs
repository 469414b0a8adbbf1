//! Fits from several starts side by side, as one of them may end in the wrong place.
//!
//! A start costs as many steps as a window has iterations, and there are several of them. They go on with each frame that comes,
//! so that no frame takes much longer than another: what was fitted to a few pairs is near the path of one more.

use super::gauss_newton::fit;
use super::posterior::Posterior;
use super::setup::Setup;
use crate::parallel::*;
use crate::solve::continuous::data::PairWindow;
use crate::solve::continuous::trajectory::KnotDensity;

/// Steps to the first path, and to each one after it, at most. As many as to the first where γ has not come to rest: while it is
/// far off, the splines bend to imitate the shutter, and become straight again only as it comes nearer. Not all at once, for a
/// live stream does not wait.
pub const STEPS: [usize; 2] = [12, 4];
/// Pairs times steps that are taken a frame: when the first frame is due, as many as the current path takes, four steps over
/// eight pairs; later, when that one takes no first steps, half as many more.
const WORK: [usize; 2] = [32, 48];
/// Pairs that show which of the starts to continue before all have come.
const SHOWN_PAIRS: usize = 8;
/// A readout ratio, a knot density or a smoothness is preferred to another where its evidence is greater by a factor of e to this
/// power.
pub const DECISIVE_LOG_BAYES_FACTOR: f64 = 5.0;
/// Standard deviation of γ above which it may be anything; two values that differ by less are the same answer.
pub const MAX_READOUT_DEVIATION: f64 = 0.2;

/// A start and what has become of it.
#[derive(Clone, Debug)]
struct Candidate {
    posterior: Posterior,
    /// The readout ratio that it started from.
    start: f64,
    /// Steps so far on windows that are long enough to count.
    steps: usize,
}

/// Paths that are fitted from several starts.
#[derive(Clone, Debug)]
pub struct Multistart {
    candidates: Vec<Candidate>,
    is_narrowed: bool,
}

impl Multistart {
    /// For the knot density and smoothness of a posterior, from several readout ratios.
    pub fn new(posterior: &Posterior, setup: &Setup, starts: &[f64]) -> Self {
        let mut fresh = posterior.clone();
        fresh.restart();
        Self::of(&fresh, clamped(setup, starts))
    }

    /// For another knot density, from these readout ratios and from that of the posterior.
    pub fn with_density(posterior: &Posterior, setup: &Setup, density: KnotDensity, starts: &[f64]) -> Self {
        let starts = clamped(setup, starts).chain([posterior.shared.gamma]);
        Self::of(&posterior.with_density(density), starts)
    }

    /// For a posterior without a path, from these readout ratios.
    fn of(fresh: &Posterior, starts: impl Iterator<Item = f64>) -> Self {
        let candidate = |start| {
            let mut posterior = fresh.clone();
            posterior.shared.gamma = start;
            Candidate { posterior, start, steps: 0 }
        };
        Self { candidates: starts.map(candidate).collect(), is_narrowed: false }
    }

    /// Steps of the candidate that has taken fewest.
    fn steps(&self) -> usize {
        self.candidates.iter().map(|candidate| candidate.steps).min().unwrap_or(0)
    }

    /// Whether all have taken enough steps to be compared.
    pub fn is_done(&self) -> bool {
        self.steps() >= STEPS[0]
    }

    /// Steps that the chosen one has yet to take, some at least.
    pub fn steps_left(&self) -> usize {
        STEPS[0].saturating_sub(self.steps()).max(STEPS[1])
    }

    /// Steps with a frame that takes about as long as any other one.
    pub fn pace(&self, window: PairWindow<'_>, starts: bool) -> usize {
        let pairs = window.pairs.len() * self.candidates.len();
        (WORK[usize::from(!starts)] / pairs.max(1)).clamp(1, STEPS[0])
    }

    /// Takes so many more steps with each, on a window that grows.
    pub fn prepare(&mut self, window: PairWindow<'_>, steps: usize, setup: &Setup) {
        self.advance(window, steps, setup);
        if window.is_short() {
            // A pair or two do not tell which generators are needed.
            self.candidates.iter_mut().for_each(|one| one.posterior.smoothness.restart());
        }
        if window.pairs.len() >= SHOWN_PAIRS && !self.is_narrowed {
            self.is_narrowed = true;
            self.narrow(window, setup);
        }
    }

    /// Takes so many more steps with each.
    pub fn advance(&mut self, window: PairWindow<'_>, steps: usize, setup: &Setup) {
        let is_short = window.is_short();
        self.candidates.par_iter_mut().for_each(|candidate| {
            let mut setup = *setup;
            if is_short {
                setup.camera.limits.gamma = [candidate.start; 2];
            }
            let start = std::mem::take(&mut candidate.posterior);
            (candidate.posterior, _) = fit(window, start, &setup, steps);
            candidate.steps += if is_short { 0 } else { steps };
        });
    }

    /// Keeps only the likeliest, and those that have found another γ and are nearly as likely.
    fn narrow(&mut self, window: PairWindow<'_>, setup: &Setup) {
        let evidence = |candidate: &mut Candidate| {
            let evidence = candidate.posterior.log_evidence(window.pairs, setup);
            (evidence.unwrap_or(f64::NEG_INFINITY), candidate.posterior.shared.gamma)
        };
        let seen: Vec<(f64, f64)> = self.candidates.par_iter_mut().map(evidence).collect();
        let Some(best) = (0..seen.len()).max_by(|a, b| seen[*a].0.total_cmp(&seen[*b].0)) else { return };
        let (most, gamma) = seen[best];
        let is_rival = |(evidence, other): (f64, f64)| {
            most - evidence <= DECISIVE_LOG_BAYES_FACTOR && (other - gamma).abs() > MAX_READOUT_DEVIATION
        };
        let candidates = std::mem::take(&mut self.candidates).into_iter().zip(seen).enumerate();
        let kept = candidates.filter(|(index, (_, seen))| *index == best || is_rival(*seen));
        self.candidates = kept.map(|(_, (candidate, _))| candidate).collect();
    }

    /// The posteriors with the logarithm of their evidence, the likeliest first.
    pub fn ranked(self, window: PairWindow<'_>, setup: &Setup) -> Vec<(f64, Posterior)> {
        let ranked = self.candidates.into_par_iter().filter_map(|Candidate { mut posterior, .. }| {
            let evidence = posterior.log_evidence(window.pairs, setup)?;
            Some((evidence, posterior))
        });
        let mut ranked: Vec<(f64, Posterior)> = ranked.collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        ranked
    }
}

/// Readout ratios within what the camera may have.
fn clamped(setup: &Setup, starts: &[f64]) -> impl Iterator<Item = f64> {
    let [low, high] = setup.camera.limits.gamma;
    starts.iter().map(move |start| start.clamp(low, high))
}
