// SPDX-License-Identifier: MIT OR Apache-2.0

//! Cameras whose readout is known: `cameras/readouts.csv` and `cameras/measured.csv`, see `cameras/README.md`.

use anyhow::{Context, Result};
use rsrectify::readout::ReadoutDirection;
use serde::Deserialize;
use std::collections::BTreeMap;

const READOUTS: &str = include_str!("../../cameras/readouts.csv");
const MEASURED: &str = include_str!("../../cameras/measured.csv");
const NAMES: &str = include_str!("../../cameras/names.csv");
/// Where the readouts are from that many profiles agree on.
pub const PROFILES: &str = "gyroflow/lens_profiles at 886fc61 (CC0)";
/// Least standard deviation as a share of the readout time: the median error against LED measurements is 2.4 %.
const LEAST_DEVIATION: f64 = 0.036;
/// The same where all profiles are of one person.
const ONE_PERSON: f64 = 0.1;
/// Frame rates that differ by no more than this share are the same: 23.976 and 24.
const SAME_RATE: f64 = 0.005;

/// A video mode of a camera.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Mode {
    maker: String,
    model: String,
    pub width: u32,
    pub height: u32,
    pub frames_per_second: f64,
    #[serde(rename = "readout_ms_signed")]
    signed_milliseconds: f64,
    #[serde(rename = "deviation_ms", default)]
    deviation_of_profiles: f64,
    #[serde(rename = "profiles_agreeing", default)]
    agreeing: u32,
    #[serde(default)]
    profiles: u32,
    /// People whose profiles they are; 0 of what was measured otherwise.
    #[serde(default)]
    calibrators: u32,
    /// Who measured it, and with what; none of profiles.
    source: Option<String>,
}

/// What a camera is called.
#[derive(Clone, Debug, Deserialize)]
struct Name {
    maker: String,
    /// As in the list of readouts, but for blanks, hyphens and capitals.
    listed: String,
    name: String,
    /// As its files state it.
    stated: String,
}

/// A camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    pub maker: String,
    pub model: String,
    /// Its model as its files state it.
    stated: String,
    /// By size and frame rate.
    pub modes: Vec<Mode>,
}

impl Mode {
    /// Readout time in milliseconds.
    pub fn milliseconds(&self) -> f64 {
        self.signed_milliseconds.abs()
    }

    /// The edge that is read first.
    pub fn direction(&self) -> ReadoutDirection {
        if self.signed_milliseconds < 0.0 {
            ReadoutDirection::BottomToTop
        } else {
            ReadoutDirection::TopToBottom
        }
    }

    /// Standard deviation in milliseconds with which the readout time is expected.
    pub fn deviation(&self) -> f64 {
        let least = if self.calibrators > 1 { LEAST_DEVIATION } else { ONE_PERSON };
        self.deviation_of_profiles.max(least * self.milliseconds())
    }

    /// Size and frame rate.
    pub fn name(&self) -> String {
        format!("{}x{}@{}", self.width, self.height, self.frames_per_second)
    }

    /// Where the readout is from.
    pub fn source(&self) -> String {
        if let Some(source) = &self.source {
            return format!("measured with {source}");
        }
        let (agreeing, profiles, people) = (self.agreeing, self.profiles, self.calibrators);
        let people = if people == 1 { "one person".to_owned() } else { format!("{people} people") };
        format!("{agreeing} of {profiles} profiles by {people}, {PROFILES}")
    }

    fn is_of(&self, [width, height]: [u32; 2], rate: f64) -> bool {
        let is_rate = (self.frames_per_second / rate - 1.0).abs() < SAME_RATE;
        (self.width, self.height) == (width, height) && is_rate
    }
}

impl Camera {
    /// Maker and model.
    pub fn name(&self) -> String {
        format!("{} {}", self.maker, self.model)
    }

    /// The mode of frames of this width and height, so many a second.
    pub fn mode(&self, size: [u32; 2], rate: f64) -> Option<&Mode> {
        self.modes.iter().find(|mode| mode.is_of(size, rate))
    }

    /// Whether this is what a file states.
    pub fn is_stated_as(&self, maker: &str, model: &str) -> bool {
        // Some makers state their company's name.
        key(maker).starts_with(&key(&self.maker))
            && [&self.model, &self.stated].iter().any(|own| is_same(own, &self.maker, model))
    }
}

/// Whether a model is called the same, with or without its maker's name before it.
fn is_same(own: &str, maker: &str, model: &str) -> bool {
    let (own, maker, model) = (key(own), key(maker), key(model));
    model == own || model.strip_prefix(&maker) == Some(&own)
}

/// What counts of a name: its letters and figures.
pub fn key(name: &str) -> String {
    name.chars().filter(char::is_ascii_alphanumeric).map(|letter| letter.to_ascii_lowercase()).collect()
}

