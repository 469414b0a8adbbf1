//! The pairs of a window → the path, γ and κ: Gauss–Newton on banded normal equations.
//!
//! γ and κ belong to all pairs and border the band: N·δc + b·δ = g with N the path's matrix and b the
//! border. They are solved first, from S′ = S − bᵀN⁻¹b, and the path follows. Several windows see the
//! same pair, so that what a window says of them, without the beliefs that it started from, goes into
//! the running beliefs by the share that is new.

use crate::cpu::CpuLevel;
use crate::solve::continuous::data::matches::ScanAxis;
use crate::solve::continuous::data::pair::Pair;
use crate::solve::continuous::linear::banded::Banded;
use crate::solve::continuous::linear::bands::SHARED;
use crate::solve::continuous::linear::evaluated::{self, EvaluatedPair};
use crate::solve::continuous::linear::residual::View;
use crate::solve::continuous::prior::belief::Running;
use crate::solve::continuous::prior::smoothness::Smoothness;
use crate::solve::continuous::trajectory::homographies::Flow;
use crate::solve::continuous::trajectory::knots::KnotDensity;
use crate::solve::continuous::trajectory::splines::SplinePath;
use nalgebra::{SMatrix, SVector};

/// Blocks before the first exposure and after the last that the path covers: points may leave the
/// frame, and the readout may turn out longer.
const MARGIN: f64 = 0.25;
/// Correlation of residuals beyond the noise with the derivatives by γ and κ, at most.
const ERROR_CORRELATION: f64 = 0.12;
/// Steps from knot to knot, at most, from which the next one of a vibration is told: those of one and a half
/// frame periods, enough for eight sinusoids.
const ORDER: usize = 16;
/// With a readout ratio that is known worse, a path bends to imitate the shutter, and that is nothing to learn from.
const FORESEEN: f64 = 0.03;
/// Share of the variance from which learning starts that the path of a single pair has: with all of it, depth that changes
/// from row to row is taken for a change of speed. From a third to a tenth of it, strong shakes keep more.
const ALONE: f64 = 0.3;
/// The most that γ and κ may change at once.
const MOST_CHANGE: f64 = 0.1;

/// The solver of one stream; the path, what was learnt of its smoothness and of the camera go on from
/// window to window.
#[derive(Clone, Debug)]
pub struct Solver {
    cpu: CpuLevel,
    pub scan_axis: ScanAxis,
    pub density: KnotDensity,
    /// Pixels to the unit of points.
    pub radius: f64,
    /// Least standard deviation of a coordinate in pixels.
    pub noise: f64,
    pub path: SplinePath,
    pub smoothness: Smoothness,
    /// Whether it may learn how the turns go on, not just how much they bend.
    pub foresees: bool,
    /// Beliefs from all windows so far: γ, the signed readout time in frame periods, and κ.
    pub beliefs: [Running; SHARED],
    /// What γ and κ may be.
    pub limits: [[f64; 2]; SHARED],
    /// γ and κ of this window.
    pub shared: [f64; SHARED],
    /// What this window alone says of them, with its information.
    seen: [Option<(f64, f64)>; SHARED],
    pub flow: Flow,
    evaluated: Vec<EvaluatedPair>,
    matrix: Banded,
    covariance: Banded,
    /// First block of the path when it was found.
    covariance_base: i64,
    right: Vec<f64>,
    border: [Vec<f64>; SHARED],
    weighted: [Vec<f64>; SHARED],
}

impl Solver {
    pub fn new(
        scan_axis: ScanAxis,
        density: KnotDensity,
        radius: f64,
        noise: f64,
        smoothness: Smoothness,
        beliefs: [Running; SHARED],
        limits: [[f64; 2]; SHARED],
    ) -> Self {
        Self {
            cpu: CpuLevel::detect(),
            scan_axis,
            density,
            radius,
            noise,
            path: SplinePath::default(),
            smoothness,
            foresees: false,
            shared: beliefs.map(|belief| belief.mean),
            beliefs,
            limits,
            seen: [None; SHARED],
            flow: Flow::default(),
            evaluated: Vec::new(),
            matrix: Banded::default(),
            covariance: Banded::default(),
            covariance_base: 0,
            right: Vec::new(),
            border: Default::default(),
            weighted: Default::default(),
        }
    }

