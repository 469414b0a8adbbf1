//! How smooth the path is: a prior whose strength is learnt from the window.
//!
//! The second differences of each generator's coefficients are Gaussian with a variance of its own; where the picture
//! vibrates, it is what a turn's steps have beyond their prediction. The variance is learnt by MacKay's rule
//! (D. J. C. MacKay, *Bayesian interpolation*, Neural Computation 4(3), 1992): variance = Σ d² / γ, where γ,
//! the number of differences that the data determine, is their number less their share of posterior variance
//! in the prior one. A generator that the picture does not bear out goes to nothing, and one that is needed
//! is left free.

use super::prediction::{Moments, Prediction};
use crate::motion::generators::{GENERATORS, TURNS};
use crate::solve::continuous::linear::Banded;
use crate::solve::continuous::trajectory::Splines;

/// Variance with which the other generators start.
const OTHERS_START: f64 = 0.01;
/// What a variance may become.
const LIMITS: [f64; 2] = [1e-7, 1e4];
/// The most that a variance may change at once.
const MOST_CHANGE: f64 = 10.0;
/// Share of the differences that are determined at least, well above rounding. With 1e-3 a generator whose variance had become
/// far smaller than its posterior one never came back, as MacKay's rule then makes too little of the little that it moves.
const LEAST_DETERMINED: f64 = 1e-7;
/// Variances in px² of the first differences of the turns, which have four knots to a block, and of the others, which have
/// one: all but free.
const RATES: [f64; 2] = [100.0, 400.0];
/// Inverse variance of the coefficients: only differences can be seen.
const LEVEL: f64 = 1e-6;
/// Variance of the differences of a generator that the model does not have.
const NONE: f64 = 1e-7;
/// A prediction has no more than one weight to so many knots.
const KNOTS_TO_A_WEIGHT: usize = 3;
/// Variance of what is new in a step over that of a weight: what holds weights small.
const HOLD: f64 = 3.0;
/// A path that bends from knot to knot by less than so many times the noise is not predicted.
const NOTICEABLE: f64 = 2.0;

const FIRST: [f64; 2] = [-1.0, 1.0];

/// The prior.
#[derive(Clone, Debug)]
pub struct Smoothness {
    active: [bool; GENERATORS],
    /// Variance with which the turns start.
    turns: f64,
    /// How each path goes on.
    predictions: [Prediction; GENERATORS],
    /// Variance of what is new in its steps.
    variance: [f64; GENERATORS],
}

impl Default for Smoothness {
    /// Of a model without generators.
    fn default() -> Self {
        Self::new([false; GENERATORS], OTHERS_START)
    }
}

impl Smoothness {
    /// A prior for a model with these generators, and the variance in px² with which turns start: rather
    /// too large, for calm is learnt sooner than shake.
    pub fn new(active: [bool; GENERATORS], turns: f64) -> Self {
        let variance = std::array::from_fn(|j| if j < TURNS { turns } else { OTHERS_START });
        Self { active, turns, predictions: std::array::from_fn(|_| Prediction::even()), variance }
    }

    /// The same from another start.
    pub fn started(&self, turns: f64) -> Self {
        Self::new(self.active, turns)
    }

    /// Forgets what was learnt.
    pub fn restart(&mut self) {
        *self = Self::new(self.active, self.turns);
    }

    /// Number of steps from which a generator's next one may be told, of `order` at most; it has so many coefficients.
    fn order(generator: usize, order: usize, coefficients: usize) -> usize {
        if generator < TURNS { order.min(coefficients / KNOTS_TO_A_WEIGHT).max(1) } else { 1 }
    }

    /// Moves the columns at which the rows of a matrix begin back to where the prior needs them, and learning
    /// from up to `order` steps.
    pub fn reach(&self, path: &Splines, order: usize, first: &mut [usize]) {
        for j in 0..GENERATORS {
            let places = path.places(j);
            let order = Self::order(j, order, places.count).max(self.predictions[j].order());
            for at in places.runs(order + 2) {
                for row in (1..order + 2).map(&at) {
                    first[row] = first[row].min(at(0));
                }
            }
        }
    }

