//! Frames as they come → the solution of each, a few frames later: a fixed-lag smoother.
//!
//! A frame is settled over the pairs of a few frames before it and of all that have come after it.
//! What is unknown of the camera is a set of hypotheses, each with a fit of its own; the motion given out is that of the
//! likeliest one.

use crate::correspond::Correspondence;
use crate::motion::{FrameMotion, MotionPath, SampledPath, image_centre};
use crate::readout::{Readout, ReadoutDirection, ReadoutHypothesis, ReadoutPosterior};
use crate::solve::continuous::camera::{Break, Camera, CameraPosterior, Hypothesis, READOUT_BELIEF};
use crate::solve::continuous::data::{FramePair, PairWindow, StaticOverlay};
use crate::solve::continuous::output::FittedPair;
use crate::solve::continuous::trajectory::FramePath;
use crate::solve::residual::{LocalMotion, LocalMotions, Region};
use crate::solve::{FittedCorrespondence, FocalLength, FrameSolution, Origin, root_mean_square};
use nalgebra::{Matrix3, Vector2};
use std::collections::VecDeque;

/// Frames before the one that is settled that are remembered.
const PAST: usize = 10;
/// Pairs after the frame that is settled that its path is fitted to, at most: a path forgets what is further away.
const AHEAD: usize = 12;
/// Standard deviation of a coordinate in analysed pixels that is reached on clean footage.
const NOISE: f64 = 0.03;
/// Shares of the readout at which the homographies of a frame are given out, less one.
const SHARES: usize = 32;
#[derive(Clone, Debug)]
struct Entry {
    /// Timestamp in frame periods.
    stamp: f64,
    to_next: Option<FramePair>,
    /// Whether correspondences with the frame before were looked for and too few found.
    is_cut: bool,
    /// All correspondences of the same pair, where they are kept.
    found: Vec<Correspondence>,
}

/// The continuous estimator of one stream.
#[derive(Debug)]
pub struct Continuous {
    camera: Camera,
    size: [usize; 2],
    centre: Vector2<f64>,
    radius: f64,
    /// Full-frame pixels to an analysed one.
    pixel_scale: f64,
    posterior: CameraPosterior,
    frames: VecDeque<Entry>,
    /// Frames at the front that are settled.
    settled: usize,
    /// Seconds to a frame period, and the time of stamp 0.
    clock: Option<(f64, f64)>,
    /// Seconds to a frame period before the last restart.
    unit_before: Option<f64>,
    /// Whether the first frame that waits follows a settled one.
    continues: bool,
    /// Where the picture is fixed to the frame, and the last pair's correspondences elsewhere.
    overlay: StaticOverlay,
    scene: Vec<Correspondence>,
    /// Whether correspondences are given out with the motions.
    keeps_correspondences: bool,
}

impl Continuous {
    /// For frames of `width` × `height` pixels, of which `pixel_scale` make an analysed pixel.
    pub fn new(camera: Camera, width: usize, height: usize, pixel_scale: f64) -> Self {
        let radius = width.max(1) as f64 / 2.0;
        Self {
            camera,
            size: [width, height],
            centre: image_centre(width, height),
            radius,
            pixel_scale,
            posterior: CameraPosterior::new(camera, [width, height], radius / pixel_scale, NOISE),
            frames: VecDeque::new(),
            settled: 0,
            clock: None,
            unit_before: None,
            continues: false,
            overlay: StaticOverlay::new(width, height, NOISE * pixel_scale),
            scene: Vec::new(),
            keeps_correspondences: false,
        }
    }

    /// The same, which gives out the correspondences with the motions where `keep` says so.
    #[must_use]
    pub fn with_correspondences(self, keep: bool) -> Self {
        Self { keeps_correspondences: keep, ..self }
    }

