// SPDX-License-Identifier: MIT OR Apache-2.0

//! The givens about a camera, and priors of the rest.

use crate::motion::generators::Model;
use crate::readout::{ReadoutDirection, ReadoutPrior, ReadoutTime};
use crate::solve::continuous::prior::READOUT_DEVIATION;
use std::cmp::Ordering;

/// Mean and standard deviation of the prior of γ.
pub const READOUT_BELIEF: (f64, f64) = (0.0, READOUT_DEVIATION);
/// Mean and standard deviation of the prior of κ: the focal length is about 0.9 frame widths.
const KAPPA_BELIEF: (f64, f64) = (0.3, 0.3);
/// Limits of κ: a field of view under 110°.
pub const KAPPA_LIMITS: [f64; 2] = [0.0, 2.0];
/// Prior log odds of lines along the longer side of the picture: nearly every sensor has them. About one portrait
/// clip in sixteen is cropped from a landscape one; one landscape clip in a thousand, from a portrait one.
const LONGER_SIDE_LOG_ODDS: [f64; 2] = [2.7, 6.9];
/// Standard deviation of given values.
pub const GIVEN_DEVIATION: f64 = 1e-6;

/// A component of the prior of γ, the signed readout time: lines along one axis, either edge of which or a known
/// one is read first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scan {
    /// Whether rows, not columns, are read one after another.
    pub by_rows: bool,
    /// Whether the bottom (right) edge is read first; `None`: either may be.
    pub is_reversed: Option<bool>,
}

impl From<ReadoutDirection> for Scan {
    fn from(direction: ReadoutDirection) -> Self {
        Self { by_rows: direction.is_by_rows(), is_reversed: Some(direction.is_reversed()) }
    }
}

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

    /// The components that are tried where nothing is expected of γ: one an axis, as a fit passes from one sign
    /// of γ to the other.
    pub fn scans(&self) -> Vec<Scan> {
        let either = [true, false].map(|by_rows| Scan { by_rows, is_reversed: None });
        self.direction.map_or_else(|| either.to_vec(), |direction| vec![direction.into()])
    }

    /// The prior of the readout, if the readout is unknown and the prior agrees with a given direction.
    pub fn expected(&self) -> Option<ReadoutPrior> {
        let allows = |expected: ReadoutDirection| self.direction.is_none_or(|known| known == expected);
        self.readout_prior.filter(|prior| !self.is_known() && prior.direction().is_none_or(allows))
    }

    /// The components that are tried first. Of a readout time that is given or expected, the sign of γ is
    /// another component, as its prior has two peaks.
    pub fn first_scans(&self) -> Vec<Scan> {
        use ReadoutDirection::{BottomToTop, LeftToRight, RightToLeft, TopToBottom};
        let expected = self.expected();
        match self.direction.or_else(|| expected.and_then(|prior| prior.direction())) {
            Some(direction) => vec![direction.into()],
            None if self.is_known() || expected.is_some() => {
                [TopToBottom, BottomToTop, LeftToRight, RightToLeft].map(Scan::from).to_vec()
            }
            None => self.scans(),
        }
    }

    /// Log prior probability of lines along rows, or along columns, up to a constant, in frames of this size.
    pub fn log_prior(by_rows: bool, width: usize, height: usize) -> f64 {
        let [portrait, landscape] = LONGER_SIDE_LOG_ODDS;
        match (by_rows, width.cmp(&height)) {
            (true, Ordering::Less) => -portrait,
            (false, Ordering::Greater) => -landscape,
            _ => 0.0,
        }
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
        let prior = Camera::log_prior;
        assert!(prior(true, 640, 480) > prior(false, 640, 480));
        assert!(prior(true, 480, 640) < prior(false, 480, 640));
        assert_eq!(prior(true, 500, 500), prior(false, 500, 500));
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
