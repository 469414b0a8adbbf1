//! One way in which the sensor may be read and the camera may move, with a fit of its own.

use super::evidence::EvidenceRecord;
use super::schedule::Schedule;
use crate::readout::ReadoutDirection;
use crate::solve::continuous::data::{PairWindow, breadth};
use crate::solve::continuous::fit::{
    DECISIVE_LOG_BAYES_FACTOR, MAX_READOUT_DEVIATION, Multistart, Posterior, STEPS, Setup, Summary, fit,
};
use crate::solve::continuous::prior::{Belief, Smoothness};
use crate::solve::continuous::trajectory::KnotDensity;

/// Logarithm of the odds that a camera vibrates faster than the usual knots follow.
const VIBRATION_LOG_ODDS: f64 = -5.0;
/// Residuals below this many times the noise floor count as noise.
const NOTICEABLE: f64 = 4.0;
/// Steps, at most, in which the prediction of a vibration is estimated by expectation and maximisation: to the first path, to
/// those of one frame until then, and to each path after it. That needs more steps than a path, and their changes hardly show
/// between frames, so that none is spared. Only the first frame of all takes them at once. Twelve with each frame instead of six
/// would leave up to a twelfth less over 60 frames, and take twice as long for three of them.
const EM_STEPS: [usize; 3] = [36, 6, 3];
/// A path is tried at another knot density where more than this share of its residuals is common to the matches of a line.
const BY_LINE: f64 = 0.7;
/// Readout ratios from which a vibration is fitted where the readout is unknown.
const VIBRATION_STARTS: [f64; 2] = [0.9, 0.5];
/// Readout ratio from which a vague one is searched beside its present value.
const START: f64 = 0.9;
/// γ is significant with a standard deviation below this, or at this many standard deviations from zero.
const SIGNIFICANT_DEVIATION: f64 = 0.02;
const SIGNIFICANCE: f64 = 4.0;
/// Pairs to which a fit is begun while more are to come.
const LEAST_PAIRS: usize = 2;
/// Steps of the fits from several starts with each pair that comes before the first frame is due, while they are too few to
/// constrain a readout, and after that.
const PREPARED_STEPS: [usize; 2] = [4, 1];

/// How far a hypothesis has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// It was added in mid-stream, and γ has not been searched from several starts yet: its evidence is not compared.
    AwaitsSearch,
    /// It is tried beside one of the other knot density in the same direction: nothing is given up for it.
    OnTrial,
    /// It counts.
    Established,
}

/// Fits from several starts that go on while frames are settled.
#[derive(Clone, Debug, Default)]
struct Searches {
    /// For γ.
    readout: Option<Multistart>,
    /// For the frames after a gap or a cut, while those before it are settled.
    ahead: Option<Multistart>,
    /// At the other knot density.
    density: Option<Multistart>,
}

/// A way in which the sensor may be read.
#[derive(Clone, Debug)]
pub struct Hypothesis {
    /// Edge that is read first; where that is to be found out, the one from which γ is searched, which may turn out the other.
    pub direction: ReadoutDirection,
    /// The least and the greatest γ, in intervals between frames.
    signs: [f64; 2],
    pub setup: Setup,
    /// Of the last window.
    pub posterior: Posterior,
    /// Logarithms of its prior probability and of the posterior one, up to a constant.
    pub log_prior: f64,
    pub log_probability: f64,
    /// How well it explains the windows so far.
    pub evidence: EvidenceRecord,
    pub phase: Phase,
    schedule: Schedule,
    /// Whether γ has come to rest since it was last searched.
    is_at_rest: bool,
    /// Whether it has in the last window.
    pub has_converged: bool,
    /// Whether the path of the last window explains little of what moves.
    explains_little: bool,
    /// Steps so far in which the prediction of a vibration was estimated.
    em_steps: usize,
    searches: Searches,
}

impl Hypothesis {
    /// A hypothesis without evidence.
    pub fn new(
        direction: ReadoutDirection,
        signs: [f64; 2],
        setup: Setup,
        posterior: Posterior,
        log_prior: f64,
    ) -> Self {
        Self {
            direction,
            signs,
            setup,
            posterior,
            log_prior,
            log_probability: log_prior,
            evidence: EvidenceRecord::default(),
            phase: Phase::Established,
            schedule: Schedule::new(),
            is_at_rest: true,
            has_converged: false,
            explains_little: false,
            em_steps: 0,
            searches: Searches::default(),
        }
    }

    /// The same, added to others in mid-stream, with this logarithm of its probability beside its own.
    pub fn joining(mut self, log_odds: f64) -> Self {
        self.log_prior += log_odds;
        self.log_probability = self.log_prior;
        self.phase = Phase::AwaitsSearch;
        self.schedule.expect_search();
        self
    }

