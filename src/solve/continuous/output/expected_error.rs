//! How far the points of a frame are expected to lie from where they belong, and how much of the correction to apply.
//!
//! A hypothesis takes a point of a frame, seen at the place p along the scan axis, to where it is at the middle of the
//! readout: by d, which is what the path does, and γ·(½ − p)·u, u the residual velocity. Hypothesis h has the probability
//! pₕ. Where the share w of the likeliest one's correction d₁ is applied, whose γ is believed to be γ̄ ± σ, the mean square
//! error is
//!
//! > Σ pₕ·|dₕ − w·d₁|² + tr(φ·C·φᵀ) + (σ² + (γ − γ̄)²)·|∂d₁/∂γ|² + v,
//!
//! φ the fields of the generators, C the covariance of what their paths do until the middle of the readout, from that of
//! the path's coefficients, and v what path and residual velocities leave of the flow.

use crate::motion::generators::{GENERATORS, fields};
use crate::solve::continuous::camera::{CameraPosterior, Hypothesis};
use crate::solve::continuous::fit::Covariance;
use crate::solve::continuous::trajectory::{BLOCK, Trajectory, ratio, spline};
use crate::solve::residual::{REGIONS, Region};
use nalgebra::{SMatrix, SVector, Vector2};

/// A correction is applied whole where no more than this share of its mean square is expected to be wrong, and not at all
/// where all of it is.
const WHOLE: f64 = 0.5;
/// Hypotheses of less probability change nothing.
const UNLIKELY: f64 = 1e-3;

/// Covariance of the paths of the generators in px².
type PathCovariance = SMatrix<f64, GENERATORS, GENERATORS>;

/// What is expected of a frame's correction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Expected {
    /// Share of it that is applied.
    pub share: f64,
    /// Mean square distance in px² of points from where they belong, after that, in each region.
    pub squares: Vec<f64>,
}

/// A frame at the middles of its regions, with the residual velocities and errors there.
struct Frame<'a> {
    stamp: f64,
    points: Vec<Vector2<f64>>,
    /// Residual velocities in pixels a frame period.
    velocities: Vec<Vector2<f64>>,
    regions: &'a [Region],
    /// Standard deviation of a coordinate's residual from frame to frame, in pixels.
    sigma: f64,
}

impl CameraPosterior {
    /// What is expected of the correction of a frame with these regions; without any flow, of one in which the path leaves
    /// residuals of `sigma` pixels in a coordinate. Nothing is applied where it cannot be told.
    pub fn expected(&self, stamp: f64, regions: &[Region], sigma: f64) -> Expected {
        let leading = self.leading();
        let points = middles(self.size);
        let frame = Frame::new(stamp, points, regions, sigma, leading.gamma().abs());
        let own = frame.corrections(leading);
        let all: Vec<(f64, Vec<Vector2<f64>>)> = self
            .hypotheses()
            .filter(|(probability, _)| *probability > UNLIKELY)
            .map(|(probability, hypothesis)| (probability, frame.corrections(hypothesis)))
            .collect();
        let gamma_error = if self.is_readout_given() { 0.0 } else { leading.gamma_error() };
        let errors = frame.errors(leading, gamma_error);
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
        let squares: Vec<f64> =
            errors.into_iter().enumerate().map(|(index, error)| error + apart(index)).collect();
        let is_told = squares.iter().all(|square| square.is_finite());
        if is_told { Expected { share, squares } } else { Expected::default() }
    }
}

/// The middles of the regions of a frame of this size, row by row, in units of the radius.
fn middles([width, height]: [usize; 2]) -> Vec<Vector2<f64>> {
    let [columns, rows] = REGIONS;
    let down = height as f64 / width.max(1) as f64;
    let place = |index: usize, count: usize| (2 * index + 1) as f64 / count as f64 - 1.0;
    let middle = |k: usize| Vector2::new(place(k % columns, columns), down * place(k / columns, rows));
    (0..columns * rows).map(middle).collect()
}

