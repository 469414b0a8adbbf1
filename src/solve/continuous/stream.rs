//! Frames as they come → the motion of each, a few frames later.

use super::pair::{Pair, Reading};
use super::running::Running;
use super::smoothness::Smoothness;
use super::solver::{Solver, Tempo};
use crate::correspond::Correspondence;
use crate::motion::generators::Model;
use crate::motion::{ResidualField, ResidualMesh, image_centre};
use crate::readout::{Readout, ReadoutDirection, ReadoutTime};
use crate::solve::layer::{Layer, Neighbour};
use crate::solve::shutter::ShutterEstimator;
use nalgebra::{Matrix3, Vector2};
use std::collections::VecDeque;

/// Frames before the one that is settled whose pairs are looked at again.
const PAST: usize = 4;
/// Steps to the first path, and to each one after it, at most.
const STEPS: [usize; 2] = [12, 4];
/// A step that changes the path by less than this many pixels (root mean square) is the last.
const SETTLED: f64 = 0.05;
/// Or γ by less than this.
const SETTLED_READOUT: f64 = 0.01;
/// A path that leaves more than this share of the mean squared displacement is tried at another tempo.
const UNEXPLAINED: f64 = 0.05;
/// The faster tempo must leave less than this share of what the calm one does (standard deviations).
const WORTH_VIBRATING: f64 = 0.5;
/// Standard deviation of a coordinate in analysed pixels that the tracker reaches on clean footage.
const NOISE: f64 = 0.03;
/// Residuals of less than so many times the least noise are nothing but noise.
const NOTICEABLE: f64 = 4.0;
/// Readout ratios from which a vibration is looked for where the readout is unknown.
const READOUTS: [f64; 4] = [0.9, 0.5, -0.5, -0.9];
/// A readout ratio that is known worse than this may be anything.
const VAGUE: f64 = 0.2;
/// Frames from one trial of another tempo to the next.
const TRIAL: usize = 15;
/// Shares of the readout at which the homographies of a frame are given out, less one.
const SHARES: usize = 32;
/// What is believed of γ before anything was seen: nothing that would change a picture.
const READOUT_BELIEF: (f64, f64) = (0.0, 0.5);
/// What is believed of κ = (half the width / f)²: f is 0.9 widths, give or take a half.
const KAPPA_BELIEF: (f64, f64) = (0.3, 0.3);
/// What κ may be: a field of view under 110°.
const KAPPA_LIMITS: [f64; 2] = [0.0, 2.0];
/// The longest readout that is obeyed, in frame periods: a converter may have put frames between those of the
/// camera, and a path costs as much as the readout is long.
const LONGEST_READOUT: f64 = 8.0;
/// Deviation of what is known.
const KNOWN: f64 = 1e-6;
/// The least deviation that is believed of an estimated γ.
const LEAST_DEVIATION: f64 = 0.01;
/// Independent measurements in a pair, two coordinates each: the weight of its residuals' logarithm.
const WEIGHT: f64 = 50.0;
/// An axis whose likelihood is greater than another's by a factor of e to this power is held to be right.
const CERTAIN: f64 = 5.0;
/// Pairs from one rough estimate of the readout to the next.
const HINT_EVERY: usize = 4;
/// A reading axis whose likelihood is less than another's by a factor of e to this power is given up.
const DECISIVE: f64 = 40.0;

/// What is known of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Image motions that are looked for.
    pub model: Model,
    /// Which edge is read first; `None` if that is to be found out.
    pub direction: Option<ReadoutDirection>,
    /// What is known of the readout time.
    pub readout_time: ReadoutTime,
    /// Focal length in frame widths; `None` if that is to be found out.
    pub focal_length: Option<f64>,
}

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
    /// What parts of the picture do beside that, where it was asked for and there is anything.
    pub field: Option<ResidualField>,
    /// Correspondences that follow it.
    pub inliers: usize,
    /// Standard deviation in pixels of a coordinate that it leaves in the pairs that the frame is in.
    pub sigma: f64,
    /// Standard deviation of the readout ratio, in frame periods.
    pub readout_deviation: f64,
}

#[derive(Clone, Debug)]
struct Entry {
    /// Timestamp in frame periods.
    stamp: f64,
    to_next: Option<Pair>,
    /// The same pair's correspondences in pixels, the finer ones too, for what moves on its own.
    detail: Vec<Correspondence>,
}

