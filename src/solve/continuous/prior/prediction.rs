//! How a path goes on: linear prediction of its steps from knot to knot.
//!
//! A sum of sinusoids obeys x(t) = Σₖ aₖ·x(t − k), two weights to each, whatever their amplitudes and phases.
//! What vibrates is such a sum, of amplitudes that change slowly; so a path whose weights are known goes on
//! where nothing is seen of it, and what a window of a few frames tells of it is enough. What takes a whole
//! number of cycles a frame is next to invisible between frames: smoothness alone sets it to nothing and
//! mistakes its neighbours for it.
//!
//! The weights are learnt by expectation and maximisation (R. H. Shumway, D. S. Stoffer, *An approach to time series
//! smoothing and forecasting using the EM algorithm*, J. Time Series Analysis 3(4), 1982): regression on the second
//! moments of the steps, those of the path and of its posterior covariance. There are more weights than
//! sinusoids ask for, and they are held small: so the surplus ones describe motions that die down (D. W.
//! Tufts, R. Kumaresan, *Estimation of frequencies of multiple sinusoids*, Proc. IEEE 70(9), 1982).

use crate::solve::continuous::linear::Banded;
use nalgebra::{DMatrix, DVector};

/// Expectation and maximisation approaches slowly from one side: its steps are taken so many times, where
/// less than 2 is safe.
const OVERSHOOT: f64 = 1.5;

/// Weights by which a generator's next step follows from those before it.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// The newest first.
    weights: Vec<f64>,
    /// What is new in a step, as weights of coefficients in a row.
    error: Vec<f64>,
}

impl Prediction {
    /// Each step is like the one before.
    pub fn even() -> Self {
        Self::with_weights(vec![1.0])
    }

    /// Number of steps from which the next one is told.
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

    /// What is new in a step, as weights of `order` + 2 coefficients in a row.
    pub fn error(&self) -> &[f64] {
        &self.error
    }

    /// Learns as many weights as there are moments of. `hold`, in px², is what keeps them small.
    pub fn learn(&mut self, moments: &Moments, hold: f64) {
        let order = moments.order();
        let all = &moments.path + &moments.spread;
        let old = DVector::from_fn(order, |lag, _| self.weight(lag));
        let mut matrix = all.view((1, 1), (order, order)).into_owned();
        let mut right = all.view((1, 0), (order, 1)).column(0) - &matrix * &old;
        for lag in 0..order {
            let even = if lag == 0 { 1.0 } else { 0.0 };
            right[lag] += hold * (even - old[lag]);
            matrix[(lag, lag)] += hold;
        }
        let learnt = matrix.cholesky().map(|factor| old + factor.solve(&right) * OVERSHOOT);
        if let Some(weights) = learnt.filter(|weights| weights.iter().all(|weight| weight.is_finite())) {
            *self = Self::with_weights(weights.iter().copied().collect());
        }
    }
}

/// Sums of products of a step and those before it, in px².
#[derive(Clone, Debug)]
pub struct Moments {
    /// Those of the path: rows and columns are lags from 0 to the order.
    path: DMatrix<f64>,
    /// What is uncertain of the path adds this.
    spread: DMatrix<f64>,
    /// Number of products in each sum.
    pub count: f64,
}

impl Moments {
    /// Of the coefficients at these places, `order` + 2 in a row, with their covariance.
    pub fn of<At: Fn(usize) -> usize>(
        runs: impl Iterator<Item = At>,
        order: usize,
        coefficients: &[f64],
        covariance: &Banded,
    ) -> Self {
        let mut moments = Self {
            path: DMatrix::zeros(order + 1, order + 1),
            spread: DMatrix::zeros(order + 1, order + 1),
            count: 0.0,
        };
        for at in runs {
            moments.count += 1.0;
            // The two ends of the step at some lag.
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

    /// Sum of the squares of what is new in the steps, and what the uncertainty of the path adds to it.
    pub fn innovation(&self, prediction: &Prediction) -> [f64; 2] {
        let new = |lag: usize| if lag == 0 { 1.0 } else { -prediction.weight(lag - 1) };
        let new = DVector::from_fn(self.order() + 1, |lag, _| new(lag));
        [&self.path, &self.spread].map(|sums| new.dot(&(sums * &new)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Moments of a path that is known.
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
        let mut prediction = Prediction::even();
        (0..60).for_each(|_| prediction.learn(&moments, 1e-9));
        let expected = [2.0 * 0.7f64.cos(), -1.0];
        assert!(prediction.weights.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{prediction:?}");
        assert!(moments.innovation(&prediction)[0] < 1e-9);
    }

    #[test]
    fn surplus_weights_stay_small() {
        // Two sinusoids need four weights, of up to 4; there are twelve.
        let moments = moments(12, |t| 5.0 * (0.7 * t).sin() + 2.0 * (1.2 * t + 0.4).sin());
        let mut prediction = Prediction::even();
        (0..60).for_each(|_| prediction.learn(&moments, 1e-3));
        assert!(prediction.weights.iter().all(|weight| weight.abs() < 1.0), "{prediction:?}");
        assert!(moments.innovation(&prediction)[0] < 1e-3);
    }

    #[test]
    fn the_error_of_an_even_path_s_prediction_is_its_second_difference() {
        assert_eq!(Prediction::even().error(), [1.0, -2.0, 1.0]);
        // c₃ − c₂ − ½·(c₂ − c₁) + ¼·(c₁ − c₀).
        let prediction = Prediction::with_weights(vec![0.5, -0.25]);
        assert_eq!(prediction.error(), [-0.25, 0.75, -1.5, 1.0]);
    }

    #[test]
    fn moments_count_what_is_uncertain() {
        // Coefficients of variance 1: a step has variance 2, and shares one end with the next.
        let mut covariance = Banded::default();
        covariance.reset([0; 3]);
        (0..3).for_each(|k| covariance.add(k, k, 1.0));
        let moments = Moments::of(std::iter::once(|index: usize| index), 1, &[0.0, 1.0, 4.0], &covariance);
        assert_eq!(moments.path, DMatrix::from_row_slice(2, 2, &[9.0, 3.0, 3.0, 1.0]));
        assert_eq!(moments.spread, DMatrix::from_row_slice(2, 2, &[2.0, -1.0, -1.0, 2.0]));
        assert_eq!((moments.count, moments.bend()), (1.0, 4.0));
        // What is new is 4 − 2·1 + 0 = 2, of variance 1 + 4 + 1.
        assert_eq!(moments.innovation(&Prediction::even()), [4.0, 6.0]);
    }
}