    /// Adds the next frame at `time` seconds, `period` the time from frame to frame at present, with its
    /// correspondences to the frame pushed before it: `None` at a start, a gap or a cut.
    pub fn push(&mut self, found: Option<&[Correspondence]>, time: f64, period: f64) {
        let (unit, origin) = match self.clock {
            Some((unit, origin)) if unit == period => (unit, origin),
            Some((unit, origin)) => self.change_unit(unit, period, origin),
            None => self.start(period, time),
        };
        let stamp = (time - origin) / unit;
        let (centre, radius) = (self.centre, self.radius);
        let mut latest = self.frames.iter_mut().rev();
        let (last, before) = (latest.next(), latest.next());
        let mut is_cut = false;
        if let (Some(last), Some(found)) = (last, found) {
            let before = before.and_then(|entry| entry.to_next.as_ref());
            self.overlay.remove(found, &mut self.scene);
            let area = self.pixel_scale * self.pixel_scale;
            self.scene.iter_mut().for_each(|found| found.covariance /= area);
            last.to_next = FramePair::new(&self.scene, centre, radius, [last.stamp, stamp], before);
            match &mut last.to_next {
                Some(pair) => pair.measured = found.len(),
                None => is_cut = true,
            }
            if self.keeps_correspondences {
                last.found.extend_from_slice(found);
            }
        }
        self.frames.push_back(Entry { stamp, to_next: None, is_cut, found: Vec::new() });
        self.prepare();
    }

    /// Goes on with the fit to the last frames while none of them is due.
    fn prepare(&mut self) {
        let last = self.frames.len().saturating_sub(1);
        let first =
            self.frames.iter().take(last).rposition(|entry| entry.to_next.is_none()).map_or(0, |gap| gap + 1);
        if first < self.settled || first == self.settled && self.continues {
            return;
        }
        let pairs: Vec<&FramePair> =
            self.frames.iter().skip(first).map_while(|entry| entry.to_next.as_ref()).take(AHEAD).collect();
        self.posterior.prepare(PairWindow { pairs: &pairs, past: 0 });
    }

    /// Starts the clock.
    fn start(&mut self, period: f64, time: f64) -> (f64, f64) {
        self.posterior.begin(period, self.unit_before);
        self.clock = Some((period, time));
        (period, time)
    }

    /// Goes on with another frame period. The frames stay and, once its readout is known, the camera; the path is begun anew.
    fn change_unit(&mut self, unit: f64, period: f64, origin: f64) -> (f64, f64) {
        let factor = unit / period;
        for entry in &mut self.frames {
            entry.stamp *= factor;
            entry.to_next = entry.to_next.take().and_then(|pair| pair.scale_time(factor));
        }
        if !self.posterior.change_period(unit, period) {
            self.unit_before = None;
        }
        self.continues = false;
        self.clock = Some((period, origin));
        (period, origin)
    }

    /// Where a point (pixels) of the last frame is expected in the next: it goes on as from the one before.
    pub fn expected(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        let Hypothesis { posterior, setup, .. } = self.posterior.leading();
        let last = self.frames.iter().rev().nth(1).and_then(|entry| entry.to_next.as_ref());
        let Some([before, after]) = last.map(|pair| pair.stamps) else { return pixel };
        let point = (pixel - self.centre) / self.radius;
        let place = setup.scan_axis.place(point);
        let [before, after] = [before, after].map(|stamp| posterior.block(stamp, place));
        if !posterior.trajectory.homographies.covers(after) {
            return pixel;
        }
        let moved = posterior.trajectory.homographies.carry(point, before, after) * self.radius + self.centre;
        if moved.iter().all(|coordinate| coordinate.is_finite()) { moved } else { pixel }
    }

