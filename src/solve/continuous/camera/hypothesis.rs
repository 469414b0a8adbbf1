//! One way in which the sensor may be read and the camera may move, with a fit of its own.

use crate::readout::ReadoutDirection;
use crate::solve::continuous::camera::evidence::EvidenceRecord;
use crate::solve::continuous::data::window::{PairWindow, breadth};
use crate::solve::continuous::fit::multistart::{STEPS, Search, TOLD, VAGUE, iterate};
use crate::solve::continuous::fit::solver::Solver;
use crate::solve::continuous::prior::smoothness::Smoothness;
use crate::solve::continuous::trajectory::knots::KnotDensity;

/// Logarithm of the odds that a camera vibrates faster than the usual knots follow.
const VIBRATES: f64 = -5.0;
/// Residuals below this many times the noise floor count as noise.
const NOTICEABLE: f64 = 4.0;
/// Steps, at most, where it is learnt how a vibration goes on: to the first path, to those of one frame until then, and to
/// each path after it: that needs more of them, and what it changes hardly shows between frames, so that none is spared. Only
/// the first frame of all takes them at once. Twelve with each frame instead of six would leave up to a
/// twelfth less over 60 frames, and take twice as long for three of them.
const FORESIGHT_STEPS: [usize; 3] = [36, 6, 3];
/// A path is tried at another knot density where more than this share of its residuals is common to the matches of a line.
const BY_LINE: f64 = 0.7;
/// Readout ratios, by the direction of a hypothesis, from which a vibration is looked for where the readout is unknown.
const READOUTS: [f64; 2] = [0.9, 0.5];
/// Size of the readout ratio beside the one in hand from which a vague one is sought.
const END: f64 = 0.9;
/// A readout ratio that is known as well as this, or that is so many deviations from none, may be relied upon.
const WELL_KNOWN: f64 = 0.02;
const EVIDENT: f64 = 4.0;
/// Frames from one trial of another knot density or smoothness, or search for the readout, to the next.
const TRIAL: usize = 15;
/// And at most, where several trials in a row have failed, each after twice as long.
const LONGEST_TRIAL: usize = 8 * TRIAL;

/// Pairs to which a fit is begun while more are to come.
const LEAST_PAIRS: usize = 2;
/// Steps of the fits from several starts with each pair that comes before the first frame is due, while they are too few
/// to tell a readout, and after that.
const PREPARED_STEPS: [usize; 2] = [4, 1];

/// A way in which the sensor may be read.
#[derive(Clone, Debug)]
pub struct Hypothesis {
    /// Which edge is first; where that is to be found out, the one from which γ is sought, which may turn out the other.
    pub direction: ReadoutDirection,
    /// The least and the greatest γ, in intervals between frames.
    pub signs: [f64; 2],
    pub solver: Solver,
    /// Logarithm of its probability before anything was seen, and by what was, up to a constant.
    pub prior: f64,
    pub score: f64,
    /// How well it explains the windows so far.
    pub evidence: EvidenceRecord,
    /// Frames since the other knot density was tried, and from then on to the next time.
    since_trial: usize,
    until_trial: usize,
    /// Frames until it may try another one's smoothness.
    until_offer: usize,
    /// Whether it is tried beside one of the other knot density, and nothing is decided yet.
    pub is_on_trial: bool,
    /// Frames since γ was sought from several starts, if ever.
    since_sought: Option<usize>,
    /// Whether γ has come to rest since.
    rests: bool,
    /// Whether it has in the last window.
    pub settled: bool,
    /// Steps so far in which it was learnt how a vibration goes on.
    foresight: usize,
    /// Whether it has joined another that is further, and its γ has not been sought yet.
    pub joins: bool,
    /// Whether the path of the last window explains little of what moves.
    is_lost: bool,
    /// The fits from several starts that are going on; for the frames after a gap or a cut while those before it are
    /// settled; and at the other knot density.
    search: Option<Search>,
    prepared: Option<Search>,
    trial: Option<Search>,
}

