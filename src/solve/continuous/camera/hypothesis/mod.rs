// SPDX-License-Identifier: MIT OR Apache-2.0

//! A hypothesis: a scan axis and a knot density, with a fit of its own. The edge that is read first is the sign of γ.

mod density;

use super::evidence::EvidenceRecord;
use super::given::Scan;
use super::schedule::Schedule;
use crate::solve::continuous::data::{PairWindow, breadth};
use crate::solve::continuous::fit::{
    DECISIVE_LOG_ODDS, MAX_READOUT_DEVIATION, Multistart, Posterior, STEPS, Setup, Summary, fit,
};
use crate::solve::continuous::prior::{Belief, Smoothness};
use crate::solve::continuous::trajectory::KnotDensity;

/// Residuals and displacements below this many times the noise floor count as noise.
const NOISE_LIMIT: f64 = 4.0;
/// EM steps, at most, for the prediction of a vibration: in all until the first path, of these per frame, and
/// with each later path. EM converges more slowly than the path, and its steps hardly change displacements,
/// so none is skipped. Only the first frame of all takes them at once. Twelve per frame instead of six would
/// leave up to a twelfth less over 60 frames, and take twice as long for three of them.
const EM_STEPS: [usize; 3] = [36, 6, 3];
/// Shares of the greatest and of the least γ from which an unknown γ is searched, beside its present value: the first one, and both
/// for a vibration.
const STARTS: [f64; 2] = [0.9, 0.5];
/// γ is significant with a standard deviation below this, or at this many standard deviations from zero.
const SIGNIFICANT_DEVIATION: f64 = 0.02;
const SIGNIFICANCE: f64 = 4.0;
/// Fewest pairs to which a fit is begun before the first frame is due.
const MIN_FITTED_PAIRS: usize = 2;
/// Steps from several starts per pair before the first frame is due: in short windows, and in longer ones.
const PREPARED_STEPS: [usize; 2] = [4, 1];

/// The state of a hypothesis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Added in mid-stream; γ has not been searched yet, so that its evidence is not compared. At leisure, the search costs
    /// no more with a frame than the fit that is in use.
    AwaitsSearch {
        at_leisure: bool,
    },
    /// Compared with one of the other knot density along the same axis. While it leads, none is dropped.
    OnTrial,
    Established,
}

/// Fits from several starts that advance while frames are settled.
#[derive(Clone, Debug, Default)]
struct Searches {
    /// For γ.
    readout: Option<Multistart>,
    /// For the frames after a gap or a cut, while those before it are settled.
    ahead: Option<Multistart>,
    /// At the other knot density.
    density: Option<Multistart>,
}

/// A hypothesis about the camera.
#[derive(Clone, Debug)]
pub struct Hypothesis {
    pub scan: Scan,
    /// Limits of γ over the longest readout: −1, 0 or 1.
    signs: [f64; 2],
    pub setup: Setup,
    /// Of the last window.
    pub posterior: Posterior,
    /// Logarithms of the prior and posterior probability, up to a constant.
    pub log_prior: f64,
    pub log_probability: f64,
    pub evidence: EvidenceRecord,
    pub phase: Phase,
    pub schedule: Schedule,
    /// Whether γ has converged since the last search.
    is_at_rest: bool,
    /// Whether it was fitted to the last window.
    pub is_fitted: bool,
    /// Whether γ converged in the last window.
    pub has_converged: bool,
    /// Whether the path explained little of the motion in the last window.
    explains_little: bool,
    /// EM steps so far.
    em_steps: usize,
    searches: Searches,
    /// Fits with another γ that the last search does not rule out.
    other_optima: Vec<Posterior>,
}

impl Hypothesis {
    /// A hypothesis without evidence.
    pub fn new(scan: Scan, signs: [f64; 2], setup: Setup, posterior: Posterior, log_prior: f64) -> Self {
        Self {
            scan,
            signs,
            setup,
            posterior,
            log_prior,
            log_probability: log_prior,
            evidence: EvidenceRecord::default(),
            phase: Phase::Established,
            schedule: Schedule::new(),
            is_at_rest: true,
            is_fitted: false,
            has_converged: false,
            explains_little: false,
            em_steps: 0,
            searches: Searches::default(),
            other_optima: Vec::new(),
        }
    }

    /// The hypothesis added in mid-stream, its log prior changed by `log_odds`.
    pub fn joining(mut self, log_odds: f64, at_leisure: bool) -> Self {
        self.log_prior += log_odds;
        self.log_probability = self.log_prior;
        self.await_search(at_leisure);
        self
    }

    /// Has γ searched first, and the evidence compared only then.
    fn await_search(&mut self, at_leisure: bool) {
        self.phase = Phase::AwaitsSearch { at_leisure };
        self.schedule.expect_search();
    }

