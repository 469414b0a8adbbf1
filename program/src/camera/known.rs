// SPDX-License-Identifier: MIT OR Apache-2.0

//! What is known of the camera that made a clip before any frame is looked at: what it states, and what the catalogue has.

use super::catalogue::{Camera, Mode};
use super::stated::{Kind, Stabilisation, Stated, StatedReadout};
use rsrectify::readout::{ReadoutDirection, ReadoutError, ReadoutPrior};
use std::fmt;

/// Standard deviation, as a share of the readout, where it is not stated how the picture was stabilised: a crop by the share
/// c leaves 1 − c of the rows.
const PERHAPS_CROPPED: f64 = 0.2;
/// A readout is at most the time from one frame to the next, but for rounding.
const LONGEST: f64 = 1.01;

/// What is known of a clip's camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Known {
    /// What the camera states.
    pub stated: Stated,
    /// The camera, where the catalogue has it.
    pub camera: Option<Camera>,
    /// Whether a readout that is stated is expected.
    pub heeds_statement: bool,
}

/// The readout that is expected of a clip.
#[derive(Clone, Debug, PartialEq)]
pub struct Expectation {
    pub camera: String,
    /// Size, and frame rate where that decides.
    pub mode: String,
    /// Mean and standard deviation of the readout time in milliseconds.
    pub milliseconds: f64,
    pub deviation: f64,
    pub direction: ReadoutDirection,
    /// Where it is from.
    pub source: String,
    is_stated: bool,
    /// The readout without stabilisation, in milliseconds, where the camera stabilised the clip.
    pub without_stabilisation: Option<f64>,
}

impl Known {
    /// Maker and model.
    pub fn name(&self) -> Option<String> {
        self.camera.as_ref().map(Camera::name).or_else(|| self.stated.name())
    }

    /// The stabilisation that was on.
    pub fn stabilisation(&self) -> Option<&Stabilisation> {
        self.stated.stabilisation.as_ref().filter(|stabilisation| stabilisation.is_on)
    }

    /// What is expected of the readout of frames of this size, so many a second: what the camera states, else what the
    /// catalogue has of its mode.
    pub fn expectation(&self, size: [u32; 2], rate: Option<f64>) -> Option<Expectation> {
        let mode = rate.and_then(|rate| self.camera.as_ref()?.mode(size, rate));
        let expectation = self.by_statement(size, rate, mode).or_else(|| self.by_catalogue(mode?))?;
        Some(match self.stabilisation() {
            Some(stabilisation) => expectation.stabilised(stabilisation.kind),
            None => expectation,
        })
    }

    /// The readout that is stated, on the clip's clock, and heeded.
    fn readout(&self, rate: Option<f64>) -> Option<(&StatedReadout, f64)> {
        let readout = self.stated.readout.as_ref().filter(|_| self.heeds_statement)?;
        Some((readout, readout.on_clock_of(rate)))
    }

    /// A readout that is stated, but longer than a frame lasts: the clip was cut down or its times were changed.
    pub fn impossible_readout(&self, rate: Option<f64>) -> Option<&StatedReadout> {
        let (readout, milliseconds) = self.readout(rate)?;
        (milliseconds > LONGEST * 1e3 / rate?).then_some(readout)
    }

    fn by_statement(&self, size: [u32; 2], rate: Option<f64>, mode: Option<&Mode>) -> Option<Expectation> {
        let (readout, milliseconds) = self.readout(rate)?;
        if self.impossible_readout(rate).is_some() {
            return None;
        }
        let [width, height] = size;
        // Cameras that are read from another edge are rare, see `cameras/README.md`.
        let usual = mode.map_or(ReadoutDirection::TopToBottom, Mode::direction);
        Some(Expectation {
            camera: self.name().unwrap_or_else(|| "not named".to_owned()),
            mode: format!("{width}x{height}"),
            milliseconds,
            deviation: readout.deviation * milliseconds,
            direction: readout.direction.unwrap_or(usual),
            source: format!("stated with the clip: {}", readout.source),
            is_stated: true,
            without_stabilisation: None,
        })
    }

    fn by_catalogue(&self, mode: &Mode) -> Option<Expectation> {
        Some(Expectation {
            camera: self.camera.as_ref()?.name(),
            mode: mode.name(),
            milliseconds: mode.milliseconds(),
            deviation: mode.deviation(),
            direction: mode.direction(),
            source: mode.source(),
            is_stated: false,
            without_stabilisation: None,
        })
    }
}

