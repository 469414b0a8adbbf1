//! The givens about a camera, and priors of the rest.

use crate::motion::generators::Model;
use crate::readout::{ReadoutDirection, ReadoutPrior, ReadoutTime};

/// Mean and standard deviation of the prior of γ. The mean changes no picture.
pub const READOUT_BELIEF: (f64, f64) = (0.0, 0.5);
/// Mean and standard deviation of the prior of κ = (R/f)², R half the frame's width and f the focal length: f is
/// about 0.9 frame widths.
const KAPPA_BELIEF: (f64, f64) = (0.3, 0.3);
/// Limits of κ: a field of view under 110°.
pub const KAPPA_LIMITS: [f64; 2] = [0.0, 2.0];
/// Prior log odds of lines along the longer side of the picture: nearly every sensor has them, and about one
/// video in sixteen is cropped to the other shape. Half as much again changes little.
const LONGER_SIDE_LOG_ODDS: f64 = 2.7;
/// Standard deviation of given values.
pub const GIVEN_DEVIATION: f64 = 1e-6;

/// The givens about a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Image motions that are fitted.
    pub model: Model,
    /// The edge that is read first; `None` if unknown.
    pub direction: Option<ReadoutDirection>,
    /// Readout time, delay or unknown.
    pub readout_time: ReadoutTime,
    /// Prior of the readout, used if `readout_time` is unknown.
    pub readout_prior: Option<ReadoutPrior>,
    /// Focal length in frame widths, at least 0.354 (a field of view of 110°); `None` if unknown.
    pub focal_length: Option<f64>,
}

impl Camera {
    /// Whether the readout time is given.
    pub fn is_known(&self) -> bool {
        self.readout_time.is_known()
    }

    /// The directions that are tried; opposite edges are hard to distinguish at first.
    pub fn directions(&self) -> Vec<ReadoutDirection> {
        use ReadoutDirection::{BottomToTop, LeftToRight, RightToLeft, TopToBottom};
        match self.direction {
            Some(direction) => vec![direction],
            None => vec![TopToBottom, BottomToTop, LeftToRight, RightToLeft],
        }
    }

    /// The prior of the readout, if the readout is unknown and the prior agrees with a given direction.
    pub fn expected(&self) -> Option<ReadoutPrior> {
        let allows = |expected: ReadoutDirection| self.direction.is_none_or(|known| known == expected);
        self.readout_prior.filter(|prior| !self.is_known() && prior.direction().is_none_or(allows))
    }

    /// The directions that are tried first.
    pub fn first_directions(&self) -> Vec<ReadoutDirection> {
        let expected = self.expected().and_then(|prior| prior.direction());
        expected.map_or_else(|| self.directions(), |direction| vec![direction])
    }

    /// Log prior probability of a direction, up to a constant, in frames of this size.
    pub fn log_prior(direction: ReadoutDirection, width: usize, height: usize) -> f64 {
        let is_usual = if direction.is_by_rows() { width >= height } else { height >= width };
        if is_usual { 0.0 } else { -LONGER_SIDE_LOG_ODDS }
    }

    /// Mean and standard deviation of the prior of κ.
    pub fn kappa_belief(&self) -> (f64, f64) {
        match self.focal_length.filter(|focal| focal.is_finite() && *focal > 0.0) {
            _ if !self.model.has_perspective() => (0.0, GIVEN_DEVIATION),
            Some(focal) => ((0.5 / focal).powi(2).min(KAPPA_LIMITS[1]), GIVEN_DEVIATION),
            None => KAPPA_BELIEF,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_lie_along_the_longer_side() {
        use ReadoutDirection::{RightToLeft, TopToBottom};
        let prior = Camera::log_prior;
        assert!(prior(TopToBottom, 640, 480) > prior(RightToLeft, 640, 480));
        assert!(prior(TopToBottom, 480, 640) < prior(RightToLeft, 480, 640));
        assert_eq!(prior(TopToBottom, 500, 500), prior(RightToLeft, 500, 500));
    }

    #[test]
    fn a_focal_length_is_clamped_at_the_widest_view() {
        let kappa = |focal: f64| {
            let focal_length = Some(focal);
            let readout_time = ReadoutTime::Unknown;
            let (model, direction, readout_prior) = (Model::Auto, None, None);
            Camera { model, direction, readout_time, readout_prior, focal_length }.kappa_belief().0
        };
        assert_eq!((kappa(1.0), kappa(0.5)), (0.25, 1.0));
        for narrow in [0.35, 1e-3, f64::MIN_POSITIVE, 5e-324] {
            assert_eq!(kappa(narrow), 2.0);
        }
    }
}
