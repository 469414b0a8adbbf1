// SPDX-License-Identifier: MIT OR Apache-2.0

//! Numbered images as a clip.

use super::numbered::Numbered;
use crate::elements::make;
use anyhow::{Context, Result, bail};
use gst::prelude::*;
use std::fmt;
use std::str::FromStr;

/// Frames a second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fps(gst::Fraction);

impl Fps {
    /// As a fraction.
    pub fn fraction(self) -> gst::Fraction {
        self.0
    }

    /// That of programs which write images, where nothing is said.
    pub fn usual() -> Self {
        Self(gst::Fraction::new(25, 1))
    }
}

impl FromStr for Fps {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            "neither a number of frames a second from 0.01 to 1000, nor a fraction such as 30000/1001"
                .to_owned()
        };
        let fraction = match text.split_once('/') {
            Some((num, den)) => {
                let [num, den] = [num, den].map(|part| part.parse::<i32>().ok().filter(|part| *part > 0));
                num.zip(den).map(|(num, den)| gst::Fraction::new(num, den))
            }
            None => text.parse::<f64>().ok().and_then(gst::Fraction::approximate_f64),
        };
        let is_possible = |fraction: &gst::Fraction| {
            (0.01..=1000.0).contains(&(f64::from(fraction.numer()) / f64::from(fraction.denom())))
        };
        fraction.filter(is_possible).map(|fraction| Self(ntsc(fraction))).ok_or_else(wrong)
    }
}

/// The rate that is meant by 23.98, 29.97 and so on.
fn ntsc(rate: gst::Fraction) -> gst::Fraction {
    let exact = f64::from(rate.numer()) / f64::from(rate.denom());
    let usual = [24, 30, 48, 60, 120].map(|rate| gst::Fraction::new(rate * 1000, 1001));
    let is_meant =
        |usual: &gst::Fraction| (f64::from(usual.numer()) / f64::from(usual.denom()) - exact).abs() < 0.005;
    usual.into_iter().find(is_meant).unwrap_or(rate)
}

impl fmt::Display for Fps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0.denom() {
            1 => write!(f, "{}", self.0.numer()),
            den => write!(f, "{:.2}", f64::from(self.0.numer()) / f64::from(den)),
        }
    }
}

/// Numbered images, each a frame.
#[derive(Clone, Debug)]
pub struct Images {
    pub pattern: Numbered,
    pub fps: Fps,
    /// Whether the user gave the rate.
    pub is_rate_given: bool,
}

impl Images {
    /// Refuses images that are no clip: with gaps between their numbers, or of several sizes.
    pub fn check(&self) -> Result<()> {
        let [first, last] = self.pattern.range()?;
        let size = |number: u64| {
            let file = self.pattern.file(number);
            let size = imagesize::size(&file)
                .with_context(|| format!("{} is no image that can be read", file.display()))?;
            Ok::<_, anyhow::Error>((size.width, size.height))
        };
        let (width, height) = size(first)?;
        for number in first..=last {
            let (other_width, other_height) = size(number)?;
            if (other_width, other_height) != (width, height) {
                bail!(
                    "{} is of {other_width} x {other_height} pixels, {} of {width} x {height}",
                    self.pattern.file(number).display(),
                    self.pattern.file(first).display()
                );
            }
        }
        Ok(())
    }

    /// How many there are.
    pub fn count(&self) -> Result<usize> {
        Ok(self.pattern.numbers()?.len())
    }

    /// What reads them.
    pub fn source(&self) -> Result<gst::Element> {
        let [first, last] = self.pattern.range()?.map(i32::try_from);
        let source = make("imagesequencesrc")?;
        source.set_property("location", self.pattern.printf()?);
        source.set_property("start-index", first?);
        source.set_property("stop-index", last?);
        source.set_property("framerate", self.fps.0);
        Ok(source)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_read() {
        for (text, num, den) in
            [("25", 25, 1), ("29.97", 30000, 1001), ("23.976", 24000, 1001), ("12.5", 25, 2)]
        {
            assert_eq!(text.parse(), Ok(Fps(gst::Fraction::new(num, den))), "{text}");
        }
        assert_eq!("30000/1001".parse::<Fps>().unwrap().to_string(), "29.97");
        for wrong in ["0", "-1", "1/0", "nan", "1e9", "a", "1001"] {
            assert!(wrong.parse::<Fps>().is_err(), "{wrong}");
        }
    }
}
