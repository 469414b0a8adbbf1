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
use crate::robust::loss::{EffectiveNumber, Loss, Mixture};
use nalgebra::{Matrix2, SMatrix, SVector};

/// Bands to a pair.
const BANDS: usize = 24;
/// Degrees of freedom of Student's t, as which residuals are distributed.
const FREEDOM: i32 = 4;
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
            loss_of(&new, leg, residuals.others).log_likelihood(new.square())
        });
        independent_share(residuals) * likely.filter(|likely| likely.is_finite()).sum::<f64>()
    }
}

/// The loss of a match's innovation: matches of the scene are distributed as Student's t about the path, all others about evenly
/// over as far as points move in the pair, whose variance is `others` in px².
#[inline(always)]
fn loss_of(new: &Innovation, leg: &Leg, others: f64) -> Mixture<FREEDOM> {
    let inverse_scale = new.weight.determinant().sqrt() * leg.whitening.determinant();
    Mixture::new(leg.prior, inverse_scale, others)
}

/// The factor on each weight by which a pair counts as at most [`INDEPENDENT_MATCHES`].
fn independent_share(residuals: &PairResiduals) -> f64 {
    let weights = residuals.legs.iter().map(|leg| leg.prior * leg.whitening.norm_squared());
    weights.collect::<EffectiveNumber>().independent_share(INDEPENDENT_MATCHES)
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
            new.weight *= loss_of(&new, leg, residuals.others).weight_times(independent, new.square());
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
