// SPDX-License-Identifier: MIT OR Apache-2.0

//! Trials of the other knot density: of a vibration, or of what a vibration was taken for.

use super::{EM_STEPS, Hypothesis, NOISE_LIMIT, Phase, STARTS};
use crate::robust::median::median;
use crate::solve::continuous::data::PairWindow;
use crate::solve::continuous::fit::{Multistart, STEPS};
use crate::solve::continuous::linear::EvaluatedPair;
use crate::solve::continuous::trajectory::KnotDensity;

/// Prior log odds that a camera vibrates faster than the usual knots follow.
const VIBRATION_LOG_ODDS: f64 = -5.0;
/// Least share of the squared residuals common to the matches of a line, as the median of a window's pairs, for a trial of the
/// vibrating density. In vibrations it is 0.90 to 0.97, where depth varies along the scan axis up to 0.82.
const MIN_LINE_SHARE: f64 = 0.85;

impl Hypothesis {
    /// Ends a trial after as many windows as share no pair with its first; whether it did.
    pub fn ends_trial(&mut self) -> bool {
        let has_ended =
            self.phase == Phase::OnTrial && self.evidence.weight() >= KnotDensity::Vibrating.past() as f64;
        if has_ended {
            self.phase = Phase::Established;
        }
        has_ended
    }

    /// Whether the other knot density may explain the residuals.
    fn wants_other_density(&self, window: PairWindow<'_>) -> bool {
        let Some(pair) = self.posterior.evaluated.get(window.own()) else { return false };
        pair.normal.variances.noise.sqrt() >= NOISE_LIMIT * self.setup.noise
            && self.moves(window)
            && (self.density() == KnotDensity::Vibrating || self.has_residuals_common_to_lines())
    }

    /// Whether most of the squared residuals of the median pair is common to lines: a vibration lasts, so that it is in all pairs.
    fn has_residuals_common_to_lines(&self) -> bool {
        let share = |pair: &EvaluatedPair| pair.residuals.share_by_line(self.setup.scan_axis);
        let mut shares: Vec<f64> = self.posterior.evaluated.iter().map(share).collect();
        median(&mut shares) > MIN_LINE_SHARE
    }

    /// A hypothesis of the other knot density if that may explain the residuals, once it has been fitted.
    pub fn challenger(&mut self, window: PairWindow<'_>, starts: bool) -> Option<Self> {
        // Before γ has been sought, its error may be what the residuals come from.
        if window.pairs.is_empty() || self.is_too_short(window) || self.awaits_search() {
            return None;
        }
        let is_due = self.searches.density.is_none() && self.schedule.density.is_due();
        if is_due && self.wants_other_density(window) {
            self.schedule.density.restart();
            let density = self.density().other();
            let is_unknown = density == KnotDensity::Vibrating && self.is_vague();
            let starts = if is_unknown { self.near_limits(&STARTS) } else { Vec::new() };
            let trial = Multistart::with_density(&self.posterior, &self.setup, density, &starts);
            self.searches.density = Some(trial);
        }
        let trial = self.searches.density.as_mut()?;
        let steps = if starts { STEPS[0] } else { trial.pace(window, false) };
        trial.advance(window, steps, &self.setup);
        let trial = self.searches.density.take_if(|trial| trial.is_done())?;
        let mut posterior = trial.ranked(window, &self.setup).next()?;
        let is_vibrating = posterior.trajectory.density == KnotDensity::Vibrating;
        // A window without pairs ahead constrains the prediction too little.
        posterior.predicts = is_vibrating && window.pairs.len() > window.past;
        let log_odds = if is_vibrating { VIBRATION_LOG_ODDS } else { -VIBRATION_LOG_ODDS };
        let log_prior = self.log_prior + log_odds;
        let mut other = Self::new(self.scan, self.signs, self.setup, posterior, log_prior);
        other.phase = Phase::OnTrial;
        other.schedule.search = self.schedule.search;
        other.schedule.density.restart();
        let steps = match (other.posterior.is_predicting(&other.setup), starts) {
            (true, _) => other.em_steps(starts),
            (false, true) => EM_STEPS[0],
            (false, false) => STEPS[0],
        };
        (other.is_fitted, other.has_converged) = (true, other.iterate(window, steps, false));
        Some(other)
    }
}
