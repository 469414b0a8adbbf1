//! What a pair says of the path, γ and κ: its part of the normal equations.
//!
//! A correspondence says x′ = F(x; t → t′), F the path's flow. A small change of the path changes
//! F by Σⱼ φⱼ(m)·(δξⱼ(t′) − δξⱼ(t)), m = (x + x′)/2, with φⱼ and ξⱼ field and path of generator j; each ξⱼ(t)
//! is a sum of four coefficients. A change of the readout time γ, t = t_k + γ·s, changes F by
//! Σⱼ φⱼ(m)·(ξⱼ′(t′)·s′ − ξⱼ′(t)·s), one of κ by m·(m · (ξ(t′) − ξ(t))), ξ the paths of yaw and pitch. A
//! point at λ times the inverse depth is moved λ times as far by all but the turns. What is new in a
//! residual, rᵢ − B·rⱼ, depends on the path by two *legs*: from frame to frame, and, by −B, between the two
//! before.
//!
//! The splines are evaluated once for a *band* of correspondences exposed at about the same time.
//! That rounds the slopes, never the residuals.

use super::bands::{Band, Slopes, mixed};
use super::equations::Equations;
use super::pair_residuals::PairResiduals;
use super::parallax::{Innovation, Scatter};
use super::residual::{Evaluator, Leg};
use super::shared::SHARED;
use crate::cpu::for_each_cpu;
use crate::motion::generators::{TURNS, fields};
use nalgebra::{Matrix2, SMatrix, SVector};

/// Bands to a pair.
const BANDS: usize = 24;
/// Degrees of freedom of Student's t, as which residuals are distributed.
const FREEDOM: f64 = 4.0;
/// Exponent of their density in two dimensions: −(ν + 2)/2.
const EXPONENT: i32 = -3;
/// However many correspondences a pair has, they are worth no more than so many independent ones of equal weight: what the
/// path does not explain is alike in neighbours.
const INDEPENDENT_MATCHES: f64 = 25.0;

/// What a pair says.
#[derive(Clone, Debug, Default)]
pub struct Normal {
    /// Of the path, and of how γ and κ go with it.
    pub equations: Equations,
    /// Of γ and κ.
    pub shared: SMatrix<f64, SHARED, SHARED>,
    pub shared_right: SVector<f64, SHARED>,
    /// Variances of the residuals.
    pub scatter: Scatter,
    /// Coordinates that are independent.
    pub independent: f64,
    /// Sum of the correspondences' weights.
    weight: f64,
    bands: Vec<Band>,
    squares: Vec<(f64, f64)>,
}

impl Normal {
    /// Root mean square change in pixels of the displacements, as a step of all coefficients makes it.
    pub fn moved(&self, step: &[f64]) -> f64 {
        if self.weight > 0.0 { (self.equations.square(step).max(0.0) / self.weight).sqrt() } else { 0.0 }
    }

    /// Estimates the variances of a pair's residuals, the noise at least this deviation in pixels.
    pub fn estimate_scatter(&mut self, residuals: &PairResiduals, noise: f64) {
        self.scatter = Scatter::of(residuals, noise * noise, &mut self.squares);
    }

    /// Logarithm of the likelihood of what is new in the pair, up to a constant, for as many matches as are
    /// independent.
    pub fn log_likelihood(&self, residuals: &PairResiduals) -> f64 {
        let likely = residuals.legs.iter().zip(&residuals.before).map(|(leg, before)| {
            let new = self.scatter.innovation(leg, before.as_ref());
            let [scene, other] = densities_of(&new, leg, residuals.others);
            (scene + other).ln()
        });
        independent_share(residuals) * likely.filter(|likely| likely.is_finite()).sum::<f64>()
    }
}

/// Densities of a match as one of the scene and as anything else, each times its prior probability, up to a constant.
///
/// The scene's are distributed as Student's t about the path, all others about evenly over as far as points move in the
/// pair, `others` being their variance: with the tails of t alone a path that fits two thirds of the matches well is as likely
/// as one that fits all of them badly.
#[inline(always)]
fn densities(prior: f64, square: f64, inverse_scale: f64, others: f64) -> [f64; 2] {
    let student = (1.0 + square / FREEDOM).powi(EXPONENT) * inverse_scale;
    [prior * student, (1.0 - prior) / others]
}

