// SPDX-License-Identifier: MIT OR Apache-2.0

//! Calibrated camera motion over a short window of frames, as knots that are interpolated by time.
//!
//! P.-E. Forssén and E. Ringaby, *Rectifying rolling shutter video from hand-held devices*, CVPR 2010;
//! E. Ringaby and P.-E. Forssén, *Efficient video rectification and stabilisation for cell-phones*,
//! IJCV 96(3), 2012. A camera with the calibration matrix K sees a point of its first view at
//! x(t) ~ K M(t) K⁻¹ x, where M(t) is what the motion does to rays: R(t) for a rotation, D(t) for a
//! translation in front of a wall at depth 1, R(t) D(t) for both. Two sights of one point, each
//! at its row's instant, are therefore related by x′ ~ K M(t′) M(t)⁻¹ K⁻¹ x, and the knots are
//! found by minimising the distance of either sight from where the other says it is. Robust weights
//! are added here, since the correspondences are given as they are, wild ones among them.

use super::{Correction, Corrections, Input, Method};
use anyhow::Result;
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::{DMatrix, DVector, Dyn, Matrix3, Owned, Vector2};
use rsrectify::motion::image_centre;
use rsrectify::readout::Readout;
use std::marker::PhantomData;

/// Correspondences of a pair that are looked at: enough by far for some tens of unknowns.
const PER_PAIR: usize = 300;
/// Fewer correspondences than this in a pair tell nothing.
const FEWEST: usize = 16;
/// Rounds of reweighting, each from where the one before ended.
const ROUNDS: usize = 4;
/// The least scale of a residual in pixels: better than this no correspondence is.
const LEAST_SCALE: f64 = 0.05;
/// Step of the numerical Jacobian, in radians or depths of the scene.
const STEP: f64 = 1e-6;

/// What a camera's motion does to rays, in terms of knots.
pub trait Motion: Clone + Send + Sync + 'static {
    /// The name of the model, such as `3d-rotation`.
    const NAME: &'static str;
    /// Unknowns of a knot; all zero where the camera has not moved.
    const FREEDOMS: usize;

    /// M between two knots, `share` of the way from the first to the second.
    fn between(first: &[f64], second: &[f64], share: f64) -> Matrix3<f64>;
}

/// The frames that are solved together, and how finely their motion is resolved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Window {
    /// Number of frames, at least 2.
    frames: usize,
    /// Knots to a frame; 0 for a constant velocity over the whole window.
    knots: usize,
}

impl Window {
    /// The name of a model over this window, such as `3d-rotation-2`, with the number of knots to
    /// a frame where that is not 1.
    fn name(self, model: &str) -> String {
        match self.knots {
            0 => format!("{model}-{}-constant", self.frames),
            1 => format!("{model}-{}", self.frames),
            knots => format!("{model}-{}-{knots}-knots", self.frames),
        }
    }

    /// The window of frames around frame `k` of `count`: the frame in the middle of it, or, in a
    /// window of two, first; at the ends of the run as near to that as can be.
    fn around(self, k: usize, count: usize) -> Option<std::ops::Range<usize>> {
        let first = k.saturating_sub((self.frames - 1) / 2).min(count.checked_sub(self.frames)?);
        Some(first..first + self.frames)
    }

    /// When the knots are, in seconds: at the start of each frame's readout, evenly between starts,
    /// and at the end of the last.
    fn times(self, stamps: &[f64], readout: f64) -> Vec<f64> {
        let end = stamps[stamps.len() - 1] + readout;
        if self.knots == 0 {
            return vec![stamps[0], end];
        }
        let bounds: Vec<f64> = stamps.iter().copied().chain([end]).collect();
        let between = |pair: &[f64]| {
            let (from, length) = (pair[0], pair[1] - pair[0]);
            (0..self.knots).map(move |i| from + length * i as f64 / self.knots as f64)
        };
        let mut times: Vec<f64> = bounds.windows(2).flat_map(between).chain([end]).collect();
        // A global shutter reads its last frame in no time.
        times.dedup();
        times
    }
}

/// The method for one kind of motion: corrects each frame of a run by what is found in the window around it. A frame whose
/// window has too few correspondences, or in which the fit goes astray, is left as it is.
#[derive(Clone, Copy, Debug)]
pub struct Knotted<M> {
    window: Window,
    motion: PhantomData<M>,
}

