//! How far the points of a frame are expected to lie from where they belong, and how much of the correction to apply.
//!
//! A hypothesis takes a point of a frame, seen at the place p along the scan axis, to where it is at the middle of the
//! readout: by d, which is what the path does, and γ·(½ − p)·u, u the residual velocity. Hypothesis h has the probability
//! pₕ, and its γ is believed to be γ̄ ± σ, so that rₕ·dₕ is expected, rₕ = γ̄/γ. Where the share w of the likeliest
//! one's correction d₁ is applied, the mean square error is
//!
//! > Σ pₕ·|rₕ·dₕ − w·d₁|² + tr(φ·C·φᵀ) + σ²·|∂d/∂γ|² + v,
//!
//! φ the fields of the generators, C the covariance of what their paths do until the middle of the readout, from that of
//! the path's coefficients, and v what path and residual velocities leave of the flow.

use super::bank::Bank;
use super::path::{BLOCK, ratio};
use super::solver::Solver;
use super::spline;
use crate::motion::generators::{GENERATORS, fields};
use crate::solve::residual::{REGIONS, Region};
use nalgebra::{SMatrix, SVector, Vector2};

/// A correction is applied whole where no more than this share of its mean square is expected to be wrong, and not at all
/// where all of it is.
const WHOLE: f64 = 0.5;
/// Hypotheses of less probability change nothing.
const UNLIKELY: f64 = 1e-3;

/// What is expected of a frame's correction.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Expected {
    /// Share of it that is applied.
    pub share: f64,
    /// Mean square distance in px² of points from where they belong, after that, in each region.
    pub squares: Vec<f64>,
}

impl Bank {
    /// What is expected of the correction of a frame, where the flow says this of its regions; without any flow, where the
    /// path leaves `sigma` pixels of a coordinate from frame to frame.
    pub fn expected(&self, stamp: f64, regions: &[Region], sigma: f64) -> Expected {
        let leading = &self.leading().solver;
        let is_known = self.knows_readout_time();
        let gamma = leading.shared[0];
        let points: Vec<Vector2<f64>> = self.points().collect();
        // Pixels in a frame period.
        let residual: Vec<Vector2<f64>> = (0..points.len())
            .map(|index| regions.get(index).map_or(Vector2::zeros(), |region| region.velocity / gamma.abs()))
            .filter(|velocity| velocity.iter().all(|rate| rate.is_finite()))
            .collect();
        let residual = |index: usize| residual.get(index).copied().unwrap_or_default();
        let corrections = |solver: &Solver| -> Vec<Vector2<f64>> {
            let at = |(index, point): (usize, &Vector2<f64>)| {
                let late = solver.shared[0] * (0.5 - solver.scan_axis.place(*point));
                solver.correction(stamp, *point) + residual(index) * late
            };
            points.iter().enumerate().map(at).collect()
        };
        let own = corrections(leading);
        let all: Vec<(f64, Vec<Vector2<f64>>)> = self
            .probabilities()
            .into_iter()
            .zip(&self.hypotheses)
            .filter(|(probability, _)| *probability > UNLIKELY)
            .map(|(probability, hypothesis)| {
                let solver = &hypothesis.solver;
                let ratio = if is_known { 1.0 } else { solver.believed_share() };
                (probability, corrections(solver).into_iter().map(|correction| correction * ratio).collect())
            })
            .collect();
        let deviation = if is_known { 0.0 } else { leading.readout_deviation() };
        let error = |(index, point): (usize, &Vector2<f64>)| {
            let late = 0.5 - leading.scan_axis.place(*point);
            let by_readout = (leading.velocity(stamp, *point) + residual(index)) * (late * deviation);
            let local =
                regions.get(index).map_or(2.0 * (sigma * gamma * late).powi(2), |region| region.error);
            leading.path_variance(stamp, *point) + by_readout.norm_squared() + local
        };
        let errors: Vec<f64> = points.iter().enumerate().map(error).collect();
        let product = |other: &[Vector2<f64>]| own.iter().zip(other).map(|(a, b)| a.dot(b)).sum::<f64>();
        let square = product(&own);
        // The share of d₁ that comes nearest to all of them.
        let agreed =
            all.iter().map(|(probability, other)| probability * product(other)).sum::<f64>() / square;
        let wrong = errors.iter().sum::<f64>() / square;
        let share = agreed.clamp(0.0, 1.0) * ((1.0 - wrong) / (1.0 - WHOLE)).clamp(0.0, 1.0);
        let share = if share.is_finite() { share } else { 0.0 };
        let apart = |index: usize| {
            let squares = all.iter().filter_map(|(probability, other)| {
                Some(probability * (other.get(index)? - own.get(index)? * share).norm_squared())
            });
            squares.sum::<f64>()
        };
        Expected {
            share,
            squares: errors.into_iter().enumerate().map(|(index, error)| error + apart(index)).collect(),
        }
    }

