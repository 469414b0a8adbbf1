// SPDX-License-Identifier: MIT OR Apache-2.0

//! The posterior of the camera: hypotheses about the axis along which the sensor is read and the knot density,
//! each with a fit of its own.
//!
//! They are a mixture of Gaussians of the signed readout ratio γ along either axis, weighted by the evidence
//! of the same pairs of frames. The mixture is what is reported and applied: its deviation includes the
//! rivals, and a correction is applied as far as they agree on it.

use super::evidence::WindowEvidence;
use super::given::{Camera, GIVEN_DEVIATION, KAPPA_LIMITS, READOUT_BELIEF, Scan};
use super::hypothesis::{Hypothesis, Phase};
use super::schedule::{Timer, other_camera};
use crate::cpu::CpuLevel;
use crate::parallel::*;
use crate::readout::{Readout, ReadoutDirection};
use crate::solve::continuous::data::{PairWindow, ScanAxis};
use crate::solve::continuous::fit::{COMPARED_PAIRS, DECISIVE_LOG_ODDS, Posterior, Setup};
use crate::solve::continuous::linear::Shared;
use crate::solve::continuous::prior::{Belief, CameraBelief, Smoothness};
use crate::solve::continuous::trajectory::{KnotDensity, Trajectory};
use nalgebra::Vector2;

/// Log odds below the likeliest hypothesis at which one is dropped.
const DROP_LOG_ODDS: f64 = 12.0;
/// Odds against the likeliest hypothesis below which a rival is fitted only when its path ends, as successive windows share all but
/// one of their pairs. Decisions between likelier ones do not wait: *night* would keep 28.6 % of the displacement, not 23.6.
const UNLIKELY_ODDS: f64 = 0.05;
/// Prior log odds of another camera: after some time or a gap, one in a thousand; after a cut, or of one
/// other than the expected or in another mode, one in twenty.
const OTHER_CAMERA_LOG_ODDS: [f64; 2] = [-7.0, -3.0];
/// Most hypotheses beside which another one is tried: a rival along the other axis may stay for minutes.
const MAX_BESIDE: usize = 2;
/// Fewest pairs of a window with a vibration.
const VIBRATING_PAIRS: usize = 10;
/// Longest readout in frame periods. It may exceed one if a converter inserted frames, at a cost.
const MAX_READOUT: f64 = 8.0;

/// The connection of a frame with the one before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Break {
    /// By correspondences.
    None,
    /// A start, or an interval without frames.
    Gap,
    /// Too few correspondences.
    Cut,
}

/// The hypotheses about the camera of a stream.
#[derive(Debug)]
pub struct CameraPosterior {
    pub camera: Camera,
    /// Width and height of a frame in pixels.
    pub size: [usize; 2],
    /// Half the width in analysed pixels.
    radius: f64,
    /// Least standard deviation of a coordinate in analysed pixels.
    noise: f64,
    /// The likeliest first; never empty.
    pub hypotheses: Vec<Hypothesis>,
    /// Components of the prior to be tried again, the last first.
    to_try: Vec<Scan>,
    /// Prior log odds of each of them beside the leading one.
    other_log_odds: f64,
    /// Whether they may be fitted slowly, as nothing but time suggests another camera.
    at_leisure: bool,
    /// When all are tried again.
    other_camera: Timer,
    /// Whether there was a window with pairs.
    has_begun: bool,
    /// Windows by which hypotheses could be compared so far.
    windows: usize,
}

impl CameraPosterior {
    /// For frames of this size in pixels; `radius` is half the width and `noise` the least standard deviation
    /// of a coordinate, in analysed pixels.
    pub fn new(camera: Camera, size: [usize; 2], radius: f64, noise: f64) -> Self {
        let mut posterior = Self {
            camera,
            size,
            radius,
            noise,
            hypotheses: Vec::new(),
            to_try: Vec::new(),
            other_log_odds: OTHER_CAMERA_LOG_ODDS[0],
            at_leisure: false,
            other_camera: other_camera(),
            has_begun: false,
            windows: 0,
        };
        posterior.hypotheses = camera.first_scans().into_iter().map(|scan| posterior.fresh(scan)).collect();
        if camera.expected().is_some() {
            posterior.retry_all(OTHER_CAMERA_LOG_ODDS[1]);
        }
        posterior
    }

