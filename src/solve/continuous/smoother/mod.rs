// SPDX-License-Identifier: MIT OR Apache-2.0

//! Fixed-lag smoother: frames in, the solution of each some frames later.
//!
//! A frame is settled over a window of pairs, a few before it and all that have come after it. The camera is
//! a set of hypotheses, each with its own fit; the motion is that of the likeliest.

use crate::correspond::Correspondence;
use crate::motion::{FrameMotion, MotionPath, PATH_STEPS, SampledPath, image_centre, rounded_homography};
use crate::solve::as_recorded::AsRecorded;
use crate::solve::continuous::camera::{Break, Camera, CameraPosterior, Hypothesis};
use crate::solve::continuous::data::{FramePair, PairWindow, StaticOverlay};
use crate::solve::continuous::output::{Expected, FittedPair};
use crate::solve::continuous::timing::{StatedPair, Timing};
use crate::solve::continuous::trajectory::FramePath;
use crate::solve::frame_timing::{FrameTiming, Timeline};
use crate::solve::residual::{LocalMotion, LocalMotions, Region};
use crate::solve::solution::{FittedCorrespondence, FocalLength, FrameSolution, Origin, root_mean_square};
use nalgebra::{Matrix3, Vector2};
use std::collections::VecDeque;

mod increments;
mod readout;

/// Frames kept before the one that is settled.
const PAST: usize = 10;
/// Pairs of a window after its frame, at most: later ones hardly change the path.
const AHEAD: usize = 12;
/// Noise floor: standard deviation in analysed pixels of a coordinate on clean footage.
const NOISE: f64 = 0.03;

#[derive(Clone, Debug)]
struct Entry {
    /// Number of the frame since the clock was started.
    index: usize,
    /// Time of exposure in frame periods, and the timestamp.
    stamp: f64,
    stated: f64,
    to_next: Option<FramePair>,
    /// Whether it was compared with the frame before and makes no pair with it: too few matches, as at a cut, in
    /// a black frame or where overlays leave few, or too long an interval.
    is_unmatched: bool,
    /// All correspondences with the next frame, if they are kept.
    found: Vec<Correspondence>,
}

/// The successive pairs until the last frame, the latest first.
fn latest_pairs(frames: &VecDeque<Entry>) -> impl Iterator<Item = StatedPair<'_>> {
    frames.iter().zip(frames.iter().skip(1)).rev().map_while(|(entry, next)| {
        let pair = entry.to_next.as_ref()?;
        Some(StatedPair { pair, index: entry.index, stated: next.stated - entry.stated })
    })
}

/// The unit of timestamps.
#[derive(Clone, Copy, Debug)]
struct Clock {
    /// Seconds to a frame period.
    period: f64,
    /// Time in seconds of stamp 0.
    origin: f64,
}

/// The continuous estimator of one stream.
#[derive(Debug)]
pub struct Continuous {
    centre: Vector2<f64>,
    /// Half the width in pixels.
    radius: f64,
    /// Full-frame pixels to an analysed one.
    pixel_scale: f64,
    posterior: CameraPosterior,
    frames: VecDeque<Entry>,
    /// Settled frames at the front.
    settled: usize,
    clock: Option<Clock>,
    timing: Timing,
    /// Seconds to a frame period before the last restart.
    period_before: Option<f64>,
    /// Whether the first waiting frame follows a settled one.
    continues: bool,
    overlay: StaticOverlay,
    /// The last pair's correspondences outside of overlays.
    scene: Vec<Correspondence>,
    /// Whether correspondences are returned with the motions.
    keeps_correspondences: bool,
}

