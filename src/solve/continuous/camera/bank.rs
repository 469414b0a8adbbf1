//! The bank of hypotheses about the camera: which edge of the sensor is read first, and how fast it vibrates, each with a fit
//! of its own.
//!
//! Together they are the camera's posterior: a mixture of Gaussians of the signed readout ratio γ along either axis, whose
//! weights follow from the evidence of the same pairs of frames. What the bank states and applies is that of the mixture:
//! the deviation of the readout counts the rivals, and a correction is applied as far as they agree on it.

use crate::parallel::*;
use crate::readout::ReadoutDirection;
use crate::solve::continuous::camera::evidence::Window;
use crate::solve::continuous::camera::given::{Camera, KAPPA_LIMITS, READOUT_BELIEF};
use crate::solve::continuous::camera::hypothesis::Hypothesis;
use crate::solve::continuous::data::matches::ScanAxis;
use crate::solve::continuous::data::window::PairWindow;
use crate::solve::continuous::fit::multistart::TOLD;
use crate::solve::continuous::fit::solver::Solver;
use crate::solve::continuous::prior::belief::Running;
use crate::solve::continuous::prior::smoothness::Smoothness;
use crate::solve::continuous::trajectory::knots::KnotDensity;
use nalgebra::Vector2;

/// A hypothesis that is less likely than another one by a factor of e to this power is given up.
const DECISIVE: f64 = 12.0;
/// Frames with one hypothesis after which the camera may be another one: at first, and at most. Each time that it is not,
/// twice as many, for what has not happened in n frames happens in the next one with a probability of about 1/n (Laplace's
/// rule of succession).
const OTHER_CAMERA: [usize; 2] = [90, 16 * 90];
/// Logarithm of the probability that it is, then or after a gap, one in a thousand; and after a cut, or where one of which the
/// readout is expected is another one or in another mode, one in twenty.
const OTHER_CAMERA_ODDS: [f64; 2] = [-7.0, -3.0];
/// Hypotheses beside which another one is tried: the likeliest, and a rival, as one along the other axis may stay undecided for
/// minutes.
const MOST_BESIDE: usize = 2;

/// Pairs, at least, that a vibration is looked for in, and those that tell one scan axis from another: as many as
/// there are with the usual frames ahead.
const VIBRATING_PAIRS: usize = 10;
const QUESTIONED_PAIRS: usize = 8;

/// What lies between a frame and the one before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Break {
    /// Correspondences.
    None,
    /// Nothing, or time.
    Gap,
    /// Another picture.
    Cut,
}

/// The hypotheses about the camera of a stream.
#[derive(Debug)]
pub struct Bank {
    camera: Camera,
    size: [usize; 2],
    /// Half the width in analysed pixels.
    radius: f64,
    /// Least standard deviation of a coordinate in analysed pixels.
    noise: f64,
    /// The likeliest first; never empty.
    pub hypotheses: Vec<Hypothesis>,
    /// Directions that are to be tried again, one after the other, as the camera may be another one.
    to_try: Vec<ReadoutDirection>,
    /// Logarithm of the probability of each of them beside that of the leading one.
    other_odds: f64,
    /// Frames since there was one to be tried.
    since_tried: usize,
    /// Frames from then on to the next time.
    until_tried: usize,
    has_begun: bool,
}

impl Bank {
    /// For frames of this size in pixels, half as wide as `radius` analysed ones, whose points have the deviation `noise` in
    /// analysed pixels at least.
    pub fn new(camera: Camera, size: [usize; 2], radius: f64, noise: f64) -> Self {
        let mut bank = Self {
            camera,
            size,
            radius,
            noise,
            hypotheses: Vec::new(),
            to_try: Vec::new(),
            other_odds: OTHER_CAMERA_ODDS[0],
            since_tried: 0,
            until_tried: OTHER_CAMERA[0],
            has_begun: false,
        };
        let directions = camera.first_directions();
        bank.hypotheses = directions.into_iter().map(|direction| bank.fresh(direction)).collect();
        if camera.expected().is_some() {
            bank.doubt(OTHER_CAMERA_ODDS[1]);
        }
        bank
    }

