//! Robust regression of equations whose errors go together from one to the next.

use super::equations::{Equation, Regressors, UNKNOWNS};
use crate::solve::median::median;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

type Unknowns = SVector<f64, UNKNOWNS>;
type Normal = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Fewer equations say nothing.
const MIN_EQUATIONS: usize = 4;
/// Rounds of reweighting.
const ROUNDS: usize = 6;
/// The loss reaches so many times the usual squared error.
const REACH: f64 = 4.0;
/// Standard deviation, in periods, that readout times have before anything is seen: wide.
const WIDE: f64 = 10.0;
/// Standard deviation of the slopes of inverse depth over half the frame, as a share of its mean.
const DEPTH: f64 = 0.3;
/// Depth is believed in where without it more than this share of the squared distortion is left. A
/// camera that turns in circles would be taken for one that moves before a slope otherwise: both lean
/// the picture in step.
const DEPTH_MATTERS: f64 = 0.05;
/// And where it takes away this share of what is left.
const DEPTH_EXPLAINS: f64 = 0.4;
/// Equations so far apart have errors of their own.
const LAG: usize = 8;
/// What depth does to the picture lasts for so many equations: with fewer, a misfit may go with the
/// acceleration all the way.
const LASTING: f64 = 25.0;
/// Correlation that the misfit may have with what a readout does.
const CONSPIRACY: f64 = 0.15;
/// Share of a ripple within the frame that counts as an error of the lean: what is fast against the
/// readout is not seen between frames, or as something slow.
const ALIASED: f64 = 0.2;
/// What the model's approximations cost, in periods and as a share of the readout time.
const MODEL: [f64; 2] = [0.004, 0.01];

/// The two readout times, by columns and by rows, with their covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gaussian {
    pub mean: Vector2<f64>,
    pub covariance: Matrix2<f64>,
}

impl Gaussian {
    /// Both, taken as independent.
    pub fn fused(&self, other: &Self) -> Option<Self> {
        let (a, b) = (self.covariance.try_inverse()?, other.covariance.try_inverse()?);
        let covariance = (a + b).try_inverse()?;
        Some(Self { mean: covariance * (a * self.mean + b * other.mean), covariance })
    }

    /// Less sure, by the share x that `newer` has of what both know: the precision times (1 − x)^power.
    pub fn faded(&self, newer: &Self, power: f64) -> Self {
        let size = |of: &Self| of.covariance.determinant().max(0.0).sqrt();
        let (own, other) = (size(self), size(newer));
        let share = if own + other > 0.0 { own / (own + other) } else { 0.5 };
        Self { covariance: self.covariance / (1.0 - share).max(0.01).powf(power), ..*self }
    }

    /// In a unit that is `factor` times smaller.
    pub fn scaled(&self, factor: f64) -> Self {
        Self { mean: self.mean * factor, covariance: self.covariance * (factor * factor) }
    }
}

/// The readout times that explain most equations, with errors that allow for noise that goes together
/// over [`LAG`] equations, for a misfit that happens to look like a readout, and for `ripple`, the mean
/// square that bands of columns and of rows move beyond their field. `floor` is the standard deviation
/// of a distortion below which the spread is not believed.
pub(super) fn regress(equations: &[Equation], floor: f64, ripple: [f64; 2]) -> Option<Gaussian> {
    if equations.len() < MIN_EQUATIONS {
        return None;
    }
    let flat = Fit::new(equations, floor, 0.0)?;
    let deep = Fit::new(equations, floor, DEPTH)?;
    let matters = flat.lean() > DEPTH_MATTERS * lean(equations);
    let explains = deep.lean() < (1.0 - DEPTH_EXPLAINS) * flat.lean();
    let chosen = if matters && explains { deep } else { flat };
    let mut covariance = chosen.sandwich(equations).fixed_view::<2, 2>(0, 0).into_owned();
    for axis in 0..2 {
        covariance[(axis, axis)] += chosen.bias(equations, axis, ripple[axis]);
    }
    covariance *= 1.0 + LASTING / equations.len() as f64;
    let mean = chosen.unknowns.fixed_rows::<2>(0).into_owned();
    for axis in 0..2 {
        covariance[(axis, axis)] += MODEL[0].powi(2) + (MODEL[1] * mean[axis]).powi(2);
    }
    let finite = mean.iter().chain(covariance.iter()).all(|value| value.is_finite());
    finite.then_some(Gaussian { mean, covariance })
}

/// A weighted least-squares fit.
struct Fit {
    /// What is taken off each equation: their weighted mean, if there is depth.
    offset: Equation,
    /// Of each equation.
    weights: Vec<f64>,
    /// One over the variance of each of the two distortions.
    precisions: Vector2<f64>,
    unknowns: Unknowns,
    /// Inverse of the normal matrix.
    inverse: Normal,
}

