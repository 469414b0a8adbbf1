//! The posterior of a window: path, γ and κ, their covariance, and how the pairs fit them.

use super::setup::Setup;
use crate::solve::continuous::data::{FramePair, Shutter};
use crate::solve::continuous::linear::{
    Banded, EvaluatedPair, Evaluator, Shared, SharedEquations, System, evaluated,
};
use crate::solve::continuous::prior::{Observation, Smoothness};
use crate::solve::continuous::trajectory::{KnotDensity, Trajectory};

/// Correlation of residuals beyond the noise with the derivatives by γ and κ, at most.
const ERROR_CORRELATION: f64 = 0.12;
/// Steps from knot to knot, at most, from which the next one of a vibration is predicted: those of one and a half frame
/// periods, enough for eight sinusoids.
const ORDER: usize = 16;
/// With a readout ratio that is known worse, a path bends to imitate the shutter, and that is nothing to learn from.
const PREDICTED: f64 = 0.03;
/// Share of the variance from which learning starts that the path of a single pair has: with all of it, depth that changes
/// from row to row is taken for a change of speed. From a third to a tenth of it, strong shakes keep more.
const ALONE: f64 = 0.3;

/// What a fit has found, and what the next one starts from.
#[derive(Clone, Debug, Default)]
pub struct Posterior {
    pub trajectory: Trajectory,
    pub smoothness: Smoothness,
    /// γ and κ of this window.
    pub shared: Shared<f64>,
    /// Whether it may be learnt how a vibration goes on, not just how much the path bends.
    pub predicts: bool,
    /// What this window alone constrains γ and κ to.
    pub observed: Shared<Option<Observation>>,
    /// The pairs of the window as they were last evaluated.
    pub evaluated: Vec<EvaluatedPair>,
    pub covariance: Covariance,
    pub system: System,
}

/// Covariance of the path's coefficients inside the band.
#[derive(Clone, Debug, Default)]
pub struct Covariance {
    pub matrix: Banded,
    /// First block of the path at that time.
    pub base: i64,
}

impl Posterior {
    /// Before anything was fitted.
    pub fn new(trajectory: Trajectory, smoothness: Smoothness, shared: Shared<f64>) -> Self {
        Self { trajectory, smoothness, shared, ..Self::default() }
    }

    /// Of another knot density, with what this one has found of the camera.
    pub fn with_density(&self, density: KnotDensity) -> Self {
        let smoothness = self.smoothness.restarted(density.start_variance());
        Self::new(Trajectory::new(density, self.trajectory.radius), smoothness, self.shared)
    }

    /// Forgets the path, not the camera.
    pub fn restart(&mut self) {
        self.trajectory.splines.coefficients.clear();
        evaluated::invalidate(&mut self.evaluated);
        self.smoothness.restart();
        self.observed = Shared::default();
    }

    /// Forgets the path and continues with frame periods that are shorter by `factor`.
    pub fn scale_time(&mut self, factor: f64) {
        self.shared.gamma *= factor;
        self.restart();
        self.trajectory.homographies = Default::default();
    }

    /// Block of the instant at which the line at `place` along the scan axis of the frame with this timestamp is exposed.
    pub fn block(&self, stamp: f64, place: f64) -> f64 {
        self.trajectory.block(stamp + self.shared.gamma * place)
    }

    /// Extends the path to the exposures of these pairs.
    pub fn cover(&mut self, pairs: &[&FramePair]) {
        let spans = pairs.iter().map(|pair| pair.span(self.shared.gamma));
        let span = spans.fold([f64::INFINITY, f64::NEG_INFINITY], |a, b| [a[0].min(b[0]), a[1].max(b[1])]);
        self.trajectory.cover(span, self.shared.kappa);
    }

    /// Evaluates the pairs against the path.
    pub fn evaluate(&mut self, pairs: &[&FramePair], setup: &Setup) {
        self.cover(pairs);
        let shutter = Shutter { scan_axis: setup.scan_axis, gamma: self.shared.gamma };
        let evaluator =
            Evaluator { cpu: setup.cpu, trajectory: &self.trajectory, shutter, noise: setup.noise };
        evaluated::evaluate(&mut self.evaluated, pairs, &evaluator);
    }

    /// Adds up the normal equations of the pairs and of the prior of the path; those of γ and κ.
    pub fn assemble(&mut self, setup: &Setup) -> SharedEquations {
        let splines = &self.trajectory.splines;
        let mut first: Vec<usize> = (0..splines.coefficients.len()).collect();
        self.smoothness.reach(splines, self.order(setup), &mut first);
        self.evaluated.iter().for_each(|pair| pair.normal.equations.reach(&mut first));
        let shared = self.system.assemble(first, self.evaluated.iter().map(|pair| &pair.normal));
        let System { matrix, right, .. } = &mut self.system;
        self.smoothness.add(splines, known_share(&self.evaluated), matrix, right);
        shared
    }

    /// Moves the path by the step of the system that was solved, and finds the covariance.
    pub fn apply_step(&mut self, setup: &Setup) {
        let splines = &mut self.trajectory.splines;
        splines.coefficients.iter_mut().zip(&self.system.right).for_each(|(value, step)| *value += step);
        evaluated::invalidate(&mut self.evaluated);
        self.system.matrix.inverse_band(setup.cpu, &mut self.covariance.matrix);
        self.covariance.base = splines.base;
    }

    /// Estimates the variances of the prior from the path and its covariance.
    pub fn learn_smoothness(&mut self, setup: &Setup) {
        let order = self.order(setup);
        let splines = &self.trajectory.splines;
        self.smoothness.learn(splines, &self.covariance.matrix, order, setup.noise);
    }

