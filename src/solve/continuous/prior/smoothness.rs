// SPDX-License-Identifier: MIT OR Apache-2.0

//! Smoothness prior of the path, its variances learnt from the window.
//!
//! The second differences of each generator's coefficients are Gaussian with a variance of their own; of a
//! vibrating turn, it is the prediction errors of its steps. The variance is learnt by MacKay's rule (D. J.
//! C. MacKay, *Bayesian interpolation*, Neural Computation 4(3), 1992): Σ d² over the number of differences
//! that the data determine, which is their number less Σ (posterior variance / prior variance). The variance
//! of a generator that the data do not need tends to zero; one that is needed keeps enough to follow.

use super::prediction::{Moments, Prediction};
use crate::motion::generators::{GENERATORS, TURNS};
use crate::solve::continuous::linear::Banded;
use crate::solve::continuous::trajectory::Splines;

/// Initial variance in px² of the generators other than the turns.
const OTHERS_START: f64 = 0.01;
/// Limits of a variance in px². A generator that the model lacks has the least one.
const LIMITS: [f64; 2] = [1e-7, 1e4];
/// Greatest factor by which a variance changes at once.
const MAX_CHANGE: f64 = 10.0;
/// Least share of the differences that counts as determined, well above rounding. With 1e-3 a generator never
/// came back whose variance was far below its posterior one: MacKay's rule then underestimates the little
/// that it moves.
const MIN_DETERMINED: f64 = 1e-7;
/// Weak prior: variances in px² of first differences, of the turns and of the others.
const RATE_VARIANCES: [f64; 2] = [100.0, 400.0];
/// Inverse variance in px⁻² of the coefficients. Only differences are observed and used, so a path's level is a
/// gauge, which this fixes.
const LEVEL_INFORMATION: f64 = 1e-6;
/// Knots to a weight of a prediction, at least.
const KNOTS_PER_WEIGHT: usize = 3;
/// The ridge on the weights, over the variance of the prediction error.
const RIDGE: f64 = 3.0;
/// Second differences below this many times the noise are not predicted.
const MIN_BEND: f64 = 2.0;
/// The first difference, as weights of two coefficients.
const FIRST_DIFFERENCE: [f64; 2] = [-1.0, 1.0];

/// The prior; by default, of a model without generators.
#[derive(Clone, Debug, Default)]
pub struct Smoothness {
    active: [bool; GENERATORS],
    /// Initial variance in px² of the turns.
    start: f64,
    predictions: [Prediction; GENERATORS],
    /// Variance in px² of each generator's prediction error.
    variance: [f64; GENERATORS],
}

impl Smoothness {
    /// The prior for these generators; `start` is the initial variance in px² of the turns, rather too large
    /// than too small, as it shrinks faster than it grows.
    pub fn new(active: [bool; GENERATORS], start: f64) -> Self {
        let variance = std::array::from_fn(|j| if j < TURNS { start } else { OTHERS_START });
        Self { active, start, predictions: std::array::from_fn(|_| Prediction::constant_rate()), variance }
    }

    /// The initial prior of the same model from another variance of the turns.
    pub fn restarted(&self, start: f64) -> Self {
        Self::new(self.active, start)
    }

    /// Resets all that was learnt.
    pub fn restart(&mut self) {
        *self = self.restarted(self.start);
    }

    /// Order of a generator's prediction, at most `order`, for so many coefficients.
    fn order(generator: usize, order: usize, coefficients: usize) -> usize {
        if generator < TURNS { order.min(coefficients / KNOTS_PER_WEIGHT).max(1) } else { 1 }
    }

    /// The first columns of the rows of a band that holds the prior, with predictions up to `order`.
    pub fn first_columns(&self, path: &Splines, order: usize) -> Vec<usize> {
        let mut first: Vec<usize> = (0..path.coefficients.len()).collect();
        for j in 0..GENERATORS {
            let places = path.places(j);
            let order = Self::order(j, order, places.count).max(self.predictions[j].order());
            for at in places.runs(order + 2) {
                for row in (1..order + 2).map(&at) {
                    first[row] = first[row].min(at(0));
                }
            }
        }
        first
    }