impl Fit {
    /// Reweighted least squares, the slopes of inverse depth having the standard deviation `depth`.
    ///
    /// Where there is depth, a camera that goes steadily forwards leans the picture steadily, as the
    /// ground comes up faster than the horizon: a constant that is nobody's acceleration is left out.
    fn new(equations: &[Equation], floor: f64, depth: f64) -> Option<Self> {
        let mut fit = Self {
            offset: Equation { distortion: Vector2::zeros(), by: Regressors::zeros() },
            weights: vec![1.0; equations.len()],
            precisions: Vector2::zeros(),
            unknowns: Unknowns::zeros(),
            inverse: Normal::zeros(),
        };
        let mut errors = vec![Vector2::zeros(); equations.len()];
        let mut sizes = Vec::with_capacity(equations.len());
        for _ in 0..ROUNDS {
            for (error, equation) in errors.iter_mut().zip(equations) {
                *error = fit.error(equation);
            }
            for (kind, precision) in fit.precisions.iter_mut().enumerate() {
                sizes.clear();
                sizes.extend(errors.iter().map(|error| error[kind].abs()));
                *precision = 1.0 / spread(&mut sizes).max(floor).powi(2);
            }
            for (weight, error) in fit.weights.iter_mut().zip(&errors) {
                let size = error.component_mul(error).dot(&fit.precisions) / 2.0;
                *weight = (REACH / (REACH + size)).powi(2);
            }
            if depth > 0.0 {
                fit.centre(equations);
            }
            fit.solve(equations, depth)?;
        }
        Some(fit)
    }

    /// Takes the weighted mean of the equations as their offset.
    fn centre(&mut self, equations: &[Equation]) {
        self.offset = Equation { distortion: Vector2::zeros(), by: Regressors::zeros() };
        let total: f64 = self.weights.iter().sum();
        for (equation, weight) in equations.iter().zip(&self.weights) {
            self.offset.distortion += equation.distortion * (weight / total);
            self.offset.by += equation.by * (weight / total);
        }
    }

    fn by(&self, equation: &Equation) -> Regressors {
        equation.by - self.offset.by
    }

    fn error(&self, equation: &Equation) -> Vector2<f64> {
        equation.distortion - self.offset.distortion - self.by(equation) * self.unknowns
    }

    fn solve(&mut self, equations: &[Equation], depth: f64) -> Option<()> {
        let mut normal = Normal::zeros();
        let mut right = Unknowns::zeros();
        for (equation, weight) in equations.iter().zip(&self.weights) {
            let by = self.by(equation);
            let weighted = self.scaled(&by) * *weight;
            normal += weighted.transpose() * by;
            right += weighted.transpose() * (equation.distortion - self.offset.distortion);
        }
        for unknown in 0..UNKNOWNS {
            if unknown < 2 {
                normal[(unknown, unknown)] += 1.0 / (WIDE * WIDE);
            } else if depth > 0.0 {
                normal[(unknown, unknown)] += 1.0 / (depth * depth);
            } else {
                normal.row_mut(unknown).fill(0.0);
                normal.column_mut(unknown).fill(0.0);
                normal[(unknown, unknown)] = 1.0;
                right[unknown] = 0.0;
            }
        }
        self.inverse = normal.cholesky()?.inverse();
        if depth == 0.0 {
            for unknown in 2..UNKNOWNS {
                self.inverse[(unknown, unknown)] = 0.0;
            }
        }
        self.unknowns = self.inverse * right;
        Some(())
    }

    /// The usual square of the lean and the stretch that are left.
    fn lean(&self) -> f64 {
        self.precisions.iter().map(|precision| 1.0 / precision).sum()
    }

    fn scaled(&self, by: &Regressors) -> Regressors {
        let mut by = *by;
        for (mut row, precision) in by.row_iter_mut().zip(&self.precisions) {
            row *= *precision;
        }
        by
    }

    /// The variance that the model's own errors may give the readout time along an axis.
    fn bias(&self, equations: &[Equation], axis: usize, ripple: f64) -> f64 {
        let (mut misfit, mut effect, mut plain) = (0.0, 0.0, 0.0);
        for (equation, weight) in equations.iter().zip(&self.weights) {
            let (error, by) = (self.error(equation), self.by(equation));
            let by = by.column(axis);
            misfit += weight * error.component_mul(&error).dot(&self.precisions);
            effect += weight * by.component_mul(&by).dot(&self.precisions);
            plain += by.norm_squared() / equations.len() as f64;
        }
        CONSPIRACY * CONSPIRACY * misfit / effect + ALIASED * ALIASED * ripple / plain
    }

    /// Covariance whatever the errors' sizes and correlation: W. K. Newey and K. D. West, *A simple,
    /// positive semi-definite, heteroskedasticity and autocorrelation consistent covariance matrix*,
    /// Econometrica 55, 1987; and that of errors of the assumed size.
    fn sandwich(&self, equations: &[Equation]) -> Normal {
        let score = |(equation, weight): (&Equation, &f64)| {
            self.scaled(&self.by(equation)).transpose() * self.error(equation) * *weight
        };
        let scores: Vec<Unknowns> = equations.iter().zip(&self.weights).map(score).collect();
        let mut sum = Normal::zeros();
        for (index, score) in scores.iter().enumerate() {
            sum += score * score.transpose();
            for lag in 1..=LAG.min(index) {
                let share = 1.0 - lag as f64 / (LAG + 1) as f64;
                let cross = scores[index - lag] * score.transpose() * share;
                sum += cross + cross.transpose();
            }
        }
        // Few independent errors tell little of their own size.
        let independent = equations.len() as f64 / LAG as f64;
        let few = (independent + 4.0) / independent;
        self.inverse * (sum * few) * self.inverse + self.inverse
    }
}

/// The usual square of the lean and the stretch.
fn lean(equations: &[Equation]) -> f64 {
    let of = |kind: usize| {
        spread(&mut equations.iter().map(|e| e.distortion[kind].abs()).collect::<Vec<_>>()).powi(2)
    };
    of(0) + of(1)
}

/// Standard deviation about 0 of most values, given their sizes, which are reordered.
fn spread(sizes: &mut [f64]) -> f64 {
    /// Standard deviation over the median size of normal errors.
    const FROM_MEDIAN: f64 = 1.4826;
    FROM_MEDIAN * median(sizes)
}
