// SPDX-License-Identifier: MIT OR Apache-2.0

//! Whether frames were exposed when their timestamps say so, and stand where the camera saw them.
//!
//! The shutter leans a frame by its motion during the readout: a point at the place p along the scan axis is displaced by
//! (p − ½)·l, and the *lean* is l = γ·v, v the velocity of the picture. From one frame to the next
//!
//! > d(x) = placement(x) + (p − ½)·(l′ − l),  l′ − l = γ·(v′ − v).
//!
//! The change of the lean is seen in a pair of frames, however they were placed; and v follows from the shifts between
//! the frames. So where the changes of the lean do not follow from the shifts with any |γ| ≤ 1, either the frames
//! were moved after their readout, as a stabiliser in the camera does, or their timestamps are not those of
//! their exposure.
//!
//! | file | what it holds |
//! |---|---|
//! | `lean_change` | the change of the lean in a pair, and its variance |
//! | `velocity` | velocities at the frames from the shifts between them |
//! | `explained` | the share of the changes that the shifts do not explain |
//! | `curvature` | the readout ratio from the curvature of frames, however they were placed, and whether they are leaned at all |
//! | `lean` | the lean and bend of a frame that was moved, and the displacements by them |
//! | `smoothed` | leans and bends of frames from their changes, where they do not follow from shifts |
//! | `timeline` | when frames were exposed: as stated, evenly, or with one of several missing |
//! | `blends` | whether frames are blends of two exposures, by their sharpness |

mod blends;
mod curvature;
mod explained;
mod lean;
mod lean_change;
mod smoothed;
mod timeline;
mod velocity;

use crate::solve::continuous::data::{FramePair, INDEPENDENT_MATCHES, ScanAxis};
use crate::solve::frame_timing::{FrameTiming, Timeline};
use blends::Blends;
use curvature::Curvature;
use explained::{Explained, Pairs, excludes, explained};
pub use lean::Lean;
use lean_change::LeanChange;
use nalgebra::Vector2;
use std::collections::VecDeque;
use velocity::velocities;

/// Pairs that are judged together, and fewest of them. At the ends of fewer the velocities are uncertain.
const PAIRS: usize = 30;
const MIN_PAIRS: usize = 16;
/// Fewest pairs that raise doubts before there are enough for a verdict.
const MIN_DOUBT: usize = 3;
/// Fewest pairs from which the lean of a frame is estimated, or a readout ratio is excluded by leans.
const MIN_LEANS: usize = 8;
/// Shares of the changes that the shifts leave unexplained: more from stabilised footage, less from other. Of rendered
/// clips 0.01 to 0.5 are as recorded, the most where the camera shakes at 0.4 cycles a frame; 0.7 to 1 stabilised.
const STABILISED: f64 = 0.62;
const AS_RECORDED: f64 = 0.4;
/// Another timeline is adopted if it leaves less than this unexplained, and none is tried where the present one leaves less.
const EXPLAINED: f64 = 0.3;
const WELL_EXPLAINED: f64 = 0.1;
/// Log odds in nats of another timeline before anything is seen of it, and those with which it is adopted. On clips with true
/// timestamps the log likelihood ratio is 6 at most, with false ones 20 to 100.
const RETIMED_LOG_PRIOR: f64 = -10.0;
const RETIMED_LOG_ODDS: f64 = 10.0;
/// Variance of the lean over that of a match: Σ (p − ½)² of evenly spread independent matches is a twelfth of their number.
const SLOPE_NOISE: f64 = 12.0 / INDEPENDENT_MATCHES;

/// Estimates the timing of the frames from successive pairs.
#[derive(Debug)]
pub struct Timing {
    /// The last pairs without a break.
    pairs: VecDeque<TimedPair>,
    blends: Blends,
    axis: Option<ScanAxis>,
    /// Estimate of γ along the axis from the curvature.
    curvature: Curvature,
    /// Least variance of the position of a match, in squared radii.
    noise: f64,
    /// Of the frames of this shot; before its own verdict, that of the shot before.
    found: FrameTiming,
    /// Pairs of this shot so far, while the verdict is that of the shot before.
    carried: Option<usize>,
    /// Number of the first frame of this shot, and the verdict about the frames before.
    first: usize,
    before: FrameTiming,
    /// Whether it is given that frames are stabilised, or are not.
    is_given: bool,
    /// Whether the pairs contradict the path.
    is_doubtful: bool,
}