    /// Whether γ has not been searched since it was added or rested.
    pub fn awaits_search(&self) -> bool {
        matches!(self.phase, Phase::AwaitsSearch { .. })
    }

    /// Whether γ has not been searched, and may be with little effort a frame.
    fn is_sought_at_leisure(&self) -> bool {
        self.phase == (Phase::AwaitsSearch { at_leisure: true })
    }

    /// A hypothesis for each other γ that the last search does not rule out.
    pub fn split(&mut self) -> Vec<Self> {
        let other_optima = std::mem::take(&mut self.other_optima);
        other_optima.into_iter().map(|posterior| Self { posterior, ..self.clone() }).collect()
    }

    /// γ of the last window, the signed readout time in frame periods.
    pub fn gamma(&self) -> f64 {
        self.posterior.shared.gamma
    }

    pub fn density(&self) -> KnotDensity {
        self.posterior.trajectory.density
    }

    /// Whether γ is significant; it may be zero.
    pub fn is_readout_significant(&self) -> bool {
        let deviation = self.setup.camera.gamma_deviation();
        deviation < SIGNIFICANT_DEVIATION || self.gamma().abs() > SIGNIFICANCE * deviation
    }

    /// Whether the vibrating knot density is in use or on trial.
    pub fn considers_vibration(&self) -> bool {
        self.density() == KnotDensity::Vibrating || self.searches.density.is_some()
    }

    /// Whether the last window constrains γ. While none does, γ rests.
    pub fn constrains_gamma(&self) -> bool {
        self.posterior.observed.gamma.is_some_and(|observed| observed.informs())
    }

    /// Waits until a window constrains γ; then it is searched for first.
    pub fn rest(&mut self) {
        self.posterior.restart();
        self.drop_searches();
        self.await_search(false);
    }

    /// Whether it has a path, which it lacks while it rests.
    pub fn has_path(&self) -> bool {
        !self.posterior.trajectory.splines.coefficients.is_empty()
    }

    /// Whether γ is too uncertain to be reached from any start.
    pub fn is_vague(&self) -> bool {
        self.setup.camera.gamma_deviation() > MAX_READOUT_DEVIATION
    }

    /// Whether another hypothesis has the same axis, knot density and γ; never if γ is given.
    pub fn agrees_with(&self, other: &Self) -> bool {
        let is_same_axis = self.scan.by_rows == other.scan.by_rows;
        let is_same = is_same_axis && self.density() == other.density();
        is_same && !self.posterior.has_other_readout(&other.posterior) && !self.setup.camera.is_gamma_given()
    }

    /// Sets the belief about γ, and γ to its mean.
    pub fn expect_readout(&mut self, belief: Belief) {
        self.posterior.shared.gamma = belief.mean;
        self.setup.camera.beliefs.gamma = belief;
    }

    /// Converts to frame periods shorter by `factor`; the path is reset.
    pub fn scale_time(&mut self, factor: f64) {
        self.scale_readout(factor);
        self.posterior.restart();
        self.posterior.trajectory.homographies = Default::default();
        self.drop_searches();
    }

    /// Converts to frame periods shorter by `factor`, before a new stretch of frames.
    pub fn scale_readout(&mut self, factor: f64) {
        self.setup.camera.scale_time(factor);
        self.posterior.shared.gamma *= factor;
    }

    /// γ from which a fit is begun: the present one and, if it is unknown, from near its limits. Values between
    /// are reached from these.
    fn starts(&self, is_vague: bool) -> Vec<f64> {
        let far = if is_vague { self.near_limits(&STARTS[..1]) } else { Vec::new() };
        std::iter::once(self.gamma()).chain(far).collect()
    }

    /// These shares of the limits of γ that are not 0.
    fn near_limits(&self, shares: &[f64]) -> Vec<f64> {
        let limits = self.setup.camera.limits.gamma.into_iter().filter(|limit| *limit != 0.0);
        limits.flat_map(|limit| shares.iter().map(move |share| share * limit)).collect()
    }

    /// Takes further steps of the fit, with γ at rest or not; whether γ converged.
    fn iterate(&mut self, window: PairWindow<'_>, steps: usize, rests: bool) -> bool {
        let mut setup = self.setup;
        if rests {
            setup.camera.hold_gamma(setup.camera.beliefs.gamma.mean);
        }
        let start = std::mem::take(&mut self.posterior);
        let (posterior, Summary { converged, .. }) = fit(window, start, &setup, steps);
        self.posterior = posterior;
        converged
    }

    /// Advances a fit to the pairs so far, before the first of their frames is due.
    pub fn prepare(&mut self, window: PairWindow<'_>) {
        if window.pairs.len() < MIN_FITTED_PAIRS {
            self.searches.ahead = None;
            return;
        }
        self.prepare_search(|searches| &mut searches.ahead, self.is_vague(), window);
    }

