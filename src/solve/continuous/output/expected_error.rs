// SPDX-License-Identifier: MIT OR Apache-2.0

//! The expected error of a frame's correction, and the share of it that is applied.
//!
//! A hypothesis corrects a point at the place p along the scan axis by d, to where it is at the middle of the
//! readout: the motion along the path, and γ·(½ − p)·u, u the residual velocity. Hypothesis h has the
//! probability pₕ. If the share w of the correction d₁ of the likeliest is applied, whose γ is believed to be
//! γ̄ ± σ, the mean squared error is
//!
//! > Σ pₕ·|dₕ − w·d₁|² + tr(φ·C·φᵀ) + (σ² + (γ − γ̄)²)·|∂d₁/∂γ|² + v,
//!
//! φ the fields of the generators, C the covariance of the motion of their paths until the middle of the
//! readout, from that of the path's coefficients, and v the variance of the flow about path and residual
//! velocities. If the readout is unknown, one of the hypotheses is that all rows are exposed at once: d = 0.

use crate::motion::generators::{GENERATORS, fields};
use crate::solve::continuous::camera::{CameraPosterior, Hypothesis, READOUT_BELIEF};
use crate::solve::continuous::fit::Covariance;
use crate::solve::continuous::timing::Lean;
use crate::solve::continuous::trajectory::{BLOCK, Trajectory, ratio, spline};
use crate::solve::residual::{REGIONS, Region};
use nalgebra::{SMatrix, SVector, Vector2};

/// Share of the correction's mean square that may be error if all of it is applied; the applied share falls
/// to 0 where all of the mean square is error.
const TOLERATED_ERROR: f64 = 0.5;
/// Odds before anything is seen that all rows are exposed at once, as of an animation, a screen or a picture that was corrected already,
/// times how much worse it is to bend such a picture than to leave another one as it is.
const GLOBAL_ODDS: f64 = 9.0;
/// Hypotheses of less probability are ignored.
const MIN_PROBABILITY: f64 = 1e-3;

/// Covariance of the paths of the generators in px².
type PathCovariance = SMatrix<f64, GENERATORS, GENERATORS>;

/// The share and the expected error of a frame's correction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Expected {
    /// Share that is applied, 0 to 1.
    pub share: f64,
    /// Mean squared error in px² after that, by region.
    pub squares: Vec<f64>,
}

/// A frame at the middles of its regions.
struct Frame<'a> {
    /// Timestamp in frame periods.
    stamp: f64,
    points: Vec<Vector2<f64>>,
    /// Residual velocities in pixels a frame period.
    velocities: Vec<Vector2<f64>>,
    regions: &'a [Region],
    /// Standard deviation in pixels of a coordinate's residual.
    sigma: f64,
}

impl Expected {
    /// Of a frame of `size` pixels that was moved after its readout; `radius` is half its width in analysed pixels. With the share w of
    /// the displacement d taken out, whose variance is v, the mean squared error is v + (1 − w)²·|d|².
    pub fn of_lean(lean: &Lean, size: [usize; 2], radius: f64) -> Self {
        let area = radius * radius;
        let points = middles(size);
        let displacements = points.iter().map(|point| lean.displacement(*point).norm_squared() * area);
        let errors: Vec<f64> = points.iter().map(|point| lean.variance(*point) * area).collect();
        let share = applied_share(1.0, errors.iter().sum::<f64>() / displacements.clone().sum::<f64>());
        let squares = errors.iter().zip(displacements).map(|(error, d)| error + (1.0 - share).powi(2) * d);
        Self { share, squares: squares.collect() }
    }
}

/// The share of a correction that is applied: that on which hypotheses agree, less as more of its mean square is error.
fn applied_share(agreement: f64, error_share: f64) -> f64 {
    let trust = ((1.0 - error_share) / (1.0 - TOLERATED_ERROR)).clamp(0.0, 1.0);
    let share = agreement.clamp(0.0, 1.0) * trust;
    // 0/0 is the ordinary case of no correction: no motion, or γ = 0.
    if share.is_finite() { share } else { 0.0 }
}