    /// Settles the first frame that waits, with the local motions of the same frames; `None` where its motion is unknown.
    pub fn settle(&mut self, local: &mut LocalMotions) -> Option<FrameSolution> {
        let own = self.settled;
        let joined = |entry: &Entry| entry.to_next.is_some();
        let past = self.frames.iter().take(own).rev().take_while(|entry| joined(entry)).count().min(PAST);
        let ahead = self.frames.iter().skip(own).take_while(|entry| joined(entry)).take(AHEAD).count();
        let pairs: Vec<&FramePair> = self
            .frames
            .iter()
            .skip(own - past)
            .take(past + ahead)
            .filter_map(|entry| entry.to_next.as_ref())
            .collect();
        let frame = self.frames.get(own)?;
        let stamp = frame.stamp;
        let before = if past > 0 && self.continues {
            Break::None
        } else if frame.is_cut {
            Break::Cut
        } else {
            Break::Gap
        };
        let window = self.posterior.window(PairWindow { pairs: &pairs, past });
        self.posterior.settle(window, before);
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

    /// Whether correspondences of the last frame with the one before it were looked for and too few found.
    pub fn is_at_cut(&self) -> bool {
        self.frames.back().is_some_and(|entry| entry.is_cut)
    }

    /// What is believed of the readout; none where it is given, or no frame has come.
    pub fn posterior(&self) -> Option<ReadoutPosterior> {
        let unit = self.unit().filter(|_| !self.camera.is_known())?;
        let [width, height] = self.size;
        let hypotheses = self.posterior.hypotheses().map(|(probability, hypothesis)| ReadoutHypothesis {
            readout: self.readout(hypothesis),
            deviation: hypothesis.setup.camera.gamma_deviation() * unit,
            probability,
        });
        let [rows, columns] = [ReadoutDirection::TopToBottom, ReadoutDirection::LeftToRight]
            .map(|direction| Camera::log_prior(direction, width, height).exp());
        Some(ReadoutPosterior {
            hypotheses: hypotheses.collect(),
            prior_deviation: READOUT_BELIEF.1 * unit,
            prior_by_rows: rows / (rows + columns),
        })
    }

    /// Coefficients of the longest path in hand.
    #[cfg(test)]
    pub(crate) fn unknowns(&self) -> usize {
        let splines = self.posterior.hypotheses().map(|(_, one)| &one.posterior.trajectory.splines);
        let paths = splines.map(|splines| splines.coefficients.len());
        paths.max().unwrap_or(0)
    }

    /// Forgets the frames, not the camera.
    pub fn restart(&mut self) {
        self.frames.clear();
        self.settled = 0;
        self.unit_before = self.clock.take().map(|(unit, _)| unit).or(self.unit_before);
        self.continues = false;
        self.posterior.restart();
    }

    /// The solution of frame `own` in a window.
    fn solution(
        &self,
        window: PairWindow<'_>,
        own: usize,
        stamp: f64,
        local: &mut LocalMotions,
    ) -> Option<FrameSolution> {
        let leading = self.posterior.leading();
        let readout = self.readout(leading);
        let path = SampledPath::new(&self.homographies(leading, stamp), readout.time).ok()?;
        let beside = window.beside();
        let measured = |index: usize| window.pairs.get(index).map_or(0, |pair| pair.measured);
        let inliers =
            |index: usize| leading.posterior.evaluated.get(index).map_or(0, |pair| pair.residuals.inliers);
        let counts = beside.clone().map(|index| (inliers(index), measured(index)));
        let (inliers, correspondences) = counts.max().unwrap_or_default();
        let sigma = beside.filter_map(|index| leading.posterior.sigma(index)).fold(0.0, f64::max);
        let (frame_path, intervals) = self.frame_path(leading, window, own)?;
        let LocalMotion { field, regions } = local.solve(&readout, intervals, &frame_path);
        let scale = self.pixel_scale;
        let sigma = sigma * scale;
        let regions: Vec<Region> = regions.into_iter().map(|region| region.scaled(1.0 / scale)).collect();
        let expected = self.posterior.expected(stamp, &regions, sigma / scale);
        let region_errors: Vec<f64> = expected.squares.iter().map(|square| scale * square.sqrt()).collect();
        let path = MotionPath::from(path);
        let path = match field {
            Some(field) => path.with_residual(field),
            None => path,
        };
        let focal_length = self.posterior.focal_length();
        Some(FrameSolution {
            motion: FrameMotion::new(readout, path).with_weight(expected.share),
            confidence: expected.share,
            expected_error: root_mean_square(&region_errors),
            region_errors,
            origin: Origin::Continuous,
            correspondences,
            inliers,
            residual: sigma,
            readout_deviation: self.posterior.readout_deviation(),
            begins_shot: false,
            focal_length: focal_length.map(|(widths, deviation)| FocalLength { widths, deviation }),
            fitted: self.fitted(window, own),
        })
    }

    /// Homographies (centred pixels) at even shares of the readout from 0 to 1: from where a point is seen at that share to where
    /// it is at share ½.
    fn homographies(&self, hypothesis: &Hypothesis, stamp: f64) -> Vec<Matrix3<f64>> {
        let posterior = &hypothesis.posterior;
        let trajectory = &posterior.trajectory;
        let is_reversed = hypothesis.gamma() < 0.0;
        let scale = Matrix3::new_nonuniform_scaling(&Vector2::new(self.radius, self.radius));
        let unscale = Matrix3::new_nonuniform_scaling(&Vector2::new(1.0 / self.radius, 1.0 / self.radius));
        let middle = scale * trajectory.homographies.until(posterior.block(stamp, 0.5));
        let homography = |index: usize| {
            let share = index as f64 / SHARES as f64;
            let place = if is_reversed { 1.0 - share } else { share };
            middle * trajectory.homographies.back(posterior.block(stamp, place)) * unscale
        };
        (0..=SHARES).map(homography).collect()
    }

    /// The path of a hypothesis about frame `own` of a window, and the seconds to the frame before and to the one after, where the
    /// path joins them to this one.
    fn frame_path<'a>(
        &self,
        hypothesis: &'a Hypothesis,
        window: PairWindow<'_>,
        own: usize,
    ) -> Option<(FramePath<'a>, [Option<f64>; 2])> {
        let (unit, _) = self.clock?;
        let frame = self.frames.get(own)?;
        let interval = |entry: &Entry| (entry.stamp - frame.stamp) * unit;
        let before = own.checked_sub(1).and_then(|index| self.frames.get(index)).filter(|_| window.past > 0);
        let after = self.frames.get(own + 1).filter(|_| frame.to_next.is_some());
        let path = FramePath {
            trajectory: &hypothesis.posterior.trajectory,
            // Where the far edge is read first, γ is negative and the first exposure that much before the stamp.
            first: frame.stamp + hypothesis.gamma().min(0.0),
            period: unit,
            centre: self.centre,
            radius: self.radius,
        };
        Some((path, [before.map(interval), after.map(interval)]))
    }