impl Expectation {
    /// After a stabilisation in the camera.
    ///
    /// An electronic one crops the frame and takes out as much of the rolling shutter as its gyroscope allows, up to all of
    /// it: the readout that is left is anywhere from 0 to the sensor's. The mean of that is the half, the deviation 1/√12.
    fn stabilised(self, kind: Kind) -> Self {
        let whole = self.milliseconds;
        let (milliseconds, deviation) = match kind {
            Kind::Electronic => (0.5 * whole, (whole * whole / 12.0).sqrt()),
            Kind::Unknown => (whole, self.deviation.hypot(PERHAPS_CROPPED * whole)),
        };
        Self { milliseconds, deviation, without_stabilisation: Some(whole), ..self }
    }

    /// What the rectifier starts from.
    pub fn prior(&self) -> Result<ReadoutPrior, ReadoutError> {
        ReadoutPrior::new(self.milliseconds * 1e-3, self.deviation * 1e-3, Some(self.direction))
    }

    /// What has to be added to the figures: a statement as their source, stabilisation.
    pub fn note(&self) -> String {
        let source = if self.is_stated { format!(", {}", self.source) } else { String::new() };
        let whole = self.without_stabilisation;
        let whole = whole.map(|whole| format!(", {whole:.1} ms without the stabilisation"));
        source + &whole.unwrap_or_default()
    }

    /// The readout time, negative where the bottom row or the right column is read first.
    pub fn signed_milliseconds(&self) -> f64 {
        if self.direction.is_reversed() { -self.milliseconds } else { self.milliseconds }
    }
}

impl fmt::Display for Expectation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { camera, mode, milliseconds, deviation, .. } = self;
        write!(f, "{camera} {mode}; {milliseconds:.1} ± {deviation:.1} ms expected{}", self.note())
    }
}

#[cfg(test)]
mod tests {
    use super::super::catalogue::cameras;
    use super::*;

    fn known(milliseconds: Option<f64>, stabilisation: Option<Kind>) -> Known {
        let stabilisation =
            stabilisation.map(|kind| Stabilisation { is_on: true, kind, name: None, source: "x" });
        let readout = milliseconds.and_then(|time| StatedReadout::new(time, "x"));
        let camera =
            cameras().unwrap().into_iter().find(|camera| camera.is_stated_as("GoPro", "HERO5 Session"));
        let stated = Stated { readout, stabilisation, ..Stated::default() };
        Known { stated, camera, heeds_statement: true }
    }

    const SIZE: [u32; 2] = [1280, 720];

    #[test]
    fn a_statement_wins_over_the_catalogue() {
        let expected = |time| known(time, None).expectation(SIZE, Some(25.0)).unwrap();
        let by_catalogue = expected(None);
        assert_eq!((by_catalogue.milliseconds, by_catalogue.mode.as_str()), (25.2, "1280x720@25"));
        let stated = expected(Some(20.0));
        assert_eq!((stated.milliseconds, stated.deviation), (20.0, 1.0));
        assert_eq!(stated.camera, "GoPro HERO5 Session");
        // One that cannot be does not.
        assert_eq!(expected(Some(50.0)), by_catalogue);
        assert!(known(Some(50.0), None).impossible_readout(Some(25.0)).is_some());
        let alone = Known { camera: None, ..known(Some(20.0), None) };
        assert_eq!(alone.expectation(SIZE, None).unwrap().milliseconds, 20.0);
        let not_heeded = Known { heeds_statement: false, ..alone };
        assert_eq!(not_heeded.expectation(SIZE, Some(25.0)), None);
    }

    #[test]
    fn a_stabilised_clip_has_any_readout_up_to_the_sensors() {
        for time in [None, Some(25.2)] {
            let expected = known(time, Some(Kind::Electronic)).expectation(SIZE, Some(25.0)).unwrap();
            assert_eq!(expected.without_stabilisation, Some(25.2));
            // Neither end is out of the question.
            for end in [0.0, 25.2] {
                assert!((end - expected.milliseconds).abs() < 2.0 * expected.deviation, "{expected:?}");
            }
        }
        let expected = known(Some(20.0), Some(Kind::Unknown)).expectation(SIZE, Some(25.0)).unwrap();
        assert!(expected.milliseconds == 20.0 && expected.deviation > 4.0);
    }
}
