// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the user may tell the rectifier.

use crate::camera::CameraChoice;
use crate::property_values::{Direction, Effort, Estimator, Model, Stabilised, name_of};
use anyhow::{Context, Result, anyhow};
use clap::Args;
use gst::prelude::*;
use rsrectify::readout::{ReadoutPrior, ReadoutTime};
use rsrectify::rectifier::{self, Settings};
use std::str::FromStr;

/// Most frames that the element looks ahead.
pub const MAX_LOOKAHEAD: u32 = 64;

/// How the motion is found.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Analysis")]
pub struct AnalysisOptions {
    /// Readout time of the sensor in milliseconds, if known. Without it some stretches of the file are
    /// analysed first to find it; 0 leaves that to the rectifier while it runs.
    #[arg(long, value_name = "MS", value_parser = milliseconds, allow_negative_numbers = true)]
    pub readout_time: Option<f64>,
    /// Blank time between two frames in rows; -1 where it is not known.
    #[arg(long, value_name = "ROWS", allow_negative_numbers = true)]
    pub inter_frame_delay: Option<f64>,
    /// Edge of the frame, as it is stored, that is read first.
    #[arg(long, value_name = "DIRECTION", value_enum)]
    pub readout_direction: Option<Direction>,
    /// Camera whose readout is expected where none is given: a name that `rsrectify cameras` lists; `auto`, the readout that
    /// the file states, else that of the camera which it names; `none`. What the picture shows overrules it.
    #[arg(long, value_name = "NAME", default_value = "auto")]
    pub camera: CameraChoice,
    /// What is expected of the readout, once it is known.
    #[arg(skip)]
    pub expected: Option<ReadoutPrior>,
    /// Whether the frames were moved after their readout, as by stabilisation in the camera: such frames are rectified only as
    /// far as the changes of their lean show it. Found from the picture where it is not given.
    #[arg(long, value_enum)]
    pub stabilised: Option<Stabilised>,
    /// How finely frames are analysed: `fast` takes half to two thirds of the time that `balanced`, the default, takes.
    #[arg(long, value_enum)]
    pub effort: Option<Effort>,
    /// How the motion is estimated.
    #[arg(long, value_enum)]
    pub estimator: Option<Estimator>,
    /// What motion the picture can have.
    #[arg(long, value_enum)]
    pub model: Option<Model>,
    /// Focal length in frame widths, if known.
    #[arg(long, value_name = "WIDTHS", value_parser = widths)]
    pub focal_length: Option<f64>,
    /// Frames looked ahead: 8 for strong shake.
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(0..=i64::from(MAX_LOOKAHEAD)))]
    pub lookahead: Option<u32>,
    /// Columns of the grid of correspondences.
    #[arg(long, value_name = "N")]
    pub grid_columns: Option<u32>,
    /// Rows of the grid of correspondences.
    #[arg(long, value_name = "N")]
    pub grid_rows: Option<u32>,
}

/// What may be known of a camera whose readout is to be found.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Analysis")]
pub struct MeasureSettings {
    /// Edge of the frame, as it is stored, that is read first.
    #[arg(long, value_name = "DIRECTION", value_enum)]
    pub readout_direction: Option<Direction>,
    /// Focal length in frame widths, if known.
    #[arg(long, value_name = "WIDTHS", value_parser = widths)]
    pub focal_length: Option<f64>,
    /// Frames looked ahead: 8 for strong shake.
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(0..=i64::from(MAX_LOOKAHEAD)))]
    pub lookahead: Option<u32>,
}

impl MeasureSettings {
    /// The library's settings.
    pub fn settings(&self) -> Settings {
        let Self { readout_direction, focal_length, lookahead } = *self;
        AnalysisOptions { readout_direction, focal_length, lookahead, ..AnalysisOptions::default() }
            .settings()
    }
}

