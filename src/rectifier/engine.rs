//! A common interface to the two estimators.

use crate::correspond::{Correspondence, certain};
use crate::motion::{MotionPath, Rigid, SampledPath, Twist, image_centre};
use crate::readout::{Readout, ReadoutPosterior};
use crate::solve::continuous::{Camera, Continuous, FittedCorrespondence, PairMeasurement};
use crate::solve::{Link, MotionCandidate, Origin, Window};
use nalgebra::Vector2;

/// Standard deviation of a measured coordinate in analysed pixels, for the paper's window, which assumes the
/// same for all: that of the sampler on compressed footage.
const NOISE: f64 = 0.1;

/// The settled motion of a frame.
#[derive(Clone, Debug)]
pub(super) struct Settled {
    pub readout: Readout,
    pub path: MotionPath,
    /// Confidence in the motion, 0 to 1.
    pub confidence: f64,
    /// Expected errors of the regions of the rectified frame in pixels; none if not estimated.
    pub errors: Vec<f64>,
    pub origin: Origin,
    /// Number of correspondences of the pair over which it was solved.
    pub correspondences: usize,
    /// Number of inliers among them.
    pub inliers: usize,
    /// Root mean square residual of an inlier in pixels.
    pub residual: f64,
    /// Standard deviation of the readout ratio; 0 if it was given.
    pub readout_deviation: f64,
    /// Focal length in frame widths and its standard deviation, if known.
    pub focal_length: Option<(f64, f64)>,
    /// Correspondences of the frame, if they are kept.
    pub fitted: Vec<FittedCorrespondence>,
}

/// A frame with the measurements between it and the previous one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step<'a> {
    /// Correspondences and flow with the previous frame; `None` after a start or a gap.
    pub found: Option<PairMeasurement<'a>>,
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
}

/// The estimator of a stream.
#[derive(Debug)]
pub(super) enum Engine {
    Sequential(Box<Sequential>),
    Continuous(Box<Continuous>),
}

/// The paper's window, and the predicted motion of the next pair.
#[derive(Debug, Default)]
pub(super) struct Sequential {
    window: Window,
    expected: Twist,
    /// The shutters of the waiting frames.
    readouts: std::collections::VecDeque<Readout>,
    /// FitBuffers.
    certain: Vec<Correspondence>,
}

impl Engine {
    pub fn sequential() -> Self {
        Self::Sequential(Box::default())
    }

    /// `keep`: whether the motions contain the correspondences.
    pub fn continuous(camera: Camera, (width, height): (usize, usize), pixel_scale: f64, keep: bool) -> Self {
        let continuous = Continuous::new(camera, width, height, pixel_scale);
        Self::Continuous(Box::new(continuous.with_correspondences(keep)))
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
            Self::Continuous(continuous) => continuous.expected(point),
        }
    }

    /// Adds the next frame.
    pub fn push(&mut self, step: &Step<'_>) {
        match self {
            Self::Sequential(sequential) => sequential.push(step),
            Self::Continuous(continuous) => continuous.push(step.found, step.time, step.spacing),
        }
    }

    /// Settles the first waiting frame; `None` without a motion of positive confidence.
    pub fn settle(&mut self) -> Option<Settled> {
        match self {
            Self::Sequential(sequential) => sequential.settle(),
            Self::Continuous(continuous) => continuous.settle().and_then(|motion| {
                let path = SampledPath::new(&motion.homographies, motion.readout.time).ok()?;
                Some(Settled {
                    readout: motion.readout,
                    path: match motion.field {
                        Some(field) => MotionPath::from(path).with_residual(field),
                        None => MotionPath::from(path),
                    },
                    confidence: motion.confidence,
                    errors: motion.errors,
                    origin: Origin::Continuous,
                    correspondences: motion.correspondences,
                    inliers: motion.inliers,
                    residual: motion.sigma,
                    readout_deviation: motion.readout_deviation,
                    focal_length: motion.focal_length,
                    fitted: motion.fitted,
                })
            }),
        }
    }

    /// The estimated shutter, or `stated` if it is not estimated, and the standard deviation of its readout
    /// ratio.
    pub fn belief(&self, stated: &Readout) -> (Readout, f64) {
        match self {
            Self::Sequential(_) => (*stated, 0.0),
            Self::Continuous(continuous) => continuous.belief(),
        }
    }

    /// Whether very few points of the previous frame were found in the last one.
    pub fn is_at_cut(&self) -> bool {
        match self {
            Self::Sequential(_) => false,
            Self::Continuous(continuous) => continuous.is_at_cut(),
        }
    }

    /// Posterior of the readout, if it is estimated.
    pub fn posterior(&self) -> Option<ReadoutPosterior> {
        match self {
            Self::Sequential(_) => None,
            Self::Continuous(continuous) => continuous.posterior(),
        }
    }

    /// Number of coefficients of the current path.
    #[cfg(test)]
    pub fn unknowns(&self) -> usize {
        match self {
            Self::Sequential(_) => 0,
            Self::Continuous(continuous) => continuous.unknowns(),
        }
    }

    /// Discards the frames, but not the estimates of the camera.
    pub fn restart(&mut self) {
        match self {
            Self::Sequential(sequential) => {
                sequential.window.reset();
                sequential.expected = Twist::ZERO;
                sequential.readouts.clear();
            }
            Self::Continuous(continuous) => continuous.restart(),
        }
    }
}

impl Sequential {
    fn push(&mut self, step: &Step<'_>) {
        let link = step.found.map(|found| {
            certain(found.grid, step.pixel_scale, &mut self.certain);
            Link::new(&self.certain, &step.readout, step.interval, NOISE * step.pixel_scale)
        });
        self.expected = self.window.push(link).map_or(Twist::ZERO, |fit| fit.twist);
        self.readouts.push_back(step.readout);
    }

    fn settle(&mut self) -> Option<Settled> {
        let settled = self.window.settle();
        let readout = self.readouts.pop_front()?;
        settled.map(|MotionCandidate { fit, origin }| Settled {
            readout,
            path: MotionPath::uniform(fit.twist, readout.time),
            confidence: fit.confidence,
            errors: Vec::new(),
            origin,
            correspondences: fit.correspondences,
            inliers: fit.inliers,
            residual: fit.energy.sqrt(),
            readout_deviation: 0.0,
            focal_length: None,
            fitted: Vec::new(),
        })
    }
}
