//! Robust regression of equations whose errors are correlated from one to the next.

use super::equations::{Equation, Regressors, UNKNOWNS};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector5, Vector6};

/// Share of a ripple within the frame that counts as an error of the lean.
const ALIASED: f64 = 0.2;
/// What the model's approximations cost, in periods.
const MODEL: f64 = 0.004;

type Unknowns = SVector<f64, UNKNOWNS>;
type Normal = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Rounds of reweighting.
const ROUNDS: usize = 6;
/// Equations whose errors are taken to be correlated with each other: those share frames.
const LAG: usize = 8;
/// Expected size of the slopes of inverse depth over half the frame, as a share of its mean, at
/// most and at least.
const DEPTH: [f64; 2] = [0.5, 0.002];
/// What it is taken to be at first.
const DEPTH_START: f64 = 0.1;
/// Correlation that a misfit of the model may have with what a readout does.
const CONSPIRACY: f64 = 0.1;

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
}

/// The readout times that explain most equations. `floor` is the standard deviation of a distortion
/// below which the spread is not believed.
pub(super) fn regress(equations: &[Equation], floor: f64, ripple: [f64; 2]) -> Option<Gaussian> {
    if equations.len() < 4 {
        return None;
    }
    let mut weights = vec![1.0; equations.len()];
    let mut precisions = Vector6::repeat(1.0);
    for (i, precision) in precisions.iter_mut().enumerate() {
        *precision = 1.0 / spread(equations.iter().map(|e| e.distortion[i]), floor).powi(2);
    }
    let mut depth = Vector5::repeat(DEPTH_START);
    let mut solution = solve(equations, &weights, &precisions, &depth)?;
    for _ in 0..ROUNDS {
        let errors: Vec<Vector6<f64>> = equations.iter().map(|e| e.distortion - e.by * solution.0).collect();
        for (i, precision) in precisions.iter_mut().enumerate() {
            *precision = 1.0 / spread(errors.iter().map(|e| e[i]), floor).powi(2);
        }
        for (weight, error) in weights.iter_mut().zip(&errors) {
            let size = error.component_mul(error).dot(&precisions) / 6.0;
            *weight = (4.0 / (4.0 + size)).powi(2);
        }
        // Evidence: a shape that the picture does not bear is not left to imitate the shutter.
        for (shape, size) in depth.iter_mut().enumerate() {
            let (mean, variance) = (solution.0[2 + shape], solution.1[(2 + shape, 2 + shape)]);
            *size = (mean * mean + variance).sqrt().clamp(DEPTH[1], DEPTH[0]);
        }
        solution = solve(equations, &weights, &precisions, &depth)?;
    }
    let (unknowns, inverse) = solution;
    let covariance = sandwich(equations, &weights, &precisions, &unknowns, &inverse);
    let mut covariance = covariance.fixed_view::<2, 2>(0, 0).into_owned();
    for axis in 0..2 {
        let (mut misfit, mut effect, mut total) = (0.0, 0.0, 0.0);
        for (equation, weight) in equations.iter().zip(&weights) {
            let error = equation.distortion - equation.by * unknowns;
            misfit += weight * error.component_mul(&error).dot(&precisions);
            let by = equation.by.column(axis);
            effect += weight * by.component_mul(&by).dot(&precisions);
            total += by.norm_squared() / equations.len() as f64;
        }
        covariance[(axis, axis)] += CONSPIRACY * CONSPIRACY * misfit / effect;
        covariance[(axis, axis)] += ALIASED * ALIASED * ripple[axis] / total + MODEL * MODEL;
    }
    let finite = unknowns.iter().chain(covariance.iter()).all(|value| value.is_finite());
    finite.then_some(Gaussian { mean: unknowns.fixed_rows::<2>(0).into_owned(), covariance })
}

/// Standard deviation of most values about 0, from their median size.
fn spread(values: impl Iterator<Item = f64>, floor: f64) -> f64 {
    let mut sizes: Vec<f64> = values.map(f64::abs).collect();
    let middle = sizes.len() / 2;
    let median = *sizes.select_nth_unstable_by(middle, f64::total_cmp).1;
    (1.4826 * median).max(floor)
}

/// The unknowns and the inverse of their normal matrix.
fn solve(
    equations: &[Equation],
    weights: &[f64],
    precisions: &Vector6<f64>,
    depth: &Vector5<f64>,
) -> Option<(Unknowns, Normal)> {
    let mut normal = Normal::zeros();
    let mut right = Unknowns::zeros();
    for (equation, weight) in equations.iter().zip(weights) {
        let weighted = scaled(&equation.by, precisions) * *weight;
        normal += weighted.transpose() * equation.by;
        right += weighted.transpose() * equation.distortion;
    }
    for axis in 0..2 {
        normal[(axis, axis)] += 0.01;
    }
    for shape in 2..UNKNOWNS {
        normal[(shape, shape)] += depth[shape - 2].powi(-2);
    }
    let inverse = normal.cholesky()?.inverse();
    Some((inverse * right, inverse))
}

fn scaled(by: &Regressors, precisions: &Vector6<f64>) -> Regressors {
    let mut by = *by;
    for (mut row, precision) in by.row_iter_mut().zip(precisions) {
        row *= *precision;
    }
    by
}

/// Covariance whatever the errors' sizes and correlation: W. K. Newey and K. D. West, *A simple,
/// positive semi-definite, heteroskedasticity and autocorrelation consistent covariance matrix*,
/// Econometrica 55, 1987.
fn sandwich(
    equations: &[Equation],
    weights: &[f64],
    precisions: &Vector6<f64>,
    unknowns: &Unknowns,
    inverse: &Normal,
) -> Normal {
    let score = |(equation, weight): (&Equation, &f64)| {
        let error = equation.distortion - equation.by * unknowns;
        scaled(&equation.by, precisions).transpose() * error * *weight
    };
    let scores: Vec<Unknowns> = equations.iter().zip(weights).map(score).collect();
    let mut sum = Normal::zeros();
    for (index, score) in scores.iter().enumerate() {
        sum += score * score.transpose();
        for lag in 1..=LAG.min(index) {
            let share = 1.0 - lag as f64 / (LAG + 1) as f64;
            let cross = scores[index - lag] * score.transpose() * share;
            sum += cross + cross.transpose();
        }
    }
    let independent = equations.len() as f64 / LAG as f64;
    let small = (independent + 4.0) / independent.max(0.5);
    inverse * (sum * small) * inverse + inverse
}
