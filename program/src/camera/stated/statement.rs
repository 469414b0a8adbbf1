// SPDX-License-Identifier: MIT OR Apache-2.0

//! What a camera can state about a clip.

use rsrectify::readout::ReadoutDirection;
use serde::{Serialize, Serializer};
use std::fmt;

/// Standard deviation of a readout time that a camera states, as a share of it. The iPhone 4 states 32.08 ms where an LED
/// panel shows 31.98 and 32.37 ms (two devices); the rest is left for frames that are not all of the rows that were read.
const STATED_DEVIATION: f64 = 0.05;
/// The same of a value that people wrote into a file: as of lens profiles by one person.
const ENTERED_DEVIATION: f64 = 0.1;
/// No sensor of a video camera takes longer, in milliseconds.
const LONGEST: f64 = 1e3;

/// What the camera wrote into a file, as far as it could be read.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Stated {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub maker: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub readout: Option<StatedReadout>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stabilisation: Option<Stabilisation>,
    /// How the camera was held or mounted, in the camera's own words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation: Option<String>,
    /// Resolution, frame rate and field of view, in the camera's own words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mode: Option<String>,
}

/// A readout time that is stated.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StatedReadout {
    /// Of all rows of the frame, on the clock of the sensor.
    #[serde(rename = "ms")]
    pub milliseconds: f64,
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "direction")]
    pub direction: Option<ReadoutDirection>,
    /// Frames a second that the sensor took, where that may differ from the clip's: slow and quick motion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub capture_rate: Option<f64>,
    /// The format and its field.
    pub source: &'static str,
    /// Standard deviation as a share of the time.
    #[serde(skip)]
    pub deviation: f64,
}

/// Whether the camera steadied the picture while it recorded.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Stabilisation {
    #[serde(rename = "on")]
    pub is_on: bool,
    pub kind: Kind,
    /// What the camera calls it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The format and its field.
    pub source: &'static str,
}

/// What is moved to steady the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// The picture: each frame is cropped and warped.
    Electronic,
    /// Not stated.
    Unknown,
}

impl Stated {
    /// With what `other` states beside it.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        Self {
            maker: self.maker.or(other.maker),
            model: self.model.or(other.model),
            readout: self.readout.or(other.readout),
            stabilisation: self.stabilisation.or(other.stabilisation),
            orientation: self.orientation.or(other.orientation),
            mode: self.mode.or(other.mode),
        }
    }

    /// Maker and model.
    pub fn name(&self) -> Option<String> {
        match (&self.maker, &self.model) {
            // Some models have their maker's name in front.
            (Some(maker), Some(model)) if !model.to_lowercase().starts_with(&maker.to_lowercase()) => {
                Some(format!("{maker} {model}"))
            }
            (maker, model) => model.clone().or_else(|| maker.clone()),
        }
    }
}

impl fmt::Display for Stabilisation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.is_on {
            return write!(f, "off in the camera ({})", self.source);
        }
        write!(f, "on in the camera (")?;
        if let Some(name) = &self.name {
            write!(f, "{name}, ")?;
        }
        let effect = match self.kind {
            Kind::Electronic => {
                "each frame is cropped and warped, its rolling shutter perhaps corrected already"
            }
            Kind::Unknown => "each frame may be cropped and warped",
        };
        write!(f, "{}): {effect}; switch it off for clips that are to be rectified", self.source)
    }
}

impl StatedReadout {
    /// Of a camera; `None` where no readout takes so long: a field that was not filled in.
    pub fn new(milliseconds: f64, source: &'static str) -> Option<Self> {
        let is_possible = milliseconds > 0.0 && milliseconds <= LONGEST;
        is_possible.then_some(Self {
            milliseconds,
            direction: None,
            capture_rate: None,
            source,
            deviation: STATED_DEVIATION,
        })
    }

    /// Of a person.
    pub fn entered(milliseconds: f64, source: &'static str) -> Option<Self> {
        Some(Self { deviation: ENTERED_DEVIATION, ..Self::new(milliseconds, source)? })
    }

    /// Milliseconds on the clock of a clip of so many frames a second: in slow motion it runs slower than the sensor's.
    pub fn on_clock_of(&self, frame_rate: Option<f64>) -> f64 {
        let stretch = self.capture_rate.zip(frame_rate).map_or(1.0, |(captured, played)| captured / played);
        self.milliseconds * stretch
    }
}

fn direction<S: Serializer>(direction: &Option<ReadoutDirection>, serializer: S) -> Result<S::Ok, S::Error> {
    use crate::property_values::{Direction, name_of};
    serializer.serialize_str(&direction.map(|known| name_of(&Direction::from(known))).unwrap_or_default())
}

/// Text without the zeros and blanks that fill it up; `None` where there is none.
pub fn text(bytes: &[u8]) -> Option<String> {
    let text = std::str::from_utf8(bytes).ok()?.trim_matches(|c: char| c == '\0' || c.is_whitespace());
    // Names are printed: no control sequences of a terminal.
    (!text.is_empty() && !text.contains(char::is_control)).then(|| text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_a_readout_is_none() {
        for milliseconds in [0.0, -3.0, f64::NAN, f64::INFINITY, 2e3] {
            assert_eq!(StatedReadout::new(milliseconds, "x"), None);
        }
        assert!(StatedReadout::new(16.0, "x").is_some());
    }

    #[test]
    fn a_readout_is_stretched_with_the_clip() {
        let readout = StatedReadout { capture_rate: Some(120.0), ..StatedReadout::new(8.0, "x").unwrap() };
        assert_eq!(readout.on_clock_of(Some(30.0)), 32.0);
        assert_eq!(readout.on_clock_of(None), 8.0);
        assert_eq!(StatedReadout::new(8.0, "x").unwrap().on_clock_of(Some(30.0)), 8.0);
    }

    #[test]
    fn a_makers_name_is_not_said_twice() {
        let name = |maker: &str, model: &str| {
            let [maker, model] = [maker, model].map(|text| (!text.is_empty()).then(|| text.to_owned()));
            Stated { maker, model, ..Stated::default() }.name()
        };
        assert_eq!(name("GoPro", "GoPro Max").unwrap(), "GoPro Max");
        assert_eq!(name("Apple", "iPhone 4S").unwrap(), "Apple iPhone 4S");
        assert_eq!(name("DJI", "").unwrap(), "DJI");
        assert_eq!(name("", ""), None);
    }

    #[test]
    fn text_that_would_steer_a_terminal_is_none() {
        assert_eq!(text(b" HS HLevel\0\0").as_deref(), Some("HS HLevel"));
        assert_eq!(text(b"\x1b[2J"), None);
    }
}