    /// The correspondences of frame `own` and how they fit the path, where they are kept.
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

    /// The shutter as far as it is known, and the standard deviation of its readout ratio.
    pub fn belief(&self) -> (Readout, f64) {
        (self.readout(self.posterior.leading()), self.posterior.readout_deviation())
    }

    /// Seconds to a frame period; `None` before the first frame.
    fn unit(&self) -> Option<f64> {
        self.clock.map(|(unit, _)| unit).or(self.unit_before)
    }

    /// The shutter of a hypothesis.
    fn readout(&self, hypothesis: &Hypothesis) -> Readout {
        let unit = self.unit().unwrap_or(0.0);
        let gamma = hypothesis.gamma();
        let direction = match (hypothesis.direction.is_by_rows(), gamma < 0.0) {
            (true, false) => ReadoutDirection::TopToBottom,
            (true, true) => ReadoutDirection::BottomToTop,
            (false, false) => ReadoutDirection::LeftToRight,
            (false, true) => ReadoutDirection::RightToLeft,
        };
        let [width, height] = self.size;
        Readout { width, height, direction, time: gamma.abs() * unit }
    }
}

#[cfg(test)]
mod doubt_tests;
#[cfg(test)]
mod film;
#[cfg(test)]
mod prior_tests;
#[cfg(test)]
mod tests;