    /// A hypothesis that nothing was seen for or against yet.
    fn fresh(&self, direction: ReadoutDirection) -> Hypothesis {
        let [width, height] = self.size;
        let camera = &self.camera;
        let lines = if direction.is_by_rows() { height } else { width };
        let length = 2.0 * lines.max(1) as f64 / width.max(1) as f64;
        let scan_axis = ScanAxis { by_rows: direction.is_by_rows(), length };
        let smoothness = Smoothness::new(camera.model.generators(), KnotDensity::Usual.start_variance());
        let signs = match (camera.direction, direction.is_reversed()) {
            (None, _) => [-1.0, 1.0],
            (Some(_), false) => [0.0, 1.0],
            (Some(_), true) => [-1.0, 0.0],
        };
        let beliefs =
            [READOUT_BELIEF, camera.kappa_belief()].map(|(mean, deviation)| Running::new(mean, deviation));
        let limits = [signs, KAPPA_LIMITS];
        let solver =
            Solver::new(scan_axis, KnotDensity::Usual, self.radius, self.noise, smoothness, beliefs, limits);
        let mut hypothesis = Hypothesis::new(direction, signs, solver);
        hypothesis.prior = Camera::log_prior(direction, width, height);
        hypothesis.score = hypothesis.prior;
        hypothesis
    }

    /// The likeliest hypothesis.
    pub fn leading(&self) -> &Hypothesis {
        &self.hypotheses[0]
    }

    /// Width and height of a frame in pixels.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Whether the readout time is given.
    pub fn knows_readout_time(&self) -> bool {
        self.camera.is_known()
    }

    /// Whether more than one is left.
    pub fn is_in_question(&self) -> bool {
        self.hypotheses.len() > 1
    }

    /// Goes on with fits to the pairs that have come so far, before the first one of them is due.
    pub fn prepare(&mut self, window: PairWindow<'_>) {
        self.hypotheses.par_iter_mut().for_each(|hypothesis| hypothesis.prepare(window));
    }

    /// Fits each hypothesis to the window of a frame and weighs them; `before` is what lies before the frame.
    pub fn settle(&mut self, window: PairWindow<'_>, before: Break) {
        let starts = before != Break::None;
        let longest = window.usual_interval();
        let is_known = self.camera.is_known();
        self.hypotheses.par_iter_mut().for_each(|hypothesis| {
            if !is_known {
                hypothesis.solver.limits[0] = hypothesis.signs.map(|sign| sign * longest);
            }
            hypothesis.settle(window, starts);
        });
        self.share_smoothness(window);
        self.challenge(window, starts);
        self.hypotheses.par_iter_mut().for_each(|hypothesis| hypothesis.conclude(window));
        self.weigh(window);
        self.sort();
        self.try_other_cameras(window, before);
    }