impl Continuous {
    /// For frames of `width` × `height` pixels, of which `pixel_scale` make an analysed pixel.
    pub fn new(camera: Camera, width: usize, height: usize, pixel_scale: f64) -> Self {
        let radius = width.max(1) as f64 / 2.0;
        Self {
            centre: image_centre(width, height),
            radius,
            pixel_scale,
            posterior: CameraPosterior::new(camera, [width, height], radius / pixel_scale, NOISE),
            frames: VecDeque::new(),
            settled: 0,
            clock: None,
            timing: Timing::new(NOISE * pixel_scale / radius),
            period_before: None,
            continues: false,
            overlay: StaticOverlay::new(width, height, NOISE * pixel_scale),
            scene: Vec::new(),
            keeps_correspondences: false,
        }
    }

    /// Returns the correspondences with the motions if `keep`.
    #[must_use]
    pub fn with_correspondences(self, keep: bool) -> Self {
        Self { keeps_correspondences: keep, ..self }
    }

    /// With frames that are stabilised, or are not, where that is known.
    #[must_use]
    pub fn with_stabilised(self, stabilised: Option<bool>) -> Self {
        Self { timing: self.timing.with_stabilised(stabilised), ..self }
    }

    /// Adds the next frame at `time` seconds, with its correspondences to the frame pushed before it: `None`
    /// at a start or a gap; a cut comes as too few. `period` is the present frame period in seconds, `sharpness`
    /// the mean square of the frame's gradient.
    pub fn push(&mut self, found: Option<&[Correspondence]>, time: f64, period: f64, sharpness: f64) {
        let origin = match self.clock {
            Some(clock) if clock.period == period => clock.origin,
            Some(clock) => self.change_period(clock, period),
            None => self.start(period, time),
        };
        let stated = (time - origin) / period;
        let (index, stamp) =
            self.frames.back().map_or((0, stated), |last| (last.index + 1, self.stamp_after(last, stated)));
        let (centre, radius) = (self.centre, self.radius);
        let mut latest = self.frames.iter_mut().rev();
        let (last, before) = (latest.next(), latest.next());
        let mut is_unmatched = false;
        if let (Some(last), Some(found)) = (last, found) {
            let before = before.and_then(|entry| entry.to_next.as_ref());
            self.overlay.remove(found, &mut self.scene);
            let area = self.pixel_scale * self.pixel_scale;
            self.scene.iter_mut().for_each(|found| found.covariance /= area);
            last.to_next = FramePair::new(&self.scene, centre, radius, [last.stamp, stamp], before);
            match &mut last.to_next {
                Some(pair) => pair.measured = found.len(),
                None => is_unmatched = true,
            }
            if self.keeps_correspondences {
                last.found.extend_from_slice(found);
            }
        }
        self.frames.push_back(Entry { index, stamp, stated, to_next: None, is_unmatched, found: Vec::new() });
        self.judge_timing();
        self.timing.push_frame(sharpness);
        self.prepare();
    }

    /// The time of exposure of the frame after `last` with this timestamp, in frame periods.
    fn stamp_after(&self, last: &Entry, stated: f64) -> f64 {
        match self.timing.found().timeline {
            Timeline::Stated => stated,
            timeline => last.stamp + timeline.interval(last.index, stated - last.stated),
        }
    }

    /// Judges the timing with the last pair. If the frames were exposed at other times than was assumed, they get
    /// these, and the camera is sought anew.
    fn judge_timing(&mut self) {
        let mut latest = self.frames.iter().rev();
        let (Some(last), Some(before)) = (latest.next(), latest.next()) else { return };
        if before.to_next.is_none() {
            return if last.is_unmatched { self.timing.cut(last.index) } else { self.timing.interrupt() };
        }
        let leading = self.posterior.leading();
        let camera = (leading.setup.scan_axis, leading.gamma());
        if !self.timing.push(latest_pairs(&self.frames), camera) {
            return;
        }
        let Some(mut stamp) = self.frames.front().map(|first| first.stated) else { return };
        let timeline = self.timing.found().timeline;
        let mut pair_before = None;
        for index in 0..self.frames.len() {
            let next = self.frames.get(index + 1).map(|next| next.stated);
            let Some(entry) = self.frames.get_mut(index) else { return };
            entry.stamp = stamp;
            if let Some(next) = next {
                stamp += timeline.interval(entry.index, next - entry.stated);
            }
            let stamps = [entry.stamp, stamp];
            entry.to_next = entry.to_next.take().and_then(|pair| pair.at(stamps, pair_before));
            pair_before = Some(stamps);
        }
        if let Some(clock) = self.clock {
            self.posterior.forget(clock.period);
        }
        self.continues = false;
    }

