//! The posterior of the camera: hypotheses about which edge of the sensor is read first and how fast the camera vibrates, each
//! with a fit of its own.
//!
//! Together they are a mixture of Gaussians of the signed readout ratio γ along either axis, whose weights follow from the
//! evidence of the same pairs of frames. What is reported and applied is that of the mixture: the deviation of the readout
//! includes the rivals, and a correction is applied as far as they agree on it.

use super::evidence::WindowEvidence;
use super::given::{Camera, KAPPA_LIMITS, KNOWN, READOUT_BELIEF};
use super::hypothesis::{Hypothesis, Phase};
use super::schedule::{Timer, other_camera};
use crate::cpu::CpuLevel;
use crate::parallel::*;
use crate::readout::{Readout, ReadoutDirection};
use crate::solve::continuous::data::{PairWindow, ScanAxis};
use crate::solve::continuous::fit::{DECISIVE_LOG_BAYES_FACTOR, Posterior, Setup};
use crate::solve::continuous::linear::Shared;
use crate::solve::continuous::prior::{Belief, CameraBelief, Smoothness};
use crate::solve::continuous::trajectory::{KnotDensity, Trajectory};
use nalgebra::Vector2;

/// A hypothesis that is less likely than another one by a factor of e to this power is given up.
const DECISIVE: f64 = 12.0;
/// Logarithm of the probability that the camera is another one, after some time or after a gap, one in a thousand; and after a
/// cut, or where one of which the readout is expected is another one or in another mode, one in twenty.
const OTHER_CAMERA_LOG_ODDS: [f64; 2] = [-7.0, -3.0];
/// Hypotheses beside which another one is tried: the likeliest, and a rival, as one along the other axis may stay undecided for
/// minutes.
const MOST_BESIDE: usize = 2;
/// Pairs, at least, that a vibration is looked for in, and those that distinguish one scan axis from another: as many as there
/// are with the usual frames ahead.
const VIBRATING_PAIRS: usize = 10;
const QUESTIONED_PAIRS: usize = 8;
/// The longest readout that is accepted, in frame periods: a converter may have put frames between those of the camera, and a
/// path costs as much as the readout is long.
const LONGEST_READOUT: f64 = 8.0;

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
pub struct CameraPosterior {
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
    other_log_odds: f64,
    /// When all of them are tried again.
    other_camera: Timer,
    has_begun: bool,
}

impl CameraPosterior {
    /// For frames of this size in pixels, half as wide as `radius` analysed ones, whose points have the deviation `noise` in
    /// analysed pixels at least.
    pub fn new(camera: Camera, size: [usize; 2], radius: f64, noise: f64) -> Self {
        let mut posterior = Self {
            camera,
            size,
            radius,
            noise,
            hypotheses: Vec::new(),
            to_try: Vec::new(),
            other_log_odds: OTHER_CAMERA_LOG_ODDS[0],
            other_camera: other_camera(),
            has_begun: false,
        };
        let directions = camera.first_directions();
        posterior.hypotheses = directions.into_iter().map(|direction| posterior.fresh(direction)).collect();
        if camera.expected().is_some() {
            posterior.doubt(OTHER_CAMERA_LOG_ODDS[1]);
        }
        posterior
    }

    /// A hypothesis without evidence.
    fn fresh(&self, direction: ReadoutDirection) -> Hypothesis {
        let [width, height] = self.size;
        let camera = &self.camera;
        let lines = if direction.is_by_rows() { height } else { width };
        let length = 2.0 * lines.max(1) as f64 / width.max(1) as f64;
        let scan_axis = ScanAxis { by_rows: direction.is_by_rows(), length };
        let density = KnotDensity::Usual;
        let smoothness = Smoothness::new(camera.model.generators(), density.start_variance());
        let signs = match (camera.direction, direction.is_reversed()) {
            (None, _) => [-1.0, 1.0],
            (Some(_), false) => [0.0, 1.0],
            (Some(_), true) => [-1.0, 0.0],
        };
        let beliefs = Shared { gamma: READOUT_BELIEF, kappa: camera.kappa_belief() };
        let beliefs = beliefs.map(|(mean, deviation)| Belief::new(mean, deviation));
        let belief = CameraBelief { beliefs, limits: Shared { gamma: signs, kappa: KAPPA_LIMITS } };
        let setup = Setup { cpu: CpuLevel::detect(), scan_axis, noise: self.noise, camera: belief };
        let trajectory = Trajectory::new(density, self.radius);
        let posterior = Posterior::new(trajectory, smoothness, beliefs.map(|belief| belief.mean));
        let log_prior = Camera::log_prior(direction, width, height);
        Hypothesis::new(direction, signs, setup, posterior, log_prior)
    }

