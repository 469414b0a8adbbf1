// SPDX-License-Identifier: MIT OR Apache-2.0

//! Linear prediction of a path's steps from knot to knot.
//!
//! A sum of sinusoids obeys x(t) = Σₖ aₖ·x(t − k), with two weights for each, whatever their amplitudes and
//! phases. A vibration is such a sum with slowly varying amplitudes; so its path is determined where few
//! matches constrain it. A whole number of cycles a frame hardly shows between frames: smoothness alone would
//! suppress it and alias its neighbours.
//!
//! The weights are estimated by EM (R. H. Shumway, D. S. Stoffer, *An approach to time series smoothing and
//! forecasting using the EM algorithm*, J. Time Series Analysis 3(4), 1982): regression on the second moments
//! of the steps, which include their posterior covariance. There are more weights than the sinusoids need,
//! shrunk by a ridge, so that the surplus ones describe damped motions (D. W. Tufts, R. Kumaresan,
//! *Estimation of frequencies of multiple sinusoids*, Proc. IEEE 70(9), 1982).

use crate::solve::continuous::linear::Banded;
use nalgebra::{DMatrix, DVector};

/// Over-relaxation of the EM steps, which converge slowly and from one side; stable below 2.
const OVER_RELAXATION: f64 = 1.5;

/// Weights by which a generator's next step is predicted from those before it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Prediction {
    /// The newest first.
    weights: Vec<f64>,
    /// The prediction error of a step, as weights of `order` + 2 successive coefficients.
    pub error: Vec<f64>,
}

impl Prediction {
    /// Each step equals the one before.
    pub fn constant_rate() -> Self {
        Self::with_weights(vec![1.0])
    }

    /// Number of steps from which the next one is predicted.
    pub fn order(&self) -> usize {
        self.weights.len()
    }

    fn weight(&self, lag: usize) -> f64 {
        self.weights.get(lag).copied().unwrap_or(0.0)
    }

    fn with_weights(weights: Vec<f64>) -> Self {
        let steps = weights.iter().rev().map(|weight| -weight).chain([1.0]);
        let mut error = vec![0.0; weights.len() + 2];
        for (k, step) in steps.enumerate() {
            error[k] -= step;
            error[k + 1] += step;
        }
        Self { weights, error }
    }

    /// One EM step, with as many weights as the moments have lags; `ridge` in px².
    pub fn learn(&mut self, moments: &Moments, ridge: f64) {
        let order = moments.order();
        let all = &moments.path + &moments.spread;
        let old = DVector::from_fn(order, |lag, _| self.weight(lag));
        let mut matrix = all.view((1, 1), (order, order)).into_owned();
        let mut right = all.view((1, 0), (order, 1)).column(0) - &matrix * &old;
        for lag in 0..order {
            let constant_rate = if lag == 0 { 1.0 } else { 0.0 };
            right[lag] += ridge * (constant_rate - old[lag]);
            matrix[(lag, lag)] += ridge;
        }
        let learnt = matrix.cholesky().map(|factor| old + factor.solve(&right) * OVER_RELAXATION);
        if let Some(weights) = learnt.filter(|weights| weights.iter().all(|weight| weight.is_finite())) {
            *self = Self::with_weights(weights.iter().copied().collect());
        }
    }
}

/// Sums of products of a step and those before it, in px²; rows and columns are lags from 0 to the order.
#[derive(Clone, Debug)]
pub struct Moments {
    /// Of the path.
    path: DMatrix<f64>,
    /// Of its posterior covariance.
    spread: DMatrix<f64>,
    /// Number of products in each sum.
    pub count: f64,
}

impl Moments {
    /// Of the runs of `order` + 2 coefficients at these places.
    pub fn of<At: Fn(usize) -> usize>(
        runs: impl Iterator<Item = At>,
        order: usize,
        coefficients: &[f64],
        covariance: &Banded,
    ) -> Self {
        let zeros = || DMatrix::zeros(order + 1, order + 1);
        let mut moments = Self { path: zeros(), spread: zeros(), count: 0.0 };
        for at in runs {
            moments.count += 1.0;
            // The coefficients whose difference is the step at some lag.
            let ends = |lag: usize| [at(order + 1 - lag), at(order - lag)];
            let step = |lag: usize| ends(lag).map(|end| coefficients[end]);
            for k in 0..=order {
                let ([a, b], [new, old]) = (ends(k), step(k));
                for l in 0..=k {
                    let ([c, d], [newer, older]) = (ends(l), step(l));
                    let z = |p: usize, q: usize| covariance.at(p, q);
                    moments.path[(k, l)] += (new - old) * (newer - older);
                    moments.spread[(k, l)] += z(a, c) - z(a, d) - z(b, c) + z(b, d);
                }
            }
        }
        moments.path.fill_upper_triangle_with_lower_triangle();
        moments.spread.fill_upper_triangle_with_lower_triangle();
        moments
    }