/// All cameras that are known, by name.
pub fn cameras() -> Result<Vec<Camera>> {
    let names = rows::<Name>(NAMES)?;
    let mut cameras: BTreeMap<String, Camera> = BTreeMap::new();
    // A family of cameras is no camera.
    let modes = [rows::<Mode>(READOUTS)?, rows::<Mode>(MEASURED)?].concat();
    for mode in modes.into_iter().filter(|mode| !mode.model.contains('/')) {
        let name =
            names.iter().find(|name| name.maker == mode.maker && key(&name.listed) == key(&mode.model));
        let [model, stated] = name.map_or([&mode.model; 2], |name| [&name.name, &name.stated]);
        let camera =
            cameras.entry(format!("{} {model}", mode.maker).to_lowercase()).or_insert_with(|| Camera {
                maker: mode.maker.clone(),
                model: model.clone(),
                stated: stated.clone(),
                modes: Vec::new(),
            });
        let same = |other: &&mut Mode| other.is_of([mode.width, mode.height], mode.frames_per_second);
        match camera.modes.iter_mut().find(same) {
            Some(other) if other.calibrators < mode.calibrators => *other = mode,
            Some(_) => {}
            None => camera.modes.push(mode),
        }
    }
    Ok(cameras.into_values().collect())
}

fn rows<T: for<'a> Deserialize<'a>>(table: &str) -> Result<Vec<T>> {
    let rows = csv::Reader::from_reader(table.as_bytes()).into_deserialize();
    rows.collect::<Result<_, _>>().context("the table of cameras cannot be read")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stated(maker: &str, model: &str) -> Option<Camera> {
        cameras().unwrap().into_iter().find(|camera| camera.is_stated_as(maker, model))
    }

    #[test]
    fn each_row_is_a_mode_of_one_camera() {
        let cameras = cameras().unwrap();
        // Of 86 rows two are of families, and one mode of the EOS R5 C, one of the FX6 are there twice.
        let by_profiles = |mode: &&Mode| mode.source.is_none();
        assert_eq!(cameras.iter().flat_map(|camera| &camera.modes).filter(by_profiles).count(), 82);
        let measured = rows::<Mode>(MEASURED).unwrap().len();
        assert_eq!(cameras.iter().map(|camera| camera.modes.len()).sum::<usize>(), 82 + measured);
        for mode in cameras.iter().flat_map(|camera| &camera.modes) {
            let (time, period) = (mode.milliseconds(), 1e3 / mode.frames_per_second);
            assert!(time > 0.0 && time < 1.01 * period, "{mode:?}");
            assert!(mode.deviation() > 0.99 * LEAST_DEVIATION * time, "{mode:?}");
        }
        for name in rows::<Name>(NAMES).unwrap() {
            let is_listed = |mode: &Mode| key(&mode.model) == key(&name.listed);
            let mut modes = [READOUTS, MEASURED].into_iter().flat_map(|table| rows::<Mode>(table).unwrap());
            assert!(modes.any(|mode| is_listed(&mode)), "{name:?}");
        }
    }

    #[test]
    fn a_camera_is_found_by_what_its_files_state() {
        let sony = stated("Sony", "ILCE-7SM3").unwrap();
        assert_eq!((sony.name(), sony.modes.len()), ("Sony A7S III".to_owned(), 5));
        let mode = sony.mode([3840, 2160], 24.0).unwrap();
        assert_eq!((mode.milliseconds(), mode.direction()), (8.7, ReadoutDirection::TopToBottom));
        assert!((mode.deviation() - 0.036 * 8.7).abs() < 1e-9);
        assert_eq!(sony.mode([1920, 1080], 24.0), None);
        assert_eq!(sony.mode([3840, 2160], 48.0), None);
        assert_eq!(
            stated("FUJIFILM", "FUJIFILM X-T5").unwrap().modes[0].direction(),
            ReadoutDirection::BottomToTop
        );
        assert_eq!(stated("Canon", "Canon EOS R5 C").unwrap().modes[0].milliseconds(), 15.5);
        assert_eq!(stated("GoPro", "HERO5 Black").unwrap().modes.len(), 8);
        assert_eq!(stated("GoPro", "HERO5").map(|camera| camera.name()), None);
        assert_eq!(stated("NIKON CORPORATION", "NIKON Z 9").unwrap().modes.len(), 3);
        assert_eq!(
            stated("Sony", "ILCE-7M3").unwrap().mode([3840, 2160], 30.0).unwrap().milliseconds(),
            17.2
        );
        assert_eq!(stated("Apple", "iPhone 13"), None);
        // One person's.
        let mode = stated("GoPro", "HERO8 Black").unwrap().modes[0].clone();
        assert!((mode.deviation() - 0.1 * mode.milliseconds()).abs() < 1e-9);
    }
}
