// SPDX-License-Identifier: MIT OR Apache-2.0

//! The posterior of a window: path, γ and κ, with their covariance and evidence.

use super::setup::Setup;
use crate::solve::continuous::data::{FramePair, INDEPENDENT_MATCHES};
use crate::solve::continuous::linear::{
    Banded, EvaluatedPair, Evaluator, Shared, SharedEquations, System, evaluated,
};
use crate::solve::continuous::prior::{Observation, Smoothness};
use crate::solve::continuous::trajectory::{KnotDensity, Trajectory};
use crate::solve::pairs::explained_share;

/// Correlation of residuals beyond the noise with the derivatives by γ and κ, at most.
const ERROR_CORRELATION: f64 = 0.12;
/// Greatest order of the prediction of a vibration: one and a half frame periods, or eight sinusoids.
const MAX_ORDER: usize = 16;
/// Standard deviation of γ above which no prediction is learnt: with a wrong γ the path imitates the shutter.
const MAX_PREDICTION_DEVIATION: f64 = 0.03;
/// Share of the initial variances for the path of a single pair: with all of them, depth that varies along
/// the rows is fitted as acceleration. Between a third and a tenth, strong shakes keep more.
const SINGLE_PAIR_SHARE: f64 = 0.3;

/// Standard deviation of γ above which it counts as unknown. Two values nearer than this count as the same.
pub const MAX_READOUT_DEVIATION: f64 = 0.2;

/// The result of a fit, and the start of the next one.
#[derive(Clone, Debug, Default)]
pub struct Posterior {
    pub trajectory: Trajectory,
    pub smoothness: Smoothness,
    /// γ and κ of this window.
    pub shared: Shared<f64>,
    /// Whether the prediction of a vibration may be learnt, not only its variance.
    pub predicts: bool,
    /// Estimates of γ and κ by this window alone.
    pub observed: Shared<Option<Observation>>,
    /// The pairs of the window as last evaluated.
    pub evaluated: Vec<EvaluatedPair>,
    pub covariance: Covariance,
    pub system: System,
    /// Log evidence of the window, once computed.
    pub evidence: Option<f64>,
}

/// Covariance of the path's coefficients inside the band.
#[derive(Clone, Debug, Default)]
pub struct Covariance {
    pub matrix: Banded,
    /// First block of the path when this was computed.
    pub base: i64,
}

impl Posterior {
    /// Before any fit.
    pub fn new(trajectory: Trajectory, smoothness: Smoothness, shared: Shared<f64>) -> Self {
        Self { trajectory, smoothness, shared, ..Self::default() }
    }

    /// Before any fit at another knot density, with the same γ and κ.
    pub fn with_density(&self, density: KnotDensity) -> Self {
        let smoothness = self.smoothness.restarted(density.start_variance());
        Self::new(Trajectory::new(density, self.trajectory.radius), smoothness, self.shared)
    }

    /// Resets the path, not γ and κ.
    pub fn restart(&mut self) {
        self.trajectory.splines.coefficients.clear();
        self.evaluated.clear();
        self.smoothness.restart();
        self.observed = Shared::default();
        self.evidence = None;
    }

    /// Whether its γ is not the same.
    pub fn has_other_readout(&self, other: &Self) -> bool {
        (self.shared.gamma - other.shared.gamma).abs() > MAX_READOUT_DEVIATION
    }

    /// Block at which a place along the scan axis is exposed in the frame with this timestamp.
    pub fn block(&self, stamp: f64, place: f64) -> f64 {
        self.trajectory.exposure(stamp, self.shared.gamma, place)
    }

    /// Moves the path to the exposures of these pairs.
    pub fn cover(&mut self, pairs: &[&FramePair]) {
        let spans = pairs.iter().map(|pair| pair.span(self.shared.gamma));
        let span = spans.fold([f64::INFINITY, f64::NEG_INFINITY], |a, b| [a[0].min(b[0]), a[1].max(b[1])]);
        self.trajectory.cover(span, self.shared.kappa);
    }

    /// Evaluates the pairs against the path.
    pub fn evaluate(&mut self, pairs: &[&FramePair], setup: &Setup) {
        self.cover(pairs);
        let Setup { cpu, scan_axis, noise, .. } = *setup;
        let gamma = self.shared.gamma;
        let evaluator = Evaluator { cpu, trajectory: &self.trajectory, scan_axis, gamma, noise };
        evaluated::evaluate(&mut self.evaluated, pairs, &evaluator);
    }

    /// Sums the normal equations of the pairs and of the prior; returns those of γ and κ.
    pub fn assemble(&mut self, setup: &Setup) -> SharedEquations {
        let splines = &self.trajectory.splines;
        let mut first = self.smoothness.first_columns(splines, self.order(setup));
        self.evaluated.iter().for_each(|pair| pair.normal.equations.reach(&mut first));
        self.trajectory.reach(self.shared.gamma, &mut first);
        let shared = self.system.assemble(first, self.evaluated.iter());
        let System { matrix, right, .. } = &mut self.system;
        self.smoothness.add(splines, variance_share(&self.evaluated), matrix, right);
        shared
    }

    /// Moves the path by the solved step, and computes the covariance.
    pub fn apply_step(&mut self, setup: &Setup) {
        let splines = &mut self.trajectory.splines;
        splines.coefficients.iter_mut().zip(&self.system.right).for_each(|(value, step)| *value += step);
        self.system.matrix.inverse_band(setup.cpu, &mut self.covariance.matrix);
        self.covariance.base = splines.base;
    }