/// How steady the picture is to be, and how much of it is cut away.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Rectifier")]
pub struct SteadinessOptions {
    /// Per cent of the width and height that are cut away, so that no border is seen: 0 to 50, or `auto`, the least that does
    /// it, for which the clip is analysed beforehand. `auto` is the default with --border-mode crop and with --stabilize.
    #[arg(long, value_name = "auto|PERCENT")]
    pub crop: Option<Crop>,
    /// Steadies the picture: standard deviation in seconds of the smoothing of the camera's path, 0.5 without a number. As many
    /// frames are looked ahead as that takes.
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, default_missing_value = "0.5", value_parser = deviation)]
    pub stabilize: Option<f64>,
}

/// Properties of the element; those not given keep its defaults.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Rectifier")]
pub struct RectifierOptions {
    #[command(flatten)]
    pub analysis: AnalysisOptions,
    /// Share of the readout whose instant is shown: 0 first read, 1 last read.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub reference_row: Option<f64>,
    /// How samples between pixels are made.
    #[arg(long, value_parser = ["nearest", "linear", "cubic", "lanczos"])]
    pub interpolation: Option<String>,
    /// What is shown where the frame saw nothing.
    #[arg(long, value_name = "MODE", value_parser = ["replicate", "mirror", "constant", "crop"])]
    pub border_mode: Option<String>,
    #[command(flatten)]
    pub steadiness: SteadinessOptions,
    /// How much of the correction is applied, 0 to 1.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub strength: Option<f64>,
    /// Threads of the rectifier; 0 for one a core.
    #[arg(long, value_name = "N")]
    pub threads: Option<u32>,
}

/// How much of the picture is cut away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Crop {
    /// As little as hides the borders.
    Auto,
    /// So many per cent.
    PerCent(f64),
}

impl FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" { Ok(Self::Auto) } else { in_range(text, 0.0..=50.0).map(Self::PerCent) }
    }
}

fn deviation(text: &str) -> Result<f64, String> {
    let hint = |error| format!("{error}; without seconds, --stabilize stands behind the clips");
    in_range(text, 0.0..=10.0).map_err(hint)
}

fn milliseconds(text: &str) -> Result<f64, String> {
    // As `measure` prints it where the last row is read first.
    if text.parse().is_ok_and(|value: f64| value < 0.0) {
        return Err("give its amount, and the edge that is read first by --readout-direction".to_owned());
    }
    in_range(text, 0.0..=1e3)
}

fn share(text: &str) -> Result<f64, String> {
    in_range(text, 0.0..=1.0)
}

fn widths(text: &str) -> Result<f64, String> {
    in_range(text, 0.0..=1e3)
}

/// A number that is given, if it lies in the range.
pub fn in_range(text: &str, range: std::ops::RangeInclusive<f64>) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if range.contains(&value) {
        Ok(value)
    } else {
        Err(format!("not between {} and {}", range.start(), range.end()))
    }
}

impl AnalysisOptions {
    /// Whether the readout is to be found before the first frame is rectified.
    pub fn wants_readout(&self) -> bool {
        self.readout_time.is_none() && self.leaves_readout_open()
    }

    /// Whether the rectifier itself is to find the readout, frame by frame.
    pub fn leaves_readout_open(&self) -> bool {
        self.settings().readout_time == ReadoutTime::Unknown && self.estimator != Some(Estimator::Sequential)
    }

    /// The library's settings, as the element derives them from its properties.
    pub fn settings(&self) -> Settings {
        let mut settings = Settings::default();
        settings.readout_time = match (self.readout_time, self.inter_frame_delay) {
            (Some(time), _) if time > 0.0 => ReadoutTime::Seconds(time * 1e-3),
            (_, Some(rows)) if rows >= 0.0 => ReadoutTime::DelayRows(rows),
            _ => ReadoutTime::Unknown,
        };
        settings.direction = self.readout_direction.and_then(Into::into);
        settings.readout_prior = self.expected;
        settings.stabilised = self.stabilised.and_then(Into::into);
        settings.effort = self.effort.map(Into::into).unwrap_or_default();
        settings.model = self.model.map(Into::into).unwrap_or_default();
        settings.focal_length = self.focal_length.filter(|widths| *widths > 0.0);
        if self.estimator == Some(Estimator::Sequential) {
            settings.estimator = rectifier::Estimator::Sequential;
        }
        let number = |value: Option<u32>, default| value.map_or(default, |value| value as usize);
        settings.lookahead = number(self.lookahead, settings.lookahead);
        settings.grid_columns = number(self.grid_columns, settings.grid_columns);
        settings.grid_rows = number(self.grid_rows, settings.grid_rows);
        settings
    }
}