impl Hypothesis {
    /// A hypothesis that nothing speaks for or against yet.
    pub fn new(direction: ReadoutDirection, signs: [f64; 2], solver: Solver) -> Self {
        Self {
            direction,
            signs,
            solver,
            prior: 0.0,
            score: 0.0,
            evidence: EvidenceRecord::default(),
            since_trial: TRIAL,
            until_trial: TRIAL,
            until_offer: 0,
            is_on_trial: false,
            since_sought: None,
            rests: true,
            settled: false,
            foresight: 0,
            joins: false,
            is_lost: false,
            search: None,
            prepared: None,
            trial: None,
        }
    }

    /// The same for one that joins another in a stream that goes on, with this logarithm of its probability beside its own.
    pub fn joining(mut self, log_probability: f64) -> Self {
        self.prior += log_probability;
        (self.score, self.since_sought, self.joins) = (self.prior, Some(TRIAL), true);
        self
    }

    /// Whether γ is known, be it that there is none.
    pub fn knows_readout(&self) -> bool {
        let deviation = self.solver.readout_deviation();
        deviation < WELL_KNOWN || self.solver.shared[0].abs() > EVIDENT * deviation
    }

    /// Whether its path vibrates, or is tried for that.
    pub fn looks_for_vibration(&self) -> bool {
        self.solver.density == KnotDensity::Vibrating || self.trial.is_some()
    }

    /// Whether the readout ratio is too uncertain to be reached from any start.
    pub fn is_vague(&self) -> bool {
        self.solver.readout_deviation() > VAGUE
    }

    /// Whether it has come to the same answer as another one; never, where all that is sought is the edge.
    pub fn agrees_with(&self, other: &Self) -> bool {
        let [low, high] = self.solver.limits[0];
        let is_same_axis = self.direction.is_by_rows() == other.direction.is_by_rows();
        let distance = (self.solver.shared[0] - other.solver.shared[0]).abs();
        low < high && is_same_axis && distance < VAGUE && self.solver.density == other.solver.density
    }

    /// Readout ratios from which a fit is begun: the one in hand and, where that is vague, the end of its direction. What
    /// is in between is reached; so is what is beyond zero, where the other direction's fit may end in a worse place.
    fn starts(&self, is_vague: bool) -> Vec<f64> {
        let end = if self.direction.is_reversed() { -END } else { END };
        std::iter::once(self.solver.shared[0]).chain(is_vague.then_some(end)).collect()
    }

    /// Goes on with a fit to the pairs that have come so far, before the first one of them is due.
    pub fn prepare(&mut self, window: PairWindow<'_>) {
        if window.pairs.len() < LEAST_PAIRS {
            self.prepared = None;
            return;
        }
        let starts = self.starts(self.is_vague());
        let search = self.prepared.get_or_insert_with(|| Search::new(&self.solver, &starts));
        search.prepare(window, prepared_steps(window), &self.solver);
    }

    /// Drops the fits beside the one in hand.
    pub fn drop_searches(&mut self) {
        (self.search, self.prepared, self.trial) = (None, None, None);
    }

    /// Fits the path to a window, of the knot density in hand.
    pub fn settle(&mut self, window: PairWindow<'_>, starts: bool) {
        if starts {
            self.solver.restart();
            // What was fitted to a pair or two is no better start than none.
            (self.search, self.trial) = (self.prepared.take().filter(|_| !window.is_short()), None);
        }
        self.settled = false;
        if window.pairs.is_empty() {
            return;
        }
        if std::mem::take(&mut self.is_lost) {
            // What was fitted to noise, as while the camera rests, is no start for what moves.
            self.solver.restart();
        }
        if self.knows_little(window) {
            if window.pairs.len() >= LEAST_PAIRS {
                let starts = self.starts(true);
                let search = self.search.get_or_insert_with(|| Search::new(&self.solver, &starts));
                search.prepare(window, prepared_steps(window), &self.solver);
            }
            iterate(&mut self.solver, window, STEPS[usize::from(!starts)]);
            return;
        }
        let found = self.seek(window, starts);
        self.settled = found.unwrap_or_else(|| self.follow(window));
    }

    /// Fits a window with the smoothness that another hypothesis has learnt, and goes on with that where it explains more:
    /// how the camera moves does not depend on which edge is read first. Tried again some time after it has failed.
    pub fn try_smoothness(&mut self, smoothness: &Smoothness, evidence: f64, window: PairWindow<'_>) {
        if self.until_offer > 0 {
            return;
        }
        let mut tried = self.solver.clone();
        tried.smoothness = smoothness.clone();
        let rests = iterate(&mut tried, window, STEPS[1]);
        if tried.evidence(window.pairs).is_some_and(|found| found > evidence) {
            self.solver = tried;
            self.settled &= rests;
        } else {
            self.until_offer = TRIAL;
        }
    }

