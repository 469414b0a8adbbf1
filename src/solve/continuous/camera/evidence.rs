//! Which of two hypotheses the frames so far speak for, and how surely.
//!
//! Log evidences of a window are exact for a model that is exact. Ours is not: the depth of a scene, things that move and
//! the splines themselves leave misfits that favour one hypothesis for a while and another one later. So it counts how the
//! difference of two evidences compares with its own scatter from window to window, as in a test of non-nested models (Q. H.
//! Vuong, *Likelihood ratio tests for model selection and non-nested hypotheses*, Econometrica 57(2), 1989): the mean
//! difference over its standard error is a normal deviate z, and ½·z² the logarithm of the odds. Before there are windows
//! to scatter, errors of the model are expected to add what they do to the variance of γ.

use crate::solve::continuous::prior::MEMORY;
use std::collections::VecDeque;

/// Variance in nats² of the difference of two evidences of one pair of frames whose residuals are noise of measurement: some
/// 25 independent matches that scatter by a nat each.
const SCATTER: f64 = 25.0;
/// The difference of the evidences of a window counts up to so many of its deviations: one window must not pass for scatter.
const MOST: f64 = 10.0;

/// What a hypothesis says of a window.
#[derive(Clone, Copy, Debug)]
pub struct WindowEvidence {
    /// What the window is worth, 0 to 1.
    pub weight: f64,
    /// By how much greater than by chance the variance of its evidence may be, as errors of the model are alike in its
    /// pairs; at least 1.
    pub design_effect: f64,
    /// Log evidence for each of its pairs.
    pub evidence: f64,
    pub pairs: usize,
}

impl WindowEvidence {
    /// Variance in nats² that is expected of the difference of two evidences for each pair.
    fn expected(&self) -> f64 {
        SCATTER / self.pairs as f64
    }
}

/// The log evidences of successive windows by one hypothesis.
#[derive(Clone, Debug, Default)]
pub struct EvidenceRecord {
    /// The newest first.
    windows: VecDeque<WindowEvidence>,
}

impl EvidenceRecord {
    /// Adds a window; one without pairs or with numbers that are none says nothing.
    pub fn add(&mut self, window: WindowEvidence) {
        let numbers = [window.weight, window.design_effect, window.evidence];
        if window.pairs == 0 || !numbers.iter().all(|number| number.is_finite()) {
            return;
        }
        self.windows.push_front(window);
        self.windows.truncate(MEMORY);
    }

    /// How many windows that count whole it has seen.
    pub fn weight(&self) -> f64 {
        self.windows.iter().map(|window| window.weight).sum()
    }

    /// Logarithm of the odds of this hypothesis against another one by the windows that both have seen.
    pub fn log_odds(&self, other: &Self) -> f64 {
        let both = || self.windows.iter().zip(&other.windows);
        let sum = |of: &dyn Fn(&WindowEvidence, f64) -> f64| -> f64 {
            let difference = |own: &WindowEvidence, theirs: &WindowEvidence| {
                let most = MOST * own.expected().sqrt();
                (own.evidence - theirs.evidence).clamp(-most, most)
            };
            both().map(|(own, theirs)| own.weight * of(own, difference(own, theirs))).sum()
        };
        let count = sum(&|_, _| 1.0);
        if count <= 0.0 {
            return 0.0;
        }
        let mean = sum(&|_, difference| difference) / count;
        let expected = sum(&|own, _| own.expected()) / count;
        // What errors of the model add is as expected at first, for one window, and then as it shows.
        let errors = sum(&|own, _| own.expected() * (own.design_effect - 1.0)) / count;
        let seen = (sum(&|_, difference| (difference - mean).powi(2)) + errors) / (count + 1.0);
        // The first window counts whole; each one after it has all but one of its pairs in common with the one before.
        let later = sum(&|own, _| (own.pairs as f64).recip()) * (1.0 - count.recip()).max(0.0);
        let independent = count.min(1.0) + later;
        0.5 * mean * mean.abs() * independent / (seen + expected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(evidence: impl IntoIterator<Item = f64>) -> EvidenceRecord {
        let mut record = EvidenceRecord::default();
        let window = |evidence| WindowEvidence { weight: 1.0, design_effect: 1.0, evidence, pairs: 4 };
        evidence.into_iter().for_each(|evidence| record.add(window(evidence)));
        record
    }

    #[test]
    fn worked_by_hand() {
        // Differences of 10, no scatter of their own, in a window of four pairs, and in as many as two: z² = 10²·4/25·2.
        let odds = record([15.0; 5]).log_odds(&record([5.0; 5]));
        assert!((odds - 16.0).abs() < 1e-12, "{odds}");
        assert_eq!(record([5.0; 5]).log_odds(&record([15.0; 5])), -odds);
        assert!((record([15.0]).log_odds(&record([5.0])) - 8.0).abs() < 1e-12);
        // No more than ten deviations of 2.5 count.
        assert!((record([99.0]).log_odds(&record([5.0])) - 50.0).abs() < 1e-12);
        assert_eq!(record([]).log_odds(&record([3.0])), 0.0);
    }

    #[test]
    fn what_speaks_now_for_one_and_now_for_the_other_decides_little() {
        let steady = record((0..40).map(|_| 4.0)).log_odds(&record([0.0; 40]));
        let wavering = record((0..40).map(|k| if k / 10 % 2 == 0 { 34.0 } else { -26.0 }));
        assert!(wavering.log_odds(&record([0.0; 40])) < 0.05 * steady);
    }

    #[test]
    fn only_what_both_have_seen_counts_and_old_windows_are_forgotten() {
        // The newest two windows favour the second.
        let odds = record([9.0, 9.0, 9.0, 0.0, 0.0]).log_odds(&record([3.0, 3.0]));
        assert!(odds < 0.0);
        let long = record((0..200).map(|k| if k < 140 { 50.0 } else { -50.0 }));
        assert!(long.log_odds(&record([0.0; 200])) < -20.0);
        let worthless: EvidenceRecord = {
            let mut record = EvidenceRecord::default();
            record.add(WindowEvidence { weight: 1.0, design_effect: 1.0, evidence: 70.0, pairs: 0 });
            record.add(WindowEvidence { weight: 1.0, design_effect: 1.0, evidence: f64::NAN, pairs: 4 });
            record.add(WindowEvidence { weight: 0.0, design_effect: 1.0, evidence: 70.0, pairs: 4 });
            record
        };
        assert_eq!(worthless.log_odds(&record([1.0])), 0.0);
    }
}