    /// Updates the prior from the path and its covariance.
    pub fn learn_smoothness(&mut self, setup: &Setup) {
        let order = self.order(setup);
        self.smoothness.learn(&self.trajectory.splines, &self.covariance.matrix, order, setup.noise);
    }

    /// Log evidence up to a constant, by Laplace's method (MacKay, as in [`Smoothness`]): with the path
    /// marginalised, ln p(pairs | path) − ½·cᵀPc + ½·ln|P| − ½·ln|N|, c being the path's coefficients, P the
    /// matrix of the prior and N that of all. A path that bends to imitate another shutter has less. `None`
    /// if a matrix is not positive definite. Computed once after a fit.
    pub fn log_evidence(&mut self, pairs: &[&FramePair], setup: &Setup) -> Option<f64> {
        self.evidence = self.evidence.or_else(|| self.compute_evidence(pairs, setup));
        self.evidence
    }

    fn compute_evidence(&mut self, pairs: &[&FramePair], setup: &Setup) -> Option<f64> {
        self.evaluate(pairs, setup);
        self.assemble(setup);
        let splines = &self.trajectory.splines;
        let mut prior = Banded::default();
        prior.reset(self.smoothness.first_columns(splines, 1));
        let mut right = vec![0.0; prior.size()];
        self.smoothness.add(splines, variance_share(&self.evaluated), &mut prior, &mut right);
        let matrix = &mut self.system.matrix;
        if !(matrix.factorise(setup.cpu) && prior.factorise(setup.cpu)) {
            return None;
        }
        let likelihoods = self.evaluated.iter_mut().map(EvaluatedPair::log_likelihood);
        let likelihood: f64 = likelihoods.sum();
        // The prior's right side is −Pc.
        let energy: f64 = splines.coefficients.iter().zip(&right).map(|(value, side)| -value * side).sum();
        let log_volume = prior.half_log_determinant() - matrix.half_log_determinant();
        Some(likelihood - 0.5 * energy + log_volume).filter(|evidence| evidence.is_finite())
    }

    /// Standard deviation in pixels of a coordinate's residual in pair `index`.
    pub fn sigma(&self, index: usize) -> Option<f64> {
        self.evaluated.get(index).map(|pair| pair.residuals.sigma)
    }

    /// Standard deviation in pixels of a coordinate's innovation in pair `index`.
    pub fn innovation_deviation(&self, index: usize) -> Option<f64> {
        self.evaluated.get(index).map(|pair| pair.normal.variances.noise.sqrt())
    }

    /// Root mean square change of the displacements of pair `index` by the last step, in standard deviations.
    pub fn moved(&self, index: usize, setup: &Setup) -> f64 {
        self.evaluated.get(index).map_or(0.0, |pair| pair.normal.moved(setup.cpu, &self.system.right))
    }

    /// Share explained of displacements whose mean square is `moved` squared radii, 0 to 1, if a coordinate's
    /// residual has the standard deviation `sigma` in pixels.
    pub fn explained(&self, sigma: f64, moved: f64, setup: &Setup) -> f64 {
        let radius = self.trajectory.radius;
        explained_share(2.0 * sigma * sigma, moved * radius * radius, setup.noise)
    }

    /// Factor on the covariance where errors of measurement are independent. The fit counts all errors as
    /// correlated, as those of the model are.
    pub fn noise_share(&self, setup: &Setup) -> f64 {
        let shares = self.evaluated.iter().map(|EvaluatedPair { normal, residuals, .. }| {
            let noise = (setup.noise * setup.noise / normal.variances.noise).min(1.0);
            let counted = normal.independent / (2.0 * residuals.matches.len().max(1) as f64);
            1.0 - noise + noise * counted.min(1.0)
        });
        shares.sum::<f64>() / self.evaluated.len().max(1) as f64
    }

    /// The *design effect* (L. Kish, *Survey Sampling*, 1965), by which errors of the model, correlated
    /// between matches and pairs, increase the variances of γ and κ. With the correlation ρ, n such errors of
    /// variance σ² add ρ²·n·σ² to the variance σ² of independent ones.
    pub fn design_effect(&self, setup: &Setup) -> f64 {
        let model_errors = |EvaluatedPair { normal, .. }: &EvaluatedPair| {
            normal.independent * (1.0 - setup.noise * setup.noise / normal.variances.noise)
        };
        1.0 + ERROR_CORRELATION.powi(2) * self.evaluated.iter().map(model_errors).sum::<f64>()
    }

    /// Log odds by a difference of log evidence in this window: ½·z², the variance of the difference being that of
    /// noise, 1 nat² for each independent match, and as much again for each multiple of it that errors of the model may add.
    pub fn log_odds(&self, difference: f64, setup: &Setup) -> f64 {
        let variance = INDEPENDENT_MATCHES * self.evaluated.len() as f64 * self.design_effect(setup);
        0.5 * difference * difference.abs() / variance
    }

    /// Whether the prediction of a vibration is learnt.
    pub fn is_predicting(&self, setup: &Setup) -> bool {
        let camera = &setup.camera;
        self.predicts && (camera.is_gamma_given() || camera.gamma_deviation() < MAX_PREDICTION_DEVIATION)
    }

    /// Order of the prediction of the turns, at most.
    fn order(&self, setup: &Setup) -> usize {
        if self.is_predicting(setup) { MAX_ORDER } else { 1 }
    }
}

/// Share of the prior's variances that is used: those of a single pair are not learnt.
fn variance_share(evaluated: &[EvaluatedPair]) -> f64 {
    if evaluated.len() == 1 { SINGLE_PAIR_SHARE } else { 1.0 }
}