    /// A hypothesis without evidence.
    fn fresh(&self, scan: Scan) -> Hypothesis {
        let [width, height] = self.size;
        let camera = &self.camera;
        let lines = if scan.by_rows { height } else { width };
        let length = 2.0 * lines.max(1) as f64 / width.max(1) as f64;
        let scan_axis = ScanAxis { by_rows: scan.by_rows, length };
        let density = KnotDensity::Usual;
        let smoothness = Smoothness::new(camera.model.generators(), density.start_variance());
        let signs = match camera.direction.map(ReadoutDirection::is_reversed) {
            None => [-1.0, 1.0],
            Some(false) => [0.0, 1.0],
            Some(true) => [-1.0, 0.0],
        };
        let beliefs = Shared { gamma: READOUT_BELIEF, kappa: camera.kappa_belief() };
        let beliefs = beliefs.map(|(mean, deviation)| Belief::new(mean, deviation));
        let belief = CameraBelief { beliefs, limits: Shared { gamma: signs, kappa: KAPPA_LIMITS } };
        let setup = Setup { cpu: CpuLevel::detect(), scan_axis, noise: self.noise, camera: belief };
        let trajectory = Trajectory::new(density, self.radius);
        let posterior = Posterior::new(trajectory, smoothness, beliefs.map(|belief| belief.mean));
        let log_prior = Camera::log_prior(scan.by_rows, width, height);
        Hypothesis::new(scan, signs, setup, posterior, log_prior)
    }

    /// Begins a stretch of frames; frame periods of this stretch and the one before, in seconds.
    pub fn begin(&mut self, period: f64, before: Option<f64>) {
        let [width, height] = self.size;
        let camera = self.camera;
        for hypothesis in &mut self.hypotheses {
            let Scan { by_rows, is_reversed } = hypothesis.scan;
            let sign = if is_reversed == Some(true) { -1.0 } else { 1.0 };
            let gamma = |time: f64| sign * (time / period).min(MAX_READOUT);
            if camera.is_known() {
                let direction =
                    if by_rows { ReadoutDirection::TopToBottom } else { ReadoutDirection::LeftToRight };
                let readout = Readout::resolved(width, height, direction, camera.readout_time, period);
                let gamma = gamma(readout.time);
                hypothesis.expect_readout(Belief::new(gamma, GIVEN_DEVIATION));
                hypothesis.setup.camera.hold_gamma(gamma);
            } else if let Some(before) = before {
                hypothesis.scale_readout(before / period);
            } else if let Some(prior) = camera.expected() {
                hypothesis.expect_readout(Belief::new(gamma(prior.time()), prior.deviation() / period));
            }
        }
    }

    /// Changes the frame period, in seconds, and resets the path. A significant readout is kept; else all
    /// starts anew, as the prior of γ is in frame periods. Whether the camera was kept.
    pub fn change_period(&mut self, before: f64, period: f64) -> bool {
        let factor = before / period;
        let leading = self.leading();
        let is_found = leading.is_readout_significant() && (factor * leading.gamma()).abs() < MAX_READOUT;
        let is_kept = self.camera.is_known() || is_found;
        if is_kept {
            self.hypotheses.iter_mut().for_each(|hypothesis| hypothesis.scale_time(factor));
        } else {
            self.forget(period);
        }
        is_kept
    }

    /// Starts anew with frame periods of so many seconds.
    pub fn forget(&mut self, period: f64) {
        *self = Self::new(self.camera, self.size, self.radius, self.noise);
        self.begin(period, None);
    }

    /// The hypotheses with their probabilities, the likeliest first.
    pub fn hypotheses(&self) -> impl Iterator<Item = (f64, &Hypothesis)> {
        let first = self.leading().log_probability;
        let weight = move |one: &Hypothesis| (one.log_probability - first).exp();
        let sum: f64 = self.hypotheses.iter().map(weight).sum();
        self.hypotheses.iter().map(move |one| (weight(one) / sum, one))
    }

    /// The likeliest hypothesis.
    pub fn leading(&self) -> &Hypothesis {
        &self.hypotheses[0]
    }

    /// The hypotheses that were fitted to the last window.
    fn fitted(&mut self) -> Vec<&mut Hypothesis> {
        self.hypotheses.iter_mut().filter(|one| one.is_fitted).collect()
    }

    /// Whether there are several hypotheses.
    fn is_undecided(&self) -> bool {
        self.hypotheses.len() > 1
    }

    /// Advances fits to the pairs so far, before the first of their frames is due.
    pub fn prepare(&mut self, window: PairWindow<'_>) {
        self.hypotheses.par_iter_mut().for_each(|hypothesis| hypothesis.prepare(window));
    }