/// The correspondences of a pair of frames.
#[derive(Clone, Copy, Debug)]
pub struct Found<'a> {
    /// Those of the grid, by which the motion of the whole is found.
    pub grid: &'a [Correspondence],
    /// Finer ones, where parts of the picture move differently.
    pub fine: &'a [Correspondence],
}

/// A way in which the sensor may be read.
#[derive(Clone, Debug)]
struct Hypothesis {
    /// Which edge is first, where γ is known to be positive or negative.
    direction: ReadoutDirection,
    solver: Solver,
    /// Logarithm of its likelihood, up to a constant.
    score: f64,
    /// The same by the rough estimate.
    rough: f64,
    /// Frames since another tempo was tried.
    since_trial: usize,
}

/// The continuous estimator of one stream.
#[derive(Debug)]
pub struct Continuous {
    camera: Camera,
    size: [usize; 2],
    centre: Vector2<f64>,
    radius: f64,
    /// Least standard deviation of a measured coordinate in pixels.
    noise: f64,
    /// The one that is believed first.
    hypotheses: Vec<Hypothesis>,
    frames: VecDeque<Entry>,
    /// Frames at the front that are settled.
    settled: usize,
    /// Seconds to a frame period, and the time of stamp 0.
    clock: Option<(f64, f64)>,
    /// Seconds to a frame period before the last restart.
    unit_before: Option<f64>,
    /// Whether the first frame that waits follows a settled one.
    continues: bool,
    /// Finds the readout where it is not known: roughly, but from whatever start.
    shutter: Option<ShutterEstimator>,
    /// Pairs that it has taken in.
    taken: usize,
    layer: Layer,
    /// Standard deviation of a coordinate in the last frame that was settled.
    sigma: f64,
    /// Memory for correspondences.
    spare: Vec<Vec<Correspondence>>,
}

impl Continuous {
    /// For frames of `width` × `height` pixels, of which `pixel_scale` make an analysed pixel.
    pub fn new(camera: Camera, width: usize, height: usize, pixel_scale: f64) -> Self {
        let noise = NOISE * pixel_scale;
        let radius = width.max(1) as f64 / 2.0;
        let hypothesis = |direction: ReadoutDirection| {
            let lines = if direction.is_by_rows() { height } else { width } as f64;
            let reading = Reading { by_rows: direction.is_by_rows(), length: lines.max(1.0) / radius };
            let smoothness = Smoothness::new(camera.model.generators(), Tempo::Calm.start_variance());
            let signs = match (camera.direction, direction.is_reversed()) {
                (None, _) => [-1.0, 1.0],
                (Some(_), false) => [0.0, 1.0],
                (Some(_), true) => [-1.0, 0.0],
            };
            let beliefs = [READOUT_BELIEF, kappa_belief(&camera)].map(|(mean, deviation)| Running::new(mean, deviation));
            let solver = Solver::new(reading, Tempo::Calm, radius, noise, smoothness, beliefs, [signs, KAPPA_LIMITS]);
            Hypothesis { direction, solver, score: 0.0, rough: 0.0, since_trial: TRIAL }
        };
        Self {
            camera,
            size: [width, height],
            centre: image_centre(width, height),
            radius,
            noise,
            hypotheses: camera.directions().iter().copied().map(hypothesis).collect(),
            frames: VecDeque::new(),
            settled: 0,
            clock: None,
            unit_before: None,
            continues: false,
            shutter: (camera.readout_time == ReadoutTime::Unknown).then(|| ShutterEstimator::new(width, height)),
            taken: 0,
            layer: Layer::new(width, height, pixel_scale),
            sigma: f64::INFINITY,
            spare: Vec::new(),
        }
    }

    /// Whether the path leaves so much that finer correspondences are of use.
    pub fn wants_detail(&self) -> bool {
        self.sigma > NOTICEABLE * self.noise
    }

