// SPDX-License-Identifier: MIT OR Apache-2.0

//! How a stream is analysed.

use crate::motion::Model;
pub use crate::pyramid::Effort;
use crate::readout::{ReadoutDirection, ReadoutPrior, ReadoutTime};
use crate::solve::continuous::Camera;
use crate::stabilize::SUPPORT;

/// The motion estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Estimator {
    /// Splines over exposure time; the readout is estimated from the picture unless given.
    #[default]
    Continuous,
    /// The paper's estimator: one 2D rotation per frame, each computed from that of its neighbour.
    Sequential,
}

/// Number of later frames that the motion is estimated from, at most, in a stabilised stream. More do not improve it
/// (`docs/accuracy.md`); only the smoothing uses them.
pub const MOTION_LOOKAHEAD: usize = 8;

/// The [`Settings::lookahead`] that covers all later frames used by the smoothing, given its standard deviation
/// ([`Settings::stabilization`]) and the interval from frame to frame, both in seconds.
#[must_use]
pub fn stabilization_lookahead(deviation: f64, interval: f64) -> usize {
    // No overflow: conversions saturate.
    MOTION_LOOKAHEAD.saturating_add((SUPPORT * deviation / interval).ceil() as usize)
}

/// How a stream is analysed.
///
/// ```
/// let mut settings = rsrectify::rectifier::Settings::default();
/// settings.lookahead = 8;
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Settings {
    /// At how many pixels frames are analysed.
    pub effort: Effort,
    /// Columns of the sampling grid.
    pub grid_columns: usize,
    /// Rows of the sampling grid.
    pub grid_rows: usize,
    /// Number of later frames needed before a frame's motion is available.
    pub lookahead: usize,
    /// The motion estimator.
    pub estimator: Estimator,
    /// The motion model of the continuous estimator.
    pub model: Model,
    /// Focal length in frame widths; `None` to estimate it from the picture. At least 0.354, a field of view
    /// of 110°; smaller values are raised to that.
    pub focal_length: Option<f64>,
    /// Which edge of the frame is read first; `None` to estimate it from the picture. The sequential
    /// estimator takes `None` as top to bottom.
    pub direction: Option<ReadoutDirection>,
    /// The readout time, if known.
    pub readout_time: ReadoutTime,
    /// Prior of the readout if it is unknown; ignored if it contradicts `direction`, and by the sequential
    /// estimator.
    pub readout_prior: Option<ReadoutPrior>,
    /// Whether the frames were moved after their readout, as by stabilisation in the camera, so that only the
    /// changes of their lean are used; `None` to estimate it from the picture. Ignored by the sequential estimator.
    pub stabilised: Option<bool>,
    /// Standard deviation in seconds of the smoothing of the virtual camera's path, 0 to 10; 0: the picture is rectified but not
    /// stabilised. Frames are smoothed over 2.65 deviations before and after, as far as [`lookahead`](Self::lookahead) reaches:
    /// of that, the motion itself takes at most [`MOTION_LOOKAHEAD`] frames.
    pub stabilization: f64,
    /// Largest distance by which stabilisation may move an edge of the frame into the picture, as a share of the width or height,
    /// 0 to 0.5. A zoom hides (1 − 1/zoom)/2.
    pub margin: f64,
    /// Whether [`FrameSolution::fitted`](super::FrameSolution::fitted) is filled, which takes memory for each frame.
    pub keep_correspondences: bool,
}

impl From<&Settings> for Camera {
    fn from(settings: &Settings) -> Self {
        let Settings { model, direction, readout_time, readout_prior, focal_length, .. } = *settings;
        Self { model, direction, readout_time, readout_prior, focal_length }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            effort: Effort::Balanced,
            grid_columns: 32,
            grid_rows: 24,
            lookahead: 4,
            estimator: Estimator::Continuous,
            model: Model::Auto,
            focal_length: None,
            direction: None,
            readout_time: ReadoutTime::Unknown,
            readout_prior: None,
            stabilised: None,
            stabilization: 0.0,
            margin: 0.1,
            keep_correspondences: false,
        }
    }
}