    /// Advances the fit to the last frames while none of them is due.
    fn prepare(&mut self) {
        let last = self.frames.len().saturating_sub(1);
        let gap = self.frames.iter().take(last).rposition(|entry| entry.to_next.is_none());
        let first = gap.map_or(0, |gap| gap + 1);
        if first < self.settled || first == self.settled && self.continues {
            return;
        }
        let pairs: Vec<&FramePair> =
            self.frames.iter().skip(first).map_while(|entry| entry.to_next.as_ref()).take(AHEAD).collect();
        self.posterior.prepare(PairWindow { pairs: &pairs, past: 0 });
    }

    /// Starts the clock; its origin.
    fn start(&mut self, period: f64, time: f64) -> f64 {
        self.posterior.begin(period, self.period_before);
        self.clock = Some(Clock { period, origin: time });
        time
    }

    /// Changes the frame period; the path is reset. The clock's origin.
    fn change_period(&mut self, Clock { period: before, origin }: Clock, period: f64) -> f64 {
        let factor = before / period;
        self.timing.interrupt();
        for entry in &mut self.frames {
            entry.stamp *= factor;
            entry.stated *= factor;
            entry.to_next = entry.to_next.take().and_then(|pair| pair.scale_time(factor));
        }
        if !self.posterior.change_period(before, period) {
            self.period_before = None;
        }
        self.continues = false;
        self.clock = Some(Clock { period, origin });
        origin
    }

    /// Where a point (pixels) of the last frame is expected in the next, by the motion of the last interval.
    pub fn expected(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        let Hypothesis { posterior, setup, .. } = self.posterior.leading();
        let last = self.frames.iter().rev().nth(1).and_then(|entry| entry.to_next.as_ref());
        let Some([before, after]) = last.map(|pair| pair.stamps) else { return pixel };
        let point = (pixel - self.centre) / self.radius;
        let place = setup.scan_axis.place(point);
        let [before, after] = [before, after].map(|stamp| posterior.block(stamp, place));
        let homographies = &posterior.trajectory.homographies;
        if !homographies.covers(after) {
            return pixel;
        }
        let moved = homographies.carry(point, before, after) * self.radius + self.centre;
        if moved.iter().all(|coordinate| coordinate.is_finite()) { moved } else { pixel }
    }

    /// Settles the first waiting frame, with its local motions; `None` if its motion is unknown.
    pub fn settle(&mut self, local: &mut LocalMotions) -> Option<FrameSolution> {
        let own = self.settled;
        let joined = |entry: &&Entry| entry.to_next.is_some();
        let past = self.frames.iter().take(own).rev().take_while(joined).count().min(PAST);
        let ahead = self.frames.iter().skip(own).take_while(joined).take(AHEAD).count();
        let entries = self.frames.iter().skip(own - past).take(past + ahead);
        let pairs: Vec<&FramePair> = entries.filter_map(|entry| entry.to_next.as_ref()).collect();
        let frame = self.frames.get(own)?;
        let stamp = frame.stamp;
        let before = match (past > 0 && self.continues, frame.is_unmatched) {
            (true, _) => Break::None,
            (false, true) => Break::Cut,
            (false, false) => Break::Gap,
        };
        let window = self.posterior.window(PairWindow { pairs: &pairs, past });
        self.posterior.settle(window, before);
        let leading = self.posterior.leading();
        let gamma = (!self.posterior.camera.is_known()).then(|| leading.gamma());
        self.timing.update_doubt(latest_pairs(&self.frames), (leading.setup.scan_axis, gamma));
        self.continues = !pairs.is_empty();
        let solution = if pairs.is_empty() { None } else { self.solution(window, own, stamp, local) };
        local.advance();
        self.settled += 1;
        if self.settled > PAST {
            self.frames.pop_front();
            self.settled -= 1;
        }
        solution
    }