/// Of what is new in a match.
#[inline(always)]
fn densities_of(new: &Innovation, leg: &Leg, others: f64) -> [f64; 2] {
    let inverse_scale = new.weight.determinant().sqrt() * leg.whitening.determinant();
    densities(leg.prior, new.square(), inverse_scale, others)
}

/// How many independent matches one is worth: of weights w, there are as many as (Σw)²/Σw² equal ones (L. Kish, *Survey
/// Sampling*, 1965).
fn independent_share(residuals: &PairResiduals) -> f64 {
    let weights = residuals.legs.iter().map(|leg| leg.prior * leg.whitening.norm_squared());
    let [sum, squares] = weights.fold([0.0; 2], |[sum, squares], w| [sum + w, squares + w * w]);
    if sum > 0.0 { (INDEPENDENT_MATCHES * squares / (sum * sum)).min(1.0) } else { 0.0 }
}

for_each_cpu! {
    fn add_up(view: &Evaluator<'_>, residuals: &PairResiduals, out: &mut Normal) {
        view.add_up(residuals, out);
    }
}

impl Evaluator<'_> {
    /// Adds up what a pair says, given the one before and the variances of its residuals.
    pub fn normal(&self, residuals: &PairResiduals, out: &mut Normal) {
        add_up(self.cpu, self, residuals, out);
    }

    #[inline(always)]
    fn add_up(&self, residuals: &PairResiduals, out: &mut Normal) {
        let scatter = out.scatter;
        let independent = independent_share(residuals);
        out.independent = 2.0 * INDEPENDENT_MATCHES.min(residuals.legs.len() as f64);
        out.bands.clear();
        out.bands.resize_with(BANDS, Band::default);
        out.shared = SMatrix::zeros();
        out.shared_right = SVector::zeros();
        for (leg, before) in residuals.legs.iter().zip(&residuals.before) {
            let mut new = scatter.innovation(leg, before.as_ref());
            let [scene, other] = densities_of(&new, leg, residuals.others);
            new.weight *= independent * (FREEDOM + 2.0) / (FREEDOM + new.square()) * scene / (scene + other);
            if !new.weight.iter().all(|weight| weight.is_finite()) {
                continue;
            }
            let band = (self.shutter.scan_axis.place(leg.m.from).clamp(0.0, 1.0) * (BANDS - 1) as f64).round()
                as usize;
            let shared = self.add(&new, leg, before.as_ref(), &mut out.bands[band]);
            out.shared += shared.transpose() * new.weight * shared;
            out.shared_right += shared.transpose() * new.weight * new.error;
        }
        out.weight = out.bands.iter().map(|band| band.weight).sum();
        out.equations.fill(&out.bands, &self.trajectory.splines);
    }

    /// Adds what is new in a match to its band; what the shared unknowns change of it.
    #[inline(always)]
    fn add(
        &self,
        new: &Innovation,
        leg: &Leg,
        before: Option<&Leg>,
        band: &mut Band,
    ) -> SMatrix<f64, 2, SHARED> {
        let (own, mut shared) = self.slopes(leg, new.depth);
        let weight = new.weight.trace() / 2.0;
        band.weight += weight;
        band.times[1] += weight * leg.times[0];
        band.times[2] += weight * leg.times[1];
        let before = before.filter(|_| new.share != Matrix2::zeros()).map(|leg| {
            let (before, of_shared) = self.slopes(leg, new.depth);
            shared -= new.share * of_shared;
            band.linked += weight;
            band.times[0] += weight * leg.times[0];
            mixed(&-new.share, &before)
        });
        band.add(&new.weight, &own, before.as_ref(), new.error, &shared);
        shared
    }

    /// What the paths of the generators and the shared unknowns change of a displacement, of a point of relative
    /// inverse depth `depth`.
    #[inline(always)]
    fn slopes(&self, leg: &Leg, depth: f64) -> (Slopes, SMatrix<f64, 2, SHARED>) {
        let phi = fields((leg.m.from + leg.m.to) / 2.0, self.trajectory.splines.kappa);
        let by_readout = leg.by_readout[0] + leg.by_readout[1] * depth;
        let depth = |j: usize| if j < TURNS { 1.0 } else { depth };
        let slopes = [0, 1].map(|end| std::array::from_fn(|j| phi[(end, j)] * depth(j)));
        (mixed(&leg.whitening, &slopes), SMatrix::from_columns(&[by_readout, leg.by_kappa]))
    }
}

#[cfg(test)]
#[path = "normal_tests.rs"]
mod tests;