    /// Advances one of the searches, or begins it.
    fn prepare_search(
        &mut self,
        search: fn(&mut Searches) -> &mut Option<Multistart>,
        is_vague: bool,
        window: PairWindow<'_>,
    ) {
        let starts = self.starts(is_vague);
        let Self { posterior, setup, searches, .. } = self;
        let search = search(searches).get_or_insert_with(|| Multistart::new(posterior, setup, &starts));
        search.prepare(window, PREPARED_STEPS[usize::from(!window.is_short())], setup);
    }

    /// Drops the fits beside the current one.
    pub fn drop_searches(&mut self) {
        self.searches = Searches::default();
    }

    /// Whether an earlier fit does not suffice: its path does not reach the end of the frame's readout, or γ or a vibration is sought.
    pub fn needs_fit(&self, window: PairWindow<'_>) -> bool {
        let homographies = &self.posterior.trajectory.homographies;
        let covers = |place: f64, stamp: f64| homographies.covers(self.posterior.block(stamp, place));
        let stamp = window.pairs.get(window.past).map(|pair| pair.stamps[0]);
        let covers_frame = stamp.is_some_and(|stamp| covers(0.0, stamp) && covers(1.0, stamp));
        let is_sought = self.phase != Phase::Established || self.searches.readout.is_some();
        is_sought || self.considers_vibration() || !covers_frame
    }

    /// Keeps the fit to an earlier window.
    pub fn skip(&mut self) {
        (self.is_fitted, self.has_converged) = (false, false);
    }

    /// Fits the path to a window; `longest` limits an unknown readout, in frame periods.
    pub fn settle(&mut self, window: PairWindow<'_>, starts: bool, longest: Option<f64>) {
        if let Some(longest) = longest {
            self.setup.camera.limits.gamma = self.signs.map(|sign| sign * longest);
        }
        if starts {
            self.posterior.restart();
            self.searches.density = None;
            // Fits to a short window are no better than none.
            self.searches.readout = self.searches.ahead.take().filter(|_| !window.is_short());
        }
        (self.is_fitted, self.has_converged) = (true, false);
        if window.pairs.is_empty() {
            return;
        }
        if std::mem::take(&mut self.explains_little) {
            // A path fitted to noise, as while the camera rests, is no start for a motion.
            self.posterior.restart();
        }
        if self.is_too_short(window) {
            if window.pairs.len() >= MIN_FITTED_PAIRS {
                self.prepare_search(|searches| &mut searches.readout, true, window);
            }
            self.iterate(window, STEPS[usize::from(!starts)], false);
            return;
        }
        self.has_converged = match self.search(window, starts) {
            Some(has_converged) => has_converged,
            // Its path would be compared with no other.
            None if self.is_sought_at_leisure() => false,
            None => self.follow(window),
        };
    }

    /// Fits the window with the smoothness of another hypothesis, and keeps that fit if its evidence exceeds
    /// `evidence`: the motion of the camera does not depend on its readout.
    pub fn try_smoothness(&mut self, smoothness: &Smoothness, evidence: f64, window: PairWindow<'_>) {
        if !self.schedule.smoothness.is_due() {
            return;
        }
        let start = Posterior { smoothness: smoothness.clone(), ..self.posterior.clone() };
        let (mut tried, summary) = fit(window, start, &self.setup, STEPS[1]);
        let found = tried.log_evidence(window.pairs, &self.setup);
        if found.is_some_and(|found| found > evidence) {
            self.posterior = tried;
            self.has_converged &= summary.converged;
        } else {
            self.schedule.smoothness.restart();
        }
    }

    /// Updates the beliefs by the window if γ has converged.
    pub fn conclude(&mut self, window: PairWindow<'_>) {
        self.schedule.density.tick();
        self.schedule.smoothness.tick();
        if !self.is_fitted {
            return;
        }
        // Less than half of the mean squared displacement in the frame's pairs.
        let radius = self.posterior.trajectory.radius;
        let residual = 2.0 * self.innovation_deviation(window).powi(2);
        self.explains_little = residual > 0.5 * window.moved() * radius * radius;
        if self.has_converged && !window.pairs.is_empty() && !self.is_too_short(window) {
            let share = self.weight(window) / window.pairs.len() as f64;
            self.setup.camera.add(&self.posterior.observed, share);
        }
    }

    /// Continues the current path; whether γ converged.
    fn follow(&mut self, window: PairWindow<'_>) -> bool {
        let steps = if self.posterior.is_predicting(&self.setup) {
            self.em_steps(false)
        } else {
            self.em_steps = 0;
            STEPS[usize::from(self.is_at_rest)]
        };
        let rests = self.posterior.observed.gamma.is_some() && !self.constrains_gamma();
        let has_converged = self.iterate(window, steps, rests);
        self.is_at_rest |= has_converged;
        has_converged
    }