    /// Adds the next frame at `time` seconds, `period` the nominal frame period, with its
    /// correspondences to the frame pushed before it: `None` at a start, a gap or a cut.
    pub fn push(&mut self, found: Option<Found<'_>>, time: f64, period: f64) {
        let (unit, origin) = self.clock.unwrap_or_else(|| self.start(period, time));
        let stamp = (time - origin) / unit;
        let (centre, radius) = (self.centre, self.radius);
        if let (Some(last), Some(found)) = (self.frames.back_mut(), found) {
            last.to_next = Pair::new(found.grid, centre, radius, [last.stamp, stamp]);
            last.detail.extend_from_slice(found.grid);
            last.detail.extend_from_slice(found.fine);
            if let Some(shutter) = &mut self.shutter {
                shutter.push(found.grid, (stamp - last.stamp) * unit);
                self.taken += 1;
                if self.taken % HINT_EVERY == 0 {
                    self.take_hint(unit);
                }
            }
        } else if let Some(shutter) = &mut self.shutter {
            shutter.reset_pair();
        }
        let detail = self.spare.pop().unwrap_or_default();
        self.frames.push_back(Entry { stamp, to_next: None, detail });
    }

    /// Takes what the rough estimate says into each hypothesis: γ if only its axis is read along, and how
    /// well that fits.
    fn take_hint(&mut self, unit: f64) {
        let Some(estimate) = self.shutter.as_mut().and_then(ShutterEstimator::estimate) else { return };
        let (times, covariance) = (estimate.times / unit, estimate.covariance / (unit * unit));
        for hypothesis in &mut self.hypotheses {
            let own = usize::from(hypothesis.direction.is_by_rows());
            let other = 1 - own;
            let coupling = covariance[(own, other)] / covariance[(other, other)];
            let mean = times[own] - coupling * times[other];
            let variance = covariance[(own, own)] - coupling * covariance[(own, other)];
            if mean.is_finite() && variance.is_finite() && variance > 0.0 {
                hypothesis.solver.hint = Some((mean, 1.0 / variance));
                hypothesis.rough = -0.5 * times[other] * times[other] / covariance[(other, other)];
            }
        }
    }

    /// Starts the clock.
    fn start(&mut self, period: f64, time: f64) -> (f64, f64) {
        let [width, height] = self.size;
        let time_known = self.camera.readout_time;
        for hypothesis in &mut self.hypotheses {
            if self.camera.is_known() {
                let readout = Readout::new(width, height, hypothesis.direction, time_known, period);
                let sign = if hypothesis.direction.is_reversed() { -1.0 } else { 1.0 };
                let ratio = (readout.time / period).min(LONGEST_READOUT);
                hypothesis.solver.know_readout(Running::new(sign * ratio, KNOWN));
            } else if let Some(unit) = self.unit_before {
                hypothesis.solver.scale_readout(unit / period);
            }
        }
        self.clock = Some((period, time));
        (period, time)
    }

    /// Where a point (pixels) of the last frame is expected in the next: it goes on as from the one before.
    pub fn expected(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        let solver = &self.hypotheses[0].solver;
        let last = self.frames.iter().rev().nth(1).and_then(|entry| entry.to_next.as_ref());
        let Some([before, after]) = last.map(|pair| pair.stamps) else { return pixel };
        let point = (pixel - self.centre) / self.radius;
        let place = solver.reading.place(point);
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
        let ahead = self.frames.iter().skip(own).take_while(|entry| joined(entry)).count();
        let pairs: Vec<&Pair> =
            self.frames.iter().skip(own - past).take(past + ahead).filter_map(|entry| entry.to_next.as_ref()).collect();
        let stamp = self.frames.get(own)?.stamp;
        let starts = past == 0 || !self.continues;
        for hypothesis in &mut self.hypotheses {
            hypothesis.settle(&pairs, starts, past, self.camera.is_known());
        }
        self.continues = !pairs.is_empty();
        let mut motion = (!pairs.is_empty()).then(|| self.motion(&pairs, past, stamp));
        self.sigma = motion.as_ref().map_or(f64::INFINITY, |motion| motion.sigma);
        if let Some(motion) = motion.as_mut().filter(|_| self.wants_detail()) {
            motion.field = self.field(own, past > 0, &motion.readout);
        }
        self.choose();
        self.settled += 1;
        if self.settled > PAST {
            if let Some(mut old) = self.frames.pop_front() {
                old.detail.clear();
                self.spare.push(old.detail);
            }
            self.settled -= 1;
        }
        motion
    }

    /// Forgets the frames, not the camera.
    pub fn restart(&mut self) {
        self.frames.clear();
        self.settled = 0;
        self.unit_before = self.clock.take().map(|(unit, _)| unit).or(self.unit_before);
        self.continues = false;
    }