    /// A solver of another knot density that knows of the camera what this one does.
    pub fn with_density(&self, density: KnotDensity) -> Self {
        let smoothness = self.smoothness.started(density.start_variance());
        let mut other = Self::new(
            self.scan_axis,
            density,
            self.radius,
            self.noise,
            smoothness,
            self.beliefs,
            self.limits,
        );
        other.shared = self.shared;
        other
    }

    /// Forgets the path, not the camera.
    pub fn restart(&mut self) {
        self.path.coefficients.clear();
        evaluated::invalidate(&mut self.evaluated);
        self.smoothness.restart();
        self.seen = [None; SHARED];
    }

    /// Takes what another one knows of the camera.
    pub fn learn_camera(&mut self, other: &Self) {
        (self.beliefs, self.limits) = (other.beliefs, other.limits);
    }

    /// Takes γ as known.
    pub fn know_readout(&mut self, belief: Running) {
        self.shared[0] = belief.mean;
        self.limits[0] = [belief.mean; 2];
        self.beliefs[0] = belief;
    }

    /// Takes γ as expected.
    pub fn expect_readout(&mut self, belief: Running) {
        self.shared[0] = belief.mean;
        self.beliefs[0] = belief;
    }

    /// Goes on with frame periods that are shorter by `factor`.
    pub fn scale_readout(&mut self, factor: f64) {
        self.shared[0] *= factor;
        self.beliefs[0].scale(factor);
    }

    /// Forgets the path and goes on with frame periods that are shorter by `factor`.
    pub fn scale_time(&mut self, factor: f64) {
        self.scale_readout(factor);
        let [low, high] = self.limits[0];
        if low == high {
            self.limits[0] = [self.shared[0]; 2];
        }
        self.restart();
        self.flow = Flow::default();
    }

    /// Standard deviation of a coordinate in pixels that the path leaves in pair `index`.
    pub fn sigma(&self, index: usize) -> Option<f64> {
        self.evaluated.get(index).map(|held| held.residuals.sigma)
    }

    /// Share of what the path leaves of pair `index` that is a function of the line alone, 0 to 1.
    pub fn share_by_line(&self, index: usize) -> f64 {
        self.evaluated.get(index).map_or(0.0, |held| held.residuals.share_by_line(self.scan_axis))
    }

    /// Standard deviation of what is new in a coordinate of pair `index`, given the pair before.
    pub fn innovation_deviation(&self, index: usize) -> Option<f64> {
        self.evaluated.get(index).map(|held| held.normal.scatter.noise.sqrt())
    }

    /// How much of displacements of so much (mean square, squared radii) is explained where `sigma` is left
    /// of a coordinate in pixels, 0 to 1.
    pub fn explained(&self, sigma: f64, moved: f64) -> f64 {
        let allowed = (3.0 * self.noise).powi(2) + 0.25 * moved * self.radius * self.radius;
        (1.0 - 2.0 * sigma * sigma / allowed).clamp(0.0, 1.0)
    }

    /// Covariance of the path's coefficients after the last step, inside the band, and the first block of the path then.
    pub fn covariance(&self) -> (&Banded, i64) {
        (&self.covariance, self.covariance_base)
    }

    /// Share of that covariance which is left where matches err independently as far as they err by chance, be there ever so
    /// many of them. Of what the path does not explain few are independent, and the fit takes all for that.
    pub fn chance_share(&self) -> f64 {
        let shares = self.evaluated.iter().map(|EvaluatedPair { normal, residuals, .. }| {
            let chance = (self.noise * self.noise / normal.scatter.noise).min(1.0);
            let counted = normal.independent / (2.0 * residuals.legs.len().max(1) as f64);
            1.0 - chance + chance * counted.min(1.0)
        });
        shares.sum::<f64>() / self.evaluated.len().max(1) as f64
    }

    /// Matches of pair `index` within three deviations of the path, thinned out ones counted.
    pub fn inliers(&self, index: usize) -> usize {
        self.evaluated.get(index).map_or(0, |held| held.residuals.inliers)
    }

    /// Block of the instant at which the line at `place` along the axis of the frame with this timestamp is exposed.
    pub fn time(&self, stamp: f64, place: f64) -> f64 {
        self.density.blocks() * (stamp + self.shared[0] * place)
    }