    /// Fits each hypothesis to the window of a frame, and updates their probabilities.
    pub fn settle(&mut self, window: PairWindow<'_>, before: Break) {
        let starts = before != Break::None;
        let longest = (!self.camera.is_known()).then(|| window.usual_interval());
        let settle = |hypothesis: &mut Hypothesis| hypothesis.settle(window, starts, longest);
        let unlikely = self.leading().log_probability + UNLIKELY_ODDS.ln();
        let settle_rival = |rival: &mut Hypothesis| {
            if starts || rival.log_probability > unlikely || rival.needs_fit(window) {
                settle(rival);
            } else {
                rival.skip();
            }
        };
        if let Some((leading, rivals)) = self.hypotheses.split_first_mut() {
            settle(leading);
            // Without a motion that tells hypotheses apart, the others wait for one.
            let is_needed = |one: &Hypothesis| one.constrains_gamma() || one.considers_vibration();
            let rests = !(starts || window.is_short() || self.camera.is_known());
            if rests && !is_needed(leading) && !rivals.iter().any(is_needed) {
                rivals.iter_mut().for_each(Hypothesis::rest);
            } else {
                rivals.par_iter_mut().for_each(settle_rival);
            }
        }
        self.split();
        self.share_smoothness(window);
        self.challenge(window, starts);
        self.hypotheses.par_iter_mut().for_each(|hypothesis| hypothesis.conclude(window));
        self.weigh(window);
        self.prune();
        self.try_other_cameras(window, before);
    }

    /// Adds hypotheses for each γ that a search has found beside another one.
    fn split(&mut self) {
        let found: Vec<Hypothesis> = self.hypotheses.iter_mut().flat_map(Hypothesis::split).collect();
        for one in found {
            if !self.hypotheses.iter().any(|other| other.agrees_with(&one)) {
                self.hypotheses.push(one);
            }
        }
    }