    /// Whether the last frame was compared with the one before and makes no pair with it.
    pub fn is_at_cut(&self) -> bool {
        self.frames.back().is_some_and(|entry| entry.is_unmatched)
    }

    /// Number of coefficients of the longest path.
    #[cfg(test)]
    pub(crate) fn unknowns(&self) -> usize {
        let splines = self.posterior.hypotheses().map(|(_, one)| &one.posterior.trajectory.splines);
        splines.map(|splines| splines.coefficients.len()).max().unwrap_or(0)
    }

    /// Drops the frames, not the camera.
    pub fn restart(&mut self) {
        self.frames.clear();
        self.settled = 0;
        self.period_before = self.period();
        self.clock = None;
        self.timing.restart();
        self.continues = false;
        self.posterior.hypotheses.iter_mut().for_each(Hypothesis::drop_searches);
    }

    /// The solution of frame `own` in a window.
    fn solution(
        &self,
        window: PairWindow<'_>,
        own: usize,
        stamp: f64,
        local: &mut LocalMotions,
    ) -> Option<FrameSolution> {
        let index = self.frames.get(own)?.index;
        let timing = self.timing.found_of(index);
        if timing.is_blended() {
            return None;
        }
        let leading = self.posterior.leading();
        let readout = self.readout(leading);
        let evaluated = |index: usize| leading.posterior.evaluated.get(index);
        let counts = |index: usize| {
            let inliers = evaluated(index).map_or(0, |pair| pair.residuals.inliers);
            (inliers, window.pairs.get(index).map_or(0, |pair| pair.measured))
        };
        let (inliers, correspondences) = window.beside().map(counts).max().unwrap_or_default();
        let sigmas = window.beside().filter_map(|index| leading.posterior.sigma(index));
        let scale = self.pixel_scale;
        let sigma = sigmas.fold(0.0, f64::max) * scale;
        let lean = self.timing.lean(index, leading.setup.scan_axis);
        let sampled = |homography: &dyn Fn(f64) -> Matrix3<f64>| {
            // The places that are exposed at even shares of the readout.
            let share = |index: usize| index as f64 / PATH_STEPS as f64;
            let place = |index| if leading.gamma() < 0.0 { 1.0 - share(index) } else { share(index) };
            let rounded = |homography| rounded_homography(&homography, readout.width, readout.height);
            let homographies: Vec<_> =
                (0..=PATH_STEPS).map(|index| rounded(homography(place(index)))).collect();
            SampledPath::new(&homographies, readout.time).ok().map(MotionPath::from)
        };
        let is_in_doubt = lean.is_some() && !timing.is_stabilised();
        let (path, expected) = if let Some(lean) = lean {
            let path = sampled(&|place| lean.homography(place, self.radius))?;
            (path, Expected::of_lean(&lean, self.posterior.size, self.radius / scale))
        } else {
            let path = sampled(&self.to_middle(leading, stamp))?;
            let (frame_path, intervals) = self.frame_path(leading, window, own)?;
            let LocalMotion { field, regions } = local.solve(&readout, intervals, &frame_path);
            let regions: Vec<Region> = regions.into_iter().map(|region| region.scaled(1.0 / scale)).collect();
            let expected = self.posterior.expected(stamp, &regions, sigma / scale);
            (if let Some(field) = field { path.with_residual(field) } else { path }, expected)
        };
        let region_errors: Vec<f64> = expected.squares.iter().map(|square| scale * square.sqrt()).collect();
        let focal_length = self.posterior.focal_length();
        let motion = FrameMotion::new(readout, path).with_weight(expected.share);
        Some(FrameSolution {
            confidence: expected.share,
            expected_error: root_mean_square(&region_errors),
            region_errors,
            correspondences,
            inliers,
            residual: sigma,
            readout_deviation: self.readout_deviation(index),
            as_recorded: is_in_doubt.then_some(AsRecorded::UnknownReadout),
            timing,
            focal_length: focal_length.map(|(widths, deviation)| FocalLength { widths, deviation }),
            fitted: self.fitted(window, own),
            ..FrameSolution::new(motion, Origin::Continuous)
        })
    }