    /// Lays the path under the pairs and follows it.
    pub fn cover(&mut self, pairs: &[&Pair]) {
        let spans = pairs.iter().map(|pair| pair.span(self.shared[0]));
        let [from, to] =
            spans.fold([f64::INFINITY, f64::NEG_INFINITY], |a, b| [a[0].min(b[0]), a[1].max(b[1])]);
        if from > to {
            return;
        }
        let [from, to] = [from, to].map(|time| time * self.density.blocks());
        let [from, to] = [from - MARGIN, to + MARGIN];
        let base = from.floor() as i64;
        self.path.kappa = self.shared[1];
        self.path.shift(base, (to.floor() as i64 - base + 4) as usize);
        self.flow.follow(&self.path, [from, to], self.radius);
    }

    /// Evaluates the pairs against the path.
    fn compare(&mut self, pairs: &[&Pair]) {
        self.cover(pairs);
        let view = View {
            cpu: self.cpu,
            path: &self.path,
            flow: &self.flow,
            scan_axis: self.scan_axis,
            density: self.density.blocks(),
            readout: self.shared[0],
            radius: self.radius,
            noise: self.noise,
        };
        evaluated::evaluate(&mut self.evaluated, pairs, &view);
    }

    /// One step; whether it could be solved.
    pub fn step(&mut self, pairs: &[&Pair]) -> bool {
        self.compare(pairs);
        let (information, side) = self.assemble();
        if !self.matrix.factorise(self.cpu) {
            return false;
        }
        self.matrix.solve(&mut self.right);
        let change = self.step_shared(information, side);
        for (by, change) in self.weighted.iter().zip(change) {
            self.right.iter_mut().zip(by).for_each(|(step, by)| *step -= by * change);
        }
        if !self.right.iter().all(|step| step.is_finite()) {
            return false;
        }
        self.path.coefficients.iter_mut().zip(&self.right).for_each(|(value, step)| *value += step);
        evaluated::invalidate(&mut self.evaluated);
        self.matrix.inverse_band(self.cpu, &mut self.covariance);
        self.covariance_base = self.path.base;
        // One pair alone does not tell a change of speed from depth that changes from row to row.
        if pairs.len() > 1 {
            self.smoothness.learn(&self.path, &self.covariance, self.order(), self.noise);
        }
        true
    }

    /// How much the last step changed the displacements of pair `index` (root mean square, pixels).
    pub fn moved(&self, index: usize) -> f64 {
        self.evaluated.get(index).map_or(0.0, |held| held.normal.moved(&self.right))
    }

    /// The columns at which the rows of the path's matrix begin.
    fn band(&self) -> Vec<usize> {
        let mut first: Vec<usize> = (0..self.path.coefficients.len()).collect();
        self.smoothness.reach(&self.path, self.order(), &mut first);
        self.evaluated.iter().for_each(|held| held.normal.equations.reach(&mut first));
        first
    }

    /// Share of the path's variances that its prior has. Nothing is learnt of them from a single pair.
    fn known_share(&self) -> f64 {
        if self.evaluated.len() == 1 { ALONE } else { 1.0 }
    }

    /// Adds up the normal equations; those of γ and κ.
    fn assemble(&mut self) -> (SMatrix<f64, SHARED, SHARED>, SVector<f64, SHARED>) {
        self.matrix.reset(self.band());
        for values in self.border.iter_mut().chain([&mut self.right]) {
            values.clear();
            values.resize(self.path.coefficients.len(), 0.0);
        }
        let (mut information, mut side) = (SMatrix::zeros(), SVector::zeros());
        for EvaluatedPair { normal, .. } in &self.evaluated {
            normal.equations.add_to(&mut self.matrix, &mut self.right, &mut self.border);
            information += normal.shared;
            side += normal.shared_right;
        }
        self.smoothness.add(&self.path, self.known_share(), &mut self.matrix, &mut self.right);
        (information, side)
    }

