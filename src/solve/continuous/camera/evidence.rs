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
    /// Its number among the windows of a stream by which hypotheses could be compared.
    pub number: usize,
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
        self.windows.retain(|one| one.number + MEMORY > window.number);
    }

    /// Sum of the windows' weights.
    pub fn weight(&self) -> f64 {
        self.windows.iter().map(|window| window.weight).sum()
    }

    /// The windows to which both were fitted, the newest first, and by how much the evidence exceeds that of the other. The weight is
    /// that of all windows since the common one before, as the pairs of these are new, but of no more than it has pairs.
    fn differences(&self, other: &Self) -> Vec<(WindowEvidence, f64)> {
        let mut theirs = other.windows.iter().peekable();
        let mut common: Vec<(WindowEvidence, f64)> = Vec::new();
        for own in &self.windows {
            while theirs.next_if(|window| window.number > own.number).is_some() {}
            let Some(window) = theirs.next_if(|window| window.number == own.number) else { continue };
            if let Some((newer, _)) = common.last_mut() {
                newer.weight *= (newer.number - own.number).min(newer.pairs) as f64;
            }
            let most = MAX_DEVIATIONS * own.expected().sqrt();
            common.push((*own, (own.evidence - window.evidence).clamp(-most, most)));
        }
        common
    }

    /// Log odds of this hypothesis against another one by the windows of both.
    pub fn log_odds(&self, other: &Self) -> f64 {
        let common = self.differences(other);
        let sum = |of: &dyn Fn(&WindowEvidence, f64) -> f64| -> f64 {
            common.iter().map(|(own, difference)| own.weight * of(own, *difference)).sum()
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
        record_of(evidence.into_iter().enumerate())
    }

    /// Of windows with these numbers and this evidence.
    fn record_of(windows: impl IntoIterator<Item = (usize, f64)>) -> EvidenceRecord {
        let mut record = EvidenceRecord::default();
        for (number, evidence) in windows {
            record.add(WindowEvidence { number, weight: 1.0, design_effect: 1.0, evidence, pairs: 4 });
        }
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
    fn a_common_window_counts_for_those_before_it_that_are_not() {
        let all = record([5.0; 12]);
        let some = |numbers: &[usize]| record_of(numbers.iter().map(|number| (*number, 15.0)));
        let odds = |numbers: &[usize]| some(numbers).log_odds(&all);
        // After the first, windows 3, 6 and 9 have three new pairs each; 5 and 10 have no more than the four they have.
        assert_eq!(odds(&[0, 3, 6, 9]), record([15.0; 10]).log_odds(&record([5.0; 10])));
        assert_eq!(odds(&[0, 5, 10]), record([15.0; 9]).log_odds(&record([5.0; 9])));
        assert_eq!(all.log_odds(&some(&[0, 3, 6, 9])), -odds(&[0, 3, 6, 9]));
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
        let odds = record([9.0, 9.0, 9.0, 0.0, 0.0]).log_odds(&record_of([(3, 3.0), (4, 3.0)]));
        assert!(odds < 0.0);
        let long = record((0..200).map(|k| if k < 140 { 50.0 } else { -50.0 }));
        assert!(long.log_odds(&record([0.0; 200])) < -20.0);
        let invalid: EvidenceRecord = {
            let mut record = EvidenceRecord::default();
            let window =
                WindowEvidence { number: 0, weight: 1.0, design_effect: 1.0, evidence: 70.0, pairs: 4 };
            record.add(WindowEvidence { pairs: 0, ..window });
            record.add(WindowEvidence { evidence: f64::NAN, ..window });
            record.add(WindowEvidence { weight: 0.0, ..window });
            record
        };
        assert_eq!(invalid.log_odds(&record([1.0])), 0.0);
    }
}