    /// The part of a window that all hypotheses are fitted to, so that their evidence is comparable.
    ///
    /// With few pairs ahead, more of the past are included if many are needed: to compare hypotheses, and to
    /// predict a vibration. Otherwise they are of no use, as shake is soon uncorrelated.
    pub fn window<'a>(&self, window: PairWindow<'a>) -> PairWindow<'a> {
        let is_vibrating = self.hypotheses.iter().any(Hypothesis::considers_vibration);
        let density = if is_vibrating { KnotDensity::Vibrating } else { KnotDensity::Usual };
        let least = match (density, self.is_undecided()) {
            (KnotDensity::Vibrating, _) => VIBRATING_PAIRS,
            (KnotDensity::Usual, true) => COMPARED_PAIRS,
            (KnotDensity::Usual, false) => 0,
        };
        window.recent(density.past(), least)
    }

    /// Offers the smoothness with the greatest evidence to the other hypotheses of its knot density, so that
    /// none is less likely only for a worse one.
    fn share_smoothness(&mut self, window: PairWindow<'_>) {
        if !self.can_compare(window) {
            return;
        }
        let mut fitted = self.fitted();
        let evidence: Vec<Option<f64>> = fitted.par_iter_mut().map(|one| one.log_evidence(window)).collect();
        for density in [KnotDensity::Usual, KnotDensity::Vibrating] {
            let all = fitted.iter().zip(&evidence).filter(|(one, _)| one.density() == density);
            let found = all.filter_map(|(one, evidence)| Some((evidence.as_ref()?, one)));
            let Some((most, best)) = found.max_by(|a, b| a.0.total_cmp(b.0)) else { continue };
            let smoothness = best.posterior.smoothness.clone();
            fitted.par_iter_mut().zip(&evidence).for_each(|(hypothesis, evidence)| {
                let evidence = evidence.unwrap_or(f64::NEG_INFINITY);
                if hypothesis.density() == density && evidence < most - DECISIVE_LOG_ODDS {
                    hypothesis.try_smoothness(&smoothness, evidence, window);
                }
            });
        }
    }

    /// Whether there are several hypotheses with comparable evidence of a window.
    fn can_compare(&self, window: PairWindow<'_>) -> bool {
        let is_new = |one: &Hypothesis| one.awaits_search() || one.is_too_short(window);
        self.is_undecided() && !window.pairs.is_empty() && !self.hypotheses.iter().any(is_new)
    }

    /// Adds hypotheses of the other knot density that may explain the residuals.
    fn challenge(&mut self, window: PairWindow<'_>, starts: bool) {
        let all: Vec<(Scan, KnotDensity)> =
            self.hypotheses.iter().map(|one| (one.scan, one.density())).collect();
        let is_alone = |one: &Hypothesis| {
            all.iter().all(|(scan, density)| *scan != one.scan || *density == one.density())
        };
        let alone = self.hypotheses.par_iter_mut().filter(|one| one.is_fitted && is_alone(one));
        let found: Vec<Hypothesis> = alone.filter_map(|one| one.challenger(window, starts)).collect();
        self.hypotheses.extend(found);
    }

    /// Tries each component again, from time to time and after a gap or a cut, as the camera may be another
    /// one: one at a time beside the likeliest hypotheses, as each doubles the cost.
    fn try_other_cameras(&mut self, window: PairWindow<'_>, before: Break) {
        self.other_camera.tick();
        let starts_anew = before != Break::None && self.has_begun;
        self.has_begun |= !window.pairs.is_empty();
        if self.camera.is_known() {
            return;
        }
        if starts_anew || self.other_camera.is_due() {
            if starts_anew {
                self.other_camera = other_camera();
            } else {
                self.other_camera.back_off();
            }
            self.at_leisure = !starts_anew;
            self.retry_all(OTHER_CAMERA_LOG_ODDS[usize::from(before == Break::Cut)]);
        }
        if self.is_undecided() || !self.to_try.is_empty() {
            self.other_camera.restart();
        }
        if self.hypotheses.len() <= MAX_BESIDE
            && !self.hypotheses.iter().any(Hypothesis::awaits_search)
            && self.leading().constrains_gamma()
            && let Some(scan) = self.to_try.pop()
        {
            let log_odds = self.leading().log_prior + self.other_log_odds;
            self.hypotheses.push(self.fresh(scan).joining(log_odds, self.at_leisure));
        }
    }

    /// Has each component tried again, with these prior log odds beside the leading one.
    fn retry_all(&mut self, log_odds: f64) {
        self.other_log_odds = log_odds;
        let by_rows = self.leading().scan.by_rows;
        self.to_try = self.camera.scans();
        // The last one is tried first.
        self.to_try.sort_by_key(|scan| scan.by_rows == by_rows);
    }

    /// Updates the probabilities by the evidence of the window.
    fn weigh(&mut self, window: PairWindow<'_>) {
        if !self.can_compare(window) {
            return;
        }
        self.windows += 1;
        let number = self.windows;
        let mut fitted = self.fitted();
        if fitted.len() < 2 {
            return;
        }
        let weight = fitted.iter().map(|one| one.weight(window)).fold(0.0, f64::max);
        let design_effects = fitted.iter().map(|one| one.posterior.design_effect(&one.setup));
        let design_effect = design_effects.fold(f64::INFINITY, f64::min);
        let evidence: Option<Vec<f64>> = fitted.par_iter_mut().map(|one| one.log_evidence(window)).collect();
        let pairs = window.pairs.len();
        for (hypothesis, evidence) in fitted.into_iter().zip(evidence.into_iter().flatten()) {
            let evidence = evidence / pairs as f64;
            hypothesis.evidence.add(WindowEvidence { number, weight, design_effect, evidence, pairs });
        }
        let hypotheses = &mut self.hypotheses;
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

    /// Sorts by probability and drops hypotheses that are far less likely than the first, once its γ is
    /// significant: until then the comparison may depend on searches that have not converged. Beside a first
    /// one on trial none is dropped, as a few windows share pairs and their errors.
    fn prune(&mut self) {
        self.end_trials();
        self.hypotheses.sort_by(|a, b| b.log_probability.total_cmp(&a.log_probability));
        let first = self.leading();
        let least = first.log_probability - DROP_LOG_ODDS;
        if first.is_readout_significant() && first.phase != Phase::OnTrial {
            // The first one is kept even if its probability is not finite.
            let mut is_first = true;
            self.hypotheses.retain(|hypothesis| {
                std::mem::take(&mut is_first)
                    || hypothesis.awaits_search()
                    || hypothesis.log_probability > least
            });
        }
        self.drop_twins();
    }

    /// Drops hypotheses that end their trial less likely than the other one of the same scan.
    fn end_trials(&mut self) {
        for index in (0..self.hypotheses.len()).rev() {
            let tried = &mut self.hypotheses[index];
            if !tried.ends_trial() {
                continue;
            }
            let (scan, log_probability) = (tried.scan, tried.log_probability);
            let mut others = self.hypotheses.iter_mut().filter(|other| other.scan == scan);
            if let Some(better) = others.find(|other| other.log_probability > log_probability) {
                better.schedule.density.back_off();
                self.hypotheses.remove(index);
            }
        }
    }

    /// Of hypotheses that have converged to the same γ, keeps the likeliest.
    fn drop_twins(&mut self) {
        let mut kept: Vec<Hypothesis> = Vec::with_capacity(self.hypotheses.len());
        for hypothesis in self.hypotheses.drain(..) {
            let is_twin = |other: &Hypothesis| {
                other.has_converged && hypothesis.has_converged && other.agrees_with(&hypothesis)
            };
            if !kept.iter().any(is_twin) {
                kept.push(hypothesis);
            }
        }
        self.hypotheses = kept;
    }

    /// Standard deviation of the mixture of γ about the likeliest hypothesis; 0 if the readout is given.
    pub fn readout_deviation(&self) -> f64 {
        if self.camera.is_known() {
            return 0.0;
        }
        let vector = |one: &Hypothesis| {
            let gamma = one.gamma();
            if one.scan.by_rows { Vector2::new(0.0, gamma) } else { Vector2::new(gamma, 0.0) }
        };
        let own = vector(self.leading());
        let variance = |one: &Hypothesis| {
            (vector(one) - own).norm_squared() + one.setup.camera.gamma_deviation().powi(2)
        };
        self.hypotheses().map(|(probability, one)| probability * variance(one)).sum::<f64>().sqrt()
    }

    /// Focal length in frame widths and its standard deviation, from that of κ; `None` without perspective.
    pub fn focal_length(&self) -> Option<(f64, f64)> {
        let leading = self.leading();
        let kappa = leading.posterior.shared.kappa;
        if !self.camera.model.has_perspective() || kappa <= 0.0 {
            return None;
        }
        let (focal, deviation) = (0.5 / kappa.sqrt(), leading.setup.camera.beliefs.kappa.deviation());
        let is_given = self.camera.focal_length.is_some();
        Some((focal, if is_given { 0.0 } else { 0.5 * focal * deviation / kappa }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::generators::Model;
    use crate::readout::ReadoutTime;

    /// Two hypotheses of one scan, the second on trial for so many windows and with these log odds.
    fn posterior_with_trial(windows: usize, odds: f64) -> CameraPosterior {
        let direction = Some(ReadoutDirection::TopToBottom);
        let readout_time = ReadoutTime::Unknown;
        let (model, readout_prior, focal_length) = (Model::Auto, None, None);
        let camera = Camera { model, direction, readout_time, readout_prior, focal_length };
        let mut posterior = CameraPosterior::new(camera, [640, 480], 320.0, 0.03);
        let mut tried = posterior.fresh(ReadoutDirection::TopToBottom.into());
        (tried.phase, tried.log_probability) = (Phase::OnTrial, odds);
        let window = WindowEvidence { number: 0, weight: 1.0, design_effect: 1.0, evidence: 0.0, pairs: 8 };
        (0..windows).for_each(|number| tried.evidence.add(WindowEvidence { number, ..window }));
        posterior.hypotheses.push(tried);
        posterior
    }

    #[test]
    fn a_trial_ends_after_windows_without_common_pairs() {
        let mut posterior = posterior_with_trial(5, -1.0);
        posterior.end_trials();
        assert_eq!(posterior.hypotheses.len(), 2);
        let mut posterior = posterior_with_trial(6, -1.0);
        posterior.end_trials();
        assert_eq!(posterior.hypotheses.len(), 1);
        assert!(posterior.leading().phase == Phase::Established);
    }

    #[test]
    fn a_likelier_hypothesis_stays_after_its_trial() {
        let mut posterior = posterior_with_trial(6, 1.0);
        posterior.prune();
        assert_eq!(posterior.hypotheses.len(), 2);
        assert!(
            posterior.leading().log_probability > 0.0
                && posterior.hypotheses.iter().all(|one| one.phase == Phase::Established)
        );
    }

    #[test]
    fn beside_one_on_trial_none_is_dropped() {
        let mut posterior = posterior_with_trial(1, 2.0 * DROP_LOG_ODDS);
        posterior.hypotheses.iter_mut().for_each(|one| one.posterior.shared.gamma = 0.5);
        posterior.hypotheses[1].expect_readout(Belief::new(0.5, 0.001));
        posterior.prune();
        assert_eq!(posterior.hypotheses.len(), 2);
        posterior.hypotheses[0].phase = Phase::Established;
        posterior.prune();
        assert_eq!(posterior.hypotheses.len(), 1);
    }
}