    /// Adds the window's estimate to the beliefs if γ has come to rest.
    pub fn conclude(&mut self, window: PairWindow<'_>) {
        self.since_trial += 1;
        self.until_offer = self.until_offer.saturating_sub(1);
        self.is_lost = self.explains_little(window);
        if self.settled && !window.pairs.is_empty() && !self.knows_little(window) {
            self.solver.remember(self.weight(window) / window.pairs.len() as f64);
        }
    }

    /// Goes on along the path in hand; whether γ came to rest.
    fn follow(&mut self, window: PairWindow<'_>) -> bool {
        let steps = if self.solver.is_foreseeing() {
            self.foresight_steps(false)
        } else {
            self.foresight = 0;
            STEPS[usize::from(self.rests)]
        };
        let rests = iterate(&mut self.solver, window, steps);
        self.rests |= rests;
        rests
    }

    /// Steps to a path of which it is learnt how it goes on; whether those to the first path are taken at once.
    fn foresight_steps(&mut self, at_once: bool) -> usize {
        let [first, of_a_frame, later] = FORESIGHT_STEPS;
        let most = if at_once { first } else { of_a_frame };
        let steps = first.saturating_sub(self.foresight).min(most).max(later);
        self.foresight += steps;
        steps
    }

    /// Goes on with a search for γ, or begins one that is due; where it has ended, whether γ came to rest.
    fn seek(&mut self, window: PairWindow<'_>, starts: bool) -> Option<bool> {
        let at_once = starts || self.since_sought.is_none();
        let is_time = self.since_sought.is_none_or(|since| since >= TRIAL);
        self.since_sought = self.since_sought.map(|since| since + 1);
        let is_due = is_time && self.is_vague() && self.moves(window);
        if self.search.is_none() && (starts || is_due) {
            self.search = Some(Search::new(&self.solver, &self.starts(is_due)));
        }
        let search = self.search.as_mut()?;
        search.advance(window, search.pace(window, at_once), &self.solver);
        let search = self.search.take_if(|search| at_once || search.is_done())?;
        let steps = search.steps_left();
        self.joins = false;
        Some(self.decide(search, window, steps))
    }

    /// Whether the readout is sought, and the window too short to say anything of it.
    pub fn knows_little(&self, window: PairWindow<'_>) -> bool {
        let [low, high] = self.solver.limits[0];
        low < high && window.is_short()
    }

    /// Whether anything moves at the frame of a window that may tell a readout or a knot density.
    pub fn moves(&self, window: PairWindow<'_>) -> bool {
        let moved = window.moved().sqrt() * self.solver.radius;
        moved > NOTICEABLE * self.solver.noise && self.breadth(window) > 0.0
    }

    /// Whether the pairs of the frame show enough of the lines, 0 to 1.
    fn breadth(&self, window: PairWindow<'_>) -> f64 {
        window.own_pairs().map(|pair| breadth(pair, self.solver.scan_axis)).fold(1.0, f64::min)
    }

    /// Standard deviation in pixels of what is new in a coordinate of the pairs that the frame is in.
    fn innovation_deviation(&self, window: PairWindow<'_>) -> f64 {
        window.beside().filter_map(|index| self.solver.innovation_deviation(index)).fold(0.0, f64::max)
    }

    /// Whether the path explains less than half of the mean square that points move by in the pairs that the frame is in.
    fn explains_little(&self, window: PairWindow<'_>) -> bool {
        let left = 2.0 * self.innovation_deviation(window).powi(2);
        left > 0.5 * window.moved() * self.solver.radius * self.solver.radius
    }

    /// Share of what a window says that counts: as much as the path explains at its frame, and none where so few lines
    /// show anything that a thing of its own may be all that moves.
    pub fn weight(&self, window: PairWindow<'_>) -> f64 {
        self.breadth(window) * self.solver.explained(self.innovation_deviation(window), window.moved())
    }