impl<M: Motion> Knotted<M> {
    /// The method over windows of so many frames, with so many knots to a frame.
    pub const fn new(frames: usize, knots: usize) -> Self {
        Self { window: Window { frames, knots }, motion: PhantomData }
    }
}

impl<M: Motion> Method for Knotted<M> {
    fn name(&self) -> String {
        self.window.name(M::NAME)
    }

    fn solve(&self, input: &Input) -> Result<Corrections> {
        let correction = |k| -> Box<dyn Correction> {
            match correction::<M>(self.window, input, k) {
                Some(found) => Box::new(found),
                None => Box::new(|pixel| pixel),
            }
        };
        Ok((0..input.stamps.len()).map(correction).collect())
    }
}

fn correction<M: Motion>(window: Window, input: &Input, k: usize) -> Option<Rectified<M>> {
    let frames = window.around(k, input.stamps.len())?;
    let stamps = &input.stamps[frames.clone()];
    let camera = Camera::new(input.focal, input.readout);
    let mut sights = Vec::new();
    for (pair, stamps) in input.pairs[frames.start..frames.end - 1].iter().zip(stamps.windows(2)) {
        if pair.len() < FEWEST {
            return None;
        }
        let chosen = pair.iter().step_by(pair.len().div_ceil(PER_PAIR));
        sights.extend(chosen.map(|found| {
            let sight = |stamp: f64, x: Vector2<f64>| Sight { x, t: camera.exposure(stamp, x) };
            [sight(stamps[0], found.from), sight(stamps[1], found.to)]
        }));
    }
    let curve = Curve::<M>::still(window.times(stamps, input.readout.time()));
    let curve = Fit { camera, weights: vec![1.0; sights.len()], sights, curve }.robust()?;
    Some(Rectified { camera, curve, stamp: input.stamps[k] })
}

/// A pinhole camera, its principal point in the middle of the image, with a rolling shutter.
#[derive(Clone, Copy)]
struct Camera {
    focal: f64,
    centre: Vector2<f64>,
    readout: Readout,
}

impl Camera {
    fn new(focal: f64, readout: Readout) -> Self {
        Self { focal, centre: image_centre(readout.width(), readout.height()), readout }
    }

    fn exposure(&self, stamp: f64, x: Vector2<f64>) -> f64 {
        stamp + self.readout.offset(x.x, x.y)
    }

    /// K A K⁻¹ x in pixels.
    fn apply(&self, a: &Matrix3<f64>, x: Vector2<f64>) -> Vector2<f64> {
        let ray = a * ((x - self.centre) / self.focal).push(1.0);
        ray.xy() * (self.focal / ray.z) + self.centre
    }
}

/// A point in pixels and when it was exposed there, in seconds.
#[derive(Clone, Copy)]
struct Sight {
    x: Vector2<f64>,
    t: f64,
}

/// Knots at their times. The first stays at zero: only motion between sights can be seen.
#[derive(Clone)]
struct Curve<M> {
    times: Vec<f64>,
    knots: Vec<f64>,
    motion: PhantomData<M>,
}

impl<M: Motion> Curve<M> {
    fn still(times: Vec<f64>) -> Self {
        Self { knots: vec![0.0; times.len() * M::FREEDOMS], times, motion: PhantomData }
    }

    /// The interval in which an instant lies; the first and the last go on outside the knots.
    fn interval(&self, t: f64) -> usize {
        let inner = &self.times[1..self.times.len() - 1];
        inner.partition_point(|knot| *knot <= t)
    }

    fn at(&self, t: f64) -> Matrix3<f64> {
        let i = self.interval(t);
        let share = (t - self.times[i]) / (self.times[i + 1] - self.times[i]);
        let (first, second) = (i * M::FREEDOMS, (i + 1) * M::FREEDOMS);
        M::between(&self.knots[first..second], &self.knots[second..second + M::FREEDOMS], share)
    }

    /// What happens to rays between two instants; `None` where that is not finite.
    fn between(&self, from: f64, to: f64) -> Option<Matrix3<f64>> {
        Some(self.at(to) * self.at(from).try_inverse()?)
    }

    /// Whether a knot has a say at an instant.
    fn depends(&self, t: f64, knot: usize) -> bool {
        let i = self.interval(t);
        knot == i || knot == i + 1
    }
}

