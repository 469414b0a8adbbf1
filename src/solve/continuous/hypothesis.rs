//! One way in which the sensor may be read, with a solver of its own.

use super::pair::{Pair, Reading};
use super::solver::{Solver, Tempo};
use crate::readout::ReadoutDirection;
use crate::solve::median::median;
use rayon::prelude::*;

/// Residuals of less than so many times the least noise are nothing but noise.
pub(super) const NOTICEABLE: f64 = 4.0;
/// Steps to the first path, and to each one after it, at most. As many as to the first where γ has not come
/// to rest: while it is far off, the splines bend to imitate the shutter, and learn to be straight again only
/// as it comes nearer. Not all at once, for a live stream does not wait.
const STEPS: [usize; 2] = [12, 4];
/// The same where it is learnt how a vibration goes on: that needs more steps, and what it changes hardly shows between
/// frames, so that none is spared.
const FORESIGHT_STEPS: [usize; 2] = [36, 3];
/// A path that leaves more than goes with this trust is not foreseen.
const FORESEEABLE: f64 = 0.5;
/// Readout ratios beside the one in hand from which a vague one is sought: the ends, as what is in between is reached.
const ENDS: [f64; 2] = [0.9, -0.9];
/// A readout ratio, or a tempo, is told from another where its evidence is greater by a factor of e to this power.
const TOLD: f64 = 5.0;
/// A step that changes the displacements at the frame by less than this share of the least noise (root mean
/// square) is the last.
const SETTLED: f64 = 0.3;
/// Or γ by less than this.
const SETTLED_READOUT: f64 = 0.01;
/// What a window says of γ is believed where the last step moved points by less than they scatter, and γ by
/// no more than this share of what is uncertain of it anyway.
const UNCERTAIN: f64 = 0.5;
/// A path that leaves more than this share of the mean squared displacement is tried at another tempo.
const UNEXPLAINED: f64 = 0.05;
/// Readout ratios from which a vibration is looked for where the readout is unknown.
const READOUTS: [f64; 4] = [0.9, 0.5, -0.5, -0.9];
/// Pairs that tell one readout from another.
const FEWEST_PAIRS: usize = 4;
/// Pairs, at least, that a vibration is looked for in, and those that tell one reading axis from another: as many as
/// there are with the usual frames ahead.
const VIBRATING_PAIRS: usize = 10;
const QUESTIONED_PAIRS: usize = 8;
/// A readout ratio that is known worse than this may be anything.
const VAGUE: f64 = 0.2;
/// A readout ratio that is known as well as this, or that is so many deviations from none, may be relied upon.
const WELL_KNOWN: f64 = 0.02;
const EVIDENT: f64 = 4.0;
/// Frames from one trial of another tempo, or search for the readout, to the next.
pub(super) const TRIAL: usize = 15;

/// Where more than this share of the matches goes its own way, a path for the rest is tried,
const APART: f64 = 0.25;
/// unless the path for everything leaves residuals that are the tracker's to this degree.
const TRUSTED: f64 = 0.5;
/// A path for the rest is worth what it does not see where it is trusted by this factor more.
const PREFERRED: f64 = 2.0;

/// Bands of lines in which matches are looked for.
const LINES: usize = 16;

/// Pairs that follow one another, around a frame.
#[derive(Clone, Copy)]
pub(super) struct Stretch<'a> {
    pub pairs: &'a [&'a Pair],
    /// Number of those before the frame.
    pub past: usize,
    /// Whether the reading axis is still in question.
    pub in_question: bool,
}

impl<'a> Stretch<'a> {
    /// The part of it that a path of this tempo is fitted to.
    ///
    /// Where few frames are known ahead, more before it are taken in for what shows in many pairs only: how a vibration
    /// goes on, and which way the sensor is read. Else they are of no use, for a shake is soon another one.
    pub fn of_tempo(self, tempo: Tempo) -> Self {
        let least = match (tempo, self.in_question) {
            (Tempo::Vibrating, _) => VIBRATING_PAIRS,
            (Tempo::Calm, true) => QUESTIONED_PAIRS,
            (Tempo::Calm, false) => 0,
        };
        let ahead = self.pairs.len().saturating_sub(self.past);
        let skipped = self.past.saturating_sub(tempo.past().max(least.saturating_sub(ahead)));
        let pairs = self.pairs.get(skipped..).unwrap_or_default();
        Self { pairs, past: self.past - skipped, ..self }
    }

    /// Indices of the pairs that the frame is in.
    pub fn beside(self) -> impl Iterator<Item = usize> + Clone {
        let count = self.pairs.len();
        [self.past.checked_sub(1), Some(self.past)].into_iter().flatten().filter(move |index| *index < count)
    }

