// SPDX-License-Identifier: MIT OR Apache-2.0

//! A common interface to the two estimators.

use super::settings::{Estimator, Settings};
use crate::correspond::{Correspondence, certain};
use crate::flow::FlowField;
use crate::motion::{FrameMotion, MotionPath, Rigid, Twist, image_centre};
use crate::readout::{Readout, ReadoutPosterior};
use crate::solve::continuous::Continuous;
use crate::solve::residual::LocalMotions;
use crate::solve::{FrameSolution, FrameTiming, Link, MotionCandidate, Window};
use nalgebra::{Matrix3, Vector2};

/// Standard deviation of a measured coordinate in analysed pixels, for the paper's window, which assumes the
/// same for all: that of the sampler on compressed footage.
const NOISE: f64 = 0.1;

/// A frame with the measurements between it and the previous one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step<'a> {
    /// Correspondences with the previous frame, and the flow from it and back; `None` after a start or a gap.
    pub found: Option<(&'a [Correspondence], [&'a FlowField; 2])>,
    /// Timestamp in seconds.
    pub time: f64,
    /// Seconds since the previous frame; negative in reverse playback.
    pub interval: f64,
    /// Actual seconds from frame to frame: see [`Clock::spacing`](super::clock::Clock::spacing).
    pub spacing: f64,
    /// The shutter by the settings.
    pub readout: Readout,
    /// Width of an analysed pixel in full-frame pixels.
    pub pixel_scale: f64,
    /// Mean square of the frame's gradient.
    pub sharpness: f64,
}

/// The estimator of a stream.
#[derive(Debug)]
pub(super) enum Engine {
    Sequential(Box<Sequential>),
    Continuous(Box<Smoother>),
}

/// The continuous estimator of the path, and the estimator of the local motions beside it.
#[derive(Debug)]
pub(super) struct Smoother {
    path: Continuous,
    local: LocalMotions,
}

/// The paper's window, and the predicted motion of the next pair.
#[derive(Debug, Default)]
pub(super) struct Sequential {
    window: Window,
    expected: Twist,
    /// The shutters of the waiting frames.
    readouts: std::collections::VecDeque<Readout>,
    /// The motion of the frame settled last.
    settled: Option<Twist>,
    /// Buffer for the correspondences of small variance.
    certain: Vec<Correspondence>,
}

impl Engine {
    /// For pictures of `width` × `height` pixels, of which an analysed pixel is `pixel_scale` wide.
    pub fn new(settings: &Settings, width: usize, height: usize, pixel_scale: f64) -> Self {
        if settings.estimator == Estimator::Sequential {
            return Self::Sequential(Box::default());
        }
        let continuous = Continuous::new(settings.into(), width, height, pixel_scale);
        let path = continuous.with_correspondences(settings.keep_correspondences);
        let path = path.with_stabilised(settings.stabilised);
        Self::Continuous(Box::new(Smoother { path, local: LocalMotions::default() }))
    }

    /// Predicts the position of a point (pixels) of the last frame after `interval` seconds.
    pub fn predictor(
        &self,
        readout: &Readout,
        interval: f64,
    ) -> impl Fn(Vector2<f64>) -> Vector2<f64> + Sync + '_ {
        let centre = image_centre(readout.width, readout.height);
        let uniform = match self {
            Self::Sequential(sequential) => sequential.expected.after(interval),
            Self::Continuous(_) => Rigid::IDENTITY,
        };
        move |point| match self {
            Self::Sequential(_) => uniform.apply(point - centre) + centre,
            Self::Continuous(continuous) => continuous.path.expected(point),
        }
    }

    /// Adds the next frame.
    pub fn push(&mut self, step: &Step<'_>) {
        match self {
            Self::Sequential(sequential) => sequential.push(step),
            Self::Continuous(continuous) => {
                let found = step.found.map(|(grid, _)| grid);
                continuous.path.push(found, step.time, step.spacing, step.sharpness);
                continuous.local.push(step.found.map(|(_, flow)| flow));
            }
        }
    }

    /// Settles the first waiting frame; `None` without a motion. The sequential estimator has none of confidence 0;
    /// the continuous one returns it, with weight 0.
    pub fn settle(&mut self) -> Option<FrameSolution> {
        match self {
            Self::Sequential(sequential) => sequential.settle(),
            Self::Continuous(continuous) => {
                let Smoother { path, local } = &mut **continuous;
                path.settle(local)
            }
        }
    }

    /// Motions of the scene in centred pixels from the frame settled last to those after it, as far as they are known; `interval`
    /// in seconds to the next frame.
    pub fn increments(&self, interval: f64) -> Vec<Matrix3<f64>> {
        match self {
            Self::Sequential(sequential) => {
                sequential.settled.iter().map(|twist| twist.after(interval).to_homogeneous()).collect()
            }
            Self::Continuous(continuous) => continuous.path.increments().collect(),
        }
    }

    /// The estimated shutter, or `stated` if it is not estimated, and the standard deviation of its readout
    /// ratio.
    pub fn belief(&self, stated: &Readout) -> (Readout, f64) {
        match self {
            Self::Sequential(_) => (*stated, 0.0),
            Self::Continuous(continuous) => continuous.path.belief(),
        }
    }

    /// Timing and placement of the frames, as estimated so far.
    pub fn timing(&self) -> FrameTiming {
        match self {
            Self::Sequential(_) => FrameTiming::default(),
            Self::Continuous(continuous) => continuous.path.timing(),
        }
    }

    /// Whether very few points of the previous frame were found in the last one.
    pub fn is_at_cut(&self) -> bool {
        match self {
            Self::Sequential(_) => false,
            Self::Continuous(continuous) => continuous.path.is_at_cut(),
        }
    }

    /// Posterior of the readout, if it is estimated.
    pub fn posterior(&self) -> Option<ReadoutPosterior> {
        match self {
            Self::Sequential(_) => None,
            Self::Continuous(continuous) => continuous.path.posterior(),
        }
    }

    /// Number of coefficients of the current path.
    #[cfg(test)]
    pub fn unknowns(&self) -> usize {
        match self {
            Self::Sequential(_) => 0,
            Self::Continuous(continuous) => continuous.path.unknowns(),
        }
    }

    /// Discards the frames, but not the estimates of the camera.
    pub fn restart(&mut self) {
        match self {
            Self::Sequential(sequential) => {
                sequential.window.reset();
                sequential.expected = Twist::ZERO;
                sequential.readouts.clear();
                sequential.settled = None;
            }
            Self::Continuous(continuous) => {
                continuous.path.restart();
                continuous.local.restart();
            }
        }
    }
}

impl Sequential {
    fn push(&mut self, step: &Step<'_>) {
        let link = step.found.map(|(grid, _)| {
            certain(grid, step.pixel_scale, &mut self.certain);
            Link::new(&self.certain, &step.readout, step.interval, NOISE * step.pixel_scale)
        });
        self.expected = self.window.push(link).map_or(Twist::ZERO, |fit| fit.twist);
        self.readouts.push_back(step.readout);
    }

    fn settle(&mut self) -> Option<FrameSolution> {
        let settled = self.window.settle();
        self.settled = settled.as_ref().map(|candidate| candidate.fit.twist);
        let readout = self.readouts.pop_front()?;
        settled.map(|MotionCandidate { fit, origin }| {
            let motion = FrameMotion::new(readout, MotionPath::uniform(fit.twist, readout.time));
            FrameSolution {
                confidence: fit.confidence,
                correspondences: fit.correspondences,
                inliers: fit.inliers,
                residual: fit.energy.sqrt(),
                ..FrameSolution::new(motion, origin)
            }
        })
    }
}