    /// Begins a stretch of frames this far apart, in seconds; `before` is the distance of those of the stretch before it.
    pub fn begin(&mut self, period: f64, before: Option<f64>) {
        let [width, height] = self.size;
        let camera = self.camera;
        for hypothesis in &mut self.hypotheses {
            let sign = if hypothesis.direction.is_reversed() { -1.0 } else { 1.0 };
            let gamma = |time: f64| sign * (time / period).min(LONGEST_READOUT);
            if camera.is_known() {
                let direction = hypothesis.direction;
                let readout = Readout::resolved(width, height, direction, camera.readout_time, period);
                hypothesis.give_readout(Belief::new(gamma(readout.time), KNOWN));
            } else if let Some(before) = before {
                hypothesis.scale_readout(before / period);
            } else if let Some(prior) = camera.expected() {
                hypothesis.expect_readout(Belief::new(gamma(prior.time()), prior.deviation() / period));
            }
        }
    }

    /// Continues with frames this far apart, in seconds, instead of `before`: with the camera once its readout is known, or else
    /// anew, as what is believed of a readout beforehand is so in frame periods. The path begins anew. Whether the camera was
    /// kept.
    pub fn change_period(&mut self, before: f64, period: f64) -> bool {
        let factor = before / period;
        let leading = self.leading();
        let is_found = leading.knows_readout() && (factor * leading.gamma()).abs() < LONGEST_READOUT;
        let is_kept = self.camera.is_known() || is_found;
        if is_kept {
            self.hypotheses.iter_mut().for_each(|hypothesis| hypothesis.scale_time(factor));
        } else {
            *self = Self::new(self.camera, self.size, self.radius, self.noise);
            self.begin(period, None);
        }
        is_kept
    }

    /// Forgets the frames, not the camera.
    pub fn restart(&mut self) {
        self.hypotheses.iter_mut().for_each(Hypothesis::drop_searches);
    }

    /// The hypotheses with their probabilities, the likeliest first.
    pub fn hypotheses(&self) -> impl Iterator<Item = (f64, &Hypothesis)> {
        self.probabilities().into_iter().zip(&self.hypotheses)
    }

    /// The likeliest hypothesis.
    pub fn leading(&self) -> &Hypothesis {
        &self.hypotheses[0]
    }

    /// Width and height of a frame in pixels.
    pub fn size(&self) -> [usize; 2] {
        self.size
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
        let longest = (!self.camera.is_known()).then(|| window.usual_interval());
        let settle = |hypothesis: &mut Hypothesis| hypothesis.settle(window, starts, longest);
        self.hypotheses.par_iter_mut().for_each(settle);
        self.share_smoothness(window);
        self.challenge(window, starts);
        self.hypotheses.par_iter_mut().for_each(|hypothesis| hypothesis.conclude(window));
        self.weigh(window);
        self.prune();
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
        let evidence = |hypothesis: &mut Hypothesis| hypothesis.log_evidence(window);
        let evidence: Vec<Option<f64>> = self.hypotheses.par_iter_mut().map(evidence).collect();
        for density in [KnotDensity::Usual, KnotDensity::Vibrating] {
            let found = self.hypotheses.iter().zip(&evidence).filter_map(|(hypothesis, evidence)| {
                (hypothesis.density() == density)
                    .then_some((evidence.as_ref()?, &hypothesis.posterior.smoothness))
            });
            let Some((most, smoothness)) = found.max_by(|a, b| a.0.total_cmp(b.0)) else { continue };
            let smoothness = smoothness.clone();
            self.hypotheses.par_iter_mut().zip(&evidence).for_each(|(hypothesis, evidence)| {
                let evidence = evidence.unwrap_or(f64::NEG_INFINITY);
                if hypothesis.density() == density && evidence < most - DECISIVE_LOG_BAYES_FACTOR {
                    hypothesis.try_smoothness(&smoothness, evidence, window);
                }
            });
        }
    }