    /// γ of the last window, the signed readout time in frame periods.
    pub fn gamma(&self) -> f64 {
        self.posterior.shared.gamma
    }

    pub fn density(&self) -> KnotDensity {
        self.posterior.trajectory.density
    }

    /// Whether γ is known; it may be zero.
    pub fn knows_readout(&self) -> bool {
        let deviation = self.setup.camera.gamma_deviation();
        deviation < SIGNIFICANT_DEVIATION || self.gamma().abs() > SIGNIFICANCE * deviation
    }

    /// Whether its path vibrates, or is tried for that.
    pub fn looks_for_vibration(&self) -> bool {
        self.density() == KnotDensity::Vibrating || self.searches.density.is_some()
    }

    /// Whether γ is too uncertain to be reached from any start.
    pub fn is_vague(&self) -> bool {
        self.setup.camera.gamma_deviation() > MAX_READOUT_DEVIATION
    }

    /// Whether it has come to the same answer as another one; never, where only the edge is to be found.
    pub fn agrees_with(&self, other: &Self) -> bool {
        let is_same_axis = self.direction.is_by_rows() == other.direction.is_by_rows();
        let distance = (self.gamma() - other.gamma()).abs();
        let is_same = is_same_axis && distance < MAX_READOUT_DEVIATION && self.density() == other.density();
        is_same && !self.setup.camera.is_gamma_given()
    }

    /// Takes γ as known.
    pub fn give_readout(&mut self, belief: Belief) {
        self.posterior.shared.gamma = belief.mean;
        self.setup.camera.give_gamma(belief);
    }

    /// Takes γ as expected.
    pub fn expect_readout(&mut self, belief: Belief) {
        self.posterior.shared.gamma = belief.mean;
        self.setup.camera.beliefs.gamma = belief;
    }

    /// Continues with frame periods that are shorter by `factor`; the path begins anew.
    pub fn scale_time(&mut self, factor: f64) {
        self.setup.camera.scale_time(factor);
        self.posterior.scale_time(factor);
        self.drop_searches();
    }

    /// Continues with frame periods that are shorter by `factor`, before a new stretch of frames.
    pub fn scale_readout(&mut self, factor: f64) {
        self.setup.camera.scale_time(factor);
        self.posterior.shared.gamma *= factor;
    }

    /// Readout ratios from which a fit is begun: the present one and, where that is vague, the end of its direction. What
    /// is in between is reached; so is what is beyond zero, where the other direction's fit may end in a worse place.
    fn starts(&self, is_vague: bool) -> Vec<f64> {
        let end = self.signed(START);
        std::iter::once(self.gamma()).chain(is_vague.then_some(end)).collect()
    }

    /// γ of this size in the direction of the hypothesis.
    fn signed(&self, size: f64) -> f64 {
        if self.direction.is_reversed() { -size } else { size }
    }

    /// Fits the posterior further, to a window; whether γ came to rest.
    fn iterate(&mut self, window: PairWindow<'_>, steps: usize) -> bool {
        let start = std::mem::take(&mut self.posterior);
        let (posterior, Summary { converged, .. }) = fit(window, start, &self.setup, steps);
        self.posterior = posterior;
        converged
    }

    /// Continues a fit to the pairs that have come so far, before the first one of them is due.
    pub fn prepare(&mut self, window: PairWindow<'_>) {
        if window.pairs.len() < LEAST_PAIRS {
            self.searches.ahead = None;
            return;
        }
        let starts = self.starts(self.is_vague());
        let Self { posterior, setup, searches, .. } = self;
        let search = searches.ahead.get_or_insert_with(|| Multistart::new(posterior, setup, &starts));
        search.prepare(window, prepared_steps(window), setup);
    }

    /// Drops the fits beside the current one.
    pub fn drop_searches(&mut self) {
        self.searches = Searches::default();
    }

    /// Fits the path of the present knot density to a window; `longest` is the longest readout in frame periods where it is
    /// unknown.
    pub fn settle(&mut self, window: PairWindow<'_>, starts: bool, longest: Option<f64>) {
        if let Some(longest) = longest {
            self.setup.camera.limits.gamma = self.signs.map(|sign| sign * longest);
        }
        if starts {
            self.posterior.restart();
            self.searches.density = None;
            // What was fitted to a pair or two is no better start than none.
            self.searches.readout = self.searches.ahead.take().filter(|_| !window.is_short());
        }
        self.has_converged = false;
        if window.pairs.is_empty() {
            return;
        }
        if std::mem::take(&mut self.explains_little) {
            // What was fitted to noise, as while the camera rests, is no start for what moves.
            self.posterior.restart();
        }
        if self.is_too_short(window) {
            if window.pairs.len() >= LEAST_PAIRS {
                let starts = self.starts(true);
                let Self { posterior, setup, searches, .. } = self;
                let search =
                    searches.readout.get_or_insert_with(|| Multistart::new(posterior, setup, &starts));
                search.prepare(window, prepared_steps(window), setup);
            }
            self.iterate(window, STEPS[usize::from(!starts)]);
            return;
        }
        let found = self.search(window, starts);
        self.has_converged = found.unwrap_or_else(|| self.follow(window));
    }