impl RectifierOptions {
    /// Seconds over which the picture is steadied; 0: not at all.
    pub fn stabilization(&self) -> f64 {
        self.steadiness.stabilize.unwrap_or(0.0)
    }

    /// Whether borders are cut away.
    pub fn is_cropped(&self) -> bool {
        match &self.border_mode {
            Some(mode) => mode == "crop",
            None => self.steadiness.crop.is_some() || self.stabilization() > 0.0,
        }
    }

    /// How much is cut away; `None` where nothing is.
    pub fn crop(&self) -> Option<Crop> {
        self.is_cropped().then(|| self.steadiness.crop.unwrap_or(Crop::Auto))
    }

    /// By how much the picture is enlarged, once it is known how much is cut away.
    pub fn zoom(&self) -> f64 {
        match self.crop() {
            Some(Crop::PerCent(crop)) => 1.0 / (1.0 - crop / 100.0),
            _ => 1.0,
        }
    }

    /// Sets the properties that were given.
    pub fn apply(&self, rectifier: &gst::Element) -> Result<()> {
        let analysis = &self.analysis;
        let nanoseconds = |seconds: f64| ((seconds * 1e9).round() as u64).to_string();
        let expected = analysis.expected;
        let direction = expected.and_then(|expected| expected.direction()).map(Direction::from);
        let crop = match self.crop() {
            Some(Crop::PerCent(crop)) => Some(crop),
            _ => None,
        };
        let given = [
            ("readout-time", analysis.readout_time.map(|ms| nanoseconds(ms * 1e-3))),
            ("expected-readout-time", expected.map(|expected| nanoseconds(expected.time()))),
            ("expected-readout-deviation", expected.map(|expected| nanoseconds(expected.deviation()))),
            ("expected-readout-direction", direction.as_ref().map(name_of)),
            ("inter-frame-delay", analysis.inter_frame_delay.map(|v| v.to_string())),
            ("readout-direction", analysis.readout_direction.as_ref().map(name_of)),
            ("stabilised", analysis.stabilised.as_ref().map(name_of)),
            ("estimator", analysis.estimator.as_ref().map(name_of)),
            ("effort", analysis.effort.as_ref().map(name_of)),
            ("model", analysis.model.as_ref().map(name_of)),
            ("focal-length", analysis.focal_length.map(|v| v.to_string())),
            ("lookahead", analysis.lookahead.map(|v| v.to_string())),
            ("grid-columns", analysis.grid_columns.map(|v| v.to_string())),
            ("grid-rows", analysis.grid_rows.map(|v| v.to_string())),
            ("reference-row", self.reference_row.map(|v| v.to_string())),
            ("interpolation", self.interpolation.clone()),
            (
                "border-mode",
                self.is_cropped().then(|| "crop".to_owned()).or_else(|| self.border_mode.clone()),
            ),
            ("crop", crop.map(|crop| crop.to_string())),
            ("stabilization", self.steadiness.stabilize.map(|v| v.to_string())),
            ("strength", self.strength.map(|v| v.to_string())),
            ("threads", self.threads.map(|v| v.to_string())),
        ];
        for (name, value) in given {
            let Some(value) = value else { continue };
            let spec = rectifier.find_property(name).with_context(|| format!("rsrectify has no {name}"))?;
            let value = gst::glib::Value::deserialize_with_pspec(&value, &spec)
                .map_err(|_| anyhow!("{value} is not a value of --{name}"))?;
            rectifier.set_property_from_value(name, &value);
        }
        Ok(())
    }
}
