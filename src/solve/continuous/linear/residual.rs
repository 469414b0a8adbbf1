//! The residual of a match, with its derivatives, whitened by its covariance.

use crate::cpu::CpuLevel;
use crate::motion::generators::{GENERATORS, TURNS, fields};
use crate::solve::continuous::data::{Match, Shutter};
use crate::solve::continuous::trajectory::Trajectory;
use nalgebra::{Matrix2, SVector, Vector2};

/// Generators other than the turns.
const OTHERS: usize = GENERATORS - TURNS;

/// The estimate at which a pair is evaluated.
pub struct Evaluator<'a> {
    pub cpu: CpuLevel,
    pub trajectory: &'a Trajectory,
    pub shutter: Shutter,
    /// Least standard deviation of a coordinate in pixels.
    pub noise: f64,
}

/// A match as the path sees it.
#[derive(Clone, Copy, Debug)]
pub struct Leg {
    pub m: Match,
    /// How probably it shows the scene, before its residual is known.
    pub prior: f64,
    /// Blocks at which both ends are exposed.
    pub times: [f64; 2],
    /// Its residual x′ − F(x) in pixels.
    pub residual: Vector2<f64>,
    /// What the generators other than the turns move it by, in pixels: at twice the inverse depth, so much again.
    pub parallax: Vector2<f64>,
    /// What a frame period of γ adds to what the turns move it by, and to what the others do.
    pub by_readout: [Vector2<f64>; 2],
    /// What κ adds to what the turns move it by.
    pub by_kappa: Vector2<f64>,
    /// What all of these have been multiplied by.
    pub whitening: Matrix2<f64>,
}

impl Leg {
    /// Makes it as uncertain as a residual of this variance is by itself: W = (I + C/σ²)^(−½), C the covariance of its
    /// match.
    pub fn whiten(&mut self, variance: f64) {
        let whitening = inverse_root(Matrix2::identity() + self.m.covariance / variance);
        self.whitening = whitening;
        for vector in [&mut self.residual, &mut self.parallax, &mut self.by_kappa]
            .into_iter()
            .chain(&mut self.by_readout)
        {
            *vector = whitening * *vector;
        }
    }
}

/// A^(−½) of a positive definite matrix: √A = (A + √|A|·I)/√(tr A + 2·√|A|).
fn inverse_root(matrix: Matrix2<f64>) -> Matrix2<f64> {
    let root = matrix.determinant().max(0.0).sqrt();
    let length = (matrix.trace() + 2.0 * root).sqrt();
    let inverse = (matrix + Matrix2::identity() * root).try_inverse().map(|inverse| inverse * length);
    inverse.filter(|inverse| inverse.iter().all(|value| value.is_finite())).unwrap_or_else(Matrix2::identity)
}

impl Evaluator<'_> {
    /// Blocks at which both ends of a match are exposed.
    pub fn times(&self, stamps: [f64; 2], m: &Match) -> [f64; 2] {
        let places = [m.from, m.to].map(|point| self.shutter.scan_axis.place(point));
        [0, 1].map(|end| self.trajectory.block(self.shutter.exposure(stamps[end], places[end])))
    }

    /// A match against the path; `None` where there is no path.
    pub fn leg(&self, stamps: [f64; 2], m: &Match, prior: f64) -> Option<Leg> {
        let times = self.times(stamps, m);
        let (from, to) =
            (self.trajectory.homographies.at(times[0])?, self.trajectory.homographies.at(times[1])?);
        let places = [m.from, m.to].map(|point| self.trajectory.block(self.shutter.scan_axis.place(point)));
        let (rates, values) = ([from.rates(), to.rates()], [from.values(), to.values()]);
        let rates =
            SVector::<f64, GENERATORS>::from_fn(|j, _| rates[1][j] * places[1] - rates[0][j] * places[0]);
        let moved = SVector::<f64, GENERATORS>::from_fn(|j, _| values[1][j] - values[0][j]);
        let middle = (m.from + m.to) / 2.0;
        let fields = fields(middle, self.trajectory.splines.kappa);
        let (turns, others) = (fields.fixed_columns::<TURNS>(0), fields.fixed_columns::<OTHERS>(TURNS));
        Some(Leg {
            m: *m,
            prior,
            times,
            residual: (m.to - from.carry(m.from, to)) * self.trajectory.radius,
            parallax: others * moved.fixed_rows::<OTHERS>(TURNS),
            by_readout: [turns * rates.fixed_rows::<TURNS>(0), others * rates.fixed_rows::<OTHERS>(TURNS)],
            by_kappa: middle * middle.dot(&moved.xy()),
            whitening: Matrix2::identity(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn leg() -> Leg {
        Leg {
            m: Match { from: Vector2::zeros(), to: Vector2::zeros(), covariance: Matrix2::zeros() },
            prior: 1.0,
            times: [0.0; 2],
            residual: Vector2::new(1.0, 0.0),
            parallax: Vector2::zeros(),
            by_readout: [Vector2::zeros(); 2],
            by_kappa: Vector2::zeros(),
            whitening: Matrix2::identity(),
        }
    }

    #[test]
    fn a_whitened_residual_is_as_uncertain_as_the_others() {
        let covariance = Matrix2::new(0.5, 0.2, 0.2, 0.3);
        let mut leg = leg();
        (leg.m.covariance, leg.parallax) = (covariance, Vector2::new(0.0, 2.0));
        leg.whiten(0.04);
        // W·(σ²·I + C)·Wᵀ = σ²·I.
        let all = Matrix2::identity() * 0.04 + covariance;
        let white = leg.whitening * all * leg.whitening.transpose();
        assert!((white - Matrix2::identity() * 0.04).norm() < 1e-12, "{white}");
        assert_eq!(leg.residual, leg.whitening.column(0));
        assert!((leg.parallax - leg.whitening.column(1) * 2.0).norm() < 1e-12);
        for strange in [f64::NAN, f64::INFINITY, -1.0] {
            let mut leg = self::leg();
            leg.m.covariance = Matrix2::identity() * strange;
            leg.whiten(0.04);
            assert!(leg.residual.iter().all(|value| value.is_finite()), "{strange}: {}", leg.residual);
        }
    }
}
