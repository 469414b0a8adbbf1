// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify measure`: what clips say of their cameras.

mod report;

use crate::camera::CameraChoice;
use crate::clips;
use crate::input::{Clip, InputOptions};
use crate::interruption::Interruption;
use crate::part::{self, PartOptions};
use crate::progress;
use crate::readout::{self, Extent};
use crate::rectifier_options::MeasureSettings;
use anyhow::{Context, Result};
use clap::Args;
use report::{Measurement, Together};
use serde::Serialize;
use std::path::PathBuf;

/// What the user may ask of `measure`.
#[derive(Args, Debug)]
pub struct MeasureOptions {
    /// Clips, folders of clips, or patterns such as 'card/*.MP4'; numbered images such as frames/%06d.png, or a folder of them; -
    /// for Y4M or Matroska on the standard input.
    #[arg(required = true, value_name = "CLIP")]
    pub clips: Vec<PathBuf>,
    #[command(flatten)]
    pub input: InputOptions,
    /// Prints JSON; times in milliseconds, focal lengths in frame widths.
    #[arg(long)]
    pub json: bool,
    /// The clips are of one camera in one mode: prints the estimate from all of them, too.
    #[arg(long)]
    pub same_camera: bool,
    /// Analyses up to 20 s of each clip, spread over its length, instead of all of it.
    #[arg(long, conflicts_with = "frames")]
    pub quick: bool,
    /// Camera whose known readout is stated beside the measured one, which it does not change: a name that `rsrectify cameras`
    /// lists; `auto`, the readout that the file states, else that of the camera which it names; `none`.
    #[arg(long, value_name = "NAME", default_value = "auto")]
    pub camera: CameraChoice,
    #[command(flatten)]
    pub part: PartOptions,
    #[command(flatten)]
    pub settings: MeasureSettings,
}

/// A clip that could not be measured.
#[derive(Debug, Serialize)]
struct Failure {
    clip: String,
    error: String,
}

/// What is printed as JSON.
#[derive(Debug, Serialize)]
struct Report {
    clips: Vec<Measurement>,
    failed: Vec<Failure>,
    #[serde(skip_serializing_if = "Option::is_none")]
    same_camera: Option<Together>,
}

/// Measures all clips; whether all could be.
pub fn run(options: &MeasureOptions, interruption: &Interruption) -> Result<bool> {
    let mut report = Report { clips: Vec::new(), failed: Vec::new(), same_camera: None };
    for clips::Named { clip, .. } in clips::expand(&options.clips, false, &options.input, interruption)? {
        match one(&clip, options, interruption) {
            Ok(measurement) => {
                if !options.json {
                    progress::print(format!("{measurement}\n").as_bytes())?;
                }
                report.clips.push(measurement);
            }
            Err(error) => {
                interruption.check()?;
                let (clip, error) = (clip.display().to_string(), format!("{error:#}"));
                log::error!("{clip}: {error}");
                report.failed.push(Failure { clip, error });
            }
        }
    }
    if options.same_camera {
        report.same_camera = Together::new(&report.clips);
    }
    if options.json {
        progress::print(format!("{}\n", serde_json::to_string_pretty(&report)?).as_bytes())?;
    } else if let Some(together) = &report.same_camera {
        progress::print(format!("{together}\n").as_bytes())?;
    }
    Ok(report.failed.is_empty())
}

fn one(clip: &Clip, options: &MeasureOptions, interruption: &Interruption) -> Result<Measurement> {
    clip.begin()?;
    let settings = options.settings.settings();
    let camera = options.camera.of(clip.path())?;
    // What follows is left to the measurement of another part, so that each frame tells once.
    let part = options.part.of(clip, 0, interruption)?;
    let frames = part.as_ref().map(|part| part.frames.clone());
    let extent = match part {
        Some(part) => Extent::Part(part),
        None if options.quick => Extent::Stretches,
        None => Extent::Whole,
    };
    let found = readout::find(clip, settings, None, extent, interruption)?;
    let found = found.context("no frame could be analysed")?;
    if let Some(frames) = &frames {
        part::check_count(found.frames as usize, frames.len())?;
    }
    let first_frame = frames.map_or(0, |frames| frames.start);
    let measurement =
        Measurement::new(clip.display().to_string(), &found).with_camera(camera.as_ref(), &found);
    Ok(if options.quick { measurement } else { measurement.with_cuts(first_frame, &found.cuts) })
}
