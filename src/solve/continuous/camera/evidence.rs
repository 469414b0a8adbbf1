// SPDX-License-Identifier: MIT OR Apache-2.0

//! Log odds of two hypotheses by the evidence of successive windows.
//!
//! Log evidence is exact only if the model is. Depth, moving objects and the splines leave misfits that
//! favour one hypothesis for a while and another one later. So the mean difference of two log evidences is
//! compared with its scatter between windows, as in a test of non-nested models (Q. H. Vuong, *Likelihood
//! ratio tests for model selection and non-nested hypotheses*, Econometrica 57(2), 1989): over its standard
//! error it is a normal deviate z, and the log odds are ½·z². The scatter starts from that which errors of
//! the model are expected to cause, by their share in the variance of γ.

use crate::solve::continuous::data::INDEPENDENT_MATCHES;
use crate::solve::continuous::prior::{MAX_DEVIATIONS, MEMORY};
use std::collections::VecDeque;

/// The evidence of a window for one hypothesis.
#[derive(Clone, Copy, Debug)]
pub struct WindowEvidence {
    /// Weight of the window, 0 to 1.
    pub weight: f64,
    /// Factor, at least 1, by which correlated errors of the model may increase the variance.
    pub design_effect: f64,
    /// Log evidence in nats per pair.
    pub evidence: f64,
    pub pairs: usize,
}

impl WindowEvidence {
    /// Expected variance in nats² of the difference of two log evidences per pair: that of a single pair, whose residuals are
    /// noise, is 1 for each independent match.
    fn expected(&self) -> f64 {
        INDEPENDENT_MATCHES / self.pairs as f64
    }
}

/// The evidence of the last windows for one hypothesis.
#[derive(Clone, Debug, Default)]
pub struct EvidenceRecord {
    /// The newest first.
    windows: VecDeque<WindowEvidence>,
}

impl EvidenceRecord {
    /// Adds a window unless it has no pairs or is not finite.
    pub fn add(&mut self, window: WindowEvidence) {
        let numbers = [window.weight, window.design_effect, window.evidence];
        if window.pairs == 0 || !numbers.iter().all(|number| number.is_finite()) {
            return;
        }
        self.windows.push_front(window);
        self.windows.truncate(MEMORY);
    }

    /// Sum of the windows' weights.
    pub fn weight(&self) -> f64 {
        self.windows.iter().map(|window| window.weight).sum()
    }

    /// Log odds of this hypothesis against another one by the windows of both.
    pub fn log_odds(&self, other: &Self) -> f64 {
        let both = || self.windows.iter().zip(&other.windows);
        let sum = |of: &dyn Fn(&WindowEvidence, f64) -> f64| -> f64 {
            let difference = |own: &WindowEvidence, theirs: &WindowEvidence| {
                let most = MAX_DEVIATIONS * own.expected().sqrt();
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
        // The expected variance of model errors counts as one window beside those observed.
        let model_errors = sum(&|own, _| own.expected() * (own.design_effect - 1.0)) / count;
        let scatter = (sum(&|_, difference| (difference - mean).powi(2)) + model_errors) / (count + 1.0);
        // Each window after the first shares all but one of its pairs with the one before.
        let later = sum(&|own, _| (own.pairs as f64).recip()) * (1.0 - count.recip()).max(0.0);
        let independent = count.min(1.0) + later;
        0.5 * mean * mean.abs() * independent / (scatter + expected)
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
        // Differences of 10, no scatter of their own, in a window of four pairs, and in as many as two: z² =
        // 10²·4/25·2.
        let odds = record([15.0; 5]).log_odds(&record([5.0; 5]));
        assert!((odds - 16.0).abs() < 1e-12, "{odds}");
        assert_eq!(record([5.0; 5]).log_odds(&record([15.0; 5])), -odds);
        assert!((record([15.0]).log_odds(&record([5.0])) - 8.0).abs() < 1e-12);
        // No more than ten deviations of 2.5 count.
        assert!((record([99.0]).log_odds(&record([5.0])) - 50.0).abs() < 1e-12);
        assert_eq!(record([]).log_odds(&record([3.0])), 0.0);
    }

    #[test]
    fn alternating_evidence_decides_little() {
        let steady = record((0..40).map(|_| 4.0)).log_odds(&record([0.0; 40]));
        let alternating = record((0..40).map(|k| if k / 10 % 2 == 0 { 34.0 } else { -26.0 }));
        assert!(alternating.log_odds(&record([0.0; 40])) < 0.05 * steady);
    }

    #[test]
    fn only_common_windows_count_and_old_ones_are_forgotten() {
        // The newest two windows favour the second.
        let odds = record([9.0, 9.0, 9.0, 0.0, 0.0]).log_odds(&record([3.0, 3.0]));
        assert!(odds < 0.0);
        let long = record((0..200).map(|k| if k < 140 { 50.0 } else { -50.0 }));
        assert!(long.log_odds(&record([0.0; 200])) < -20.0);
        let invalid: EvidenceRecord = {
            let mut record = EvidenceRecord::default();
            record.add(WindowEvidence { weight: 1.0, design_effect: 1.0, evidence: 70.0, pairs: 0 });
            record.add(WindowEvidence { weight: 1.0, design_effect: 1.0, evidence: f64::NAN, pairs: 4 });
            record.add(WindowEvidence { weight: 0.0, design_effect: 1.0, evidence: 70.0, pairs: 4 });
            record
        };
        assert_eq!(invalid.log_odds(&record([1.0])), 0.0);
    }
}