    /// The pairs that the frame is in.
    fn own_pairs(self) -> impl Iterator<Item = &'a Pair> {
        self.beside().filter_map(move |index| self.pairs.get(index).copied())
    }

    /// Whether it is too short to say anything of a readout: some path fits a pair or two with any shutter, and
    /// whatever it stands for.
    fn is_short(self) -> bool {
        self.pairs.len() < FEWEST_PAIRS
    }

    /// Mean square distance by which points moved in the pairs that the frame is in, in squared units of the radius.
    pub fn moved(self) -> f64 {
        self.own_pairs().map(Pair::moved).fold(0.0, f64::max)
    }

    /// Share of the matches that go their own way at the frame.
    pub fn apart(self) -> f64 {
        self.own_pairs().map(Pair::apart).fold(0.0, f64::max)
    }

    /// Index of the pair that the frame begins; without lookahead, of the one that it ends.
    pub fn own(self) -> usize {
        self.past.min(self.pairs.len().saturating_sub(1))
    }

    /// The middle one of the intervals between the pairs' frames, in frame periods; a readout takes no longer.
    pub fn usual_interval(self) -> f64 {
        let mut intervals: Vec<f64> =
            self.pairs.iter().map(|pair| (pair.stamps[1] - pair.stamps[0]).abs()).collect();
        if intervals.is_empty() { 1.0 } else { median(&mut intervals) }
    }
}

/// A way in which the sensor may be read.
#[derive(Clone, Debug)]
pub(super) struct Hypothesis {
    /// Which edge is first, where γ is known to be positive or negative.
    pub direction: ReadoutDirection,
    /// The least and the greatest γ, in intervals between frames.
    pub signs: [f64; 2],
    pub solver: Solver,
    /// Logarithm of its likelihood, up to a constant.
    pub score: f64,
    /// The same by the rough estimate.
    pub rough: f64,
    /// Frames since another tempo was tried.
    since_trial: usize,
    /// Frames since γ was sought from several starts.
    since_sought: usize,
    /// Whether γ has come to rest since.
    rests: bool,
    /// Whether it was learnt in the window before how a vibration goes on.
    foresaw: bool,
}

impl Hypothesis {
    /// A hypothesis that nothing speaks for or against yet.
    pub fn new(direction: ReadoutDirection, signs: [f64; 2], solver: Solver) -> Self {
        Self {
            direction,
            signs,
            solver,
            score: 0.0,
            rough: 0.0,
            since_trial: TRIAL,
            since_sought: TRIAL,
            rests: true,
            foresaw: false,
        }
    }

    /// Logarithm of the likelihood, up to a constant.
    pub fn likelihood(&self) -> f64 {
        self.score + self.rough
    }

    /// Whether γ is known, be it that there is none.
    pub fn knows_readout(&self) -> bool {
        let deviation = self.solver.readout_deviation();
        deviation < WELL_KNOWN || self.solver.shared[0].abs() > EVIDENT * deviation
    }

    /// Fits the path to a stretch.
    pub fn settle(&mut self, stretch: Stretch<'_>, starts: bool) {
        if starts {
            self.solver.restart();
        }
        if stretch.pairs.is_empty() {
            return;
        }
        if self.knows_little(stretch) {
            iterate(&mut self.solver, stretch, STEPS[usize::from(!starts)]);
            return;
        }
        self.since_sought += 1;
        let is_due = self.since_sought >= TRIAL && self.solver.readout_deviation() > VAGUE;
        let settled = if is_due && self.moves(stretch) {
            self.seek(stretch)
        } else {
            let foresees = self.solver.is_foreseeing();
            let first = starts || if foresees { !self.foresaw } else { !self.rests };
            self.foresaw = foresees;
            let steps = most_steps(&self.solver, first);
            let fit = if starts { begin } else { iterate };
            let rests = fit(&mut self.solver, stretch, steps);
            self.rests |= rests;
            rests
        };
        self.try_tempo(stretch);
        if settled {
            self.remember(stretch);
        }
    }

    /// Whether the readout is sought, and the stretch too short to say anything of it.
    pub fn knows_little(&self, stretch: Stretch<'_>) -> bool {
        let [low, high] = self.solver.limits[0];
        low < high && stretch.is_short()
    }

    /// Whether anything moves at the frame of a stretch that may tell a readout or a tempo.
    fn moves(&self, stretch: Stretch<'_>) -> bool {
        let moved = stretch.moved().sqrt() * self.solver.radius;
        moved > NOTICEABLE * self.solver.noise && self.breadth(stretch) > 0.0
    }

    /// Whether the pairs of the frame show enough of the lines, 0 to 1.
    fn breadth(&self, stretch: Stretch<'_>) -> f64 {
        stretch.own_pairs().map(|pair| breadth(pair, self.solver.reading)).fold(1.0, f64::min)
    }