impl CameraPosterior {
    /// Share and expected error of the correction of a frame with these regions; without flow, `sigma` in
    /// pixels is the standard deviation of a coordinate's residual. Share 0 if an error is not finite.
    pub fn expected(&self, stamp: f64, regions: &[Region], sigma: f64) -> Expected {
        let leading = self.leading();
        let frame = Frame::new(stamp, middles(self.size), regions, sigma, leading.gamma().abs());
        let own = frame.corrections(leading);
        let (gamma_error, is_global) = if self.camera.is_known() {
            (0.0, 0.0)
        } else {
            let gamma_error = leading.gamma_error();
            (gamma_error, global_probability(leading.gamma(), gamma_error))
        };
        let likely = self.hypotheses().filter(|(probability, _)| *probability > MIN_PROBABILITY);
        let mut all: Vec<(f64, Vec<Vector2<f64>>)> = likely
            .map(|(probability, one)| ((1.0 - is_global) * probability, frame.corrections(one)))
            .collect();
        all.push((is_global, vec![Vector2::zeros(); own.len()]));
        let errors = frame.errors(leading, gamma_error);
        let product = |other: &[Vector2<f64>]| own.iter().zip(other).map(|(a, b)| a.dot(b)).sum::<f64>();
        let square = product(&own);
        // The share of d₁ with the least squared distance from all corrections.
        let agreement =
            all.iter().map(|(probability, other)| probability * product(other)).sum::<f64>() / square;
        let share = applied_share(agreement, errors.iter().sum::<f64>() / square);
        let disagreement = |index: usize| {
            let squares = all.iter().filter_map(|(probability, other)| {
                Some(probability * (other.get(index)? - own.get(index)? * share).norm_squared())
            });
            squares.sum::<f64>()
        };
        let squares: Vec<f64> =
            errors.into_iter().enumerate().map(|(index, error)| error + disagreement(index)).collect();
        let is_finite = squares.iter().all(|square| square.is_finite());
        if is_finite { Expected { share, squares } } else { Expected::default() }
    }
}

/// The probability that γ is 0, not `gamma` with this deviation: by the density of γ at 0, then and before anything was seen (the
/// Savage–Dickey ratio: J. M. Dickey, *The weighted likelihood ratio*, 1971).
fn global_probability(gamma: f64, deviation: f64) -> f64 {
    let density = |(mean, deviation): (f64, f64)| (-0.5 * (mean / deviation).powi(2)).exp() / deviation;
    let odds = GLOBAL_ODDS * density((gamma, deviation)) / density(READOUT_BELIEF);
    if odds.is_finite() { odds / (1.0 + odds) } else { 1.0 }
}

/// The middles of the regions of a frame of this size, row by row, in radii.
fn middles([width, height]: [usize; 2]) -> Vec<Vector2<f64>> {
    let [columns, rows] = REGIONS;
    let down = height as f64 / width.max(1) as f64;
    let place = |index: usize, count: usize| (2 * index + 1) as f64 / count as f64 - 1.0;
    let middle = |k: usize| Vector2::new(place(k % columns, columns), down * place(k / columns, rows));
    (0..columns * rows).map(middle).collect()
}

impl<'a> Frame<'a> {
    /// `readout` is the readout time in frame periods.
    fn new(stamp: f64, points: Vec<Vector2<f64>>, regions: &'a [Region], sigma: f64, readout: f64) -> Self {
        let velocity = |index: usize| {
            let velocity = regions.get(index).map_or(Vector2::zeros(), |region| region.velocity / readout);
            if velocity.iter().all(|rate| rate.is_finite()) { velocity } else { Vector2::zeros() }
        };
        let velocities = (0..points.len()).map(velocity).collect();
        Self { stamp, points, velocities, regions, sigma }
    }

    /// The corrections of the points by a hypothesis, in pixels; none while it rests.
    fn corrections(&self, hypothesis: &Hypothesis) -> Vec<Vector2<f64>> {
        if !hypothesis.has_path() {
            return vec![Vector2::zeros(); self.points.len()];
        }
        let Trajectory { homographies, radius, .. } = &hypothesis.posterior.trajectory;
        let correction = |(point, velocity): (&Vector2<f64>, &Vector2<f64>)| {
            let place = hypothesis.setup.scan_axis.place(*point);
            let [seen, middle] = hypothesis.blocks_to_middle(self.stamp, place);
            let by_path = (homographies.carry(*point, seen, middle) - point) * *radius;
            by_path + velocity * (hypothesis.gamma() * (0.5 - place))
        };
        self.points.iter().zip(&self.velocities).map(correction).collect()
    }