    /// Fits a window with the smoothness that another hypothesis has learnt, and keeps it where it explains more than `evidence`:
    /// how the camera moves does not depend on which edge is read first. Tried again some time after it has failed.
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

    /// Adds the estimate of the window to the beliefs if γ has come to rest.
    pub fn conclude(&mut self, window: PairWindow<'_>) {
        self.schedule.density.tick();
        self.schedule.smoothness.tick();
        self.explains_little = self.explains_little(window);
        if self.has_converged && !window.pairs.is_empty() && !self.is_too_short(window) {
            let share = self.weight(window) / window.pairs.len() as f64;
            self.setup.camera.add(&self.posterior.observed, share);
        }
    }

    /// Continues along the current path; whether γ came to rest.
    fn follow(&mut self, window: PairWindow<'_>) -> bool {
        let steps = if self.posterior.is_predicting(&self.setup) {
            self.em_steps(false)
        } else {
            self.em_steps = 0;
            STEPS[usize::from(self.is_at_rest)]
        };
        let rests = self.iterate(window, steps);
        self.is_at_rest |= rests;
        rests
    }

    /// Steps to a path whose prediction is estimated; whether those to the first path are taken at once.
    fn em_steps(&mut self, at_once: bool) -> usize {
        let [first, of_a_frame, later] = EM_STEPS;
        let most = if at_once { first } else { of_a_frame };
        let steps = first.saturating_sub(self.em_steps).min(most).max(later);
        self.em_steps += steps;
        steps
    }

    /// Continues a search for γ, or begins one that is due; where it has ended, whether γ came to rest.
    fn search(&mut self, window: PairWindow<'_>, starts: bool) -> Option<bool> {
        let at_once = starts || self.schedule.search.is_none();
        let is_time = self.schedule.search.is_none_or(|timer| timer.is_due());
        if let Some(timer) = &mut self.schedule.search {
            timer.tick();
        }
        let is_due = is_time && self.is_vague() && self.moves(window);
        if self.searches.readout.is_none() && (starts || is_due) {
            let starts = self.starts(is_due);
            self.searches.readout = Some(Multistart::new(&self.posterior, &self.setup, &starts));
        }
        let search = self.searches.readout.as_mut()?;
        search.advance(window, search.pace(window, at_once), &self.setup);
        let search = self.searches.readout.take_if(|search| at_once || search.is_done())?;
        if self.phase == Phase::AwaitsSearch {
            self.phase = Phase::Established;
        }
        Some(self.decide(search, window))
    }

    /// Whether the readout is unknown and the window too short to constrain it.
    pub fn is_too_short(&self, window: PairWindow<'_>) -> bool {
        !self.setup.camera.is_gamma_given() && window.is_short()
    }

    /// Whether anything moves at the frame of a window that may constrain a readout or a knot density.
    pub fn moves(&self, window: PairWindow<'_>) -> bool {
        let moved = window.moved().sqrt() * self.posterior.trajectory.radius;
        moved > NOTICEABLE * self.setup.noise && self.breadth(window) > 0.0
    }

    /// Whether the pairs of the frame show enough of the lines, 0 to 1.
    fn breadth(&self, window: PairWindow<'_>) -> f64 {
        window.own_pairs().map(|pair| breadth(pair, self.setup.scan_axis)).fold(1.0, f64::min)
    }

    /// Standard deviation in pixels of a coordinate's innovation in the pairs that the frame is in.
    fn innovation_deviation(&self, window: PairWindow<'_>) -> f64 {
        window.beside().filter_map(|index| self.posterior.innovation_deviation(index)).fold(0.0, f64::max)
    }

    /// Whether the path explains less than half of the mean square that points move by in the pairs that the frame is in.
    fn explains_little(&self, window: PairWindow<'_>) -> bool {
        let radius = self.posterior.trajectory.radius;
        let left = 2.0 * self.innovation_deviation(window).powi(2);
        left > 0.5 * window.moved() * radius * radius
    }

    /// Weight of a window, 0 to 1: the share of the motion at its frame that the path explains, and none where so few lines
    /// show anything that an object with a motion of its own may be all that moves.
    pub fn weight(&self, window: PairWindow<'_>) -> f64 {
        let sigma = self.innovation_deviation(window);
        self.breadth(window) * self.posterior.explained(sigma, window.moved(), &self.setup)
    }