    /// Share of what a stretch says that counts: as much as the path explains at its frame, and none where so few lines
    /// show anything that a thing of its own may be all that moves.
    pub fn worth(&self, stretch: Stretch<'_>) -> f64 {
        let stretch = stretch.of_tempo(self.solver.tempo);
        let surprise = stretch.beside().filter_map(|index| self.solver.surprise(index)).fold(0.0, f64::max);
        self.breadth(stretch) * self.solver.explained(surprise, stretch.moved())
    }

    /// Logarithm of the evidence of a pair of the stretch, up to a constant.
    pub fn evidence(&mut self, stretch: Stretch<'_>) -> Option<f64> {
        evidence(&mut self.solver, stretch)
    }

    /// Fits the path from several readout ratios and goes on from the likeliest; whether γ came to rest where no other
    /// one is nearly as likely. Later windows go on where it did not.
    fn seek(&mut self, stretch: Stretch<'_>) -> bool {
        self.since_sought = 0;
        let pairs = stretch.of_tempo(self.solver.tempo).pairs;
        let [low, high] = self.solver.limits[0];
        let ends = ENDS.into_iter().filter(|end| (low..=high).contains(end));
        let tried = std::iter::once(self.solver.shared[0]).chain(ends).filter_map(|readout| {
            let mut solver = self.solver.clone();
            solver.shared[0] = readout;
            begin(&mut solver, stretch, STEPS[0]);
            solver.evidence(pairs).map(|evidence| (evidence, solver))
        });
        let mut tried: Vec<(f64, Solver)> = tried.collect();
        tried.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut tried = tried.into_iter();
        let Some((_, best)) = tried.next() else { return false };
        self.solver = best;
        self.rests = iterate(&mut self.solver, stretch, STEPS[0]);
        let Some(evidence) = self.solver.evidence(pairs) else { return false };
        let apart = |solver: &Solver| (solver.shared[0] - self.solver.shared[0]).abs() > VAGUE;
        self.rests && tried.all(|(other, solver)| !apart(&solver) || evidence - other > TOLD)
    }

    /// The same for a path that stands for the scene alone, or again for everything.
    fn turned(&self, stretch: Stretch<'_>) -> Self {
        let mut other = self.clone();
        other.solver.scene_alone = !self.solver.scene_alone;
        let settled = if self.solver.readout_deviation() > VAGUE {
            other.seek(stretch)
        } else {
            begin(&mut other.solver, stretch, STEPS[0])
        };
        if settled {
            other.remember(stretch);
        }
        other
    }

    /// Adds what a stretch says to the beliefs, as far as it is worth anything, once for each of its pairs.
    fn remember(&mut self, stretch: Stretch<'_>) {
        let seen = stretch.of_tempo(self.solver.tempo);
        self.solver.remember(self.worth(stretch) / seen.pairs.len() as f64);
    }

    /// Goes over to another tempo where that is worth it.
    fn try_tempo(&mut self, stretch: Stretch<'_>) {
        self.since_trial += 1;
        let tempo = self.solver.tempo;
        let sigma_of = |solver: &Solver| solver.surprise(stretch.of_tempo(solver.tempo).own());
        let (Some(sigma), Some(pair)) = (sigma_of(&self.solver), stretch.pairs.get(stretch.own())) else {
            return;
        };
        let moved = pair.moved() * self.solver.radius * self.solver.radius;
        let wanted = tempo == Tempo::Vibrating || 2.0 * sigma * sigma > UNEXPLAINED * moved;
        let is_due = self.since_trial >= TRIAL && wanted && self.moves(stretch);
        if !is_due || sigma < NOTICEABLE * self.solver.noise {
            return;
        }
        self.since_trial = 0;
        let vague = tempo == Tempo::Calm && self.solver.readout_deviation() > VAGUE;
        let starts = if vague { &READOUTS[..] } else { &[] };
        let trials = starts.iter().map(Some).chain([None]).filter_map(|readout| {
            let mut other = self.solver.at_tempo(tempo.other());
            let [low, high] = other.limits[0];
            other.shared[0] = readout.map_or(other.shared[0], |readout| readout.clamp(low, high));
            iterate(&mut other, stretch, STEPS[0]);
            evidence(&mut other, stretch).map(|evidence| (evidence, other))
        });
        let Some((others, mut other)) = trials.max_by(|a, b| a.0.total_cmp(&b.0)) else { return };
        let Some(own) = evidence(&mut self.solver.clone(), stretch) else { return };
        // Per pair: the two tempos look at different numbers of them.
        let pairs = stretch.of_tempo(Tempo::Calm).pairs.len() as f64;
        if self.solver.trust_in_evidence().max(other.trust_in_evidence()) * pairs * (others - own) > TOLD {
            // What things of their own do is no vibration, and does not go on as one; and what has only a past says too
            // little of how it goes on.
            let is_ahead = stretch.pairs.len() > stretch.past;
            other.foresees =
                is_ahead && other.tempo == Tempo::Vibrating && other.trust_in_evidence() > FORESEEABLE;
            let steps = most_steps(&other, true);
            iterate(&mut other, stretch, steps);
            self.foresaw = other.is_foreseeing();
            self.solver = other;
        }
    }
}