    fn order(&self) -> usize {
        self.path.nrows() - 1
    }

    /// Mean square of the path's second differences.
    pub fn bend(&self) -> f64 {
        (self.path[(0, 0)] + self.path[(1, 1)] - 2.0 * self.path[(0, 1)]) / self.count
    }

    /// Sum of the squared prediction errors of the path, and the sum of their posterior variances.
    pub fn error_squares(&self, prediction: &Prediction) -> [f64; 2] {
        let error = |lag: usize| if lag == 0 { 1.0 } else { -prediction.weight(lag - 1) };
        let error = DVector::from_fn(self.order() + 1, |lag, _| error(lag));
        [&self.path, &self.spread].map(|sums| error.dot(&(sums * &error)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Moments of a path without covariance.
    fn moments(order: usize, path: impl Fn(f64) -> f64) -> Moments {
        let coefficients: Vec<f64> = (0..60).map(|k| path(k as f64)).collect();
        let runs = (0..coefficients.len() - order - 1).map(|start| move |index: usize| start + index);
        let mut covariance = Banded::default();
        covariance.reset((0..coefficients.len()).map(|row| row.saturating_sub(4)));
        Moments::of(runs, order, &coefficients, &covariance)
    }

    #[test]
    fn the_weights_of_a_sinusoid_are_the_closed_form_s() {
        // sin(ωt) + sin(ω(t − 2)) = 2·cos ω·sin(ω(t − 1)).
        let moments = moments(2, |t| 5.0 * (0.7 * t + 0.4).sin());
        let mut prediction = Prediction::constant_rate();
        (0..60).for_each(|_| prediction.learn(&moments, 1e-9));
        let expected = [2.0 * 0.7f64.cos(), -1.0];
        assert!(prediction.weights.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{prediction:?}");
        assert!(moments.error_squares(&prediction)[0] < 1e-9);
    }

    #[test]
    fn surplus_weights_stay_small() {
        // Two sinusoids need four weights, of up to 4; there are twelve.
        let moments = moments(12, |t| 5.0 * (0.7 * t).sin() + 2.0 * (1.2 * t + 0.4).sin());
        let mut prediction = Prediction::constant_rate();
        (0..60).for_each(|_| prediction.learn(&moments, 1e-3));
        assert!(prediction.weights.iter().all(|weight| weight.abs() < 1.0), "{prediction:?}");
        assert!(moments.error_squares(&prediction)[0] < 1e-3);
    }

    #[test]
    fn the_prediction_error_of_a_constant_rate_is_the_second_difference() {
        assert_eq!(Prediction::constant_rate().error, [1.0, -2.0, 1.0]);
        // c₃ − c₂ − ½·(c₂ − c₁) + ¼·(c₁ − c₀).
        let prediction = Prediction::with_weights(vec![0.5, -0.25]);
        assert_eq!(prediction.error, [-0.25, 0.75, -1.5, 1.0]);
    }

    #[test]
    fn moments_include_the_covariance() {
        // Coefficients of variance 1: a step has variance 2, and shares one end with the next.
        let mut covariance = Banded::default();
        covariance.reset([0; 3]);
        (0..3).for_each(|k| covariance.add(k, k, 1.0));
        let moments = Moments::of(std::iter::once(|index: usize| index), 1, &[0.0, 1.0, 4.0], &covariance);
        assert_eq!(moments.path, DMatrix::from_row_slice(2, 2, &[9.0, 3.0, 3.0, 1.0]));
        assert_eq!(moments.spread, DMatrix::from_row_slice(2, 2, &[2.0, -1.0, -1.0, 2.0]));
        assert_eq!((moments.count, moments.bend()), (1.0, 4.0));
        // The error is 4 − 2·1 + 0 = 2, of variance 1 + 4 + 1.
        assert_eq!(moments.error_squares(&Prediction::constant_rate()), [4.0, 6.0]);
    }
}