    /// Whether there are hypotheses whose evidence of a window distinguishes them.
    fn can_compare(&self, window: PairWindow<'_>) -> bool {
        let is_new = |one: &Hypothesis| one.phase == Phase::AwaitsSearch || one.is_too_short(window);
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
        self.other_camera.tick();
        let starts_anew = before != Break::None && std::mem::replace(&mut self.has_begun, true);
        if self.camera.is_known() {
            return;
        }
        if starts_anew || self.other_camera.is_due() {
            if starts_anew {
                self.other_camera = other_camera();
            } else {
                self.other_camera.back_off();
            }
            self.doubt(OTHER_CAMERA_LOG_ODDS[usize::from(before == Break::Cut)]);
        }
        if self.is_in_question() || !self.to_try.is_empty() {
            self.other_camera.restart();
        }
        let awaits_search = |one: &Hypothesis| one.phase == Phase::AwaitsSearch;
        if self.hypotheses.len() <= MOST_BESIDE
            && !self.hypotheses.iter().any(awaits_search)
            && self.leading().moves(window)
            && let Some(direction) = self.to_try.pop()
        {
            let log_odds = self.leading().log_prior + self.other_log_odds;
            self.hypotheses.push(self.fresh(direction).joining(log_odds));
        }
    }

    /// Has each direction tried anew, with this logarithm of its probability beside that of the leading one.
    fn doubt(&mut self, log_odds: f64) {
        self.other_log_odds = log_odds;
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
        let weight = hypotheses.iter().map(|one| one.weight(window)).fold(0.0, f64::max);
        let design_effects = hypotheses.iter().map(|one| one.posterior.design_effect(&one.setup));
        let design_effect = design_effects.fold(f64::INFINITY, f64::min);
        let evidence: Option<Vec<f64>> =
            hypotheses.par_iter_mut().map(|one| one.log_evidence(window)).collect();
        let pairs = window.pairs.len();
        for (hypothesis, evidence) in hypotheses.iter_mut().zip(evidence.into_iter().flatten()) {
            let evidence = evidence / pairs as f64;
            hypothesis.evidence.add(WindowEvidence { weight, design_effect, evidence, pairs });
        }
        let Some(likeliest) = hypotheses.iter().reduce(|best, other| {
            let odds = other.log_prior - best.log_prior + other.evidence.log_odds(&best.evidence);
            if odds > 0.0 { other } else { best }
        }) else {
            return;
        };
        let evidence = likeliest.evidence.clone();
        for hypothesis in hypotheses {
            hypothesis.log_probability = hypothesis.log_prior + hypothesis.evidence.log_odds(&evidence);
        }
    }

