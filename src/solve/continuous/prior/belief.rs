// SPDX-License-Identifier: MIT OR Apache-2.0

//! A Gaussian belief about a constant of the camera, updated window by window.
//!
//! Estimates are weighed by their inverse variances. These are too large if the errors of successive windows
//! are correlated; by how much is measured by the *scatter*, the mean of (estimate − mean)² over its
//! variance, by which information is divided where it is above 1. Old estimates are forgotten exponentially,
//! as they may be errors of the start or of another camera.

/// Windows of memory: the time constant of forgetting.
pub const MEMORY: usize = 60;
/// What a window says counts as at most this many standard deviations from what was expected.
pub const MAX_DEVIATIONS: f64 = 10.0;
/// Weight of a new estimate in the running mean of the scatter.
const SCATTER_RATE: f64 = 0.05;

/// Mean and inverse variance of a constant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Belief {
    pub mean: f64,
    /// Inverse variance.
    pub information: f64,
    /// Variance of the estimates over the variance that they state, at least 1.
    scatter: f64,
    /// Inverse variance of the prior, which is not forgotten.
    prior: f64,
}

impl Belief {
    /// A prior.
    pub fn new(mean: f64, deviation: f64) -> Self {
        let prior = 1.0 / (deviation * deviation);
        Self { mean, information: prior, scatter: 1.0, prior }
    }

    /// Updates by an estimate of this inverse variance, a `share` of it independent of earlier ones.
    pub fn add(&mut self, value: f64, information: f64, share: f64) {
        if !(value.is_finite() && information.is_finite() && information > 0.0) {
            return;
        }
        let normalised_square = (value - self.mean).powi(2) / (1.0 / information + 1.0 / self.information);
        let corrected = information / self.scatter;
        self.scatter +=
            SCATTER_RATE * (normalised_square.min(MAX_DEVIATIONS * MAX_DEVIATIONS) - self.scatter);
        self.scatter = self.scatter.max(1.0);
        let kept = self.prior + (self.information - self.prior) * (1.0 - 1.0 / MEMORY as f64);
        let sum = kept + share * corrected;
        self.mean += (value - self.mean) * share * corrected / sum;
        self.information = sum;
    }

    /// Converts to units smaller by `factor`.
    pub fn scale(&mut self, factor: f64) {
        self.mean *= factor;
        self.information /= factor * factor;
        self.prior /= factor * factor;
    }

    /// Standard deviation.
    pub fn deviation(&self) -> f64 {
        self.information.sqrt().recip()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn estimates_that_agree_add_their_information() {
        // 0 ± 1 and 3 ± 1/2 (information 1 and 4), both new: (0 + 4·3)/5.
        let mut running = Belief::new(0.0, 1.0);
        running.add(3.0, 4.0, 1.0);
        // The normalised square 9 / (1/4 + 1) counts from the next estimate on.
        assert!((running.mean - 2.4).abs() < 1e-12 && (running.information - 5.0).abs() < 1e-12);
        let mut shared = Belief::new(0.0, 1.0);
        (0..4).for_each(|_| shared.add(0.0, 4.0, 0.25));
        // A quarter new, four times, of which a sixtieth is forgotten three, two and one time.
        let kept: f64 = (0..4).map(|times| (59.0_f64 / 60.0).powi(times)).sum();
        assert!((shared.information - 1.0 - kept).abs() < 1e-12);
    }

    #[test]
    fn estimates_that_scatter_more_than_stated_count_less() {
        // Ten times the stated deviation: a hundredth of the information, once the scatter is estimated.
        let mut running = Belief::new(0.0, 1.0);
        let swing = |k: usize| if k.is_multiple_of(2) { 1.0 } else { -1.0 };
        (0..500).for_each(|k| running.add(swing(k), 100.0, 1.0));
        // Sixty are remembered.
        let each = (running.information - 1.0) / 60.0;
        // Somewhat more, as the belief that they are compared with is uncertain itself.
        assert!((0.9..2.0).contains(&each), "{each}");
        assert!(running.mean.abs() < 0.1);
    }

    #[test]
    fn old_estimates_are_forgotten_but_not_the_prior() {
        let mut running = Belief::new(0.0, 0.5);
        (0..200).for_each(|_| running.add(0.8, 4.0, 1.0));
        assert!((running.information - 4.0 - 60.0 * 4.0).abs() < 10.0, "{running:?}");
        // Another camera.
        (0..200).for_each(|_| running.add(0.3, 4.0, 1.0));
        assert!((running.mean - 0.3).abs() < 0.05, "{running:?}");
        let known = Belief::new(0.7, 1e-6);
        let mut updated = known;
        (0..200).for_each(|_| updated.add(0.2, 4.0, 1.0));
        assert!((updated.mean - 0.7).abs() < 1e-4 && updated.information >= known.information);
    }

    #[test]
    fn invalid_estimates_are_ignored() {
        let mut running = Belief::new(0.3, 0.1);
        let before = running;
        for (value, information) in [
            (f64::NAN, 1.0),
            (f64::INFINITY, 1.0),
            (1.0, f64::NAN),
            (1.0, 0.0),
            (1.0, -2.0),
            (1.0, f64::INFINITY),
        ] {
            running.add(value, information, 1.0);
            assert_eq!(running, before);
        }
    }

    #[test]
    fn other_units_change_mean_and_deviation_alike() {
        let mut running = Belief::new(0.4, 0.1);
        running.scale(2.0);
        assert!((running.mean - 0.8).abs() < 1e-12);
        assert!((running.deviation() - 0.2).abs() < 1e-12);
    }
}
