// SPDX-License-Identifier: MIT OR Apache-2.0

//! Why a frame keeps its picture.
//!
//! The reasons are those of the table in `docs/method.md`, "When nothing is applied", as far as they can be inferred from the
//! solution of the frame.

use crate::readout;
use rsrectify::rectifier::{FrameSolution, FrameTiming, Origin};

/// Pixels a frame: where the picture moves less than that even where it moves fastest, no readout bends it by more than half.
const STILL: f64 = 0.25;

/// A frame that is not corrected, with the values from which the reason is inferred.
#[derive(Clone, Copy, Debug)]
pub enum AsRecorded {
    /// Its motion was to be found.
    Analysed {
        origin: Origin,
        timing: FrameTiming,
        /// Pixels a second by which the picture moves where it moves fastest.
        speed: f64,
        /// Standard deviation of the readout time as a share of the frame duration; 0 where it was given.
        readout_deviation: f64,
        /// Seconds.
        readout_time: f64,
    },
    /// It was to have a motion from a motion file, which has none for it, or one without a correction.
    Given { has_motion: bool },
}

impl AsRecorded {
    /// A frame that is not corrected by this solution.
    pub fn analysed(solution: &FrameSolution) -> Self {
        let motion = &solution.motion;
        let readout = motion.readout();
        let twist = motion.path().mean_twist();
        let reach = 0.5 * (readout.width() as f64).hypot(readout.height() as f64);
        Self::Analysed {
            origin: solution.origin,
            timing: solution.timing,
            speed: twist.velocity.norm() + twist.omega.abs() * reach,
            readout_deviation: solution.readout_deviation,
            readout_time: readout.time(),
        }
    }

    /// A frame for which nothing but this is known of the camera: milliseconds, share of the frame duration, pixels a second.
    #[cfg(test)]
    pub fn with_readout(readout_ms: f64, readout_deviation: f64, speed: f64) -> Self {
        let (origin, timing) = (Origin::Continuous, FrameTiming::default());
        Self::Analysed { origin, timing, speed, readout_deviation, readout_time: readout_ms * 1e-3 }
    }

    /// The reason, in the words in which the element reports it; `period` is the time from frame to frame in seconds.
    pub fn reason(&self, period: f64) -> String {
        match self {
            Self::Given { has_motion: false } => "the motion file does not have them".to_owned(),
            Self::Given { has_motion: true } => "the motion file has no correction of them".to_owned(),
            Self::Analysed { timing, .. } if timing.is_blended() => timing.timeline.to_string(),
            Self::Analysed { origin: Origin::Untouched, .. } => "no motion was found".to_owned(),
            Self::Analysed { timing, .. } if timing.is_stabilised() => {
                "the frames were moved after their readout".to_owned()
            }
            Self::Analysed { readout_deviation, readout_time, speed, .. } => {
                let (is_known, is_global) =
                    (*readout_deviation <= readout::SURE, readout_time * 1e3 < readout::NONE);
                let reason = match (is_known, is_global) {
                    // With a readout of 0 the path has no displacement during the readout, whatever moves.
                    (false, true) => "the readout was not known",
                    (_, false) if speed * period < STILL => "nothing moved",
                    (false, false) => "the readout was not known",
                    (true, true) => "the rows are as good as exposed at once",
                    (true, false) => "the correction was too uncertain",
                };
                reason.to_owned()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rsrectify::rectifier::Timeline;

    #[test]
    fn each_frame_that_keeps_its_picture_has_its_reason() {
        let with = |stabilised, timeline, origin| AsRecorded::Analysed {
            origin,
            timing: FrameTiming::new(stabilised, timeline),
            speed: 900.0,
            readout_deviation: 0.0,
            readout_time: 0.02,
        };
        let blended = Timeline::Blended { period: 6 };
        for (frame, reason) in [
            (with(None, blended, Origin::Continuous), "all frames but one in 6 are blends of two"),
            (with(None, Timeline::Stated, Origin::Untouched), "no motion was found"),
            (
                with(Some(true), Timeline::Stated, Origin::Continuous),
                "the frames were moved after their readout",
            ),
            (with(None, Timeline::Stated, Origin::Continuous), "the correction was too uncertain"),
            (AsRecorded::with_readout(20.0, 0.3, 5.0), "nothing moved"),
            (AsRecorded::with_readout(20.0, 0.3, 50.0), "the readout was not known"),
            (AsRecorded::with_readout(0.0, 0.01, 0.0), "the rows are as good as exposed at once"),
            (AsRecorded::Given { has_motion: false }, "the motion file does not have them"),
        ] {
            assert_eq!(frame.reason(1.0 / 30.0), reason);
        }
    }
}
