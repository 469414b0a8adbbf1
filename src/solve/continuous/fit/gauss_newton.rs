// SPDX-License-Identifier: MIT OR Apache-2.0

//! Gauss–Newton on the banded normal equations of a window.

use super::posterior::Posterior;
use super::setup::Setup;
use crate::solve::continuous::data::PairWindow;

/// A step is the last if it changes the displacements in the frame's pairs by less than this (root mean square, in
/// standard deviations of a coordinate), and γ by less than `GAMMA_TOLERANCE`.
const TOLERANCE: f64 = 0.1;
const GAMMA_TOLERANCE: f64 = 0.01;
/// A fit has also converged if its last step changed displacements by less than σ, and γ by less than this
/// many deviations.
const GAMMA_TOLERANCE_DEVIATIONS: f64 = 0.5;

/// How a fit ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Steps that were tried.
    pub steps: usize,
    /// Steps whose equations could be solved.
    pub accepted: usize,
    /// Whether γ has converged.
    pub converged: bool,
}

/// Fits path, γ and κ to a window in at most `steps` steps.
pub fn fit(window: PairWindow<'_>, start: Posterior, setup: &Setup, steps: usize) -> (Posterior, Summary) {
    let mut posterior = Posterior { evidence: None, ..start };
    let mut summary = Summary::default();
    for _ in 0..steps {
        summary.steps += 1;
        let before = posterior.shared.gamma;
        if !step(window, &mut posterior, setup) {
            posterior.restart();
            continue;
        }
        summary.accepted += 1;
        let change = window.beside().map(|index| posterior.moved(index, setup)).fold(0.0, f64::max);
        let moved = (posterior.shared.gamma - before).abs();
        if change < TOLERANCE && moved < GAMMA_TOLERANCE {
            summary.converged = true;
            if posterior.is_predicting(setup) {
                continue;
            }
            break;
        }
        // Robust weights may oscillate, by less than the uncertainty.
        let deviation = posterior.observed.gamma.map_or(f64::INFINITY, |gamma| gamma.deviation());
        let slack = GAMMA_TOLERANCE_DEVIATIONS * deviation;
        summary.converged = change < 1.0 && moved < GAMMA_TOLERANCE.max(slack);
    }
    posterior.cover(window.pairs);
    (posterior, summary)
}

/// One step; false if its equations cannot be solved.
fn step(window: PairWindow<'_>, posterior: &mut Posterior, setup: &Setup) -> bool {
    posterior.evaluate(window.pairs, setup);
    let equations = posterior.assemble(setup);
    if !posterior.system.solve_path(setup.cpu) {
        return false;
    }
    let mut equations = posterior.system.eliminate_path(setup.cpu, equations);
    let independent = posterior.design_effect(setup).recip();
    equations.information *= independent;
    equations.right *= independent;
    let before = posterior.shared;
    (posterior.shared, posterior.observed) = setup.camera.step(&equations, before);
    let changes = posterior.shared.zip(before).map(|(now, before)| now - before);
    if !posterior.system.substitute(changes) {
        return false;
    }
    posterior.apply_step(setup);
    // A single pair does not distinguish acceleration from depth that varies along the rows.
    if window.pairs.len() > 1 {
        posterior.learn_smoothness(setup);
    }
    true
}
