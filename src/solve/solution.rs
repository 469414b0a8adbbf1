// SPDX-License-Identifier: MIT OR Apache-2.0

//! The result for a frame, from either estimator.

use super::as_recorded::AsRecorded;
use super::frame_timing::{FrameTiming, Timeline};
use crate::area::PictureArea;
use crate::motion::{FrameMotion, MotionPath};
use crate::readout::Readout;
use nalgebra::Vector2;

/// Pixels a frame: where the picture moves less than that even where it moves fastest, no readout bends it by more than half.
const STILL: f64 = 0.25;
/// Share of the readout at which it is asked whether a frame is corrected; of other instants, few pixels more or less are.
const REFERENCE: f64 = 0.5;

/// How a frame's motion was obtained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Origin {
    /// One pair of frames in uniform rotation (25.6).
    Initial,
    /// The recursion from earlier frames (25.7, 25.8).
    Forward,
    /// The recursion from later frames (25.9, 25.10).
    Backward,
    /// The continuous path.
    Continuous,
    /// The motion of the previous frame, of which this one is a duplicate.
    Repeated,
    /// No motion was found: the frame is not corrected. A path of confidence 0 is not corrected either, but is
    /// [`Continuous`](Self::Continuous); the sequential estimator returns no motion of confidence 0.
    Untouched,
}

impl Origin {
    /// The name in lower case.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Initial => "initial",
            Self::Forward => "forward",
            Self::Backward => "backward",
            Self::Continuous => "continuous",
            Self::Repeated => "repeated",
            Self::Untouched => "untouched",
        }
    }
}

/// The motion of one frame with its confidence.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct FrameSolution {
    /// Number of the frame, counted from 0 over all frames pushed since the rectifier was made or
    /// [reset](crate::Rectifier::reset). A [drain](crate::Rectifier::drain) does not start it anew: no two frames that can
    /// be popped have the same.
    pub index: usize,
    /// Timestamp of the frame in seconds, as it was pushed; `None` where it was missing or not finite.
    pub time: Option<f64>,
    /// The motion to rectify the frame with: the path during its readout, the shutter it was solved for, and
    /// the share of the correction to apply, less than 1 if a continuous path is uncertain.
    pub motion: FrameMotion,
    /// Confidence in the motion, 0 (the picture is left as it is) to 1. From the continuous estimator it is the
    /// share of the correction that is expected to be right, and equal to the motion's
    /// [weight](FrameMotion::weight), the share that is applied; the sequential one has the weight 1 wherever the
    /// confidence is positive.
    pub confidence: f64,
    /// Expected root mean square error, in pixels, of the positions of the frame's points after rectification
    /// with [`motion`](Self::motion); `None` for a frame without a motion and from the sequential estimator.
    pub expected_error: Option<f64>,
    /// The same in each of [`REGIONS`](super::residual::REGIONS), row by row; empty if it is `None`.
    pub region_errors: Vec<f64>,
    /// How the motion was obtained.
    pub origin: Origin,
    /// Number of correspondences in the pair of frames over which the motion was solved: all that were measured,
    /// before overlays and invalid ones are removed; from the sequential estimator, those that are left when
    /// uncertain ones are removed. For a frame without a motion, all that were measured with the previous frame:
    /// 0 for the first, after a gap in time and for a duplicate.
    pub correspondences: usize,
    /// Number of inliers among them.
    pub inliers: usize,
    /// Root mean square residual of an inlier in pixels: √E of 25.4, or a coordinate's deviation from
    /// the continuous path.
    pub residual: f64,
    /// Standard deviation of the estimated readout ratio; 0 if it was given.
    pub readout_deviation: f64,
    /// Whether very few points of the previous frame were found in this one, as at a cut; always false with
    /// the sequential estimator.
    pub begins_shot: bool,
    /// Timing and placement of the frames, as estimated from all that were pushed so far; undecided from the sequential
    /// estimator.
    pub timing: FrameTiming,
    /// Why the frame keeps its picture; `None` if it is corrected.
    pub as_recorded: Option<AsRecorded>,
    /// The focal length; `None` for a frame without a motion, from the sequential estimator, and for a model
    /// without perspective.
    pub focal_length: Option<FocalLength>,
    /// Correspondences of the frame and their residuals, at most one per point of the sampling grid; those
    /// with the next frame if there is one. Empty unless
    /// [`Settings::keep_correspondences`](crate::rectifier::Settings::keep_correspondences) is set, for a frame
    /// without a motion, and from the sequential estimator.
    pub fitted: Vec<FittedCorrespondence>,
}

impl FrameSolution {
    /// An uncorrected frame.
    pub(crate) fn untouched(readout: Readout) -> Self {
        let motion = FrameMotion::new(readout, MotionPath::STILL).with_weight(0.0);
        Self::new(motion, Origin::Untouched)
    }

    /// A frame of this motion, without a number, confidence, or anything else that only some estimators state.
    pub(crate) fn new(motion: FrameMotion, origin: Origin) -> Self {
        Self {
            index: 0,
            time: None,
            motion,
            confidence: 0.0,
            expected_error: None,
            region_errors: Vec::new(),
            origin,
            correspondences: 0,
            inliers: 0,
            residual: 0.0,
            readout_deviation: 0.0,
            begins_shot: false,
            timing: FrameTiming::default(),
            as_recorded: None,
            focal_length: None,
            fitted: Vec::new(),
        }
    }

