// SPDX-License-Identifier: MIT OR Apache-2.0

//! The posterior of the readout: its likeliest value, with deviation and rivals.

use super::Continuous;
use crate::readout::{Readout, ReadoutDirection, ReadoutHypothesis, ReadoutPosterior};
use crate::solve::continuous::camera::{Camera, Hypothesis, READOUT_BELIEF};

impl Continuous {
    /// The posterior of the readout; `None` if it is given, or before the first frame.
    pub fn posterior(&self) -> Option<ReadoutPosterior> {
        let period = self.period().filter(|_| !self.posterior.camera.is_known())?;
        let [width, height] = self.posterior.size;
        let least = self.least_deviation(self.last_index());
        let hypotheses = self.posterior.hypotheses().map(|(probability, hypothesis)| ReadoutHypothesis {
            readout: self.readout(hypothesis),
            deviation: hypothesis.setup.camera.gamma_deviation().hypot(self.excess(hypothesis)).max(least)
                * period,
            probability,
        });
        let [rows, columns] = [true, false].map(|by_rows| Camera::log_prior(by_rows, width, height).exp());
        Some(ReadoutPosterior {
            hypotheses: hypotheses.collect(),
            prior_deviation: READOUT_BELIEF.1 * period,
            prior_by_rows: rows / (rows + columns),
        })
    }

    /// The likeliest shutter, and the standard deviation of its readout ratio.
    pub fn belief(&self) -> (Readout, f64) {
        (self.readout(self.posterior.leading()), self.readout_deviation(self.last_index()))
    }

    /// Number of the last frame.
    fn last_index(&self) -> usize {
        self.frames.back().map_or(0, |last| last.index)
    }

    /// Standard deviation of the readout ratio that is reported with the frame of this number.
    pub(super) fn readout_deviation(&self, frame: usize) -> f64 {
        let deviation = self.posterior.readout_deviation();
        deviation.hypot(self.excess(self.posterior.leading())).max(self.least_deviation(frame))
    }

    /// By how much a γ that is estimated from the shifts is too long, where the frames may have been moved.
    fn excess(&self, hypothesis: &Hypothesis) -> f64 {
        let (gamma, axis) = (hypothesis.gamma(), hypothesis.setup.scan_axis);
        if self.posterior.camera.is_known() { 0.0 } else { self.timing.excess(gamma, axis) }
    }

    /// Least standard deviation of an estimated readout ratio: that of the prior where frames may be stabilised or blends, as
    /// it cannot be estimated from them.
    fn least_deviation(&self, frame: usize) -> f64 {
        let axis = self.posterior.leading().setup.scan_axis;
        let is_unseen = self.timing.contradicts_path(frame, axis) || self.timing.found_of(frame).is_blended();
        if is_unseen && !self.posterior.camera.is_known() { READOUT_BELIEF.1 } else { 0.0 }
    }

    /// The shutter of a hypothesis.
    pub(super) fn readout(&self, hypothesis: &Hypothesis) -> Readout {
        let gamma = hypothesis.gamma();
        let direction = match (hypothesis.scan.by_rows, gamma < 0.0) {
            (true, false) => ReadoutDirection::TopToBottom,
            (true, true) => ReadoutDirection::BottomToTop,
            (false, false) => ReadoutDirection::LeftToRight,
            (false, true) => ReadoutDirection::RightToLeft,
        };
        let [width, height] = self.posterior.size;
        Readout { width, height, direction, time: gamma.abs() * self.period().unwrap_or(0.0) }
    }
}