    /// Logarithm of the evidence of a window, up to a constant.
    pub fn log_evidence(&mut self, window: PairWindow<'_>) -> Option<f64> {
        self.posterior.log_evidence(window.pairs, &self.setup)
    }

    /// Continues from the likeliest of the fits; whether γ came to rest where no other one is nearly as likely. Later
    /// windows go on where it did not.
    fn decide(&mut self, search: Multistart, window: PairWindow<'_>) -> bool {
        let steps = search.steps_left();
        if self.moves(window) {
            self.schedule.restart_search();
        }
        let mut ranked = search.ranked(window, &self.setup).into_iter();
        let Some((_, best)) = ranked.next() else { return false };
        self.posterior = best;
        self.is_at_rest = self.iterate(window, steps);
        let Some(evidence) = self.log_evidence(window) else { return false };
        let gamma = self.gamma();
        let is_apart = |other: &Posterior| (other.shared.gamma - gamma).abs() > MAX_READOUT_DEVIATION;
        let is_rival =
            |other: &Posterior, log: f64| is_apart(other) && evidence - log <= DECISIVE_LOG_BAYES_FACTOR;
        self.is_at_rest && !ranked.any(|(log, other)| is_rival(&other, log))
    }

    /// Ends its trial where it has seen enough, as many windows as begin with other pairs than the first one ends with; whether
    /// it did.
    pub fn ends_trial(&mut self) -> bool {
        let has_ended =
            self.phase == Phase::OnTrial && self.evidence.weight() >= KnotDensity::Vibrating.past() as f64;
        if has_ended {
            self.phase = Phase::Established;
        }
        has_ended
    }

    /// Waits twice as long with the next trial of the other knot density, as one has failed.
    pub fn put_off_trials(&mut self) {
        self.schedule.density.back_off();
    }

    /// Whether the path leaves what one of the other knot density may explain.
    fn wants_other_density(&self, window: PairWindow<'_>) -> bool {
        let own = window.own();
        let deviation = self.posterior.innovation_deviation(own);
        let is_noticed = deviation.is_some_and(|sigma| sigma >= NOTICEABLE * self.setup.noise);
        let is_wanted = || {
            self.density() == KnotDensity::Vibrating
                || self.posterior.share_by_line(own, &self.setup) > BY_LINE
        };
        is_noticed && self.moves(window) && is_wanted()
    }

    /// A hypothesis of the other knot density where the path leaves what that may explain, once it has been fitted.
    pub fn challenger(&mut self, window: PairWindow<'_>, starts: bool) -> Option<Self> {
        if window.pairs.is_empty() || self.is_too_short(window) {
            return None;
        }
        let is_due = self.searches.density.is_none() && self.schedule.density.is_due();
        if is_due && self.wants_other_density(window) {
            self.schedule.density.restart();
            let density = self.density().other();
            let is_unknown = density == KnotDensity::Vibrating && self.is_vague();
            let starts = VIBRATION_STARTS.map(|start| self.signed(start));
            let starts = if is_unknown { &starts[..] } else { &[] };
            let trial = Multistart::with_density(&self.posterior, &self.setup, density, starts);
            self.searches.density = Some(trial);
        }
        let trial = self.searches.density.as_mut()?;
        let steps = if starts { STEPS[0] } else { trial.pace(window, false) };
        trial.advance(window, steps, &self.setup);
        let trial = self.searches.density.take_if(|trial| trial.is_done())?;
        let (_, mut posterior) = trial.ranked(window, &self.setup).into_iter().next()?;
        let is_vibrating = posterior.trajectory.density == KnotDensity::Vibrating;
        // A window that only has a past constrains the prediction too little.
        posterior.predicts = is_vibrating && window.pairs.len() > window.past;
        let log_odds = if is_vibrating { VIBRATION_LOG_ODDS } else { -VIBRATION_LOG_ODDS };
        let log_prior = self.log_prior + log_odds;
        let mut other = Self::new(self.direction, self.signs, self.setup, posterior, log_prior);
        other.phase = Phase::OnTrial;
        other.schedule.search = self.schedule.search;
        other.schedule.density.restart();
        let steps = match (other.posterior.is_predicting(&other.setup), starts) {
            (true, _) => other.em_steps(starts),
            (false, true) => EM_STEPS[0],
            (false, false) => STEPS[0],
        };
        other.has_converged = other.iterate(window, steps);
        Some(other)
    }
}

/// Steps of the fits from several starts with a pair that comes before the first frame is due.
fn prepared_steps(window: PairWindow<'_>) -> usize {
    PREPARED_STEPS[usize::from(!window.is_short())]
}
