// SPDX-License-Identifier: MIT OR Apache-2.0

//! The normal equations of a pair.
//!
//! A match is an equation x′ = F(x; t → t′), F the motion along the path. With generator j's field φⱼ and
//! path ξⱼ, and m = (x + x′)/2, the derivatives of F are
//!
//! - by the path: Σⱼ φⱼ(m)·(δξⱼ(t′) − δξⱼ(t)), each ξⱼ(t) a sum of four coefficients;
//! - by γ, as t = t_k + γ·p: Σⱼ φⱼ(m)·(ξⱼ′(t′)·p′ − ξⱼ′(t)·p);
//! - by κ: m·(m · (ξ(t′) − ξ(t))), ξ the paths of yaw and pitch.
//!
//! All but the turns count λ times for a point of λ times the inverse depth. An innovation rᵢ − B·rⱼ depends
//! on the path over its own pair and, by −B, over the pair before.
//!
//! The splines are evaluated once for a *band* of matches exposed at about the same time. That rounds the
//! Jacobians, not the residuals.

use super::bands::{Band, Jacobian, Unit, product, root};
use super::equations::{Equations, Spreading};
use super::pair_residuals::PairResiduals;
use super::parallax::{Innovation, ResidualVariances, VarianceBuffers};
use super::residual::{Evaluator, MatchResidual};
use super::shared::SHARED;
use crate::cpu::CpuLevel;
use crate::lanes::dispatch::with_cpu;
use crate::lanes::{Cpu, DoubleCpu};
use crate::motion::generators::{TURNS, field_rows};
use crate::robust::loss::{Density, EffectiveNumber, Loss, Mixture};
use crate::solve::continuous::data::INDEPENDENT_MATCHES;
use nalgebra::{Matrix2, SMatrix, SVector};
use std::cell::RefCell;

/// Bands to a pair.
const BANDS: usize = 24;
/// Degrees of freedom of Student's t, the distribution of innovations.
const FREEDOM: i32 = 4;

/// The normal equations of a pair.
#[derive(Clone, Debug, Default)]
pub struct Normal {
    /// Of the path, with the columns of γ and κ.
    pub equations: Equations,
    /// Of γ and κ.
    pub shared: SMatrix<f64, SHARED, SHARED>,
    pub shared_right: SVector<f64, SHARED>,
    pub variances: ResidualVariances,
    /// Number of independent coordinates.
    pub independent: f64,
    /// Sum of the weights of the matches.
    weight: f64,
}

/// What is needed only until the equations are added up, or the variances known.
#[derive(Debug, Default)]
struct Buffers {
    bands: Vec<Band>,
    /// Band and index of each match, sorted; the innovations of one band.
    order: Vec<(u8, usize)>,
    units: Vec<Unit>,
    spreading: Spreading,
    variances: VarianceBuffers,
}

thread_local! {
    static BUFFERS: RefCell<Buffers> = RefCell::default();
}

impl Normal {
    /// Root mean square change of the displacements by a step of all coefficients, in standard deviations.
    pub fn moved(&self, cpu: CpuLevel, step: &[f64]) -> f64 {
        let step: Vec<f64> = self.equations.places.iter().map(|place| step[*place]).collect();
        let mut product = Vec::new();
        self.equations.product(cpu, &step, &mut product);
        self.deviations(step.iter().zip(product).map(|(a, b)| a * b).sum())
    }

    /// Root mean square of changes of the displacements whose weighted sum of squares is `sum`, in standard
    /// deviations of a coordinate.
    pub fn deviations(&self, sum: f64) -> f64 {
        if self.weight > 0.0 { (sum.max(0.0) / (self.weight * self.variances.noise)).sqrt() } else { 0.0 }
    }

    /// The right side, of the coefficients and of γ and κ, after a change of both.
    pub fn expand(
        &self,
        cpu: CpuLevel,
        coefficients: &[f64],
        shared: &SVector<f64, SHARED>,
        right: &mut Vec<f64>,
    ) -> SVector<f64, SHARED> {
        let [sides, columns @ ..] = &self.equations.sides;
        self.equations.product(cpu, coefficients, right);
        right.iter_mut().zip(sides).for_each(|(product, side)| *product = side - *product);
        let mut shared_right = self.shared_right - self.shared * shared;
        for (p, column) in columns.iter().enumerate() {
            right.iter_mut().zip(column).for_each(|(right, one)| *right -= one * shared[p]);
            shared_right[p] -= column.iter().zip(coefficients).map(|(one, change)| one * change).sum::<f64>();
        }
        shared_right
    }

    /// Estimates the variances of the residuals; `noise` is the least standard deviation in pixels.
    pub fn estimate_variances(&mut self, residuals: &PairResiduals, noise: f64) {
        self.variances = BUFFERS.with_borrow_mut(|buffers| {
            ResidualVariances::of(residuals, noise * noise, &mut buffers.variances)
        });
    }

    /// Log likelihood of the innovations, up to a constant, for the number of independent matches.
    pub fn log_likelihood(&self, residuals: &PairResiduals) -> f64 {
        let terms = residuals.matches.iter().zip(&residuals.before).map(|(own, before)| {
            let new = self.variances.innovation(own, before.as_ref());
            loss_of(&new, own, residuals.others).log_density(new.square())
        });
        independent_share(residuals) * terms.filter(|term| term.is_finite()).sum::<f64>()
    }
}

/// The loss of an innovation: Student's t for the scene; all other matches spread evenly over as far as
/// points move in the pair, with a variance in px². The median of |r|² gives σ² as of a normal distribution; it
/// is used as the scale of Student's t.
#[inline(always)]
fn loss_of(new: &Innovation, own: &MatchResidual, outlier_variance: f64) -> Mixture<FREEDOM> {
    let inverse_scale = new.weight.determinant().sqrt() * own.whitening.determinant();
    Mixture::new(own.prior, inverse_scale, outlier_variance)
}

