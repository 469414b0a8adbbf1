//! Whether the path stands for the scene alone, without what moves on its own before it.

use super::hypothesis::{Hypothesis, TRIAL, prepared_steps};
use super::pair_window::PairWindow;
use super::search::{Search, TRUSTED};
use super::solver::Solver;
use rayon::prelude::*;

/// Where more than this share of the matches does not follow the dominant motion, a path for the rest is tried, unless the one for
/// everything leaves residuals that are noise of measurement.
const APART: f64 = 0.25;
/// The path for the rest replaces the one for everything if its confidence is this many times higher.
const PREFERRED: f64 = 2.0;

/// The trial of paths that stand for the scene alone, or again for everything.
#[derive(Clone, Debug)]
pub(super) struct SceneTrial {
    /// Frames since the last one was begun.
    since: usize,
    /// What takes the place of the hypotheses if it is trusted more; empty where nothing is tried.
    others: Vec<Hypothesis>,
}

impl SceneTrial {
    /// Before the first trial.
    pub fn new() -> Self {
        Self { since: TRIAL, others: Vec::new() }
    }

    /// Ends a trial without a result.
    pub fn stop(&mut self) {
        self.others.clear();
    }

    /// Whether one is going on.
    pub fn is_going_on(&self) -> bool {
        !self.others.is_empty()
    }

    fn begin(&mut self, hypotheses: &[Hypothesis]) {
        self.since = 0;
        let turned = |hypothesis: &Hypothesis| {
            let mut other = hypothesis.clone();
            other.drop_searches();
            other.solver.scene_alone = !hypothesis.solver.scene_alone;
            other.search = Some(Search::new(&other.solver, &hypothesis.starts(hypothesis.is_vague())));
            other
        };
        self.others.extend(hypotheses.iter().map(turned));
    }

    /// Calls back with each search and what the path in hand knows of the camera.
    fn each(&mut self, hypotheses: &[Hypothesis], go_on: impl Fn(&mut Search, &Solver) + Sync) {
        self.others.par_iter_mut().for_each(|other| {
            let own = hypotheses.iter().find(|own| own.direction == other.direction);
            if let (Some(own), Some(search)) = (own, &mut other.search) {
                go_on(search, &own.solver);
            }
        });
    }

    /// Goes on with the pairs that have come so far, before the first frame of all is due.
    pub fn prepare(&mut self, hypotheses: &[Hypothesis], window: PairWindow<'_>) {
        let is_alone = hypotheses.first().is_none_or(|hypothesis| hypothesis.solver.scene_alone);
        if self.others.is_empty() && self.since >= TRIAL && !is_alone && window.apart() > APART {
            self.begin(hypotheses);
        }
        self.each(hypotheses, |search, camera| search.prepare(window, prepared_steps(window), camera));
    }

    /// Lets the paths stand for the scene alone where what moves on its own leaves no other one with little that is new
    /// in it, and for everything again where one for everything does as well.
    pub fn settle(&mut self, hypotheses: &mut [Hypothesis], window: PairWindow<'_>, starts: bool) {
        self.since += 1;
        if window.is_short() {
            return;
        }
        let Some(alone) = hypotheses.first().map(|hypothesis| hypothesis.solver.scene_alone) else { return };
        let own = trust(hypotheses);
        let is_prepared = starts && !self.others.is_empty();
        if self.others.is_empty() {
            if self.since < TRIAL || !alone && (own >= TRUSTED || window.apart() <= APART) {
                return;
            }
            self.begin(hypotheses);
        }
        self.each(hypotheses, |search, camera| search.advance(window, search.pace(window, starts), camera));
        let is_done = |other: &Hypothesis| other.search.as_ref().is_none_or(Search::is_done);
        if !(is_prepared || self.others.iter().all(is_done)) {
            return;
        }
        let mut others = std::mem::take(&mut self.others);
        others.par_iter_mut().for_each(|other| {
            let Some(search) = other.search.take() else { return };
            let steps = if other.is_vague() { search.steps_left() } else { 1 };
            other.settled = other.decide(search, window, steps);
        });
        let other = trust(&others);
        let is_better = if alone { PREFERRED * other > own } else { other > PREFERRED * own };
        if is_better {
            for hypothesis in hypotheses {
                if let Some(other) = others.iter().find(|other| other.direction == hypothesis.direction) {
                    hypothesis.go_over(other);
                }
            }
        }
    }
}

/// How far the residuals of the best one are noise of measurement.
fn trust(hypotheses: &[Hypothesis]) -> f64 {
    hypotheses.iter().map(|hypothesis| hypothesis.solver.trust()).fold(0.0, f64::max)
}