impl<'a> Frame<'a> {
    /// Where a readout takes so many frame periods.
    fn new(stamp: f64, points: Vec<Vector2<f64>>, regions: &'a [Region], sigma: f64, readout: f64) -> Self {
        let velocity = |index: usize| {
            let velocity = regions.get(index).map_or(Vector2::zeros(), |region| region.velocity / readout);
            if velocity.iter().all(|rate| rate.is_finite()) { velocity } else { Vector2::zeros() }
        };
        let velocities = (0..points.len()).map(velocity).collect();
        Self { stamp, points, velocities, regions, sigma }
    }

    /// The correction of the points by a hypothesis, in pixels.
    fn corrections(&self, hypothesis: &Hypothesis) -> Vec<Vector2<f64>> {
        let correction = |(point, velocity): (&Vector2<f64>, &Vector2<f64>)| {
            let late = hypothesis.gamma() * (0.5 - hypothesis.setup.scan_axis.place(*point));
            hypothesis.correction(self.stamp, *point) + velocity * late
        };
        self.points.iter().zip(&self.velocities).map(correction).collect()
    }

    /// Expected squares in px² of its error where that of γ is `gamma_error` (root mean square): of the path, of γ, and of what
    /// moves on its own.
    fn errors(&self, hypothesis: &Hypothesis, gamma_error: f64) -> Vec<f64> {
        // All points of a line are exposed at once.
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
            let from_frame_to_frame = || 2.0 * (self.sigma * hypothesis.gamma() * late).powi(2);
            let local = self.regions.get(index).map_or_else(from_frame_to_frame, |region| region.error);
            by_path + by_readout.norm_squared() + local
        };
        self.points.iter().zip(&self.velocities).enumerate().map(error).collect()
    }
}

impl Hypothesis {
    /// Where the path takes a point of a frame, less where it is seen, in pixels.
    fn correction(&self, stamp: f64, point: Vector2<f64>) -> Vector2<f64> {
        let trajectory = &self.posterior.trajectory;
        let [seen, middle] = self.blocks_to_middle(stamp, self.setup.scan_axis.place(point));
        (trajectory.homographies.carry(point, seen, middle) - point) * trajectory.radius
    }

    /// Velocity of a point when it is seen, in pixels a frame period.
    fn velocity(&self, stamp: f64, point: Vector2<f64>) -> Vector2<f64> {
        let Trajectory { splines, .. } = &self.posterior.trajectory;
        let seen = self.posterior.block(stamp, self.setup.scan_axis.place(point));
        let rates = SVector::<f64, GENERATORS>::from(splines.rates(seen));
        fields(point, splines.kappa) * rates * self.density().blocks()
    }

    /// Blocks at which a place along the scan axis is exposed and at which the middle of the readout is.
    fn blocks_to_middle(&self, stamp: f64, place: f64) -> [f64; 2] {
        [place, 0.5].map(|place| self.posterior.block(stamp, place))
    }

    /// Root mean square error that is expected of γ: that of a window is another one than is believed.
    fn gamma_error(&self) -> f64 {
        self.setup.camera.gamma_deviation().hypot(self.gamma() - self.setup.camera.beliefs.gamma.mean)
    }

    /// Covariance in px² of what the paths of the generators do from when a place along the scan axis is exposed until the
    /// middle of the readout.
    fn path_covariance(&self, stamp: f64, place: f64) -> PathCovariance {
        let times = self.blocks_to_middle(stamp, place);
        let splines = &self.posterior.trajectory.splines;
        let Covariance { matrix: covariance, base } = &self.posterior.covariance;
        let size = covariance.size();
        let weights: Vec<Vec<(usize, f64)>> = (0..GENERATORS)
            .map(|generator| {
                let of = |(time, sign): (f64, f64)| {
                    let support = spline::values(time * ratio(generator) as f64);
                    (support.first..).zip(support.weights.map(|weight| sign * weight))
                };
                let knots = times.into_iter().zip([-1.0, 1.0]).flat_map(of);
                let moved = (splines.base - base) * BLOCK as i64;
                knots
                    .filter_map(|(knot, weight)| {
                        Some((usize::try_from(splines.place(generator, knot) + moved).ok()?, weight))
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
        let lower = PathCovariance::from_fn(|j, k| if j < k { 0.0 } else { entry(j, k) });
        PathCovariance::from_fn(|j, k| lower[(j.max(k), j.min(k))]) * self.posterior.noise_share(&self.setup)
    }
}