    /// Adds the prior to normal equations about the path as it is; with `share` of the variances that were learnt.
    pub fn add(&self, path: &Splines, share: f64, matrix: &mut Banded, right: &mut [f64]) {
        let c = &path.coefficients;
        for j in 0..GENERATORS {
            let rate = RATES[usize::from(j >= TURNS)];
            let (innovation, first) =
                if self.active[j] { (share * self.variance[j], rate) } else { (NONE, NONE) };
            let places = path.places(j);
            for (difference, variance) in [(self.predictions[j].error(), innovation), (&FIRST, first)] {
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
        for place in 0..c.len() {
            matrix.add(place, place, LEVEL);
        }
    }

    /// Learns from a path and the covariance of its coefficients. A turn's next step is told from up to
    /// `order` before it, where the path bends by more than `noise`, the deviation of a point in pixels, may
    /// make it.
    pub fn learn(&mut self, path: &Splines, covariance: &Banded, order: usize, noise: f64) {
        for j in (0..GENERATORS).filter(|j| self.active[*j]) {
            let places = path.places(j);
            let moments =
                |order: usize| Moments::of(places.runs(order + 2), order, &path.coefficients, covariance);
            let order = Self::order(j, order, places.count);
            let mut least = LIMITS[0];
            let mut sums = moments(order);
            if order > 1 && sums.bend() > (NOTICEABLE * noise).powi(2) {
                least = noise * noise;
                self.predictions[j].learn(&sums, HOLD * self.variance[j]);
            } else {
                if order > 1 {
                    sums = moments(1);
                }
                if self.predictions[j].order() > 1 {
                    self.predictions[j] = Prediction::even();
                }
            }
            let [energy, trace] = sums.innovation(&self.predictions[j]);
            let old = self.variance[j];
            let determined = (sums.count - trace / old).max(LEAST_DETERMINED * sums.count);
            let new = (energy / determined).clamp(old / MOST_CHANGE, old * MOST_CHANGE);
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

    /// Room for all that the prior adds.
    fn band(size: usize) -> impl Iterator<Item = usize> {
        (0..size).map(|row| row.saturating_sub(3 * BLOCK))
    }

    /// What is learnt of coefficients of which each was measured with deviation `noise`.
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
            matrix.solve(&mut right);
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
            let mut truth = Splines { base: 0, coefficients: vec![0.0; blocks * BLOCK], kappa: 0.3 };
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
            // What does not move is held still: next to nothing beside the noise of 0.0025.
            assert!(found.variance[1..].iter().all(|variance| *variance < 5e-4), "{:?}", found.variance);
        }
    }

    #[test]
    fn a_generator_that_was_not_needed_comes_back() {
        // Matches tell that each second difference is ±1 px, with the variance `told`; the prior holds them at next to nothing.
        let (held, told) = (LIMITS[0], 0.01);
        let share = held / (held + told);
        let mut path = Splines { base: 0, coefficients: vec![0.0; 10 * BLOCK], kappa: 0.3 };
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
        // Their mean square over the share that is determined: a hundred times as much, of which ten are allowed at once.
        let grown = smoothness.variance[TURNS] / held;
        assert!((grown / MOST_CHANGE - 1.0).abs() < 1e-9, "{grown}");
    }

    #[test]
    fn what_the_model_lacks_stays_still() {
        let smoothness = Smoothness::new(Model::Translation.generators(), 1.0);
        let path = Splines { base: 0, coefficients: vec![0.0; 4 * BLOCK], kappa: 0.0 };
        let mut matrix = Banded::default();
        matrix.reset(band(path.coefficients.len()));
        smoothness.add(&path, 1.0, &mut matrix, &mut vec![0.0; path.coefficients.len()]);
        let stiffness = |j: usize| matrix.at(path.place(j, 1) as usize, path.place(j, 1) as usize);
        // Yaw is part of the model, roll and scale are not.
        assert!(stiffness(0) < 10.0 && stiffness(2) > 1e6 && stiffness(5) > 1e6);
    }

    #[test]
    fn an_even_motion_costs_next_to_nothing() {
        // xᵀ·P·x for a line: only the all but free first differences and levels count.
        let mut path = Splines { base: 0, coefficients: vec![0.0; 4 * BLOCK], kappa: 0.0 };
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
