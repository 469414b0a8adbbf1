//! What is found of a frame, by either estimator.

use super::window::Origin;
use crate::motion::FrameMotion;
use nalgebra::Vector2;

/// The motion of one frame and how far it is to be trusted.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct FrameSolution {
    /// What the frame is rectified by: the motion through its readout, the shutter it was solved with, and how much
    /// of the correction is applied: less where a continuous path is uncertain.
    pub motion: FrameMotion,
    /// Trust in the motion, 0 (untouched) to 1: the share of the correction that is expected to be right.
    pub confidence: f64,
    /// Root mean square distance in pixels at which the points of the frame, rectified as far as [`motion`](Self::motion)
    /// says, are expected to lie from where they belong; `None` where it cannot be told: of a frame without a motion and
    /// from the sequential estimator.
    pub expected_error: Option<f64>,
    /// The same in each of [`REGIONS`](super::residual::REGIONS), row by row; empty where it cannot be told.
    pub region_errors: Vec<f64>,
    /// Where the motion comes from.
    pub origin: Origin,
    /// Correspondences measured in the pair of frames over which the motion was solved. Of a frame without a motion,
    /// those with the frame before it: 0 for the first, after a gap in time and for a duplicate.
    pub correspondences: usize,
    /// Those of them that follow the motion.
    pub inliers: usize,
    /// Root mean square residual of an inlier in pixels: √E of 25.4, or a coordinate's deviation from
    /// the continuous path.
    pub residual: f64,
    /// Standard deviation of the readout ratio that was found; 0 where it was given.
    pub readout_deviation: f64,
    /// Whether hardly a point of the frame before was found again in it, as where another shot begins; never by the
    /// sequential estimator.
    pub begins_shot: bool,
    /// The focal length; `None` where nothing is known of it: of a frame without a motion, from the sequential estimator,
    /// and of a model without perspective.
    pub focal_length: Option<FocalLength>,
    /// Correspondences of the frame and how they fit the motion, at most one a point of the sampling grid; those with the
    /// next frame where there is one. Empty unless [`Settings::keep_correspondences`](crate::rectifier::Settings::keep_correspondences) asks for them, of a frame without a
    /// motion, and from the sequential estimator.
    pub fitted: Vec<FittedCorrespondence>,
}

/// A focal length, given or found.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct FocalLength {
    /// In frame widths.
    pub widths: f64,
    /// Standard deviation in frame widths; 0 where it was given.
    pub deviation: f64,
}

/// A correspondence of a frame, and how it fits the motion that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct FittedCorrespondence {
    /// Where the frame shows the point, in pixels of the full frame, pixel centres at integers.
    pub position: Vector2<f64>,
    /// How far the point was measured to move from the frame to the next one, in pixels; of a frame that is joined to none
    /// after it, from the one before to it.
    pub displacement: Vector2<f64>,
    /// What the motion of the picture as a whole leaves of the displacement, in pixels.
    pub residual: Vector2<f64>,
    /// Whether the residual lies within three standard deviations of what the covariance of the measurement and the usual
    /// residual of the pair let expect. An outlier is measured wrongly, or shows what moves by itself, parallax, or what is
    /// fixed to the frame.
    pub is_inlier: bool,
}

/// Of any numbers; `None` where there are none.
#[must_use]
pub fn root_mean_square(values: &[f64]) -> Option<f64> {
    let mean_square = values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64;
    (!values.is_empty()).then(|| mean_square.sqrt())
}