/// The factor on each weight by which a pair counts as at most [`INDEPENDENT_MATCHES`].
fn independent_share(residuals: &PairResiduals) -> f64 {
    let weights = residuals.matches.iter().map(|own| own.prior * own.whitening.norm_squared());
    weights.collect::<EffectiveNumber>().independent_share(INDEPENDENT_MATCHES)
}

impl Evaluator<'_> {
    /// Computes the normal equations of a pair, given its variances.
    pub fn normal(&self, residuals: &PairResiduals, out: &mut Normal) {
        BUFFERS.with_borrow_mut(|buffers| {
            with_cpu!(
                self.cpu,
                cpu => cpu.vectorize(#[inline(always)] || self.add_up(cpu, residuals, buffers, out))
            );
        });
    }

    #[inline(always)]
    fn add_up<C: DoubleCpu>(
        &self,
        cpu: C,
        residuals: &PairResiduals,
        buffers: &mut Buffers,
        out: &mut Normal,
    ) {
        let Buffers { bands, order, units, spreading, .. } = buffers;
        let variances = out.variances;
        let independent = independent_share(residuals);
        out.independent = 2.0 * INDEPENDENT_MATCHES.min(residuals.matches.len() as f64);
        bands.resize_with(BANDS, Band::default);
        out.shared = SMatrix::zeros();
        out.shared_right = SVector::zeros();
        self.sort(residuals, order);
        let mut order = order.iter().peekable();
        for (number, band) in (0u8..).zip(&mut *bands) {
            units.clear();
            band.clear();
            while let Some((_, index)) = order.next_if(|(of, _)| *of == number) {
                let (Some(own), Some(before)) = (residuals.matches.get(*index), residuals.before.get(*index))
                else {
                    continue;
                };
                let mut new = variances.innovation(own, before.as_ref());
                new.weight *= loss_of(&new, own, residuals.others).weight_times(independent, new.square());
                if new.weight.iter().all(|weight| weight.is_finite()) {
                    let unit = self.unit(cpu, &new, own, before.as_ref(), band);
                    for [error, shared @ ..] in unit.sides {
                        let shared = SVector::from(shared);
                        out.shared += shared * shared.transpose();
                        out.shared_right += shared * error;
                    }
                    units.push(unit);
                }
            }
            band.sum(cpu, units);
        }
        out.weight = bands.iter().map(|band| band.weight).sum();
        out.equations.fill(cpu, bands, &self.trajectory.splines, spreading);
    }

    /// Band and index of each match, sorted by both.
    #[inline(always)]
    fn sort(&self, residuals: &PairResiduals, order: &mut Vec<(u8, usize)>) {
        let band = |own: &MatchResidual| {
            let place = self.scan_axis.place(own.measured.from).clamp(0.0, 1.0);
            // The cast takes what is not a number to the first band.
            (place * (BANDS - 1) as f64 + 0.5) as u8
        };
        let mut next = [0; BANDS + 1];
        residuals.matches.iter().for_each(|own| next[usize::from(band(own)) + 1] += 1);
        for number in 1..=BANDS {
            next[number] += next[number - 1];
        }
        order.clear();
        order.resize(residuals.matches.len(), (0, 0));
        for (index, own) in residuals.matches.iter().enumerate() {
            let number = band(own);
            let next = &mut next[usize::from(number)];
            order[*next] = (number, index);
            *next += 1;
        }
    }

    /// An innovation times the root of its weight; its weight and times go to its band.
    #[inline(always)]
    fn unit<C: DoubleCpu>(
        &self,
        cpu: C,
        new: &Innovation,
        own: &MatchResidual,
        before: Option<&MatchResidual>,
        band: &mut Band,
    ) -> Unit {
        let root = root(&new.weight);
        let (by_path, mut shared) = self.jacobian(cpu, own, new.depth, &root);
        let weight = new.weight.trace() / 2.0;
        band.weight += weight;
        band.blocks[1] += weight * own.blocks[0];
        band.blocks[2] += weight * own.blocks[1];
        let mut unit = Unit { own: by_path, ..Unit::ZERO };
        if let Some(before) = before.filter(|_| new.gain != Matrix2::zeros()) {
            let gain = -(root * new.gain);
            let (by_path, by_shared) = self.jacobian(cpu, before, new.depth, &gain);
            unit.before = by_path;
            shared += by_shared;
            band.linked += weight;
            band.blocks[0] += weight * before.blocks[0];
        }
        let error = root * new.error;
        unit.sides = [0, 1].map(|end| [error[end], shared[(end, 0)], shared[(end, 1)]]);
        unit
    }

    /// The Jacobians of a displacement by the paths of the generators and by the shared unknowns, whitened and then
    /// times a matrix, for a point of relative inverse depth `depth`.
    #[inline(always)]
    fn jacobian<C: DoubleCpu>(
        &self,
        cpu: C,
        one: &MatchResidual,
        depth: f64,
        times: &Matrix2<f64>,
    ) -> (Jacobian, SMatrix<f64, 2, SHARED>) {
        let middle = one.measured.middle();
        let by_gamma = one.by_gamma[0] + one.by_gamma[1] * depth;
        let by_path = field_rows(middle, self.trajectory.splines.kappa)
            .map(|row| std::array::from_fn(|j| row[j] * if j < TURNS { 1.0 } else { depth }));
        let by_shared = SMatrix::from_columns(&[by_gamma, one.by_kappa]);
        (product(cpu, &(times * one.whitening), &by_path), times * by_shared)
    }
}

#[cfg(test)]
#[path = "normal_tests.rs"]
mod tests;
