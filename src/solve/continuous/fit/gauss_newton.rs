//! Gauss–Newton on the banded normal equations of a window.

use super::posterior::Posterior;
use super::setup::Setup;
use crate::solve::continuous::data::PairWindow;

/// A step that changes the displacements at the frame by less than this share of the least noise (root mean square) is the
/// last …
const SETTLED: f64 = 0.3;
/// … if it changes γ by less than this.
const SETTLED_READOUT: f64 = 0.01;
/// What a window constrains γ to is used where the last step moved points by less than their deviation, and γ by no more
/// than this share of its own deviation.
const UNCERTAIN: f64 = 0.5;

/// How a fit ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Steps that were tried.
    pub steps: usize,
    /// Those that could be solved.
    pub accepted: usize,
    /// Whether γ came to rest.
    pub converged: bool,
}

/// Fits the path, γ and κ to a window, from a start, in at most so many steps.
pub fn fit(window: PairWindow<'_>, start: Posterior, setup: &Setup, steps: usize) -> (Posterior, Summary) {
    let mut posterior = start;
    let mut summary = Summary::default();
    for _ in 0..steps {
        summary.steps += 1;
        let before = posterior.shared.gamma;
        if !step(window, &mut posterior, setup) {
            posterior.restart();
            continue;
        }
        summary.accepted += 1;
        let change = window.beside().map(|index| posterior.moved(index)).fold(0.0, f64::max);
        let moved = (posterior.shared.gamma - before).abs();
        if change < SETTLED * setup.noise && moved < SETTLED_READOUT {
            summary.converged = true;
            if posterior.is_predicting(setup) {
                continue;
            }
            break;
        }
        // Robust weights may go back and forth for ever, by less than is uncertain anyway.
        let sigma = window.beside().filter_map(|index| posterior.sigma(index)).fold(0.0, f64::max);
        let slack = UNCERTAIN * posterior.observed_deviation();
        summary.converged = change < sigma && moved < SETTLED_READOUT.max(slack);
    }
    posterior.cover(window.pairs);
    (posterior, summary)
}

/// One step; whether it could be solved.
fn step(window: PairWindow<'_>, posterior: &mut Posterior, setup: &Setup) -> bool {
    posterior.evaluate(window.pairs, setup);
    let equations = posterior.assemble(setup);
    if !posterior.system.solve_path(setup.cpu) {
        return false;
    }
    let mut equations = posterior.system.eliminate_path(equations);
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
    // One pair alone does not tell a change of speed from depth that changes from row to row.
    if window.pairs.len() > 1 {
        posterior.learn_smoothness(setup);
    }
    true
}
