//! A running estimate of a number that belongs to the camera and does not change.
//!
//! Estimates are weighed by their inverse variances. Those are too large where neighbouring windows err
//! alike; how much too large shows in the *scatter*, the mean square of (estimate − mean) over its
//! variance, by which information is divided where it is above 1. And they are forgotten, as evidence is, so that what was
//! wrong at first, or of another camera, does not stay.

/// Windows that are remembered: what is older speaks of another part of the scene, or another camera.
pub const REMEMBERED: usize = 60;
/// How fast the scatter follows, per estimate.
const SCATTER_RATE: f64 = 0.05;

/// What was seen of a number so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Belief {
    /// Best estimate.
    pub mean: f64,
    /// Inverse variance, if the estimates scattered as their variances say.
    information: f64,
    /// By how much more their squares scatter, at least 1.
    scatter: f64,
    /// Inverse variance before anything was seen, which is not forgotten.
    prior: f64,
}

impl Belief {
    /// A belief before anything was seen.
    pub fn new(mean: f64, deviation: f64) -> Self {
        let prior = 1.0 / (deviation * deviation);
        Self { mean, information: prior, scatter: 1.0, prior }
    }

    /// Takes in an estimate of the given inverse variance, a `share` of which is new.
    pub fn add(&mut self, value: f64, information: f64, share: f64) {
        if !(value.is_finite() && information.is_finite() && information > 0.0) {
            return;
        }
        let normalised_square = (value - self.mean).powi(2) / (1.0 / information + 1.0 / self.information());
        let believed = information / self.scatter;
        self.scatter += SCATTER_RATE * (normalised_square.min(100.0) - self.scatter);
        self.scatter = self.scatter.max(1.0);
        let remembered = self.prior + (self.information - self.prior) * (1.0 - 1.0 / REMEMBERED as f64);
        let sum = remembered + share * believed;
        self.mean += (value - self.mean) * share * believed / sum;
        self.information = sum;
    }

    /// Goes on in units that are smaller by `factor`.
    pub fn scale(&mut self, factor: f64) {
        self.mean *= factor;
        self.information /= factor * factor;
        self.prior /= factor * factor;
    }

    /// Inverse variance.
    pub fn information(&self) -> f64 {
        self.information
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
        assert!((running.mean - 2.4).abs() < 1e-12 && (running.information() - 5.0).abs() < 1e-12);
        let mut shared = Belief::new(0.0, 1.0);
        (0..4).for_each(|_| shared.add(0.0, 4.0, 0.25));
        // A quarter new, four times, of which a sixtieth is forgotten three, two and one time.
        let kept: f64 = (0..4).map(|times| (59.0_f64 / 60.0).powi(times)).sum();
        assert!((shared.information() - 1.0 - kept).abs() < 1e-12);
    }

    #[test]
    fn estimates_that_scatter_more_than_they_say_count_less() {
        // Ten times the deviation that they claim: a hundredth of the information, once that is known.
        let mut running = Belief::new(0.0, 1.0);
        let swing = |k: usize| if k.is_multiple_of(2) { 1.0 } else { -1.0 };
        (0..500).for_each(|k| running.add(swing(k), 100.0, 1.0));
        // Sixty are remembered.
        let each = (running.information() - 1.0) / 60.0;
        // Somewhat more, for the belief that they are compared with is uncertain itself.
        assert!((0.9..2.0).contains(&each), "{each}");
        assert!(running.mean.abs() < 0.1);
    }

    #[test]
    fn what_was_seen_long_ago_is_forgotten_but_not_the_prior() {
        let mut running = Belief::new(0.0, 0.5);
        (0..200).for_each(|_| running.add(0.8, 4.0, 1.0));
        assert!((running.information() - 4.0 - 60.0 * 4.0).abs() < 10.0, "{running:?}");
        // Another camera.
        (0..200).for_each(|_| running.add(0.3, 4.0, 1.0));
        assert!((running.mean - 0.3).abs() < 0.05, "{running:?}");
        let known = Belief::new(0.7, 1e-6);
        let mut told = known;
        (0..200).for_each(|_| told.add(0.2, 4.0, 1.0));
        assert!((told.mean - 0.7).abs() < 1e-4 && told.information() >= known.information());
    }

    #[test]
    fn nonsense_is_not_taken_in() {
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
        assert!((running.information().sqrt().recip() - 0.2).abs() < 1e-12);
    }
}