    /// Adds the prior to normal equations about the current path, with a `share` of the learnt variances.
    pub fn add(&self, path: &Splines, share: f64, matrix: &mut Banded, right: &mut [f64]) {
        let c = &path.coefficients;
        for j in 0..GENERATORS {
            let [error, rate] = if self.active[j] {
                [share * self.variance[j], RATE_VARIANCES[usize::from(j >= TURNS)]]
            } else {
                [LIMITS[0]; 2]
            };
            let places = path.places(j);
            for (difference, variance) in [(&self.predictions[j].error[..], error), (&FIRST_DIFFERENCE, rate)]
            {
                for at in places.runs(difference.len()) {
                    let value: f64 = difference.iter().enumerate().map(|(p, weight)| weight * c[at(p)]).sum();
                    for (p, one) in difference.iter().enumerate() {
                        right[at(p)] -= one * value / variance;
                        for (q, other) in difference[..=p].iter().enumerate() {
                            matrix.add(at(p), at(q), one * other / variance);
                        }
                    }
                }
            }
        }
        (0..c.len()).for_each(|place| matrix.add(place, place, LEVEL_INFORMATION));
    }

    /// Updates variances and predictions from a path and the covariance of its coefficients. A turn is
    /// predicted from up to `order` steps if it bends by more than the `noise` of a point in pixels explains.
    pub fn learn(&mut self, path: &Splines, covariance: &Banded, order: usize, noise: f64) {
        for j in (0..GENERATORS).filter(|j| self.active[*j]) {
            let places = path.places(j);
            let moments =
                |order: usize| Moments::of(places.runs(order + 2), order, &path.coefficients, covariance);
            let order = Self::order(j, order, places.count);
            let mut least = LIMITS[0];
            let mut sums = moments(order);
            if order > 1 && sums.bend() > (MIN_BEND * noise).powi(2) {
                least = noise * noise;
                self.predictions[j].learn(&sums, RIDGE * self.variance[j]);
            } else {
                if order > 1 {
                    sums = moments(1);
                }
                if self.predictions[j].order() > 1 {
                    self.predictions[j] = Prediction::constant_rate();
                }
            }
            let [energy, trace] = sums.error_squares(&self.predictions[j]);
            let old = self.variance[j];
            let determined = (sums.count - trace / old).max(MIN_DETERMINED * sums.count);
            let new = (energy / determined).clamp(old / MAX_CHANGE, old * MAX_CHANGE);
            if new.is_finite() {
                self.variance[j] = new.clamp(least, LIMITS[1]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::CpuLevel;
    use crate::motion::generators::Model;
    use crate::solve::continuous::trajectory::BLOCK;
    use crate::solve::random::Random;

    /// First columns of a band that holds the prior.
    fn band(size: usize) -> impl Iterator<Item = usize> {
        (0..size).map(|row| row.saturating_sub(3 * BLOCK))
    }

    /// The prior learnt from coefficients that were each measured with the deviation `noise`.
    fn learnt(truth: &Splines, noise: f64, random: &mut Random) -> Smoothness {
        let measured: Vec<f64> =
            truth.coefficients.iter().map(|value| value + noise * random.normal()).collect();
        let mut smoothness = Smoothness::new(Model::Auto.generators(), 1.0);
        let mut path = Splines { coefficients: measured.clone(), ..truth.clone() };
        let (mut matrix, mut covariance) = (Banded::default(), Banded::default());
        for _ in 0..60 {
            matrix.reset(band(measured.len()));
            let off = |(value, measured): (&f64, &f64)| (measured - value) / (noise * noise);
            let mut right: Vec<f64> = path.coefficients.iter().zip(&measured).map(off).collect();
            (0..measured.len()).for_each(|place| matrix.add(place, place, 1.0 / (noise * noise)));
            smoothness.add(&path, 1.0, &mut matrix, &mut right);
            assert!(matrix.factorise(CpuLevel::detect()));
            matrix.solve(CpuLevel::detect(), &mut right);
            path.coefficients.iter_mut().zip(&right).for_each(|(value, step)| *value += step);
            matrix.inverse_band(CpuLevel::detect(), &mut covariance);
            smoothness.learn(&path, &covariance, 1, noise);
        }
        smoothness
    }

    #[test]
    fn the_variance_of_a_random_path_is_found_again() {
        let blocks = 50;
        let mut random = Random(11);
        for variance in [0.01, 0.2] {
            let mut truth = Splines::still(0, blocks, 0.3);
            // Yaw has second differences of this variance, everything else is still.
            let (mut value, mut rate) = (0.0, 0.0);
            for knot in truth.knots(0) {
                rate += f64::sqrt(variance) * random.normal();
                value += rate;
                let place = truth.place(0, knot) as usize;
                truth.coefficients[place] = value;
            }
            let found = learnt(&truth, 0.05, &mut random);
            // 198 differences: their mean square alone is uncertain by √(2/198) = 10 %.
            let ratio = found.variance[0] / variance;
            assert!((0.7..1.4).contains(&ratio), "{ratio} of {variance}");
            // The variances of still generators are far below that of the noise, 0.0025.
            assert!(found.variance[1..].iter().all(|variance| *variance < 5e-4), "{:?}", found.variance);
        }
    }

    #[test]
    fn a_generator_that_was_not_needed_comes_back() {
        // Matches measure second differences of ±1 px with the variance `measured`; the prior has the
        // variance `held`.
        let (held, measured) = (LIMITS[0], 0.01);
        let share = held / (held + measured);
        let mut path = Splines::still(0, 10, 0.3);
        let mut covariance = Banded::default();
        covariance.reset(band(path.coefficients.len()));
        for knot in path.knots(TURNS) {
            let place = path.place(TURNS, knot) as usize;
            path.coefficients[place] = if knot % 2 == 0 { share / 4.0 } else { -share / 4.0 };
            covariance.add(place, place, held * (1.0 - share) / 6.0);
        }
        let mut smoothness = Smoothness::new(Model::Auto.generators(), 1.0);
        smoothness.variance[TURNS] = held;
        smoothness.learn(&path, &covariance, 1, 0.03);
        // Their mean square over the share that is determined: a hundred times as much, of which ten are
        // allowed at once.
        let grown = smoothness.variance[TURNS] / held;
        assert!((grown / MAX_CHANGE - 1.0).abs() < 1e-9, "{grown}");
    }

    #[test]
    fn generators_that_the_model_lacks_stay_still() {
        let smoothness = Smoothness::new(Model::Translation.generators(), 1.0);
        let path = Splines::still(0, 4, 0.0);
        let mut matrix = Banded::default();
        matrix.reset(band(path.coefficients.len()));
        smoothness.add(&path, 1.0, &mut matrix, &mut vec![0.0; path.coefficients.len()]);
        let stiffness = |j: usize| matrix.at(path.place(j, 1) as usize, path.place(j, 1) as usize);
        // Yaw is part of the model, roll and scale are not.
        assert!(stiffness(0) < 10.0 && stiffness(2) > 1e6 && stiffness(5) > 1e6);
    }

    #[test]
    fn a_constant_rate_costs_next_to_nothing() {
        // xᵀ·P·x for a line: only first differences and levels count.
        let mut path = Splines::still(0, 4, 0.0);
        let smoothness = Smoothness::new(Model::Auto.generators(), 1.0);
        let energy = |path: &Splines| {
            let mut matrix = Banded::default();
            let mut right = vec![0.0; path.coefficients.len()];
            matrix.reset(band(right.len()));
            smoothness.add(path, 1.0, &mut matrix, &mut right);
            -path.coefficients.iter().zip(&right).map(|(x, r)| x * r).sum::<f64>()
        };
        for knot in path.knots(0) {
            let place = path.place(0, knot) as usize;
            path.coefficients[place] = 2.0 * knot as f64;
        }
        // 15 first differences of 2 px at a variance of 100 px².
        assert!((energy(&path) - 15.0 * 4.0 / 100.0).abs() < 1e-9, "{}", energy(&path));
        let place = path.place(0, 7) as usize;
        path.coefficients[place] += 1.0;
        // A step of 1 px at one knot: second differences 1, −2, 1 at a variance of 1, first ones 1, −1.
        let expected = 6.0 + (13.0 * 4.0 + 9.0 + 1.0) / 100.0;
        assert!((energy(&path) - expected).abs() < 1e-9, "{}", energy(&path));
    }
}
