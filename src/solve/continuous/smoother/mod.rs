//! Frames as they come → the motion of each, a few frames later.
//!
//! A frame is settled over the pairs of a few frames before it and of all that have come after it.
//! What is not known of the camera is a bank of hypotheses, each with a fit of its own; the motion given out is that of
//! the likeliest one.

use crate::correspond::Correspondence;
use crate::flow::FlowField;
use crate::motion::{ResidualField, ResidualMesh, image_centre};
use crate::readout::{Readout, ReadoutDirection, ReadoutHypothesis, ReadoutPosterior};
use crate::solve::continuous::camera::bank::{Bank, Break};
use crate::solve::continuous::camera::given::{Camera, KNOWN, READOUT_BELIEF};
use crate::solve::continuous::camera::hypothesis::Hypothesis;
use crate::solve::continuous::data::overlay::StaticOverlay;
use crate::solve::continuous::data::pair::Pair;
use crate::solve::continuous::data::window::PairWindow;
use crate::solve::continuous::fit::solver::Solver;
use crate::solve::continuous::output::fitted::{FittedCorrespondence, FittedPair};
use crate::solve::continuous::prior::belief::Running;
use crate::solve::continuous::trajectory::pixels::PixelPath;
use crate::solve::residual::{FrameFlow, Region, ResidualSolver};
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
/// The longest readout that is obeyed, in frame periods: a converter may have put frames between those of the
/// camera, and a path costs as much as the readout is long.
const LONGEST_READOUT: f64 = 8.0;

/// The motion of a frame.
#[derive(Clone, Debug)]
pub struct Motion {
    /// The shutter with which it was solved.
    pub readout: Readout,
    /// Homographies (centred pixels) at 33 even shares of the readout from 0 to 1: from where a point is seen at that
    /// share to where it is at share ½.
    pub homographies: Vec<Matrix3<f64>>,
    /// Trust in it, 0 to 1.
    pub confidence: f64,
    /// Root mean square distance in pixels, in each of [`REGIONS`] and row by row, at which points are expected to be from
    /// where they belong if as much of the correction is applied as the trust says.
    pub errors: Vec<f64>,
    /// What parts of the picture do beside that, where it was asked for and there is anything.
    pub field: Option<ResidualField>,
    /// Correspondences that were measured in the one of the frame's pairs in which most follow it.
    pub correspondences: usize,
    /// Those of them that follow it.
    pub inliers: usize,
    /// Standard deviation in pixels of a coordinate that it leaves in the pairs that the frame is in.
    pub sigma: f64,
    /// Standard deviation of the readout ratio that was found, in frame periods; 0 where it was given.
    pub readout_deviation: f64,
    /// Focal length in frame widths and its standard deviation, where the model has a perspective.
    pub focal_length: Option<(f64, f64)>,
    /// Correspondences of one of the frame's pairs, where they are kept.
    pub fitted: Vec<FittedCorrespondence>,
}

impl Motion {
    fn is_finite(&self) -> bool {
        self.homographies.iter().flatten().all(|element| element.is_finite())
    }
}

#[derive(Clone, Debug)]
struct Entry {
    /// Timestamp in frame periods.
    stamp: f64,
    to_next: Option<Pair>,
    /// Whether correspondences with the frame before were looked for and too few found.
    is_cut: bool,
    /// The flow of the same pair, to the next frame and back from it, for what moves on its own.
    flows: [FlowField; 2],
    /// All correspondences of the same pair, where they are kept.
    found: Vec<Correspondence>,
}

