//! What is known of a camera, and what is believed of the rest.

use crate::motion::generators::Model;
use crate::readout::{ReadoutDirection, ReadoutPrior, ReadoutTime};

/// What is believed of γ before anything was seen: nothing that would change a picture.
pub const READOUT_BELIEF: (f64, f64) = (0.0, 0.5);
/// What is believed of κ = (half the width / f)²: f is 0.9 widths, give or take a half.
pub const KAPPA_BELIEF: (f64, f64) = (0.3, 0.3);
/// What κ may be: a field of view under 110°.
pub const KAPPA_LIMITS: [f64; 2] = [0.0, 2.0];
/// Logarithm of how much likelier it is that the lines of the sensor lie along the longer side of the picture than along
/// the shorter one: nearly every sensor is built so, and one video in sixteen or so is cropped to the other shape. Half as
/// much again changes little.
const ALONG_THE_LONGER_SIDE: f64 = 2.7;
/// Deviation of what is known.
pub const KNOWN: f64 = 1e-6;

/// What is known of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Image motions that are looked for.
    pub model: Model,
    /// Which edge is read first; `None` if that is to be found out.
    pub direction: Option<ReadoutDirection>,
    /// What is known of the readout time.
    pub readout_time: ReadoutTime,
    /// What is expected of the readout where it is not known.
    pub readout_prior: Option<ReadoutPrior>,
    /// Focal length in frame widths; `None` if that is to be found out. Less than 0.354, a field of view of 110°, counts
    /// as that.
    pub focal_length: Option<f64>,
}

impl Camera {
    /// Whether the readout time need not be found out.
    pub fn is_known(&self) -> bool {
        self.readout_time.is_known()
    }

    /// The directions that are tried. A shake that is read from one edge looks much like another one that is read from the
    /// opposite edge, until enough of it is seen.
    pub fn directions(&self) -> Vec<ReadoutDirection> {
        use ReadoutDirection::{BottomToTop, LeftToRight, RightToLeft, TopToBottom};
        match self.direction {
            Some(direction) => vec![direction],
            None => vec![TopToBottom, BottomToTop, LeftToRight, RightToLeft],
        }
    }

    /// What is expected of the readout, where it is not known and the direction that is known, if any, is the expected one.
    pub fn expected(&self) -> Option<ReadoutPrior> {
        let allows = |expected: ReadoutDirection| self.direction.is_none_or(|known| known == expected);
        self.readout_prior.filter(|prior| !self.is_known() && prior.direction().is_none_or(allows))
    }

    /// The directions that are tried first.
    pub fn first_directions(&self) -> Vec<ReadoutDirection> {
        let expected = self.expected().and_then(|prior| prior.direction());
        expected.map_or_else(|| self.directions(), |direction| vec![direction])
    }

    /// Logarithm of how likely a direction is before anything was seen, up to a constant, in frames of this size.
    pub fn log_prior(direction: ReadoutDirection, width: usize, height: usize) -> f64 {
        let is_usual = if direction.is_by_rows() { width >= height } else { height >= width };
        if is_usual { 0.0 } else { -ALONG_THE_LONGER_SIDE }
    }

    /// Mean and deviation of what is believed of κ.
    pub fn kappa_belief(&self) -> (f64, f64) {
        match self.focal_length.filter(|focal| focal.is_finite() && *focal > 0.0) {
            _ if !self.model.has_perspective() => (0.0, KNOWN),
            Some(focal) => ((0.5 / focal).powi(2).min(KAPPA_LIMITS[1]), KNOWN),
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
    fn a_focal_length_is_believed_up_to_the_widest_view() {
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