    /// The part of a window that the hypotheses are fitted to: the same for all, so that their evidence can be compared.
    ///
    /// Where few frames are known ahead, more before it are taken in for what shows in many pairs only: which way the
    /// sensor is read, while that is in question, and how a vibration goes on. Else they are of no use, for a shake is soon
    /// another one.
    pub fn window<'a>(&self, window: PairWindow<'a>) -> PairWindow<'a> {
        let is_vibrating = self.hypotheses.iter().any(Hypothesis::looks_for_vibration);
        let density = if is_vibrating { KnotDensity::Vibrating } else { KnotDensity::Usual };
        let least = match (density, self.is_in_question()) {
            (KnotDensity::Vibrating, _) => VIBRATING_PAIRS,
            (KnotDensity::Usual, true) => QUESTIONED_PAIRS,
            (KnotDensity::Usual, false) => 0,
        };
        window.recent(density.past(), least)
    }

    /// Offers the smoothness of the path with the most evidence to the other hypotheses of its knot density: one that has learnt
    /// a worse one than it could is not less likely for that.
    fn share_smoothness(&mut self, window: PairWindow<'_>) {
        if !self.can_compare(window) {
            return;
        }
        let evidence = |hypothesis: &mut Hypothesis| hypothesis.solver.evidence(window.pairs);
        let evidence: Vec<Option<f64>> = self.hypotheses.par_iter_mut().map(evidence).collect();
        for density in [KnotDensity::Usual, KnotDensity::Vibrating] {
            let found = self.hypotheses.iter().zip(&evidence).filter_map(|(hypothesis, evidence)| {
                let solver = &hypothesis.solver;
                (solver.density == density).then_some((evidence.as_ref()?, &solver.smoothness))
            });
            let Some((most, smoothness)) = found.max_by(|a, b| a.0.total_cmp(b.0)) else { continue };
            let smoothness = smoothness.clone();
            self.hypotheses.par_iter_mut().zip(&evidence).for_each(|(hypothesis, evidence)| {
                let evidence = evidence.unwrap_or(f64::NEG_INFINITY);
                if hypothesis.solver.density == density && evidence < most - TOLD {
                    hypothesis.try_smoothness(&smoothness, evidence, window);
                }
            });
        }
    }

    /// Whether there are hypotheses whose evidence of a window tells anything.
    fn can_compare(&self, window: PairWindow<'_>) -> bool {
        let is_new = |hypothesis: &Hypothesis| hypothesis.joins || hypothesis.knows_little(window);
        self.is_in_question() && !window.pairs.is_empty() && !self.hypotheses.iter().any(is_new)
    }

    /// Adds hypotheses of the other knot density where the path leaves what that may explain.
    fn challenge(&mut self, window: PairWindow<'_>, starts: bool) {
        let directions: Vec<ReadoutDirection> =
            self.hypotheses.iter().map(|hypothesis| hypothesis.direction).collect();
        let is_alone =
            |one: &Hypothesis| directions.iter().filter(|other| **other == one.direction).count() == 1;
        let challengers = self.hypotheses.par_iter_mut().filter(|hypothesis| is_alone(hypothesis));
        let found: Vec<Hypothesis> =
            challengers.filter_map(|hypothesis| hypothesis.challenger(window, starts)).collect();
        self.hypotheses.extend(found);
    }

    /// Whether the camera is still the one that is known: now and then, and after a gap or a cut, each direction is tried
    /// anew beside the likeliest hypothesis, one at a time, for each costs as much as that one.
    fn try_other_cameras(&mut self, window: PairWindow<'_>, before: Break) {
        self.since_tried += 1;
        let starts_anew = before != Break::None && std::mem::replace(&mut self.has_begun, true);
        if self.camera.is_known() {
            return;
        }
        if starts_anew || self.since_tried >= self.until_tried {
            let [first, longest] = OTHER_CAMERA;
            self.until_tried = if starts_anew { first } else { (2 * self.until_tried).min(longest) };
            self.doubt(OTHER_CAMERA_ODDS[usize::from(before == Break::Cut)]);
        }
        if self.is_in_question() || !self.to_try.is_empty() {
            self.since_tried = 0;
        }
        if self.hypotheses.len() <= MOST_BESIDE
            && !self.hypotheses.iter().any(|one| one.joins)
            && self.leading().moves(window)
            && let Some(direction) = self.to_try.pop()
        {
            let prior = self.leading().prior + self.other_odds;
            self.hypotheses.push(self.fresh(direction).joining(prior));
        }
    }

    /// Has each direction tried anew, with this logarithm of its probability beside that of the leading one.
    fn doubt(&mut self, odds: f64) {
        self.other_odds = odds;
        let by_rows = self.leading().direction.is_by_rows();
        self.to_try = self.camera.directions();
        // The last one is tried first.
        self.to_try.sort_by_key(|direction| direction.is_by_rows() == by_rows);
    }

    /// Compares the hypotheses by the evidence of the same windows.
    fn weigh(&mut self, window: PairWindow<'_>) {
        if !self.can_compare(window) {
            return;
        }
        let hypotheses = &mut self.hypotheses;
        let weight = hypotheses.iter().map(|hypothesis| hypothesis.weight(window)).fold(0.0, f64::max);
        let design_effects = hypotheses.iter().map(|hypothesis| hypothesis.solver.design_effect());
        let design_effect = design_effects.fold(f64::INFINITY, f64::min);
        let evidence: Option<Vec<f64>> = hypotheses.par_iter_mut().map(|h| h.log_evidence(window)).collect();
        for (hypothesis, evidence) in hypotheses.iter_mut().zip(evidence.into_iter().flatten()) {
            hypothesis.evidence.add(Window { weight, design_effect, evidence, pairs: window.pairs.len() });
        }
        let Some(likeliest) = hypotheses.iter().reduce(|best, other| {
            let odds = other.prior - best.prior + other.evidence.log_odds(&best.evidence);
            if odds > 0.0 { other } else { best }
        }) else {
            return;
        };
        let evidence = likeliest.evidence.clone();
        for hypothesis in hypotheses {
            hypothesis.score = hypothesis.prior + hypothesis.evidence.log_odds(&evidence);
        }
    }

    /// Puts the likeliest first and gives up those that are far less likely, once the first knows its γ: until then it may
    /// have fared well for another reason, and the other one badly because it was not found yet. One on trial gives up
    /// nothing: a few windows have their pairs, and so their errors, in common.
    fn sort(&mut self) {
        self.end_trials();
        self.hypotheses.sort_by(|a, b| b.score.total_cmp(&a.score));
        let first = self.leading();
        let least = first.score - DECISIVE;
        if first.knows_readout() && !first.is_on_trial {
            // The first one stays, whatever numbers a broken window brought about.
            let mut is_first = true;
            self.hypotheses.retain(|hypothesis| {
                std::mem::take(&mut is_first) || hypothesis.joins || hypothesis.score > least
            });
        }
        drop_twins(&mut self.hypotheses);
    }

    /// Gives up hypotheses on trial that have turned out less likely than those of the same direction beside which they are
    /// tried: each would cost as much as that one for as long as nothing tells them apart.
    fn end_trials(&mut self) {
        for index in (0..self.hypotheses.len()).rev() {
            let tried = &mut self.hypotheses[index];
            if !tried.ends_trial() {
                continue;
            }
            tried.is_on_trial = false;
            let (direction, score) = (tried.direction, tried.score);
            let mut others = self.hypotheses.iter_mut().filter(|other| other.direction == direction);
            if let Some(better) = others.find(|other| other.score > score) {
                better.put_off_trials();
                self.hypotheses.remove(index);
            }
        }
    }

    /// The probability of each hypothesis.
    pub fn probabilities(&self) -> Vec<f64> {
        let first = self.leading().score;
        let weights: Vec<f64> = self.hypotheses.iter().map(|other| (other.score - first).exp()).collect();
        let sum: f64 = weights.iter().sum();
        weights.into_iter().map(|weight| weight / sum).collect()
    }

    /// Standard deviation of γ about that of the likeliest hypothesis: of the mixture, by either axis.
    pub fn readout_deviation(&self) -> f64 {
        let gradient = |hypothesis: &Hypothesis| {
            let gamma = hypothesis.solver.shared[0];
            if hypothesis.direction.is_by_rows() {
                Vector2::new(0.0, gamma)
            } else {
                Vector2::new(gamma, 0.0)
            }
        };
        let own = gradient(self.leading());
        let variance = |hypothesis: &Hypothesis| {
            (gradient(hypothesis) - own).norm_squared() + hypothesis.solver.readout_deviation().powi(2)
        };
        let parts = self.probabilities().into_iter().zip(&self.hypotheses);
        parts.map(|(probability, hypothesis)| probability * variance(hypothesis)).sum::<f64>().sqrt()
    }
}