    /// The homography in centred pixels from the exposure of a place along the scan axis to the middle of the readout.
    fn to_middle<'a>(
        &self,
        hypothesis: &'a Hypothesis,
        stamp: f64,
    ) -> impl Fn(f64) -> Matrix3<f64> + use<'a> {
        let posterior = &hypothesis.posterior;
        let homographies = &posterior.trajectory.homographies;
        let scale = Matrix3::new_nonuniform_scaling(&Vector2::new(self.radius, self.radius));
        let unscale = Matrix3::new_nonuniform_scaling(&Vector2::new(1.0 / self.radius, 1.0 / self.radius));
        let middle = scale * homographies.until(posterior.block(stamp, 0.5));
        move |place| middle * homographies.back(posterior.block(stamp, place)) * unscale
    }

    /// The path about frame `own` of a window, and the seconds to the frames before and after on it.
    fn frame_path<'a>(
        &self,
        hypothesis: &'a Hypothesis,
        window: PairWindow<'_>,
        own: usize,
    ) -> Option<(FramePath<'a>, [Option<f64>; 2])> {
        let Clock { period, .. } = self.clock?;
        let frame = self.frames.get(own)?;
        let interval = |entry: &Entry| (entry.stamp - frame.stamp) * period;
        let before = own.checked_sub(1).and_then(|index| self.frames.get(index)).filter(|_| window.past > 0);
        let after = self.frames.get(own + 1).filter(|_| frame.to_next.is_some());
        let path = FramePath {
            trajectory: &hypothesis.posterior.trajectory,
            // If the far edge is read first, γ is negative and its exposure that much before the stamp.
            first: frame.stamp + hypothesis.gamma().min(0.0),
            period,
            centre: self.centre,
            radius: self.radius,
        };
        Some((path, [before.map(interval), after.map(interval)]))
    }

    /// The correspondences of frame `own` with their residuals, if they are kept.
    fn fitted(&self, window: PairWindow<'_>, own: usize) -> Vec<FittedCorrespondence> {
        let leading = self.posterior.leading();
        let index = window.own();
        let begins = index == window.past;
        let first = if begins { Some(own) } else { own.checked_sub(1) };
        let entry = first.and_then(|first| self.frames.get(first)).filter(|entry| !entry.found.is_empty());
        let (Some(entry), Some(pair), Some(sigma)) =
            (entry, window.pairs.get(index), leading.posterior.sigma(index))
        else {
            return Vec::new();
        };
        let sigma = sigma * self.pixel_scale;
        let pair = FittedPair { found: &entry.found, stamps: pair.stamps, begins, sigma };
        pair.fit(leading, self.centre, self.radius)
    }

    /// Timing and placement of the frames, as estimated so far.
    pub fn timing(&self) -> FrameTiming {
        self.timing.found()
    }

    /// Seconds to a frame period; `None` before the first frame.
    fn period(&self) -> Option<f64> {
        self.clock.map(|clock| clock.period).or(self.period_before)
    }
}

#[cfg(test)]
mod doubt_tests;
#[cfg(test)]
mod edge_tests;
#[cfg(test)]
mod film;
#[cfg(test)]
mod prior_tests;
#[cfg(test)]
mod rival_tests;
#[cfg(test)]
mod start_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod timing_tests;