    /// The same of a picture that lies there in its frame.
    pub(crate) fn within(mut self, area: PictureArea) -> Self {
        let [x, y] = area.origin().map(|at| at as f64);
        for fitted in &mut self.fitted {
            fitted.position += Vector2::new(x, y);
        }
        Self { motion: self.motion.within(area), ..self }
    }

    /// Why the frame keeps its picture; `None` if it is corrected. `period`: seconds from frame to frame.
    pub(crate) fn reason_as_recorded(&self, period: f64) -> Option<AsRecorded> {
        if !self.motion.corrects_nothing(REFERENCE) {
            return None;
        }
        // What the estimator has found out cannot be inferred from the motion.
        if self.as_recorded.is_some() {
            return self.as_recorded;
        }
        let readout = self.motion.readout();
        let twist = self.motion.path().mean_twist();
        let reach = 0.5 * (readout.width() as f64).hypot(readout.height() as f64);
        let speed = twist.velocity.norm() + twist.omega.abs() * reach;
        let is_known = self.readout_deviation <= Readout::MAX_KNOWN_DEVIATION;
        let is_global = readout.time() < Readout::MIN_VISIBLE_TIME;
        Some(match (self.timing.timeline, is_known, is_global) {
            (Timeline::Blended { period }, ..) => AsRecorded::Blended { period },
            _ if self.origin == Origin::Untouched => AsRecorded::NoMotion,
            _ if self.timing.is_stabilised() => AsRecorded::Stabilised,
            // With a readout of 0 the path has no displacement during the readout, whatever moves.
            (_, false, true) => AsRecorded::UnknownReadout,
            (_, _, false) if speed * period < STILL => AsRecorded::NothingMoved,
            (_, false, false) => AsRecorded::UnknownReadout,
            (_, true, true) => AsRecorded::GlobalShutter,
            (_, true, false) => AsRecorded::Uncertain,
        })
    }
}

/// A focal length, given or estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct FocalLength {
    /// In frame widths.
    pub widths: f64,
    /// Standard deviation in frame widths; 0 if it was given.
    pub deviation: f64,
}

/// A correspondence of a frame with its residual.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct FittedCorrespondence {
    /// Position of the point in the frame, in pixels of the full frame, pixel centres at integers.
    pub position: Vector2<f64>,
    /// Measured displacement of the point from the frame to the next one, in pixels; for a frame without a
    /// measurement to the next one, from the previous frame to it.
    pub displacement: Vector2<f64>,
    /// Displacement minus that of the global motion, in pixels.
    pub residual: Vector2<f64>,
    /// Whether the residual is at most three standard deviations, from the covariance of the measurement and
    /// the usual residual of the pair. An outlier is a wrong measurement, or a point that moves independently,
    /// shows parallax, or is fixed to the frame.
    pub is_inlier: bool,
}

/// Root mean square; `None` for no values.
#[must_use]
pub fn root_mean_square(values: &[f64]) -> Option<f64> {
    let mean_square = values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64;
    (!values.is_empty()).then(|| mean_square.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Twist;
    use crate::readout::{ReadoutDirection, ReadoutTime};

    /// A frame that moves by so many pixels a second, of which this is known; rectified with the weight 0.
    fn kept(speed: f64, readout_ms: f64, readout_deviation: f64) -> FrameSolution {
        let time = ReadoutTime::Seconds(readout_ms * 1e-3);
        let readout = Readout::new(640, 480, ReadoutDirection::TopToBottom, time, 0.04).unwrap();
        let path = MotionPath::uniform(Twist::new(0.0, speed, 0.0), readout.time());
        let motion = FrameMotion::new(readout, path).with_weight(0.0);
        FrameSolution { readout_deviation, ..FrameSolution::new(motion, Origin::Continuous) }
    }

    #[test]
    fn each_frame_that_keeps_its_picture_has_its_reason() {
        let of = |stabilised, timeline, origin| FrameSolution {
            timing: FrameTiming::new(stabilised, timeline),
            origin,
            ..kept(900.0, 20.0, 0.0)
        };
        let (blended, stated) = (Timeline::Blended { period: 6 }, Timeline::Stated);
        for (solution, reason) in [
            (of(None, blended, Origin::Continuous), "all frames but one in 6 are blends of two"),
            (of(None, stated, Origin::Untouched), "no motion was found"),
            (of(Some(true), stated, Origin::Continuous), "the frames were moved after their readout"),
            (of(None, stated, Origin::Continuous), "the correction was too uncertain"),
            (kept(5.0, 20.0, 0.3), "nothing moved"),
            (kept(50.0, 20.0, 0.3), "the readout was not known"),
            (kept(50.0, 0.0, 0.3), "the readout was not known"),
            (kept(0.0, 0.0, 0.01), "the rows are as good as exposed at once"),
        ] {
            assert_eq!(solution.reason_as_recorded(0.04).unwrap().to_string(), reason);
        }
        let mut corrected = kept(900.0, 20.0, 0.0);
        corrected.motion = corrected.motion.with_weight(0.5);
        assert_eq!(corrected.reason_as_recorded(0.04), None);
    }
}