    /// Logarithm of the *evidence*, up to a constant: how likely the pairs are to any path as smooth as this one, by
    /// Laplace's method (MacKay, as in [`Smoothness`]): ln p(pairs | path) − ½·cᵀPc + ½·ln|P| − ½·ln|N|, c being the path's
    /// coefficients, P the matrix of the prior and N all of it. A path that bends to imitate another shutter pays for it.
    /// `None` where it cannot be computed.
    pub fn log_evidence(&mut self, pairs: &[&FramePair], setup: &Setup) -> Option<f64> {
        self.evaluate(pairs, setup);
        self.assemble(setup);
        let splines = &self.trajectory.splines;
        let mut prior = Banded::default();
        let size = splines.coefficients.len();
        let mut first: Vec<usize> = (0..size).collect();
        self.smoothness.reach(splines, 1, &mut first);
        prior.reset(first);
        let mut right = vec![0.0; size];
        self.smoothness.add(splines, known_share(&self.evaluated), &mut prior, &mut right);
        let matrix = &mut self.system.matrix;
        if !(matrix.factorise(setup.cpu) && prior.factorise(setup.cpu)) {
            return None;
        }
        let likelihood: f64 =
            self.evaluated.iter().map(|pair| pair.normal.log_likelihood(&pair.residuals)).sum();
        // The prior's right side is −Pc.
        let energy: f64 = splines.coefficients.iter().zip(&right).map(|(value, side)| -value * side).sum();
        let log_volume = prior.half_log_determinant() - matrix.half_log_determinant();
        Some(likelihood - 0.5 * energy + log_volume).filter(|evidence| evidence.is_finite())
    }

    /// Standard deviation in pixels of a coordinate's residual in pair `index`.
    pub fn sigma(&self, index: usize) -> Option<f64> {
        self.evaluated.get(index).map(|pair| pair.residuals.sigma)
    }

    /// Standard deviation of a coordinate's innovation in pair `index`, given the pair before.
    pub fn innovation_deviation(&self, index: usize) -> Option<f64> {
        self.evaluated.get(index).map(|pair| pair.normal.variances.noise.sqrt())
    }

    /// Share of the residuals of pair `index` that is a function of the line alone, 0 to 1.
    pub fn share_by_line(&self, index: usize, setup: &Setup) -> f64 {
        self.evaluated.get(index).map_or(0.0, |pair| pair.residuals.share_by_line(setup.scan_axis))
    }

    /// Matches of pair `index` within three deviations of the path, including those thinned out.
    pub fn inliers(&self, index: usize) -> usize {
        self.evaluated.get(index).map_or(0, |pair| pair.residuals.inliers)
    }

    /// Root mean square change in pixels that the last step made to the displacements of pair `index`.
    pub fn moved(&self, index: usize) -> f64 {
        self.evaluated.get(index).map_or(0.0, |pair| pair.normal.moved(&self.system.right))
    }

    /// Share of displacements of this size (mean square, squared radii) that is explained where `sigma` is left of a
    /// coordinate in pixels, 0 to 1.
    pub fn explained(&self, sigma: f64, moved: f64, setup: &Setup) -> f64 {
        let radius = self.trajectory.radius;
        let allowed = (3.0 * setup.noise).powi(2) + 0.25 * moved * radius * radius;
        (1.0 - 2.0 * sigma * sigma / allowed).clamp(0.0, 1.0)
    }

    /// Share of the covariance that remains where errors of matches are independent as far as they are noise of measurement.
    /// Of what the path does not explain few are independent, and the fit takes all for that.
    pub fn noise_share(&self, setup: &Setup) -> f64 {
        let shares = self.evaluated.iter().map(|EvaluatedPair { normal, residuals, .. }| {
            let noise = (setup.noise * setup.noise / normal.variances.noise).min(1.0);
            let counted = normal.independent / (2.0 * residuals.matches.len().max(1) as f64);
            1.0 - noise + noise * counted.min(1.0)
        });
        shares.sum::<f64>() / self.evaluated.len().max(1) as f64
    }

    /// By how much greater than by chance the variances of γ and κ are, the *design effect* (L. Kish, *Survey
    /// Sampling*, 1965): errors of the model are alike from match to match and from pair to pair. With the correlation ρ, an
    /// error of n coordinates, of variance σ² each, adds ρ²·n·σ² to the σ² of chance.
    pub fn design_effect(&self, setup: &Setup) -> f64 {
        let errors_of_model = |EvaluatedPair { normal, .. }: &EvaluatedPair| {
            normal.independent * (1.0 - setup.noise * setup.noise / normal.variances.noise)
        };
        1.0 + ERROR_CORRELATION.powi(2) * self.evaluated.iter().map(errors_of_model).sum::<f64>()
    }

    /// Standard deviation of γ by this window alone.
    pub fn observed_deviation(&self) -> f64 {
        self.observed.gamma.map_or(f64::INFINITY, |observed| observed.information.sqrt().recip())
    }

    /// Whether it is learnt how a vibration goes on.
    pub fn is_predicting(&self, setup: &Setup) -> bool {
        self.predicts && (setup.camera.is_gamma_given() || setup.camera.gamma_deviation() < PREDICTED)
    }

    /// Steps of the turns from which the next one is predicted, at most.
    pub fn order(&self, setup: &Setup) -> usize {
        if self.is_predicting(setup) { ORDER } else { 1 }
    }
}

/// Share of the path's variances that its prior has. Nothing is learnt of them from a single pair.
fn known_share(evaluated: &[EvaluatedPair]) -> f64 {
    if evaluated.len() == 1 { ALONE } else { 1.0 }
}