    /// The middles of the regions, row by row.
    fn points(&self) -> impl Iterator<Item = Vector2<f64>> {
        let [columns, rows] = REGIONS;
        let [width, height] = self.size();
        let down = height as f64 / width.max(1) as f64;
        let place = |index: usize, count: usize| (2 * index + 1) as f64 / count as f64 - 1.0;
        (0..columns * rows)
            .map(move |k| Vector2::new(place(k % columns, columns), down * place(k / columns, rows)))
    }
}

impl Solver {
    /// Where the path takes a point of a frame, less where it is seen, in pixels.
    fn correction(&self, stamp: f64, point: Vector2<f64>) -> Vector2<f64> {
        let [seen, middle] = self.times_to_middle(stamp, point);
        (self.flow.carry(point, seen, middle) - point) * self.radius
    }

    /// Velocity of a point when it is seen, in pixels a frame period.
    fn velocity(&self, stamp: f64, point: Vector2<f64>) -> Vector2<f64> {
        let [seen, _] = self.times_to_middle(stamp, point);
        let rates = SVector::<f64, GENERATORS>::from(self.path.rates(seen));
        fields(point, self.path.kappa) * rates * self.density.blocks()
    }

    /// Blocks at which a point is seen and at which the middle of the readout is.
    fn times_to_middle(&self, stamp: f64, point: Vector2<f64>) -> [f64; 2] {
        [self.scan_axis.place(point), 0.5].map(|place| self.time(stamp, place))
    }

    /// γ as it is believed, as a share of the one in hand.
    fn believed_share(&self) -> f64 {
        let share = self.beliefs[0].mean / self.shared[0];
        if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 }
    }

    /// Mean square in px² by which the path is wrong about where a point of a frame goes.
    fn path_variance(&self, stamp: f64, point: Vector2<f64>) -> f64 {
        let times = self.times_to_middle(stamp, point);
        let (covariance, base) = self.covariance();
        let size = covariance.size();
        let weights: Vec<Vec<(usize, f64)>> = (0..GENERATORS)
            .map(|generator| {
                let of = |(time, sign): (f64, f64)| {
                    let support = spline::values(time * ratio(generator) as f64);
                    (support.first..).zip(support.weights.map(|weight| sign * weight))
                };
                let knots = times.into_iter().zip([-1.0, 1.0]).flat_map(of);
                let moved = (self.path.base - base) * BLOCK as i64;
                knots
                    .filter_map(|(knot, weight)| {
                        Some((usize::try_from(self.path.place(generator, knot) + moved).ok()?, weight))
                    })
                    .filter(|(place, _)| *place < size)
                    .collect()
            })
            .collect();
        let entry = |j: usize, k: usize| -> f64 {
            let sums = weights[j].iter().map(|(row, own)| {
                own * weights[k]
                    .iter()
                    .map(|(column, other)| other * covariance.at(*row, *column))
                    .sum::<f64>()
            });
            sums.sum()
        };
        let covariance = SMatrix::<f64, GENERATORS, GENERATORS>::from_fn(entry);
        let fields = fields(point, self.path.kappa);
        (fields * covariance * fields.transpose()).trace().max(0.0) * self.chance_share()
    }
}