/// The least-squares problem of a window.
struct Fit<M> {
    camera: Camera,
    sights: Vec<[Sight; 2]>,
    /// Weight of each correspondence.
    weights: Vec<f64>,
    curve: Curve<M>,
}

impl<M: Motion> Fit<M> {
    /// Levenberg–Marquardt, the correspondences weighted anew after each of some rounds as in
    /// a Cauchy M-estimator, its scale taken from the median residual.
    fn robust(mut self) -> Option<Curve<M>> {
        for _ in 0..ROUNDS {
            let solver = LevenbergMarquardt::new().with_tol(1e-7).with_patience(2);
            self = solver.minimize(self).0;
            let residuals = self.distances()?;
            let mut sorted = residuals.clone();
            let middle = sorted.len() / 2;
            let median = *sorted.select_nth_unstable_by(middle, f64::total_cmp).1;
            if !median.is_finite() {
                return None;
            }
            // 1.18 is the median of a Rayleigh distribution, 2.385 σ Cauchy's usual constant.
            let scale = 2.385 * (median / 1.18).max(LEAST_SCALE);
            let weight = |residual: &f64| 1.0 / (1.0 + (residual / scale).powi(2));
            self.weights = residuals.iter().map(weight).collect();
        }
        self.curve.knots.iter().all(|knot| knot.is_finite()).then_some(self.curve)
    }

    /// The two image-plane errors of a correspondence for some knots, forwards and backwards.
    fn errors(&self, curve: &Curve<M>, [from, to]: [Sight; 2]) -> Option<[Vector2<f64>; 2]> {
        let there = curve.between(from.t, to.t)?;
        let back = there.try_inverse()?;
        Some([self.camera.apply(&there, from.x) - to.x, self.camera.apply(&back, to.x) - from.x])
    }

    /// The error of each correspondence in pixels, the mean of both ways.
    fn distances(&self) -> Option<Vec<f64>> {
        let mean = |[there, back]: [Vector2<f64>; 2]| (there.norm() + back.norm()) / 2.0;
        self.sights.iter().map(|pair| self.errors(&self.curve, *pair).map(mean)).collect()
    }

    fn unknown(&self) -> &[f64] {
        &self.curve.knots[M::FREEDOMS..]
    }
}

impl<M: Motion> LeastSquaresProblem<f64, Dyn, Dyn> for Fit<M> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, knots: &DVector<f64>) {
        self.curve.knots[M::FREEDOMS..].copy_from_slice(knots.as_slice());
    }

    fn params(&self) -> DVector<f64> {
        DVector::from_column_slice(self.unknown())
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let mut residuals = Vec::with_capacity(4 * self.sights.len());
        for (pair, weight) in self.sights.iter().zip(&self.weights) {
            let [there, back] = self.errors(&self.curve, *pair)?;
            residuals.extend([there.x, there.y, back.x, back.y].map(|error| error * weight.sqrt()));
        }
        Some(DVector::from_vec(residuals))
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let here = self.residuals()?;
        let mut jacobian = DMatrix::zeros(here.len(), self.unknown().len());
        let mut moved = self.curve.clone();
        for (column, mut slopes) in jacobian.column_iter_mut().enumerate() {
            let index = column + M::FREEDOMS;
            let knot = index / M::FREEDOMS;
            moved.knots[index] += STEP;
            for (i, (pair, weight)) in self.sights.iter().zip(&self.weights).enumerate() {
                if !pair.iter().any(|sight| self.curve.depends(sight.t, knot)) {
                    continue;
                }
                let [there, back] = self.errors(&moved, *pair)?;
                for (j, error) in [there.x, there.y, back.x, back.y].into_iter().enumerate() {
                    slopes[4 * i + j] = (error * weight.sqrt() - here[4 * i + j]) / STEP;
                }
            }
            moved.knots[index] = self.curve.knots[index];
        }
        Some(jacobian)
    }
}

/// Takes each pixel of a frame to the middle of the readout: K M(t_mid) M(t)⁻¹ K⁻¹ x.
struct Rectified<M> {
    camera: Camera,
    curve: Curve<M>,
    stamp: f64,
}

impl<M: Motion> Correction for Rectified<M> {
    fn correct(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        let middle = self.stamp + self.camera.readout.time() / 2.0;
        match self.curve.between(self.camera.exposure(self.stamp, pixel), middle) {
            Some(motion) => self.camera.apply(&motion, pixel),
            None => pixel,
        }
    }
}
