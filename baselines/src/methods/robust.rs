// SPDX-License-Identifier: MIT OR Apache-2.0

//! Robust linear fits: iteratively reweighted least squares over banded normal equations.
//!
//! All image-plane baselines are linear in what they look for, with the same coefficients for x and y.
//! The source of the weights is P. J. Huber and E. M. Ronchetti, *Robust Statistics*, 2nd ed., 2009,
//! chapters 4 and 7; the paper's own minimisation (25.4) is the library's and not used here.

use super::banded::Banded;
use nalgebra::Vector2;

/// Reweightings of the convex cost; it settles to some thousandths of a pixel well before.
const ABSOLUTE_ROUNDS: usize = 15;
/// Reweightings with Tukey's biweight.
const TUKEY_ROUNDS: usize = 10;
/// Tukey's tuning constant, in standard deviations: 95 % efficient on Gaussian errors.
const TUKEY_REACH: f64 = 4.685;
/// Standard deviation over median of the length of a two-dimensional Gaussian error.
const RAYLEIGH: f64 = 0.849;
/// Residuals below this many pixels are told apart no more.
const FLOOR: f64 = 0.01;

/// Σ coefficient · unknown = value, in pixels, for x and y at once.
#[derive(Clone, Debug)]
pub struct Equation {
    /// Index of each unknown that occurs, and its coefficient.
    pub terms: Vec<(usize, f64)>,
    /// What the sum should be.
    pub value: Vector2<f64>,
    /// What being off by a residual costs.
    pub cost: Cost,
}

/// What a residual r, in pixels, costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cost {
    /// As the robust fit says: of a measurement.
    Robust,
    /// weight · r²/2: of what is wished for.
    Squared(f64),
}

impl Equation {
    /// The equation of a measurement.
    pub fn new(terms: impl IntoIterator<Item = (usize, f64)>, value: Vector2<f64>) -> Self {
        Self { terms: terms.into_iter().filter(|term| term.1 != 0.0).collect(), value, cost: Cost::Robust }
    }

    /// The length of what is left of the equation, in pixels.
    fn residual(&self, unknowns: &[Vector2<f64>]) -> f64 {
        let sum: Vector2<f64> = self.terms.iter().map(|(index, factor)| unknowns[*index] * *factor).sum();
        (sum - self.value).norm()
    }
}

/// The unknowns of least Σ |r| over the measurements; `None` where there are no equations or they contradict
/// each other beyond numbers (not finite).
pub fn least_absolute(equations: &[Equation], unknowns: usize) -> Option<Vec<Vector2<f64>>> {
    let mut found = weighted_least_squares(equations, unknowns, |_| 1.0)?;
    for _ in 0..ABSOLUTE_ROUNDS {
        let weight = |equation: &Equation| absolute_weight(equation.residual(&found));
        found = weighted_least_squares(equations, unknowns, weight)?;
    }
    Some(found)
}

/// The unknowns of least Σ Tukey's biweight loss, from the start that [`least_absolute`] gives; the
/// scale is the median residual there, and a measurement costs about r²/(2·scale). Survives outliers up to about a third of the equations.
pub fn tukey(equations: &[Equation], unknowns: usize) -> Option<Vec<Vector2<f64>>> {
    let mut found = least_absolute(equations, unknowns)?;
    let measured = equations.iter().filter(|equation| equation.cost == Cost::Robust);
    let scale = scale(measured.map(|equation| equation.residual(&found)).collect());
    for _ in 0..TUKEY_ROUNDS {
        let weight = |equation: &Equation| tukey_weight(equation.residual(&found), scale) / scale;
        found = weighted_least_squares(equations, unknowns, weight)?;
    }
    Some(found)
}

/// The weight of a residual, in pixels, for the least sum of absolute residuals.
pub fn absolute_weight(residual: f64) -> f64 {
    1.0 / residual.max(FLOOR)
}

/// The weight of a residual by Tukey's biweight, 0 to 1; both in pixels.
pub fn tukey_weight(residual: f64, scale: f64) -> f64 {
    let share = (residual / (TUKEY_REACH * scale)).min(1.0);
    (1.0 - share * share).powi(2)
}

/// The standard deviation of an error's coordinates, in pixels, that its median length tells.
pub fn scale(lengths: Vec<f64>) -> f64 {
    (RAYLEIGH * median(lengths)).max(FLOOR)
}

/// The median, the upper of the middle two of an even number; 0 for none.
pub fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

fn weighted_least_squares(
    equations: &[Equation],
    unknowns: usize,
    reweight: impl Fn(&Equation) -> f64,
) -> Option<Vec<Vector2<f64>>> {
    let span = |equation: &Equation| {
        let indices = equation.terms.iter().map(|term| term.0);
        indices.clone().max().unwrap_or(0) - indices.min().unwrap_or(0)
    };
    let mut normal = Banded::zeros(unknowns, equations.iter().map(span).max()?);
    let mut right = vec![Vector2::zeros(); unknowns];
    for equation in equations {
        let weight = match equation.cost {
            Cost::Robust => reweight(equation),
            Cost::Squared(weight) => weight,
        };
        for &(row, left) in &equation.terms {
            right[row] += equation.value * (weight * left);
            for &(column, factor) in equation.terms.iter().filter(|term| term.0 <= row) {
                *normal.at(row, column) += weight * left * factor;
            }
        }
    }
    let found = normal.solve(right)?;
    found.iter().all(|value| value.iter().all(|v| v.is_finite())).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_found_among_outliers() {
        let equations: Vec<_> = (0..60)
            .map(|i| {
                let x = f64::from(i) / 10.0;
                let off = if i % 3 == 0 { Vector2::new(7.0, 5.0 - x) } else { Vector2::zeros() };
                Equation::new([(0, 1.0), (1, x)], Vector2::new(2.0 + 0.5 * x, -x) + off)
            })
            .collect();
        let found = tukey(&equations, 2).unwrap();
        assert!((found[0] - Vector2::new(2.0, 0.0)).norm() < 1e-6, "{found:?}");
        assert!((found[1] - Vector2::new(0.5, -1.0)).norm() < 1e-6, "{found:?}");
    }

    #[test]
    fn the_least_absolute_error_is_at_the_median() {
        let values = [1.0, 2.0, 3.0, 50.0, 90.0];
        let equations: Vec<_> =
            values.iter().map(|v| Equation::new([(0, 1.0)], Vector2::new(*v, 0.0))).collect();
        let found = least_absolute(&equations, 1).unwrap();
        assert!((found[0].x - 3.0).abs() < 2.0 * FLOOR, "{found:?}");
    }

    #[test]
    fn nothing_measured_has_no_solution() {
        assert!(tukey(&[], 2).is_none());
    }
}