    /// Puts the likeliest first and gives up those that are far less likely, once the first knows its γ: until then it may
    /// have fared well for another reason, and the other one badly because it was not found yet. One on trial gives up
    /// nothing: a few windows have their pairs, and so their errors, in common.
    fn prune(&mut self) {
        self.end_trials();
        self.hypotheses.sort_by(|a, b| b.log_probability.total_cmp(&a.log_probability));
        let first = self.leading();
        let least = first.log_probability - DECISIVE;
        if first.knows_readout() && first.phase != Phase::OnTrial {
            // The first one stays, whatever numbers a broken window brought about.
            let mut is_first = true;
            self.hypotheses.retain(|hypothesis| {
                std::mem::take(&mut is_first)
                    || hypothesis.phase == Phase::AwaitsSearch
                    || hypothesis.log_probability > least
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
            let (direction, log_probability) = (tried.direction, tried.log_probability);
            let mut others = self.hypotheses.iter_mut().filter(|other| other.direction == direction);
            if let Some(better) = others.find(|other| other.log_probability > log_probability) {
                better.put_off_trials();
                self.hypotheses.remove(index);
            }
        }
    }

    /// The probability of each hypothesis.
    fn probabilities(&self) -> Vec<f64> {
        let first = self.leading().log_probability;
        let weight = |other: &Hypothesis| (other.log_probability - first).exp();
        let weights: Vec<f64> = self.hypotheses.iter().map(weight).collect();
        let sum: f64 = weights.iter().sum();
        weights.into_iter().map(|weight| weight / sum).collect()
    }

    /// Standard deviation of γ about that of the likeliest hypothesis: of the mixture, by either axis; 0 where the readout is
    /// given.
    pub fn readout_deviation(&self) -> f64 {
        if self.camera.is_known() {
            return 0.0;
        }
        let gradient = |hypothesis: &Hypothesis| {
            let gamma = hypothesis.gamma();
            if hypothesis.direction.is_by_rows() {
                Vector2::new(0.0, gamma)
            } else {
                Vector2::new(gamma, 0.0)
            }
        };
        let own = gradient(self.leading());
        let variance = |hypothesis: &Hypothesis| {
            (gradient(hypothesis) - own).norm_squared() + hypothesis.setup.camera.gamma_deviation().powi(2)
        };
        self.hypotheses().map(|(probability, one)| probability * variance(one)).sum::<f64>().sqrt()
    }

    /// Whether the readout time is given.
    pub fn is_readout_given(&self) -> bool {
        self.camera.is_known()
    }

    /// Focal length in frame widths and its standard deviation, to first order that of κ; `None` where the model has no
    /// perspective, or none shows.
    pub fn focal_length(&self) -> Option<(f64, f64)> {
        let leading = self.leading();
        let (kappa, deviation) =
            (leading.posterior.shared.kappa, leading.setup.camera.beliefs.kappa.deviation());
        if !self.camera.model.has_perspective() || kappa <= 0.0 {
            return None;
        }
        let focal = 0.5 / kappa.sqrt();
        let is_given = self.camera.focal_length.is_some();
        Some((focal, if is_given { 0.0 } else { 0.5 * focal * deviation / kappa }))
    }
}

/// Of hypotheses that have come to the same answer from different starts, keeps the likeliest.
fn drop_twins(hypotheses: &mut Vec<Hypothesis>) {
    let mut kept: Vec<Hypothesis> = Vec::with_capacity(hypotheses.len());
    for hypothesis in hypotheses.drain(..) {
        let is_twin = |other: &Hypothesis| {
            other.has_converged
                && hypothesis.has_converged
                && !other.is_vague()
                && other.agrees_with(&hypothesis)
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

    /// A bank of one direction in which a hypothesis has been on trial for so many windows, this much likelier than the one
    /// beside it; both in this order.
    fn posterior_with_trial(windows: usize, odds: f64) -> CameraPosterior {
        let direction = Some(ReadoutDirection::TopToBottom);
        let readout_time = ReadoutTime::Unknown;
        let (model, readout_prior, focal_length) = (Model::Auto, None, None);
        let camera = Camera { model, direction, readout_time, readout_prior, focal_length };
        let mut posterior = CameraPosterior::new(camera, [640, 480], 320.0, 0.03);
        let mut tried = posterior.fresh(ReadoutDirection::TopToBottom);
        (tried.phase, tried.log_probability) = (Phase::OnTrial, odds);
        for _ in 0..windows {
            tried.evidence.add(WindowEvidence { weight: 1.0, design_effect: 1.0, evidence: 0.0, pairs: 8 });
        }
        posterior.hypotheses.push(tried);
        posterior
    }

    #[test]
    fn a_trial_ends_once_it_has_seen_other_pairs() {
        let mut posterior = posterior_with_trial(5, -1.0);
        posterior.end_trials();
        assert_eq!(posterior.hypotheses.len(), 2);
        let mut posterior = posterior_with_trial(6, -1.0);
        posterior.end_trials();
        assert_eq!(posterior.hypotheses.len(), 1);
        assert!(posterior.leading().phase == Phase::Established);
    }

    #[test]
    fn what_is_likelier_after_its_trial_stays() {
        let mut posterior = posterior_with_trial(6, 1.0);
        posterior.prune();
        assert_eq!(posterior.hypotheses.len(), 2);
        assert!(
            posterior.leading().log_probability > 0.0
                && posterior.hypotheses.iter().all(|one| one.phase == Phase::Established)
        );
    }

    #[test]
    fn one_on_trial_gives_up_nothing() {
        let mut posterior = posterior_with_trial(1, 2.0 * DECISIVE);
        posterior.hypotheses.iter_mut().for_each(|one| one.posterior.shared.gamma = 0.5);
        posterior.hypotheses[1].setup.camera.give_gamma(Belief::new(0.5, 0.001));
        posterior.prune();
        assert_eq!(posterior.hypotheses.len(), 2);
        posterior.hypotheses[0].phase = Phase::Established;
        posterior.prune();
        assert_eq!(posterior.hypotheses.len(), 1);
    }
}