    /// Puts the likelier axis first and gives up one that is far less likely.
    fn choose(&mut self) {
        let likelihood = Hypothesis::likelihood;
        let Some(best) = self.hypotheses.iter().map(likelihood).max_by(f64::total_cmp) else { return };
        self.hypotheses.retain(|hypothesis| likelihood(hypothesis) > best - DECISIVE);
        self.hypotheses.sort_by(|a, b| likelihood(b).total_cmp(&likelihood(a)));
    }

    /// The motion of the frame after the first `past` pairs.
    fn motion(&self, pairs: &[&Pair], past: usize, stamp: f64) -> Motion {
        let solver = &self.hypotheses[0].solver;
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
        let beside = [past.checked_sub(1), Some(past)].into_iter().flatten().filter(|index| *index < pairs.len());
        let inliers = beside.clone().map(|index| solver.inliers(index)).max().unwrap_or(0);
        let sigmas: Vec<f64> = beside.clone().filter_map(|index| solver.sigma(index)).collect();
        let moved = beside.filter_map(|index| pairs.get(index)).map(|pair| pair.moved()).fold(0.0, f64::max);
        let sigma = sigmas.iter().copied().fold(0.0, f64::max);
        Motion {
            readout,
            homographies: (0..=SHARES).map(homography).collect(),
            confidence: self.confidence(solver, sigma, moved),
            field: None,
            inliers,
            sigma,
            readout_deviation: solver.readout_deviation(),
        }
    }

    /// What parts of frame `own` do beside the motion of the whole.
    fn field(&mut self, own: usize, follows: bool, readout: &Readout) -> Option<ResidualField> {
        let (unit, _) = self.clock?;
        let solver = &self.hypotheses.first()?.solver;
        let frame = self.frames.get(own)?;
        let mut neighbours = Vec::with_capacity(2);
        if let Some(before) = own.checked_sub(1).and_then(|index| self.frames.get(index)).filter(|_| follows) {
            let interval = (before.stamp - frame.stamp) * unit;
            neighbours.push(Neighbour { correspondences: &before.detail, interval });
        }
        if let Some(after) = self.frames.get(own + 1).filter(|_| frame.to_next.is_some()) {
            let interval = (after.stamp - frame.stamp) * unit;
            neighbours.push(Neighbour { correspondences: &frame.detail, interval });
        }
        // Where the far edge is read first, γ is negative and the first exposure that much before the stamp.
        let start = frame.stamp + solver.shared[0].min(0.0);
        let (centre, radius) = (self.centre, self.radius);
        let carry = |pixel: Vector2<f64>, from: f64, to: f64| {
            let [from, to] = [from, to].map(|time| solver.time(start + time / unit, 0.0));
            solver.flow.carry((pixel - centre) / radius, from, to) * radius + centre
        };
        let mesh = self.layer.solve(readout, &neighbours, carry);
        let place = ResidualMesh {
            columns: mesh.columns,
            rows: mesh.rows,
            origin: [-centre.x, -centre.y],
            spacing: [mesh.spacing; 2],
        };
        ResidualField::new(place, mesh.velocities.iter().map(|velocity| [velocity.x, velocity.y]).collect()).ok()
    }

    fn confidence(&self, solver: &Solver, sigma: f64, moved: f64) -> f64 {
        let allowed = (3.0 * solver.noise).powi(2) + 0.25 * moved * self.radius * self.radius;
        let explained = (1.0 - 2.0 * sigma * sigma / allowed).clamp(0.0, 1.0);
        if self.camera.is_known() {
            return explained;
        }
        // Nothing under one deviation from no rolling shutter at all, everything from three on.
        let deviation = solver.readout_deviation().max(LEAST_DEVIATION);
        let doubt = match self.hypotheses.as_slice() {
            [first, second, ..] => ((first.likelihood() - second.likelihood()) / CERTAIN).clamp(0.0, 1.0),
            _ => 1.0,
        };
        explained * doubt * ((solver.shared[0].abs() / deviation - 1.0) / 2.0).clamp(0.0, 1.0)
    }

    /// The shutter that a solver found.
    /// The shutter as far as it is known, and the standard deviation of its readout ratio.
    pub fn belief(&self) -> (Readout, f64) {
        let solver = &self.hypotheses[0].solver;
        (self.readout(solver), solver.readout_deviation())
    }