/// Of hypotheses that have come to the same answer from different starts, keeps the likeliest.
fn drop_twins(hypotheses: &mut Vec<Hypothesis>) {
    let mut kept: Vec<Hypothesis> = Vec::with_capacity(hypotheses.len());
    for hypothesis in hypotheses.drain(..) {
        let is_twin = |other: &Hypothesis| {
            other.settled && hypothesis.settled && !other.is_vague() && other.agrees_with(&hypothesis)
        };
        if !kept.iter().any(is_twin) {
            kept.push(hypothesis);
        }
    }
    *hypotheses = kept;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::generators::Model;
    use crate::readout::ReadoutTime;
    use crate::solve::continuous::camera::evidence::Window;

    /// A bank of one direction in which a hypothesis has been on trial for so many windows, this much likelier than the one
    /// beside it; both in this order.
    fn bank_with_trial(windows: usize, odds: f64) -> Bank {
        let direction = Some(ReadoutDirection::TopToBottom);
        let readout_time = ReadoutTime::Unknown;
        let (model, readout_prior, focal_length) = (Model::Auto, None, None);
        let camera = Camera { model, direction, readout_time, readout_prior, focal_length };
        let mut bank = Bank::new(camera, [640, 480], 320.0, 0.03);
        let mut tried = bank.fresh(ReadoutDirection::TopToBottom);
        (tried.is_on_trial, tried.score) = (true, odds);
        for _ in 0..windows {
            tried.evidence.add(Window { weight: 1.0, design_effect: 1.0, evidence: 0.0, pairs: 8 });
        }
        bank.hypotheses.push(tried);
        bank
    }

    #[test]
    fn a_trial_ends_once_it_has_seen_other_pairs() {
        let mut bank = bank_with_trial(5, -1.0);
        bank.end_trials();
        assert_eq!(bank.hypotheses.len(), 2);
        let mut bank = bank_with_trial(6, -1.0);
        bank.end_trials();
        assert_eq!(bank.hypotheses.len(), 1);
        assert!(!bank.leading().is_on_trial);
    }

    #[test]
    fn what_is_likelier_after_its_trial_stays() {
        let mut bank = bank_with_trial(6, 1.0);
        bank.sort();
        assert_eq!(bank.hypotheses.len(), 2);
        assert!(bank.leading().score > 0.0 && bank.hypotheses.iter().all(|one| !one.is_on_trial));
    }

    #[test]
    fn one_on_trial_gives_up_nothing() {
        let mut bank = bank_with_trial(1, 2.0 * DECISIVE);
        bank.hypotheses.iter_mut().for_each(|one| one.solver.shared[0] = 0.5);
        bank.hypotheses[1].solver.know_readout(Running::new(0.5, 0.001));
        bank.sort();
        assert_eq!(bank.hypotheses.len(), 2);
        bank.hypotheses[0].is_on_trial = false;
        bank.sort();
        assert_eq!(bank.hypotheses.len(), 1);
    }
}