/// The correspondences of a pair of frames.
#[derive(Clone, Copy, Debug)]
pub struct PairMeasurement<'a> {
    /// Those of the grid, by which the motion of the whole is found.
    pub grid: &'a [Correspondence],
    /// The flow to the later frame and back, by which it is found what parts of the picture do beside it; where there
    /// is any.
    pub flow: Option<[&'a FlowField; 2]>,
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
    bank: Bank,
    frames: VecDeque<Entry>,
    /// Frames at the front that are settled.
    settled: usize,
    /// Seconds to a frame period, and the time of stamp 0.
    clock: Option<(f64, f64)>,
    /// Seconds to a frame period before the last restart.
    unit_before: Option<f64>,
    /// Whether the first frame that waits follows a settled one.
    continues: bool,
    residual: ResidualSolver,
    /// Where the picture is fixed to the frame, and the last pair's correspondences elsewhere.
    fixed: StaticOverlay,
    scene: Vec<Correspondence>,
    /// Memory for flow.
    spare: Vec<[FlowField; 2]>,
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
            bank: Bank::new(camera, [width, height], radius / pixel_scale, NOISE),
            frames: VecDeque::new(),
            settled: 0,
            clock: None,
            unit_before: None,
            continues: false,
            residual: ResidualSolver::default(),
            fixed: StaticOverlay::new(width, height, NOISE * pixel_scale),
            scene: Vec::new(),
            spare: Vec::new(),
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
    pub fn push(&mut self, found: Option<PairMeasurement<'_>>, time: f64, period: f64) {
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
            self.fixed.part(found.grid, &mut self.scene);
            let area = self.pixel_scale * self.pixel_scale;
            self.scene.iter_mut().for_each(|found| found.covariance /= area);
            last.to_next = Pair::new(&self.scene, centre, radius, [last.stamp, stamp], before);
            match &mut last.to_next {
                Some(pair) => pair.measured = found.grid.len(),
                None => is_cut = true,
            }
            if self.keeps_correspondences {
                last.found.extend_from_slice(found.grid);
            }
            if let Some(flow) = found.flow {
                last.flows.iter_mut().zip(flow).for_each(|(own, flow)| own.clone_from(flow));
            }
        }
        let mut flows = self.spare.pop().unwrap_or_default();
        flows.iter_mut().for_each(FlowField::clear);
        self.frames.push_back(Entry { stamp, to_next: None, is_cut, flows, found: Vec::new() });
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
        let pairs: Vec<&Pair> =
            self.frames.iter().skip(first).map_while(|entry| entry.to_next.as_ref()).take(AHEAD).collect();
        self.bank.prepare(PairWindow { pairs: &pairs, past: 0 });
    }

    /// Starts the clock.
    fn start(&mut self, period: f64, time: f64) -> (f64, f64) {
        let [width, height] = self.size;
        let time_known = self.camera.readout_time;
        for hypothesis in self.bank.hypotheses.iter_mut() {
            let sign = if hypothesis.direction.is_reversed() { -1.0 } else { 1.0 };
            let gamma = |time: f64| sign * (time / period).min(LONGEST_READOUT);
            if self.camera.is_known() {
                let readout = Readout::resolved(width, height, hypothesis.direction, time_known, period);
                hypothesis.solver.know_readout(Running::new(gamma(readout.time), KNOWN));
            } else if let Some(unit) = self.unit_before {
                hypothesis.solver.scale_readout(unit / period);
            } else if let Some(prior) = self.camera.expected() {
                let belief = Running::new(gamma(prior.time()), prior.deviation() / period);
                hypothesis.solver.expect_readout(belief);
            }
        }
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
        let leading = self.bank.leading();
        let is_found = leading.knows_readout() && (factor * leading.solver.shared[0]).abs() < LONGEST_READOUT;
        if self.camera.is_known() || is_found {
            for hypothesis in &mut self.bank.hypotheses {
                hypothesis.solver.scale_time(factor);
                hypothesis.drop_searches();
            }
        } else {
            // What is believed of a readout beforehand is so in frame periods.
            self.bank = Bank::new(self.camera, self.size, self.radius / self.pixel_scale, NOISE);
            self.unit_before = None;
            self.start(period, origin);
        }
        self.continues = false;
        self.clock = Some((period, origin));
        (period, origin)
    }

    /// Where a point (pixels) of the last frame is expected in the next: it goes on as from the one before.
    pub fn expected(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        let solver = &self.bank.leading().solver;
        let last = self.frames.iter().rev().nth(1).and_then(|entry| entry.to_next.as_ref());
        let Some([before, after]) = last.map(|pair| pair.stamps) else { return pixel };
        let point = (pixel - self.centre) / self.radius;
        let place = solver.scan_axis.place(point);
        let [before, after] = [before, after].map(|stamp| solver.time(stamp, place));
        if !solver.flow.covers(after) {
            return pixel;
        }
        let moved = solver.flow.carry(point, before, after) * self.radius + self.centre;
        if moved.iter().all(|coordinate| coordinate.is_finite()) { moved } else { pixel }
    }

    /// Settles the first frame that waits; `None` where nothing is known of its motion.
    pub fn settle(&mut self) -> Option<Motion> {
        let own = self.settled;
        let joined = |entry: &Entry| entry.to_next.is_some();
        let past = self.frames.iter().take(own).rev().take_while(|entry| joined(entry)).count().min(PAST);
        let ahead = self.frames.iter().skip(own).take_while(|entry| joined(entry)).take(AHEAD).count();
        let pairs: Vec<&Pair> = self
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
        let window = self.bank.window(PairWindow { pairs: &pairs, past });
        self.bank.settle(window, before);
        self.continues = !pairs.is_empty();
        let motion = (!pairs.is_empty()).then(|| self.motion(window, stamp));
        let mut motion = motion.filter(Motion::is_finite);
        if let Some(motion) = motion.as_mut() {
            motion.fitted = self.fitted(window, own);
            motion.field = self.field(own, past > 0, &motion.readout);
            let scale = self.pixel_scale;
            let regions: Vec<Region> =
                self.residual.regions().iter().map(|region| region.scaled(1.0 / scale)).collect();
            let expected = self.bank.expected(stamp, &regions, motion.sigma / scale);
            motion.confidence = expected.share;
            motion.errors = expected.squares.iter().map(|square| scale * square.sqrt()).collect();
        }
        self.settled += 1;
        if self.settled > PAST {
            self.frames.pop_front();
            self.settled -= 1;
        }
        // The flow back from the next frame is still needed.
        if let Some(before) = self.settled.checked_sub(2).and_then(|index| self.frames.get_mut(index)) {
            self.spare.push(std::mem::take(&mut before.flows));
        }
        motion
    }

    /// Whether correspondences of the last frame with the one before it were looked for and too few found.
    pub fn is_at_cut(&self) -> bool {
        self.frames.back().is_some_and(|entry| entry.is_cut)
    }

    /// What is believed of the readout; none where it is given, or no frame has come.
    pub fn posterior(&self) -> Option<ReadoutPosterior> {
        let unit = self.unit().filter(|_| !self.camera.is_known())?;
        let [width, height] = self.size;
        let hypotheses = self.bank.hypotheses.iter().zip(self.bank.probabilities());
        let hypotheses = hypotheses.map(|(hypothesis, probability)| ReadoutHypothesis {
            readout: self.readout(&hypothesis.solver),
            deviation: hypothesis.solver.readout_deviation() * unit,
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
        let paths = self.bank.hypotheses.iter().map(|hypothesis| hypothesis.solver.path.coefficients.len());
        paths.max().unwrap_or(0)
    }

    /// Forgets the frames, not the camera.
    pub fn restart(&mut self) {
        self.frames.clear();
        self.settled = 0;
        self.unit_before = self.clock.take().map(|(unit, _)| unit).or(self.unit_before);
        self.continues = false;
        self.bank.hypotheses.iter_mut().for_each(Hypothesis::drop_searches);
    }

    /// The motion of the frame in a window.
    fn motion(&self, window: PairWindow<'_>, stamp: f64) -> Motion {
        let solver = &self.bank.leading().solver;
        let readout = self.readout(solver);
        let reversed = readout.direction.is_reversed();
        let scale = Matrix3::new_nonuniform_scaling(&Vector2::new(self.radius, self.radius));
        let unscale = Matrix3::new_nonuniform_scaling(&Vector2::new(1.0 / self.radius, 1.0 / self.radius));
        let middle = scale * solver.flow.until(solver.time(stamp, 0.5));
        let homography = |index: usize| {
            let share = index as f64 / SHARES as f64;
            let place = if reversed { 1.0 - share } else { share };
            middle * solver.flow.back(solver.time(stamp, place)) * unscale
        };
        let beside = window.beside();
        let measured = |index: usize| window.pairs.get(index).map_or(0, |pair| pair.measured);
        let counts = beside.clone().map(|index| (solver.inliers(index), measured(index)));
        let (inliers, correspondences) = counts.max().unwrap_or_default();
        let sigma = beside.filter_map(|index| solver.sigma(index)).fold(0.0, f64::max);
        Motion {
            readout,
            homographies: (0..=SHARES).map(homography).collect(),
            confidence: 0.0,
            errors: Vec::new(),
            field: None,
            correspondences,
            inliers,
            sigma: sigma * self.pixel_scale,
            readout_deviation: self.readout_deviation(),
            focal_length: self.focal_length(),
            fitted: Vec::new(),
        }
    }

    /// The correspondences of frame `own` and how they fit the path, where they are kept.
    fn fitted(&self, window: PairWindow<'_>, own: usize) -> Vec<FittedCorrespondence> {
        let solver = &self.bank.leading().solver;
        let index = window.own();
        let begins = index == window.past;
        let first = if begins { Some(own) } else { own.checked_sub(1) };
        let entry = first.and_then(|first| self.frames.get(first)).filter(|entry| !entry.found.is_empty());
        let (Some(entry), Some(pair), Some(sigma)) = (entry, window.pairs.get(index), solver.sigma(index))
        else {
            return Vec::new();
        };
        let sigma = sigma * self.pixel_scale;
        let pair = FittedPair { found: &entry.found, stamps: pair.stamps, begins, sigma };
        pair.fit(solver, self.centre, self.radius)
    }

    /// What parts of frame `own` do beside the motion of the whole.
    fn field(&mut self, own: usize, follows: bool, readout: &Readout) -> Option<ResidualField> {
        let (unit, _) = self.clock?;
        let solver = &self.bank.leading().solver;
        let frame = self.frames.get(own)?;
        let interval = |entry: &Entry| (entry.stamp - frame.stamp) * unit;
        let before = own.checked_sub(1).and_then(|index| self.frames.get(index)).filter(|_| follows);
        let after = self.frames.get(own + 1).filter(|_| frame.to_next.is_some());
        let backward = before.map(|before| FrameFlow { field: &before.flows[1], interval: interval(before) });
        let forward = after.map(|after| FrameFlow { field: &frame.flows[0], interval: interval(after) });
        let flows: Vec<_> = backward.into_iter().chain(forward).collect();
        let path = PixelPath { solver, frame: frame.stamp, unit, centre: self.centre, radius: self.radius };
        let cells = self.residual.solve(readout, &flows, &path);
        let centre = self.centre;
        let first = 0.5 * cells.side - 0.5;
        let mesh = ResidualMesh {
            columns: cells.columns,
            rows: cells.rows,
            origin: [first - centre.x, first - centre.y],
            spacing: [cells.side; 2],
        };
        ResidualField::new(mesh, cells.velocities.clone()).ok()
    }

    /// The shutter as far as it is known, and the standard deviation of its readout ratio.
    pub fn belief(&self) -> (Readout, f64) {
        let solver = &self.bank.leading().solver;
        (self.readout(solver), self.readout_deviation())
    }

    /// Standard deviation of the readout ratio that was found; 0 where it was given.
    fn readout_deviation(&self) -> f64 {
        if self.camera.is_known() { 0.0 } else { self.bank.readout_deviation() }
    }

    /// Focal length in frame widths and its standard deviation, to first order that of κ; `None` where the model has no
    /// perspective, or none shows.
    fn focal_length(&self) -> Option<(f64, f64)> {
        let solver = &self.bank.leading().solver;
        let (kappa, deviation) = (solver.shared[1], solver.kappa_deviation());
        if !self.camera.model.has_perspective() || kappa <= 0.0 {
            return None;
        }
        let focal = 0.5 / kappa.sqrt();
        let is_given = self.camera.focal_length.is_some();
        Some((focal, if is_given { 0.0 } else { 0.5 * focal * deviation / kappa }))
    }

    /// Seconds to a frame period; `None` before the first frame.
    fn unit(&self) -> Option<f64> {
        self.clock.map(|(unit, _)| unit).or(self.unit_before)
    }

    /// The shutter that a solver found.
    fn readout(&self, solver: &Solver) -> Readout {
        let unit = self.unit().unwrap_or(0.0);
        let direction = match (solver.scan_axis.by_rows, solver.shared[0] < 0.0) {
            (true, false) => ReadoutDirection::TopToBottom,
            (true, true) => ReadoutDirection::BottomToTop,
            (false, false) => ReadoutDirection::LeftToRight,
            (false, true) => ReadoutDirection::RightToLeft,
        };
        let [width, height] = self.size;
        Readout { width, height, direction, time: solver.shared[0].abs() * unit }
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