/// Lets the paths stand for the scene alone where what moves on its own leaves no other one with little that is new in
/// it, and for everything again where one for everything does as well.
pub(super) fn try_scene(hypotheses: &mut Vec<Hypothesis>, stretch: Stretch<'_>, since: &mut usize) {
    *since += 1;
    if *since < TRIAL || stretch.is_short() {
        return;
    }
    let Some(alone) = hypotheses.first().map(|hypothesis| hypothesis.solver.scene_alone) else { return };
    let trust = |all: &[Hypothesis]| all.iter().map(|one| one.solver.trust()).fold(0.0, f64::max);
    let own = trust(hypotheses);
    if !alone && (own >= TRUSTED || stretch.apart() <= APART) {
        return;
    }
    *since = 0;
    let others: Vec<Hypothesis> =
        hypotheses.par_iter().map(|hypothesis| hypothesis.turned(stretch)).collect();
    let other = trust(&others);
    let goes_over = if alone { PREFERRED * other > own } else { other > PREFERRED * own };
    if goes_over {
        *hypotheses = others;
    }
}

/// Logarithm of the evidence of a pair of a stretch, up to a constant.
fn evidence(solver: &mut Solver, stretch: Stretch<'_>) -> Option<f64> {
    let pairs = stretch.of_tempo(solver.tempo).pairs;
    solver.evidence(pairs).map(|evidence| evidence / pairs.len().max(1) as f64)
}

/// Whether a pair shows enough of the picture's lines to tell a shutter from a thing that moves on its own: 0 up to a
/// quarter of them, 1 from a half on.
pub(super) fn breadth(pair: &Pair, reading: Reading) -> f64 {
    let mut shown = [false; LINES];
    for one in &pair.matches {
        let line = reading.place(one.from) * LINES as f64;
        shown[line.clamp(0.0, LINES as f64 - 1.0) as usize] = true;
    }
    let share = shown.iter().filter(|shown| **shown).count() as f64 / LINES as f64;
    (4.0 * share - 1.0).clamp(0.0, 1.0)
}

/// Steps to a path, at most: the first one or a later one.
fn most_steps(solver: &Solver, first: bool) -> usize {
    let steps = if solver.is_foreseeing() { FORESIGHT_STEPS } else { STEPS };
    steps[usize::from(!first)]
}

/// Fits a path anew, in as many steps at most; whether γ came to rest.
///
/// In one pair a camera that moves does much the same to a picture as one that turns, and at first it is presumed to
/// turn. But only what moves it has a parallax, and unless that is known for what it is, it weighs as noise and holds
/// the path where it is. So where a path leaves more than noise, another one is begun for a camera that moves.
fn begin(solver: &mut Solver, stretch: Stretch<'_>, steps: usize) -> bool {
    let shared = solver.shared;
    solver.restart();
    let rests = iterate(solver, stretch, steps);
    if stretch.is_short() || solver.trust() >= TRUSTED {
        return rests;
    }
    let mut moving = solver.clone();
    moving.shared = shared;
    moving.presume_moving();
    let moving_rests = iterate(&mut moving, stretch, steps);
    let Some(likelier) = evidence(&mut moving, stretch) else { return rests };
    if evidence(solver, stretch).is_some_and(|own| own >= likelier) {
        return rests;
    }
    *solver = moving;
    moving_rests
}

/// Steps until nothing changes any more at the frame, at most so many; whether γ came to rest.
fn iterate(solver: &mut Solver, stretch: Stretch<'_>, steps: usize) -> bool {
    let stretch = stretch.of_tempo(solver.tempo);
    let mut rests = false;
    for _ in 0..steps {
        let before = solver.shared[0];
        if !solver.step(stretch.pairs) {
            solver.restart();
            continue;
        }
        let change = stretch.beside().map(|index| solver.moved(index)).fold(0.0, f64::max);
        let moved = (solver.shared[0] - before).abs();
        if change < SETTLED * solver.noise && moved < SETTLED_READOUT {
            rests = true;
            if solver.is_foreseeing() {
                continue;
            }
            break;
        }
        // Robust weights may go back and forth for ever, by less than is uncertain anyway.
        let sigma = stretch.beside().filter_map(|index| solver.sigma(index)).fold(0.0, f64::max);
        let slack = UNCERTAIN * solver.seen_deviation();
        rests = change < sigma && moved < SETTLED_READOUT.max(slack);
    }
    solver.cover(stretch.pairs);
    rests
}