    /// EM steps with this path; `at_once` takes all those of the first path.
    fn em_steps(&mut self, at_once: bool) -> usize {
        let [first, per_frame, later] = EM_STEPS;
        let most = if at_once { first } else { per_frame };
        let steps = first.saturating_sub(self.em_steps).min(most).max(later);
        self.em_steps += steps;
        steps
    }

    /// Advances a search for γ, or begins one that is due; when it ends, whether γ converged.
    fn search(&mut self, window: PairWindow<'_>, starts: bool) -> Option<bool> {
        let at_once = starts || self.schedule.search.is_none();
        let is_time = self.schedule.search.is_none_or(|timer| timer.is_due());
        if let Some(timer) = &mut self.schedule.search {
            timer.tick();
        }
        let is_new = at_once || self.awaits_search();
        let is_due = is_time && self.is_vague() && self.moves(window) && (is_new || self.constrains_gamma());
        if self.searches.readout.is_none() && (starts || is_due) {
            let starts = self.starts(is_due);
            self.searches.readout = Some(Multistart::new(&self.posterior, &self.setup, &starts));
        }
        let is_at_leisure = self.is_sought_at_leisure();
        let search = self.searches.readout.as_mut()?;
        if is_at_leisure {
            search.advance_one(window, &self.setup);
        } else {
            search.advance(window, search.pace(window, at_once), &self.setup);
        }
        let search = self.searches.readout.take_if(|search| at_once || search.is_done())?;
        if self.awaits_search() {
            self.phase = Phase::Established;
        }
        Some(self.decide(search, window))
    }

    /// Whether the readout is unknown and the window too short to constrain it.
    pub fn is_too_short(&self, window: PairWindow<'_>) -> bool {
        !self.setup.camera.is_gamma_given() && window.is_short()
    }

    /// Whether the motion at the frame may constrain a readout or a knot density.
    pub fn moves(&self, window: PairWindow<'_>) -> bool {
        let moved = window.moved().sqrt() * self.posterior.trajectory.radius;
        moved > NOISE_LIMIT * self.setup.noise && self.breadth(window) > 0.0
    }

    /// Coverage of the scan axis in the frame's pairs, 0 to 1.
    fn breadth(&self, window: PairWindow<'_>) -> f64 {
        window.own_pairs().map(|pair| breadth(pair, self.setup.scan_axis)).fold(1.0, f64::min)
    }

    /// Standard deviation in pixels of a coordinate's innovation in the frame's pairs.
    fn innovation_deviation(&self, window: PairWindow<'_>) -> f64 {
        window.beside().filter_map(|index| self.posterior.innovation_deviation(index)).fold(0.0, f64::max)
    }

    /// Weight of a window, 0 to 1: the share of the motion at its frame that the path explains, times the
    /// coverage of the scan axis, as a single object may be all that moves.
    pub fn weight(&self, window: PairWindow<'_>) -> f64 {
        let sigma = self.innovation_deviation(window);
        self.breadth(window) * self.posterior.explained(sigma, window.moved(), &self.setup)
    }

    /// Log evidence of a window, up to a constant.
    pub fn log_evidence(&mut self, window: PairWindow<'_>) -> Option<f64> {
        self.posterior.log_evidence(window.pairs, &self.setup)
    }

    /// Continues the fits of a search from the greatest evidence on, and keeps those that come to a γ of their own and are not
    /// ruled out; whether that of the first converged.
    fn decide(&mut self, search: Multistart, window: PairWindow<'_>) -> bool {
        let steps = search.steps_left();
        if self.moves(window) {
            self.schedule.restart_search();
        }
        let mut ranked = search.ranked(window, &self.setup);
        let Some(best) = ranked.next() else { return false };
        self.posterior = best;
        // The belief takes in no γ that has not converged: the first frame would be left as recorded.
        self.is_at_rest = self.iterate(window, steps, false) || self.iterate(window, STEPS[0], false);
        let Some(evidence) = self.log_evidence(window) else { return false };
        let is_near = |log: f64| self.posterior.log_odds(evidence - log, &self.setup) <= DECISIVE_LOG_ODDS;
        let mut other_optima: Vec<Posterior> = Vec::new();
        // Before these steps the evidence of one that has not converged is no measure of it.
        for start in ranked {
            let is_new = |one: &Posterior| {
                other_optima.iter().chain([&self.posterior]).all(|found| found.has_other_readout(one))
            };
            if is_new(&start) {
                let (mut found, _) = fit(window, start, &self.setup, steps);
                if is_new(&found) && found.log_evidence(window.pairs, &self.setup).is_some_and(is_near) {
                    other_optima.push(found);
                }
            }
        }
        self.other_optima = other_optima;
        self.is_at_rest
    }
}
