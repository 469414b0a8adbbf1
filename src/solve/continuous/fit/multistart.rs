//! Fits from several starts side by side, as one of them may end in the wrong place.
//!
//! A start costs as many steps as a window has iterations, and there are several of them. They go on with each frame
//! that comes, so that no frame takes much longer than another: what was fitted to a few pairs is near the path of one
//! more.

use crate::parallel::*;
use crate::solve::continuous::data::window::PairWindow;
use crate::solve::continuous::fit::solver::Solver;
use crate::solve::continuous::trajectory::knots::KnotDensity;

/// Steps to the first path, and to each one after it, at most. As many as to the first where γ has not come
/// to rest: while it is far off, the splines bend to imitate the shutter, and learn to be straight again only
/// as it comes nearer. Not all at once, for a live stream does not wait.
pub const STEPS: [usize; 2] = [12, 4];
/// A step that changes the displacements at the frame by less than this share of the least noise (root mean
/// square) is the last.
const SETTLED: f64 = 0.3;
/// Or γ by less than this.
const SETTLED_READOUT: f64 = 0.01;
/// What a window says of γ is believed where the last step moved points by less than they scatter, and γ by
/// no more than this share of what is uncertain of it anyway.
const UNCERTAIN: f64 = 0.5;

/// Pairs times steps that are taken a frame: when the first frame is due, as many as the path in hand takes, four steps
/// over eight pairs; later, when that one takes no first steps, half as many more.
const WORK: [usize; 2] = [32, 48];
/// Pairs that show which of the starts are worth going on with before all have come.
const SHOWN_PAIRS: usize = 8;
/// A readout ratio, or a knot density, is told from another where its evidence is greater by a factor of e to this power.
pub const TOLD: f64 = 5.0;
/// A readout ratio that is known worse than this may be anything; two that differ by less are the same answer.
pub const VAGUE: f64 = 0.2;

/// A start and what has become of it.
#[derive(Clone, Debug)]
struct Candidate {
    solver: Solver,
    /// The readout ratio that it started from.
    start: f64,
    /// Steps so far on windows that are long enough to count.
    steps: usize,
}

/// Paths that are fitted from several starts.
#[derive(Clone, Debug)]
pub struct Search {
    candidates: Vec<Candidate>,
    is_narrowed: bool,
}

impl Search {
    /// For the path and the readout ratio, from several of these.
    pub fn new(solver: &Solver, starts: &[f64]) -> Self {
        let mut fresh = solver.clone();
        fresh.restart();
        Self::of(&fresh, clamped(solver, starts))
    }

    /// For a path of a knot density, from the readout ratio in hand and from these.
    pub fn with_density(solver: &Solver, density: KnotDensity, readouts: &[f64]) -> Self {
        let starts = clamped(solver, readouts).chain([solver.shared[0]]);
        Self::of(&solver.with_density(density), starts)
    }

    /// For a solver without a path, from these readout ratios.
    fn of(fresh: &Solver, starts: impl Iterator<Item = f64>) -> Self {
        let candidate = |start| {
            let mut solver = fresh.clone();
            solver.shared[0] = start;
            Candidate { solver, start, steps: 0 }
        };
        Self { candidates: starts.map(candidate).collect(), is_narrowed: false }
    }

    /// Steps that the last one that was begun has taken.
    fn steps(&self) -> usize {
        self.candidates.iter().map(|candidate| candidate.steps).min().unwrap_or(0)
    }

    /// Whether all have taken enough steps to be compared.
    pub fn is_done(&self) -> bool {
        self.steps() >= STEPS[0]
    }

    /// Steps that the chosen one has yet to take, some at least.
    pub fn steps_left(&self) -> usize {
        STEPS[0].saturating_sub(self.steps()).max(STEPS[1])
    }

    /// Steps with a frame that takes about as long as any other one.
    pub fn pace(&self, window: PairWindow<'_>, starts: bool) -> usize {
        let pairs = window.pairs.len() * self.candidates.len();
        (WORK[usize::from(!starts)] / pairs.max(1)).clamp(1, STEPS[0])
    }

