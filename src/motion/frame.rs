//! The motion of one frame, the shutter it was solved for, and the share of the correction applied.

use super::MotionPath;
use crate::readout::Readout;

/// The motion of one frame, as needed for its rectification.
///
/// Path, readout and weight are kept together: the path is a function of the elapsed share of *its* readout,
/// and if it is uncertain only a part of the correction improves the frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameMotion {
    readout: Readout,
    path: MotionPath,
    weight: f64,
}

impl FrameMotion {
    /// A motion whose correction is applied in full.
    #[must_use]
    pub const fn new(readout: Readout, path: MotionPath) -> Self {
        Self { readout, path, weight: 1.0 }
    }

    /// The same motion with this share of the correction applied, clamped to 0 to 1; NaN counts as 0.
    #[must_use]
    pub fn with_weight(self, weight: f64) -> Self {
        Self { weight: if weight.is_nan() { 0.0 } else { weight.clamp(0.0, 1.0) }, ..self }
    }

    /// The shutter that the motion was solved for.
    #[must_use]
    pub const fn readout(&self) -> &Readout {
        &self.readout
    }

    /// The motion during the frame's readout; [`MotionPath::STILL`] if none was found.
    #[must_use]
    pub const fn path(&self) -> &MotionPath {
        &self.path
    }

    /// Share of the correction that is applied, 0 to 1: less if the motion is uncertain, so that the
    /// correction fades in and out without a jump.
    #[must_use]
    pub const fn weight(&self) -> f64 {
        self.weight
    }

    /// Whether no correction is applied: nothing moved, or the weight is 0.
    #[must_use]
    pub fn is_still(&self) -> bool {
        self.weight == 0.0 || self.path.is_still()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Twist;
    use crate::readout::{ReadoutDirection, ReadoutTime};

    #[test]
    fn weights_are_shares() {
        let readout =
            Readout::new(8, 4, ReadoutDirection::TopToBottom, ReadoutTime::WholePeriod, 1.0).unwrap();
        let motion = FrameMotion::new(readout, MotionPath::uniform(Twist::new(0.0, 1.0, 0.0), 1.0));
        assert_eq!(motion.weight(), 1.0);
        for (weight, share) in
            [(0.25, 0.25), (-1.0, 0.0), (7.0, 1.0), (f64::NAN, 0.0), (f64::INFINITY, 1.0), (-0.0, 0.0)]
        {
            let motion = motion.clone().with_weight(weight);
            assert_eq!((motion.weight(), motion.is_still()), (share, share == 0.0));
        }
        assert!(FrameMotion::new(readout, MotionPath::STILL).is_still());
    }
}