    fn readout(&self, solver: &Solver) -> Readout {
        let unit = self.clock.map_or(0.0, |(unit, _)| unit);
        let direction = match (solver.reading.by_rows, solver.shared[0] < 0.0) {
            (true, false) => ReadoutDirection::TopToBottom,
            (true, true) => ReadoutDirection::BottomToTop,
            (false, false) => ReadoutDirection::LeftToRight,
            (false, true) => ReadoutDirection::RightToLeft,
        };
        let [width, height] = self.size;
        Readout { width, height, direction, time: solver.shared[0].abs() * unit }
    }
}

impl Camera {
    /// Whether the readout time need not be found out.
    fn is_known(&self) -> bool {
        self.readout_time != ReadoutTime::Unknown
    }

    /// The directions that are tried. Where the readout time is to be found out, its sign tells one edge
    /// from the opposite one.
    fn directions(&self) -> Vec<ReadoutDirection> {
        use ReadoutDirection::{BottomToTop, LeftToRight, RightToLeft, TopToBottom};
        match self.direction {
            Some(direction) => vec![direction],
            None if self.is_known() => vec![TopToBottom, BottomToTop, LeftToRight, RightToLeft],
            None => vec![TopToBottom, LeftToRight],
        }
    }
}

impl Hypothesis {
    /// Logarithm of the likelihood, up to a constant.
    fn likelihood(&self) -> f64 {
        self.score + self.rough
    }

    /// Fits the path to the pairs; the frame that is settled comes after the first `past` ones.
    fn settle(&mut self, pairs: &[&Pair], starts: bool, past: usize, known: bool) {
        if starts {
            self.solver.restart();
        }
        if pairs.is_empty() {
            return;
        }
        iterate(&mut self.solver, pairs, STEPS[usize::from(!starts)], known);
        self.try_tempo(pairs, past, known);
        self.solver.remember(1.0 / pairs.len() as f64);
        if let Some(sigma) = self.solver.sigma(past) {
            self.score -= WEIGHT * self.solver.trust() * sigma.max(self.solver.noise).ln();
        }
    }

    /// Goes over to another tempo where that is worth it.
    fn try_tempo(&mut self, pairs: &[&Pair], past: usize, known: bool) {
        self.since_trial += 1;
        let tempo = self.solver.tempo;
        let (Some(sigma), Some(pair)) = (self.solver.sigma(past), pairs.get(past)) else { return };
        let moved = pair.moved() * self.solver.radius * self.solver.radius;
        let wanted = tempo == Tempo::Vibrating || 2.0 * sigma * sigma > UNEXPLAINED * moved;
        if self.since_trial < TRIAL || !wanted || sigma < NOTICEABLE * self.solver.noise {
            return;
        }
        self.since_trial = 0;
        let vague = !known && tempo == Tempo::Calm && self.solver.readout_deviation() > VAGUE;
        let starts = if vague { &READOUTS[..] } else { &[] };
        let trials = starts.iter().map(Some).chain([None]).map(|readout| {
            let mut other = self.solver.at_tempo(tempo.other());
            let [low, high] = other.limits[0];
            other.shared[0] = readout.map_or(other.shared[0], |readout| readout.clamp(low, high));
            iterate(&mut other, pairs, STEPS[0], known);
            (other.sigma(past).unwrap_or(f64::INFINITY), other)
        });
        let Some((others, other)) = trials.min_by(|a, b| a.0.total_cmp(&b.0)) else { return };
        let (fast, calm) = if tempo == Tempo::Calm { (others, sigma) } else { (sigma, others) };
        if (fast < WORTH_VIBRATING * calm) == (tempo == Tempo::Calm) {
            self.solver = other;
        }
    }
}

/// Steps until nothing changes any more, at most so many.
fn iterate(solver: &mut Solver, pairs: &[&Pair], steps: usize, known: bool) {
    for _ in 0..steps {
        let before = solver.shared[0];
        let Some(change) = solver.step(pairs) else {
            solver.restart();
            continue;
        };
        let moved = (solver.shared[0] - before).abs();
        if change < SETTLED && (known || moved < SETTLED_READOUT) {
            break;
        }
    }
    solver.cover(pairs);
}

/// Mean and deviation of what is believed of κ.
fn kappa_belief(camera: &Camera) -> (f64, f64) {
    match camera.focal_length.filter(|focal| focal.is_finite() && *focal > 0.0) {
        _ if !camera.model.has_perspective() => (0.0, KNOWN),
        Some(focal) => ((0.5 / focal).powi(2), KNOWN),
        None => KAPPA_BELIEF,
    }
}