/// A pair of frames that are `stated` frame periods apart by their timestamps.
#[derive(Clone, Copy, Debug)]
pub struct StatedPair<'a> {
    pub pair: &'a FramePair,
    /// Number of its first frame.
    pub index: usize,
    pub stated: f64,
}

#[derive(Clone, Debug)]
struct TimedPair {
    lean: LeanChange,
    /// Number of the pair, and its stated interval in frame periods.
    index: usize,
    stated: f64,
}

impl Timing {
    /// `noise`: least standard deviation of the position of a match, in radii.
    pub fn new(noise: f64) -> Self {
        Self {
            pairs: VecDeque::with_capacity(PAIRS),
            blends: Blends::default(),
            axis: None,
            curvature: Curvature::default(),
            noise: noise * noise,
            found: FrameTiming::default(),
            carried: None,
            first: 0,
            before: FrameTiming::default(),
            is_given: false,
            is_doubtful: false,
        }
    }

    /// With frames that are given to be stabilised, or not to be.
    pub fn with_stabilised(self, stabilised: Option<bool>) -> Self {
        Self { found: FrameTiming { stabilised, ..self.found }, is_given: stabilised.is_some(), ..self }
    }

    /// The timing of the last frame, from all frames so far.
    pub fn found(&self) -> FrameTiming {
        self.found
    }

    /// The timing of the frame with this number.
    pub fn found_of(&self, frame: usize) -> FrameTiming {
        if frame < self.first { self.before } else { self.found }
    }

    /// Whether the lean of the frame with this number along an axis must not be computed from a path: the frame was moved after its
    /// readout, or is in doubt (see [`update_doubt`](Self::update_doubt)).
    pub fn contradicts_path(&self, frame: usize, axis: ScanAxis) -> bool {
        let is_in_doubt = self.is_doubtful && self.axis == Some(axis) && frame >= self.first;
        self.found_of(frame).is_stabilised() || is_in_doubt
    }

    /// The lean, along this axis, of a frame that contradicts the path, estimated from the changes around it; `None` for other frames.
    pub fn lean(&self, frame: usize, axis: ScanAxis) -> Option<Lean> {
        if !self.contradicts_path(frame, axis) {
            return None;
        }
        let first = self.pairs.front().map_or(0, |pair| pair.index);
        let is_inside = (first..=first + self.pairs.len()).contains(&frame)
            && self.pairs.len() >= MIN_LEANS
            && self.axis == Some(axis)
            && (self.is_given || self.curvature.shows_leans());
        let changes = self.leans();
        let shifts: Vec<Vector2<f64>> = changes.iter().map(|lean| lean.shift).collect();
        let velocities = velocities(&shifts, &self.stamps(self.found_of(frame).timeline));
        Some(Lean::of(axis, is_inside.then(|| frame - first), &changes, &velocities))
    }

    /// By how much |γ| along an axis, as estimated from the shifts, is too large according to the curvature of the frames, which alone
    /// detects that the same share of every shift was taken out after the readout. 0 if the curvature does not contradict γ.
    pub fn excess(&self, gamma: f64, axis: ScanAxis) -> f64 {
        if self.axis == Some(axis) { self.curvature.excess(gamma) } else { 0.0 }
    }

    /// Begins another shot with the frame of this number. Camera and conversion are more likely the same than not, so the verdict is kept
    /// for as many pairs as are judged together.
    pub fn cut(&mut self, first: usize) {
        self.interrupt();
        self.before = self.found;
        self.first = first;
        self.carried = Some(0);
    }

    /// Forgets the frames before a break.
    pub fn interrupt(&mut self) {
        self.pairs.clear();
        self.is_doubtful = false;
        self.curvature = Curvature::default();
        self.blends.clear();
    }