    /// Logarithm of the evidence of a window for each of its pairs, up to a constant.
    pub fn log_evidence(&mut self, window: PairWindow<'_>) -> Option<f64> {
        let evidence = self.solver.evidence(window.pairs)?;
        Some(evidence / window.pairs.len().max(1) as f64)
    }

    /// Goes on from the likeliest of the fits; whether γ came to rest where no other one is nearly as likely. Later
    /// windows go on where it did not.
    fn decide(&mut self, search: Search, window: PairWindow<'_>, steps: usize) -> bool {
        if self.moves(window) {
            self.since_sought = Some(0);
        }
        let mut ranked = search.ranked(window).into_iter();
        let Some((_, best)) = ranked.next() else { return false };
        self.solver = best;
        self.rests = iterate(&mut self.solver, window, steps);
        let Some(evidence) = self.solver.evidence(window.pairs) else { return false };
        let apart = |solver: &Solver| (solver.shared[0] - self.solver.shared[0]).abs() > VAGUE;
        self.rests && ranked.all(|(other, solver)| !apart(&solver) || evidence - other > TOLD)
    }

    /// Whether it is on trial and has seen enough: as many windows as begin with other pairs than the first one ends with.
    pub fn ends_trial(&self) -> bool {
        self.is_on_trial && self.evidence.weight() >= KnotDensity::Vibrating.past() as f64
    }

    /// Waits twice as long with the next trial of the other knot density, as one has failed.
    pub fn put_off_trials(&mut self) {
        self.since_trial = 0;
        self.until_trial = (2 * self.until_trial).min(LONGEST_TRIAL);
    }

    /// Whether the path leaves what one of the other knot density may explain.
    fn wants_other_density(&self, window: PairWindow<'_>) -> bool {
        let own = window.own();
        let is_noticed = self
            .solver
            .innovation_deviation(own)
            .is_some_and(|sigma| sigma >= NOTICEABLE * self.solver.noise);
        let is_wanted =
            || self.solver.density == KnotDensity::Vibrating || self.solver.share_by_line(own) > BY_LINE;
        is_noticed && self.moves(window) && is_wanted()
    }

    /// A hypothesis of the other knot density where the path leaves what that may explain, once it has been fitted.
    pub fn challenger(&mut self, window: PairWindow<'_>, starts: bool) -> Option<Self> {
        if window.pairs.is_empty() || self.knows_little(window) {
            return None;
        }
        if self.trial.is_none() && self.since_trial >= self.until_trial && self.wants_other_density(window) {
            self.since_trial = 0;
            let density = self.solver.density.other();
            let is_sought = density == KnotDensity::Vibrating && self.is_vague();
            let sign = if self.direction.is_reversed() { -1.0 } else { 1.0 };
            let readouts = if is_sought { READOUTS.map(|ratio| sign * ratio).to_vec() } else { Vec::new() };
            self.trial = Some(Search::with_density(&self.solver, density, &readouts));
        }
        let trial = self.trial.as_mut()?;
        let steps = if starts { STEPS[0] } else { trial.pace(window, false) };
        trial.advance(window, steps, &self.solver);
        let trial = self.trial.take_if(|trial| trial.is_done())?;
        let (_, mut solver) = trial.ranked(window).into_iter().next()?;
        // What has only a past says too little of how it goes on.
        let is_ahead = window.pairs.len() > window.past;
        solver.foresees = is_ahead && solver.density == KnotDensity::Vibrating;
        let mut other = Self::new(self.direction, self.signs, solver);
        let odds = if other.solver.density == KnotDensity::Vibrating { VIBRATES } else { -VIBRATES };
        (other.prior, other.since_trial, other.since_sought) = (self.prior + odds, 0, self.since_sought);
        (other.score, other.is_on_trial) = (other.prior, true);
        let steps = match (other.solver.is_foreseeing(), starts) {
            (true, _) => other.foresight_steps(starts),
            (false, true) => FORESIGHT_STEPS[0],
            (false, false) => STEPS[0],
        };
        other.settled = iterate(&mut other.solver, window, steps);
        Some(other)
    }
}

/// Steps of the fits from several starts with a pair that comes before the first frame is due.
fn prepared_steps(window: PairWindow<'_>) -> usize {
    PREPARED_STEPS[usize::from(!window.is_short())]
}