    /// Goes so many steps further with each, to a window that grows.
    pub fn prepare(&mut self, window: PairWindow<'_>, steps: usize, camera: &Solver) {
        self.advance(window, steps, camera);
        if window.is_short() {
            // A pair or two do not tell which generators are needed.
            self.candidates.iter_mut().for_each(|one| one.solver.smoothness.restart());
        }
        if window.pairs.len() >= SHOWN_PAIRS && !self.is_narrowed {
            self.is_narrowed = true;
            self.narrow(window);
        }
    }

    /// Goes so many steps further with each, with what the path in hand knows of the camera.
    pub fn advance(&mut self, window: PairWindow<'_>, steps: usize, camera: &Solver) {
        let fit = |candidate: &mut Candidate| {
            let Candidate { solver, start, .. } = candidate;
            solver.learn_camera(camera);
            if window.is_short() {
                solver.limits[0] = [*start; 2];
            }
            iterate(solver, window, steps);
            solver.limits = camera.limits;
            candidate.steps += if window.is_short() { 0 } else { steps };
        };
        self.candidates.par_iter_mut().for_each(fit);
    }

    /// Goes on only with the likeliest, and with those that say something else and are nearly as likely.
    fn narrow(&mut self, window: PairWindow<'_>) {
        let evidence = |candidate: &mut Candidate| {
            let solver = &mut candidate.solver;
            let evidence = solver.evidence(window.pairs);
            (evidence.unwrap_or(f64::NEG_INFINITY), candidate.solver.shared[0])
        };
        let seen: Vec<(f64, f64)> = self.candidates.par_iter_mut().map(evidence).collect();
        let Some(best) = (0..seen.len()).max_by(|a, b| seen[*a].0.total_cmp(&seen[*b].0)) else { return };
        let (most, readout) = seen[best];
        let is_rival =
            |(evidence, other): (f64, f64)| most - evidence <= TOLD && (other - readout).abs() > VAGUE;
        let candidates = std::mem::take(&mut self.candidates).into_iter().zip(seen).enumerate();
        let kept = candidates.filter(|(index, (_, seen))| *index == best || is_rival(*seen));
        self.candidates = kept.map(|(_, (candidate, _))| candidate).collect();
    }

    /// The paths with the logarithm of their evidence, the likeliest first.
    pub fn ranked(self, window: PairWindow<'_>) -> Vec<(f64, Solver)> {
        let ranked = self.candidates.into_par_iter().filter_map(|Candidate { mut solver, .. }| {
            let evidence = solver.evidence(window.pairs)?;
            Some((evidence, solver))
        });
        let mut ranked: Vec<(f64, Solver)> = ranked.collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        ranked
    }
}

/// Readout ratios within what a solver allows.
fn clamped(solver: &Solver, readouts: &[f64]) -> impl Iterator<Item = f64> {
    let [low, high] = solver.limits[0];
    readouts.iter().map(move |readout| readout.clamp(low, high))
}

/// Steps until nothing changes any more at the frame, at most so many; whether γ came to rest.
pub fn iterate(solver: &mut Solver, window: PairWindow<'_>, steps: usize) -> bool {
    let mut rests = false;
    for _ in 0..steps {
        let before = solver.shared[0];
        if !solver.step(window.pairs) {
            solver.restart();
            continue;
        }
        let change = window.beside().map(|index| solver.moved(index)).fold(0.0, f64::max);
        let moved = (solver.shared[0] - before).abs();
        if change < SETTLED * solver.noise && moved < SETTLED_READOUT {
            rests = true;
            if solver.is_foreseeing() {
                continue;
            }
            break;
        }
        // Robust weights may go back and forth for ever, by less than is uncertain anyway.
        let sigma = window.beside().filter_map(|index| solver.sigma(index)).fold(0.0, f64::max);
        let slack = UNCERTAIN * solver.seen_deviation();
        rests = change < sigma && moved < SETTLED_READOUT.max(slack);
    }
    solver.cover(window.pairs);
    rests
}
