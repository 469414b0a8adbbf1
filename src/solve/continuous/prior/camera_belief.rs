//! What is believed of γ and κ, and how a window changes it.

use super::belief::Belief;
use crate::solve::continuous::linear::{SHARED, Shared, SharedEquations};
use nalgebra::SVector;

/// The most that γ and κ may change in a step.
const MOST_CHANGE: f64 = 0.1;

/// What a window alone constrains an unknown to.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    pub value: f64,
    /// Inverse variance.
    pub information: f64,
}

/// Beliefs about γ and κ from all windows so far, and the values that they may have.
#[derive(Clone, Copy, Debug)]
pub struct CameraBelief {
    beliefs: Shared<Belief>,
    limits: Shared<[f64; 2]>,
}

impl CameraBelief {
    pub fn new(beliefs: Shared<Belief>, limits: Shared<[f64; 2]>) -> Self {
        Self { beliefs, limits }
    }

    /// Means of the beliefs.
    pub fn means(&self) -> Shared<f64> {
        self.beliefs.map(|belief| belief.mean)
    }

    /// Whether γ need not be estimated.
    pub fn is_gamma_given(&self) -> bool {
        let [low, high] = self.limits.gamma;
        low == high
    }

    /// Standard deviation of γ.
    pub fn gamma_deviation(&self) -> f64 {
        self.beliefs.gamma.information().sqrt().recip()
    }

    /// Standard deviation of κ.
    pub fn kappa_deviation(&self) -> f64 {
        self.beliefs.kappa.information().sqrt().recip()
    }

    /// Takes γ as known.
    pub fn give_gamma(&mut self, belief: Belief) {
        self.limits.gamma = [belief.mean; 2];
        self.beliefs.gamma = belief;
    }

    /// Takes γ as expected.
    pub fn expect_gamma(&mut self, belief: Belief) {
        self.beliefs.gamma = belief;
    }

    /// The values that γ may have.
    pub fn limit_gamma(&mut self, limits: [f64; 2]) {
        self.limits.gamma = limits;
    }

    /// Holds γ at a value.
    pub fn hold_gamma(&mut self, gamma: f64) {
        self.limits.gamma = [gamma; 2];
    }

    /// γ within its limits.
    pub fn clamp_gamma(&self, gamma: f64) -> f64 {
        let [low, high] = self.limits.gamma;
        gamma.clamp(low, high)
    }

    /// Continues with frame periods that are shorter by `factor`.
    pub fn scale_time(&mut self, factor: f64) {
        self.beliefs.gamma.scale(factor);
        if self.is_gamma_given() {
            self.limits.gamma = self.limits.gamma.map(|gamma| factor * gamma);
        }
    }

    /// One Gauss–Newton step from `at`, given the equations of a window whose path is free to follow: where γ and κ are then, and
    /// what the window alone constrains each of them to, the other one being as uncertain as the belief in it.
    pub fn step(
        &self,
        equations: &SharedEquations,
        at: Shared<f64>,
    ) -> (Shared<f64>, Shared<Option<Observation>>) {
        let (at, beliefs) = (at.into_array(), self.beliefs.into_array());
        let SharedEquations { information, right } = equations;
        let (mut all, mut all_right) = (*information, *right);
        for (p, belief) in beliefs.iter().enumerate() {
            all[(p, p)] += belief.information();
            all_right[p] += belief.information() * (belief.mean - at[p]);
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
            let change = step[p].clamp(-MOST_CHANGE, MOST_CHANGE);
            if step[p].is_finite() { (at[p] + change).clamp(low, high) } else { at[p] }
        };
        let all: [usize; SHARED] = [0, 1];
        (all.map(moved).into(), all.map(observation).into())
    }

    /// Adds observations, of which `share` is new.
    pub fn add(&mut self, observed: &Shared<Option<Observation>>, share: f64) {
        let unknowns = self.beliefs.as_mut().zip(self.limits).zip(*observed);
        for ((belief, [low, high]), observed) in unknowns.into_array() {
            if let Some(observed) = observed {
                belief.add(observed.value.clamp(low, high), observed.information, share);
            }
        }
    }
}
