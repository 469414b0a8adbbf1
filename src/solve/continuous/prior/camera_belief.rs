// SPDX-License-Identifier: MIT OR Apache-2.0

//! Beliefs about γ and κ, and their update by a window.

use super::belief::Belief;
use crate::solve::continuous::linear::{SHARED, Shared, SharedEquations};
use nalgebra::SVector;

/// Standard deviation of γ among all cameras.
pub const READOUT_DEVIATION: f64 = 0.5;
/// Greatest change of γ and κ in a step.
const MAX_STEP: f64 = 0.1;

/// An estimate of γ or κ from one window alone.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    pub value: f64,
    /// Inverse variance.
    pub information: f64,
}

impl Observation {
    /// Whether its standard deviation is less than that of γ among all cameras: otherwise errors of the model may
    /// outweigh it.
    pub fn informs(&self) -> bool {
        self.deviation() < READOUT_DEVIATION
    }

    /// Standard deviation.
    pub fn deviation(&self) -> f64 {
        self.information.sqrt().recip()
    }
}

/// Beliefs about γ and κ from all windows so far, and their limits.
#[derive(Clone, Copy, Debug)]
pub struct CameraBelief {
    pub beliefs: Shared<Belief>,
    /// Least and greatest value.
    pub limits: Shared<[f64; 2]>,
}

impl CameraBelief {
    /// Whether γ is not estimated, but [held](Self::hold_gamma).
    pub fn is_gamma_given(&self) -> bool {
        let [low, high] = self.limits.gamma;
        low == high
    }

    /// Holds γ at a value.
    pub fn hold_gamma(&mut self, gamma: f64) {
        self.limits.gamma = [gamma; 2];
    }

    /// Standard deviation of γ.
    pub fn gamma_deviation(&self) -> f64 {
        self.beliefs.gamma.deviation()
    }

    /// Converts to frame periods shorter by `factor`.
    pub fn scale_time(&mut self, factor: f64) {
        self.beliefs.gamma.scale(factor);
        if self.is_gamma_given() {
            self.limits.gamma = self.limits.gamma.map(|gamma| factor * gamma);
        }
    }

    /// One Gauss–Newton step from `at`, given a window's equations with the path eliminated: the new γ and κ,
    /// and the window's own estimate of each, the other one having its belief as prior.
    pub fn step(
        &self,
        equations: &SharedEquations,
        at: Shared<f64>,
    ) -> (Shared<f64>, Shared<Option<Observation>>) {
        let (at, beliefs) = (at.into_array(), self.beliefs.into_array());
        let SharedEquations { information, right } = equations;
        let (mut all, mut all_right) = (*information, *right);
        for (p, belief) in beliefs.iter().enumerate() {
            all[(p, p)] += belief.information;
            all_right[p] += belief.information * (belief.mean - at[p]);
        }
        let observation = |p: usize| {
            let q = 1 - p;
            let coupling = information[(p, q)] / all[(q, q)];
            let own = information[(p, p)] - information[(p, q)] * coupling;
            let value = at[p] + (right[p] - coupling * all_right[q]) / own;
            (own > 0.0 && value.is_finite()).then_some(Observation { value, information: own })
        };
        let step = all.try_inverse().map_or(SVector::zeros(), |inverse| inverse * all_right);
        let limits = self.limits.into_array();
        let moved = |p: usize| {
            let [low, high] = limits[p];
            let change = step[p].clamp(-MAX_STEP, MAX_STEP);
            if step[p].is_finite() { (at[p] + change).clamp(low, high) } else { at[p] }
        };
        let all: [usize; SHARED] = [0, 1];
        (all.map(moved).into(), all.map(observation).into())
    }

    /// Updates by observations, a `share` of them independent of earlier ones.
    pub fn add(&mut self, observed: &Shared<Option<Observation>>, share: f64) {
        let unknowns = self.beliefs.as_mut().zip(self.limits).zip(*observed);
        for ((belief, [low, high]), observed) in unknowns.into_array() {
            if let Some(observed) = observed.filter(Observation::informs) {
                belief.add(observed.value.clamp(low, high), observed.information, share);
            }
        }
    }
}
