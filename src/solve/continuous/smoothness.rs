//! How smooth the path is: a prior whose strength is learnt from the window.
//!
//! The second differences of each generator's coefficients are Gaussian with a variance of its own. It
//! is learnt by MacKay's rule (D. J. C. MacKay, *Bayesian interpolation*, Neural Computation 4(3), 1992):
//! variance = Σ d² / γ, where γ, the number of differences that the data determine, is their number less
//! their share of posterior variance in the prior one. A generator that the picture does not bear out
//! goes to nothing, and one that is needed is left free.

use super::banded::Banded;
use super::path::SplinePath;
use crate::motion::generators::{GENERATORS, TURNS};

/// Variance with which the other generators start.
const OTHERS_START: f64 = 0.01;
/// What a variance may become.
const LIMITS: [f64; 2] = [1e-7, 1e4];
/// The most that a variance may change at once.
const MOST_CHANGE: f64 = 10.0;
/// Share of the differences that are held to be determined at least.
const LEAST_DETERMINED: f64 = 1e-3;
/// Variance in px² of the first differences: all but free.
const RATE: f64 = 100.0;
/// Inverse variance of the coefficients: only differences can be seen.
const LEVEL: f64 = 1e-6;
/// Variance of the differences of a generator that the model does not have.
const NONE: f64 = 1e-12;

const SECOND: [f64; 3] = [1.0, -2.0, 1.0];
const FIRST: [f64; 3] = [-1.0, 1.0, 0.0];

/// The prior.
#[derive(Clone, Debug)]
pub(super) struct Smoothness {
    active: [bool; GENERATORS],
    /// Variance with which the turns start.
    turns: f64,
    /// Variance of the second differences.
    variance: [f64; GENERATORS],
}

impl Smoothness {
    /// A prior for a model with these generators, and the variance in px² with which turns start: rather
    /// too large, for calm is learnt sooner than shake.
    pub fn new(active: [bool; GENERATORS], turns: f64) -> Self {
        let variance = std::array::from_fn(|j| if j < TURNS { turns } else { OTHERS_START });
        Self { active, turns, variance }
    }

    /// The same from another start.
    pub fn started(&self, turns: f64) -> Self {
        Self::new(self.active, turns)
    }

    /// Forgets what was learnt.
    pub fn restart(&mut self) {
        *self = Self::new(self.active, self.turns);
    }

    /// Places of three coefficients in a row, for each three of a generator.
    fn triples(path: &SplinePath, generator: usize) -> impl Iterator<Item = [usize; 3]> + '_ {
        let knots = path.knots(generator);
        (knots.start..knots.end - 2).filter_map(move |knot| {
            let place = |k: i64| usize::try_from(path.place(generator, knot + k)).ok();
            Some([place(0)?, place(1)?, place(2)?])
        })
    }

    /// Adds the prior to normal equations about the path as it is.
    pub fn add(&self, path: &SplinePath, matrix: &mut Banded, right: &mut [f64]) {
        let c = &path.coefficients;
        for j in 0..GENERATORS {
            let (second, first) = if self.active[j] { (self.variance[j], RATE) } else { (NONE, NONE) };
            for at in Self::triples(path, j) {
                for (difference, variance) in [(SECOND, second), (FIRST, first)] {
                    let value: f64 = (0..3).map(|k| difference[k] * c[at[k]]).sum();
                    for p in 0..3 {
                        right[at[p]] -= difference[p] * value / variance;
                        for q in 0..=p {
                            matrix.add(at[p], at[q], difference[p] * difference[q] / variance);
                        }
                    }
                }
            }
        }
        for place in 0..c.len() {
            matrix.add(place, place, LEVEL);
        }
    }

    /// Learns from a path and the covariance of its coefficients.
    pub fn learn(&mut self, path: &SplinePath, covariance: &Banded) {
        for j in (0..GENERATORS).filter(|j| self.active[*j]) {
            let (mut energy, mut trace, mut count) = (0.0, 0.0, 0.0);
            for at in Self::triples(path, j) {
                let [a, b, c] = at.map(|place| path.coefficients[place]);
                let z = |p: usize, q: usize| covariance.at(at[p], at[q]);
                energy += (a - 2.0 * b + c).powi(2);
                trace += z(0, 0) + 4.0 * (z(1, 1) - z(0, 1) - z(1, 2)) + z(2, 2) + 2.0 * z(0, 2);
                count += 1.0;
            }
            let old = self.variance[j];
            let determined = (count - trace / old).max(LEAST_DETERMINED * count);
            let new = (energy / determined).clamp(old / MOST_CHANGE, old * MOST_CHANGE);
            if new.is_finite() {
                self.variance[j] = new.clamp(LIMITS[0], LIMITS[1]);
            }
        }
    }
}
