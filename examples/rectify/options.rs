//! What the user may ask for.

use anyhow::{Context, Result, anyhow};
use clap::{Args, Parser, ValueEnum};
use gst::prelude::*;
use std::path::PathBuf;

/// Takes rolling-shutter distortion out of a video file.
#[derive(Parser)]
pub struct Options {
    /// Any video file that GStreamer can decode.
    pub input: PathBuf,
    /// The MP4 file to write.
    pub output: PathBuf,
    /// Shows the clip before and after, side by side.
    #[arg(long)]
    pub compare: bool,
    /// Replaces OUTPUT if it is there.
    #[arg(long)]
    pub overwrite: bool,
    /// Constant quality of the H.264 encoder: 0 is lossless, 18 hard to tell from it, 51 worst.
    #[arg(long, default_value_t = 18, value_parser = clap::value_parser!(u32).range(0..=50))]
    pub quality: u32,
    /// Bit rate in kbit/s instead of a constant quality.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=2_048_000))]
    pub bitrate: Option<u32>,
    /// What becomes of the audio. What MP4 cannot hold is encoded even if it is to be copied.
    #[arg(long, value_enum, default_value_t = Audio::Copy)]
    pub audio: Audio,
    #[command(flatten)]
    pub rectifier: RectifierOptions,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
pub enum Audio {
    Copy,
    Aac,
    None,
}

/// Properties of the element; those not given keep its defaults.
#[derive(Args)]
#[command(next_help_heading = "Rectifier")]
pub struct RectifierOptions {
    /// Readout time of the sensor in milliseconds, if known. Without it some stretches of the file are
    /// analysed first to find it; 0 leaves that to the rectifier while it runs.
    #[arg(long, value_name = "MS", value_parser = milliseconds)]
    pub readout_time: Option<f64>,
    /// Blank time between two frames in rows; -1 where it is not known.
    #[arg(long, value_name = "ROWS", allow_negative_numbers = true)]
    pub inter_frame_delay: Option<f64>,
    /// Edge of the frame, as it is stored, that is read first.
    #[arg(long, value_name = "DIRECTION",
          value_parser = ["auto", "top-to-bottom", "bottom-to-top", "left-to-right", "right-to-left"])]
    pub readout_direction: Option<String>,
    /// How the motion is estimated.
    #[arg(long, value_parser = ["auto", "sequential", "continuous"])]
    pub estimator: Option<String>,
    /// What motion the picture can have.
    #[arg(long, value_parser = ["auto", "translation", "rotation", "similarity", "affine", "homography", "rotation-3d"])]
    pub model: Option<String>,
    /// Focal length in frame widths, if known.
    #[arg(long, value_name = "WIDTHS")]
    pub focal_length: Option<f64>,
    /// Frames looked ahead: 8 for strong shake.
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(0..=64))]
    pub lookahead: Option<u32>,
    /// Columns of the grid of correspondences.
    #[arg(long, value_name = "N")]
    pub grid_columns: Option<u32>,
    /// Rows of the grid of correspondences.
    #[arg(long, value_name = "N")]
    pub grid_rows: Option<u32>,
    /// Share of the readout whose instant is shown: 0 first read, 1 last read.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub reference_row: Option<f64>,
    /// How samples between pixels are made.
    #[arg(long, value_parser = ["nearest", "linear", "cubic", "lanczos"])]
    pub interpolation: Option<String>,
    /// What is shown where the frame saw nothing.
    #[arg(long, value_name = "MODE", value_parser = ["replicate", "mirror", "constant", "crop"])]
    pub border_mode: Option<String>,
    /// How much of the correction is applied, 0 to 1.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub strength: Option<f64>,
    /// Threads of the rectifier; 0 for one a core.
    #[arg(long, value_name = "N")]
    pub threads: Option<u32>,
}

fn milliseconds(text: &str) -> Result<f64, String> {
    in_range(text, 0.0..=1e3)
}

fn share(text: &str) -> Result<f64, String> {
    in_range(text, 0.0..=1.0)
}

fn in_range(text: &str, range: std::ops::RangeInclusive<f64>) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if range.contains(&value) {
        Ok(value)
    } else {
        Err(format!("not between {} and {}", range.start(), range.end()))
    }
}

impl RectifierOptions {
    /// Whether the readout is to be found before the first frame is rectified.
    pub fn wants_readout(&self) -> bool {
        let has_delay = self.inter_frame_delay.is_some_and(|rows| rows >= 0.0);
        self.readout_time.is_none() && !has_delay && self.estimator.as_deref() != Some("sequential")
    }

    /// Sets the properties that were given.
    pub fn apply(&self, rectifier: &gst::Element) -> Result<()> {
        let nanoseconds = self.readout_time.map(|ms| (ms * 1e6).round() as u64);
        let given = [
            ("readout-time", nanoseconds.map(|v| v.to_string())),
            ("inter-frame-delay", self.inter_frame_delay.map(|v| v.to_string())),
            ("readout-direction", self.readout_direction.clone()),
            ("estimator", self.estimator.clone()),
            ("model", self.model.clone()),
            ("focal-length", self.focal_length.map(|v| v.to_string())),
            ("lookahead", self.lookahead.map(|v| v.to_string())),
            ("grid-columns", self.grid_columns.map(|v| v.to_string())),
            ("grid-rows", self.grid_rows.map(|v| v.to_string())),
            ("reference-row", self.reference_row.map(|v| v.to_string())),
            ("interpolation", self.interpolation.clone()),
            ("border-mode", self.border_mode.clone()),
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