    /// Moves γ and κ by what the window, its path free to follow, and the beliefs say; their changes.
    fn step_shared(
        &mut self,
        mut information: SMatrix<f64, SHARED, SHARED>,
        mut side: SVector<f64, SHARED>,
    ) -> [f64; SHARED] {
        for (weighted, border) in self.weighted.iter_mut().zip(&self.border) {
            weighted.clone_from(border);
            self.matrix.solve(weighted);
        }
        let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        for p in 0..SHARED {
            side[p] -= dot(&self.border[p], &self.right);
            for q in 0..SHARED {
                information[(p, q)] -= dot(&self.border[p], &self.weighted[q]);
            }
        }
        let independent = self.design_effect().recip();
        information *= independent;
        side *= independent;
        let mut all = information;
        let mut all_side = side;
        for (p, belief) in self.beliefs.iter().enumerate() {
            all[(p, p)] += belief.information();
            all_side[p] += belief.information() * (belief.mean - self.shared[p]);
        }
        for p in 0..SHARED {
            // The other one is as uncertain as the belief in it.
            let q = 1 - p;
            let coupling = information[(p, q)] / all[(q, q)];
            let own = information[(p, p)] - information[(p, q)] * coupling;
            let value = self.shared[p] + (side[p] - coupling * all_side[q]) / own;
            self.seen[p] = (own > 0.0 && value.is_finite()).then_some((value, own));
        }
        let step = all.try_inverse().map_or(SVector::zeros(), |inverse| inverse * all_side);
        let before = self.shared;
        for (p, [low, high]) in self.limits.into_iter().enumerate() {
            if step[p].is_finite() {
                self.shared[p] = (before[p] + step[p].clamp(-MOST_CHANGE, MOST_CHANGE)).clamp(low, high);
            }
        }
        [self.shared[0] - before[0], self.shared[1] - before[1]]
    }

    /// Logarithm of the *evidence*, up to a constant: how likely the pairs are to any path as smooth as this one, by
    /// Laplace's method (MacKay, as in [`Smoothness`]): ln p(pairs | path) − ½·cᵀPc + ½·ln|P| − ½·ln|N|, c the path's
    /// coefficients, P the prior's matrix and N all of it. A path that bends to imitate another shutter pays for it.
    /// `None` where that cannot be told.
    pub fn evidence(&mut self, pairs: &[&Pair]) -> Option<f64> {
        self.compare(pairs);
        self.assemble();
        let mut prior = Banded::default();
        let size = self.path.coefficients.len();
        let mut first: Vec<usize> = (0..size).collect();
        self.smoothness.reach(&self.path, 1, &mut first);
        prior.reset(first);
        let mut side = vec![0.0; size];
        self.smoothness.add(&self.path, self.known_share(), &mut prior, &mut side);
        if !(self.matrix.factorise(self.cpu) && prior.factorise(self.cpu)) {
            return None;
        }
        let likelihood: f64 =
            self.evaluated.iter().map(|held| held.normal.log_likelihood(&held.residuals)).sum();
        // The prior's right side is −Pc.
        let energy: f64 = self.path.coefficients.iter().zip(&side).map(|(value, side)| -value * side).sum();
        let log_volume = prior.half_log_determinant() - self.matrix.half_log_determinant();
        Some(likelihood - 0.5 * energy + log_volume).filter(|evidence| evidence.is_finite())
    }

    /// Standard deviation of γ by all that is known.
    pub fn readout_deviation(&self) -> f64 {
        self.beliefs[0].information().sqrt().recip()
    }

    /// Standard deviation of κ.
    pub fn kappa_deviation(&self) -> f64 {
        self.beliefs[1].information().sqrt().recip()
    }

    /// Steps of the turns from which the next one is told, at most.
    fn order(&self) -> usize {
        if self.is_foreseeing() { ORDER } else { 1 }
    }

    /// Whether it is learnt how the turns go on.
    pub fn is_foreseeing(&self) -> bool {
        let [low, high] = self.limits[0];
        self.foresees && (low == high || self.readout_deviation() < FORESEEN)
    }

    /// Standard deviation of γ by this window alone.
    pub fn seen_deviation(&self) -> f64 {
        self.seen[0].map_or(f64::INFINITY, |(_, information)| information.sqrt().recip())
    }

    /// By how much greater than by chance the variances of γ and κ are, the *design effect* (L. Kish, *Survey
    /// Sampling*, 1965): errors of the model are alike from match to match and from pair to pair. With the correlation ρ, an
    /// error of n coordinates, of variance σ² each, adds ρ²·n·σ² to the σ² that chance is worth.
    pub fn design_effect(&self) -> f64 {
        let errors_of_model = |EvaluatedPair { normal, .. }: &EvaluatedPair| {
            normal.independent * (1.0 - self.noise * self.noise / normal.scatter.noise)
        };
        1.0 + ERROR_CORRELATION.powi(2) * self.evaluated.iter().map(errors_of_model).sum::<f64>()
    }

    /// Adds what the window says of γ and κ to the beliefs; `share` of it is new.
    pub fn remember(&mut self, share: f64) {
        for (p, [low, high]) in self.limits.into_iter().enumerate() {
            if let Some((value, information)) = self.seen[p] {
                self.beliefs[p].add(value.clamp(low, high), information, share);
            }
        }
    }
}