    /// Expected squared errors in px² of a correction by path, γ (root mean square `gamma_error`) and flow.
    fn errors(&self, hypothesis: &Hypothesis, gamma_error: f64) -> Vec<f64> {
        // The points of a line have the same exposure time.
        let mut lines: Vec<(f64, PathCovariance)> = Vec::new();
        let mut path_covariance = |place: f64| {
            let known = lines.iter().find(|(other, _)| *other == place).map(|(_, covariance)| *covariance);
            known.unwrap_or_else(|| {
                let covariance = hypothesis.path_covariance(self.stamp, place);
                lines.push((place, covariance));
                covariance
            })
        };
        let error = |(index, (point, velocity)): (usize, (&Vector2<f64>, &Vector2<f64>))| {
            let place = hypothesis.setup.scan_axis.place(*point);
            let late = 0.5 - place;
            let fields = fields(*point, hypothesis.posterior.trajectory.splines.kappa);
            let by_path = (fields * path_covariance(place) * fields.transpose()).trace().max(0.0);
            let by_readout = (hypothesis.velocity(self.stamp, *point) + velocity) * (late * gamma_error);
            let without_flow = || 2.0 * (self.sigma * hypothesis.gamma() * late).powi(2);
            let local = self.regions.get(index).map_or_else(without_flow, |region| region.error);
            by_path + by_readout.norm_squared() + local
        };
        self.points.iter().zip(&self.velocities).enumerate().map(error).collect()
    }
}

impl Hypothesis {
    /// Velocity of a point at its exposure, in pixels a frame period.
    fn velocity(&self, stamp: f64, point: Vector2<f64>) -> Vector2<f64> {
        let Trajectory { splines, .. } = &self.posterior.trajectory;
        let seen = self.posterior.block(stamp, self.setup.scan_axis.place(point));
        let rates = SVector::<f64, GENERATORS>::from(splines.rates(seen));
        fields(point, splines.kappa) * rates * self.density().blocks()
    }

    /// Blocks of the exposure of a place along the scan axis and of the middle of the readout.
    fn blocks_to_middle(&self, stamp: f64, place: f64) -> [f64; 2] {
        [place, 0.5].map(|place| self.posterior.block(stamp, place))
    }

    /// Root mean square error of γ: that of a window differs from the belief.
    fn gamma_error(&self) -> f64 {
        self.setup.camera.gamma_deviation().hypot(self.gamma() - self.setup.camera.beliefs.gamma.mean)
    }

    /// Covariance in px² of the generators' motion from the exposure of a place to the middle of the readout.
    fn path_covariance(&self, stamp: f64, place: f64) -> PathCovariance {
        let blocks = self.blocks_to_middle(stamp, place);
        let splines = &self.posterior.trajectory.splines;
        let Covariance { matrix: covariance, base } = &self.posterior.covariance;
        let shift = (splines.base - base) * BLOCK as i64;
        let weights = |generator: usize| -> Vec<(usize, f64)> {
            let of = |(block, sign): (f64, f64)| {
                let support = spline::values(block * ratio(generator) as f64);
                (support.first..).zip(support.weights.map(|weight| sign * weight))
            };
            let knots = blocks.into_iter().zip([-1.0, 1.0]).flat_map(of);
            let places = knots.filter_map(|(knot, weight)| {
                Some((usize::try_from(splines.place(generator, knot) + shift).ok()?, weight))
            });
            places.filter(|(place, _)| *place < covariance.size()).collect()
        };
        let weights: [_; GENERATORS] = std::array::from_fn(weights);
        let entry = |j: usize, k: usize| -> f64 {
            let row = |row: usize| {
                weights[k].iter().map(|(column, w)| w * covariance.at(row, *column)).sum::<f64>()
            };
            weights[j].iter().map(|(place, weight)| weight * row(*place)).sum()
        };
        let lower = PathCovariance::from_fn(|j, k| if j < k { 0.0 } else { entry(j, k) });
        PathCovariance::from_fn(|j, k| lower[(j.max(k), j.min(k))]) * self.posterior.noise_share(&self.setup)
    }
}
