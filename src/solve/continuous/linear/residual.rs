// SPDX-License-Identifier: MIT OR Apache-2.0

//! The residual of a match with its derivatives, whitened by the covariance of the match.

use super::shared::Shared;
use crate::cpu::CpuLevel;
use crate::lanes::DoubleCpu;
use crate::motion::generators::velocities;
use crate::solve::continuous::data::{Match, ScanAxis};
use crate::solve::continuous::trajectory::Trajectory;
use nalgebra::{Matrix2, Vector2};

/// The estimate at which pairs are evaluated.
pub struct Evaluator<'a> {
    pub cpu: CpuLevel,
    pub trajectory: &'a Trajectory,
    pub scan_axis: ScanAxis,
    /// γ.
    pub gamma: f64,
    /// Least standard deviation of a coordinate in pixels.
    pub noise: f64,
}

/// The residual of a match, in pixels. All but the first three are whitened.
#[derive(Clone, Copy, Debug)]
pub struct MatchResidual {
    pub measured: Match,
    /// Prior probability π that the match shows the scene: the match's weight in the medians for σ² and τ², its
    /// share of the effective number of matches, and the probability of an inlier in the robust loss.
    pub prior: f64,
    /// Exposure times of both points in blocks.
    pub blocks: [f64; 2],
    /// r = x′ − F(x).
    pub residual: Vector2<f64>,
    /// w, the displacement by the generators other than the turns, at the depth of the path. All of them are
    /// counted as parallax: their effect scales with inverse depth.
    pub parallax: Vector2<f64>,
    /// Derivatives by γ of the displacements by the turns and by the other generators: two, as only the second is
    /// multiplied by the relative inverse depth λ of the point, which is known later.
    pub by_gamma: [Vector2<f64>; 2],
    /// Derivative by κ of the displacement by the turns.
    pub by_kappa: Vector2<f64>,
    /// W.
    pub whitening: Matrix2<f64>,
}

impl MatchResidual {
    /// Multiplies by W = (I + C/σ²)^(−½), C the covariance of the match and σ² the `variance` of a coordinate
    /// without it, which is then that of the residual.
    #[inline(always)]
    pub fn whiten(&mut self, variance: f64) {
        self.whitening = inverse_root(Matrix2::identity() + self.measured.covariance / variance);
        let [by_turns, by_others] = &mut self.by_gamma;
        for vector in [&mut self.residual, &mut self.parallax, &mut self.by_kappa, by_turns, by_others] {
            *vector = self.whitening * *vector;
        }
    }
}

/// A^(−½) of a positive definite matrix: √A = (A + √|A|·I)/√(tr A + 2·√|A|).
#[inline(always)]
fn inverse_root(matrix: Matrix2<f64>) -> Matrix2<f64> {
    let root = matrix.determinant().max(0.0).sqrt();
    let length = (matrix.trace() + 2.0 * root).sqrt();
    let inverse = (matrix + Matrix2::identity() * root).try_inverse().map(|inverse| inverse * length);
    inverse.filter(|inverse| inverse.iter().all(|value| value.is_finite())).unwrap_or_else(Matrix2::identity)
}

impl Evaluator<'_> {
    /// γ and κ.
    pub fn shared(&self) -> Shared<f64> {
        Shared { gamma: self.gamma, kappa: self.trajectory.splines.kappa }
    }

    /// Exposure times in blocks of both points of a match.
    #[inline(always)]
    pub fn blocks(&self, stamps: [f64; 2], m: &Match) -> [f64; 2] {
        let places = [m.from, m.to].map(|point| self.scan_axis.place(point));
        [0, 1].map(|end| self.trajectory.exposure(stamps[end], self.gamma, places[end]))
    }

    /// The residual of a match, not yet whitened; `None` without a path.
    #[inline(always)]
    pub fn match_residual<C: DoubleCpu>(
        &self,
        cpu: C,
        stamps: [f64; 2],
        m: &Match,
        prior: f64,
    ) -> Option<MatchResidual> {
        let blocks = self.blocks(stamps, m);
        let homographies = &self.trajectory.homographies;
        let (from, to) = (homographies.at(blocks[0])?, homographies.at(blocks[1])?);
        let places = [m.from, m.to].map(|point| self.trajectory.block(self.scan_axis.place(point)));
        let moved = to.values_less(cpu, from);
        let rates = to.rates_less(cpu, places[1], from, places[0]);
        let middle = m.middle();
        let kappa = self.trajectory.splines.kappa;
        let [_, parallax] = velocities(middle, kappa, &moved);
        Some(MatchResidual {
            measured: *m,
            prior,
            blocks,
            residual: (m.to - from.carry(cpu, m.from, to)) * self.trajectory.radius,
            parallax,
            by_gamma: velocities(middle, kappa, &rates),
            by_kappa: middle * (middle.x * moved[0] + middle.y * moved[1]),
            whitening: Matrix2::identity(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one() -> MatchResidual {
        MatchResidual {
            measured: Match { from: Vector2::zeros(), to: Vector2::zeros(), covariance: Matrix2::zeros() },
            prior: 1.0,
            blocks: [0.0; 2],
            residual: Vector2::new(1.0, 0.0),
            parallax: Vector2::zeros(),
            by_gamma: [Vector2::zeros(); 2],
            by_kappa: Vector2::zeros(),
            whitening: Matrix2::identity(),
        }
    }

    #[test]
    fn whitened_residuals_have_the_given_variance() {
        let covariance = Matrix2::new(0.5, 0.2, 0.2, 0.3);
        let mut one = one();
        (one.measured.covariance, one.parallax) = (covariance, Vector2::new(0.0, 2.0));
        one.whiten(0.04);
        // W·(σ²·I + C)·Wᵀ = σ²·I.
        let all = Matrix2::identity() * 0.04 + covariance;
        let white = one.whitening * all * one.whitening.transpose();
        assert!((white - Matrix2::identity() * 0.04).norm() < 1e-12, "{white}");
        assert_eq!(one.residual, one.whitening.column(0));
        assert!((one.parallax - one.whitening.column(1) * 2.0).norm() < 1e-12);
        for strange in [f64::NAN, f64::INFINITY, -1.0] {
            let mut one = self::one();
            one.measured.covariance = Matrix2::identity() * strange;
            one.whiten(0.04);
            assert!(one.residual.iter().all(|value| value.is_finite()), "{strange}: {}", one.residual);
        }
    }
}