    /// Adds a frame by the mean square of its gradient.
    pub fn push_frame(&mut self, sharpness: f64) {
        self.blends.push(sharpness);
        if let Some(timeline) = self.blends.found() {
            self.found.timeline = timeline;
            self.carried = None;
        }
    }

    /// Begins another stretch of frames, numbered from 0, as after a cut.
    pub fn restart(&mut self) {
        self.cut(0);
        // Which of the frames is missing is another one.
        if matches!(self.found.timeline, Timeline::Missing { .. }) {
            self.found.timeline = Timeline::Stated;
        }
    }

    /// Adds the first of some successive pairs, the latest first, as seen along the likeliest scan axis with its readout ratio.
    /// Whether the camera is to be sought anew, as what was assumed of its frames has changed.
    pub fn push<'a>(
        &mut self,
        mut latest: impl Iterator<Item = StatedPair<'a>>,
        (axis, gamma): (ScanAxis, f64),
    ) -> bool {
        if self.axis != Some(axis) {
            self.change_axis(axis, latest);
        } else if let Some(pair) = latest.next() {
            if self.pairs.len() == PAIRS {
                self.pairs.pop_front();
            }
            self.pairs.push_back(self.timed(&pair, axis));
        }
        let was_carried = self.carried.is_some_and(|_| self.found.is_stabilised());
        // Correspondences between blends are of no single exposure.
        let is_retimed = self.pairs.len() >= MIN_PAIRS && !self.found.is_blended() && self.judge(gamma);
        self.lapse();
        is_retimed || was_carried && !self.found.is_stabilised()
    }

    /// Drops the verdict of the shot before, if this one has not confirmed it in the pairs that are judged together. Its timeline stays:
    /// it is compared with all others as soon as frames move.
    fn lapse(&mut self) {
        self.carried = self.carried.map(|pairs| pairs + 1);
        if self.carried != Some(PAIRS) {
            return;
        }
        self.conclude(None);
        if self.found.is_blended() {
            self.found.timeline = Timeline::Stated;
        }
    }

    /// Judges pairs along this axis from now on, beginning with these, the latest first.
    fn change_axis<'a>(&mut self, axis: ScanAxis, latest: impl Iterator<Item = StatedPair<'a>>) {
        self.axis = Some(axis);
        self.curvature = Curvature::default();
        self.pairs.clear();
        for pair in latest.take(PAIRS) {
            self.pairs.push_front(self.timed(&pair, axis));
        }
    }

    fn timed(&self, &StatedPair { pair, index, stated }: &StatedPair<'_>, axis: ScanAxis) -> TimedPair {
        TimedPair { lean: LeanChange::of(pair, axis, self.noise), index, stated }
    }

    /// Determines whether a path is in doubt that was fitted to some successive pairs, the latest first, along this axis with this readout
    /// ratio, `None` if it is given: where frames do not lean as this ratio tells, and, while the pairs are too few for a verdict, or for
    /// that of the shot before to lapse, where they look moved or retimed.
    pub fn update_doubt<'a>(
        &mut self,
        latest: impl Iterator<Item = StatedPair<'a>>,
        (axis, gamma): (ScanAxis, Option<f64>),
    ) {
        if self.axis != Some(axis) {
            self.change_axis(axis, latest);
        }
        let is_open = self.carried.is_some() || self.found.stabilised.is_none();
        let pairs = self.pairs.len();
        self.is_doubtful = !self.is_given
            && (pairs >= MIN_LEANS && gamma.is_some_and(|gamma| self.do_not_lean(gamma))
                || is_open && (MIN_DOUBT..MIN_PAIRS).contains(&pairs) && self.looks_moved_or_retimed(gamma));
    }

    /// Whether the frames do not lean, as with this readout ratio they would.
    fn do_not_lean(&self, gamma: f64) -> bool {
        excludes(&self.leans(), &self.stamps(self.found.timeline), self.lean_noise(), gamma)
    }

    /// Whether the few pairs so far look as if frames had been moved after their readout, or another timeline or readout ratio is likelier.
    fn looks_moved_or_retimed(&mut self, gamma: Option<f64>) -> bool {
        let leans = self.leans();
        let is_retimed = |now: &Explained| {
            let other = self.likeliest_other(Pairs::Few, &leans);
            other.is_some_and(|(other, _)| other.log_likelihood_over(now) + RETIMED_LOG_PRIOR > 0.0)
        };
        let now = self.agreement(Pairs::Few, &leans, self.found.timeline);
        let Some(now) = now.filter(Explained::is_telling) else { return false };
        let unexplained = gamma.map_or(now.unexplained, |gamma| now.unexplained_with(gamma));
        let contradicts =
            looks_moved(&now, unexplained) || now.unexplained > WELL_EXPLAINED && is_retimed(&now);
        if contradicts {
            self.add_curvature(&leans);
        }
        contradicts
    }

    /// The timeline, but the present one, that leaves least unexplained.
    fn likeliest_other(&self, number: Pairs, leans: &[LeanChange]) -> Option<(Explained, Timeline)> {
        let intervals: Vec<f64> = self.pairs.iter().map(|pair| pair.stated).collect();
        let others = Timeline::candidates(&intervals).filter(|other| *other != self.found.timeline);
        let tried = others.filter_map(|other| Some((self.agreement(number, leans, other)?, other)));
        tried.min_by(|a, b| a.0.unexplained.total_cmp(&b.0.unexplained))
    }

    fn add_curvature(&mut self, leans: &[LeanChange]) {
        let first = self.pairs.front().map_or(0, |pair| pair.index);
        let stamps = self.stamps(self.found.timeline);
        self.curvature.add(leans, first, &stamps);
    }

    fn leans(&self) -> Vec<LeanChange> {
        self.pairs.iter().map(|pair| pair.lean).collect()
    }

    fn judge(&mut self, gamma: f64) -> bool {
        let leans = self.leans();
        let now = self.agreement(Pairs::Many, &leans, self.found.timeline);
        let Some(now) = now.filter(Explained::is_telling) else {
            return false;
        };
        self.add_curvature(&leans);
        if now.unexplained < WELL_EXPLAINED {
            self.conclude_recorded(gamma);
            return false;
        }
        if let Some((better, timeline)) = self.likeliest_other(Pairs::Many, &leans)
            && better.unexplained < EXPLAINED
            && better.log_likelihood_over(&now) + RETIMED_LOG_PRIOR > RETIMED_LOG_ODDS
        {
            self.found.timeline = timeline;
            self.curvature = Curvature::default();
            self.conclude(Some(false));
            return true;
        }
        if looks_moved(&now, now.unexplained) {
            self.conclude(Some(true));
        } else if now.unexplained < AS_RECORDED {
            self.conclude_recorded(gamma);
        }
        false
    }

    /// Concludes that the frames are as recorded, or that it is undecided where the curvature contradicts γ.
    fn conclude_recorded(&mut self, gamma: f64) {
        if self.curvature.contradicts(gamma) {
            self.conclude(None);
        } else if self.curvature.excess(gamma) == 0.0 {
            self.conclude(Some(false));
        }
    }

    fn conclude(&mut self, stabilised: Option<bool>) {
        self.carried = None;
        if !self.is_given {
            self.found.stabilised = stabilised;
        }
    }

    fn agreement(&self, number: Pairs, leans: &[LeanChange], timeline: Timeline) -> Option<Explained> {
        explained(leans, &self.stamps(timeline), self.lean_noise(), number)
    }

    /// Least variance of a change of the lean.
    fn lean_noise(&self) -> f64 {
        SLOPE_NOISE * self.noise
    }

    /// The stamps of the frames of all pairs.
    fn stamps(&self, timeline: Timeline) -> Vec<f64> {
        let mut stamps = Vec::with_capacity(self.pairs.len() + 1);
        stamps.push(0.0);
        stamps.extend(self.pairs.iter().scan(0.0, |stamp, pair| {
            *stamp += timeline.interval(pair.index, pair.stated);
            Some(*stamp)
        }));
        stamps
    }
}

/// Whether so large a share of the changes that is unexplained shows that frames were moved after their readout.
fn looks_moved(now: &Explained, unexplained: f64) -> bool {
    unexplained > STABILISED && !now.is_fast
}
