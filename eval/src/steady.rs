// SPDX-License-Identifier: MIT OR Apache-2.0

//! How steady the library makes a picture, beside vid.stab in two passes at its defaults.
//!
//! Both outputs are judged alike, from their pictures: successive frames are followed and the motion between them fitted, so that
//! the jitter is the root mean square second difference of the places of a grid of points, and the wobble what rows are displaced
//! by beside that. The library is given the crop that vid.stab took, so that both keep the same share of the picture.

use crate::clip::{as_it_is, seen, solve};
use crate::metrics::jitter;
use crate::metrics::resample::{Rectified, rectified};
use crate::systems::product::{self, Delay, carried};
use anyhow::{Context, Result, ensure};
use baselines::methods::Correction;
use nalgebra::Vector2;
use render::footage::Footage;
use render::media::{self, Clip};
use render::scene::Frame;
use render::stats::Stats;
use render::video;
use rsrectify::motion::{FrameMotion, image_centre};
use rsrectify::readout::{Readout, ReadoutTime};
use rsrectify::rectifier::{Estimator, Settings};
use rsrectify::warp::{WarpSettings, least_zoom};
use std::path::Path;
use std::process::Command;

/// The heading of the table.
pub const HEADING: &str = "| clip | jitter px | wobble px | vid.stab: zoom | jitter left | wobble left \
     | rsrectify, same zoom: jitter left | wobble left | share of vid.stab's jitter | wobble | least zoom |\n\
     |---|---|---|---|---|---|---|---|---|---|---|";

/// Frames that are looked ahead: all that the smoothing takes.
const LOOKAHEAD: usize = 200;

/// What is asked of the library.
#[derive(Clone, Copy, Debug)]
pub struct Asked {
    /// Standard deviation of the smoothing in seconds.
    pub deviation: f64,
    /// Zoom; that of vid.stab where it is not given.
    pub zoom: Option<f64>,
}

/// Jitter and wobble of pictures, RMS in pixels.
#[derive(Clone, Copy, Debug)]
pub struct Steadiness {
    /// Second difference of the places of a grid of points.
    pub jitter: f64,
    /// What rows are displaced by beside the motion of the picture.
    pub wobble: f64,
}

/// A row of the table for a rendered sequence.
///
/// # Errors
/// If ffmpeg with vid.stab is missing.
pub fn row(footage: &Footage, asked: Asked, out: Option<&Path>) -> Result<String> {
    let settings = footage.settings();
    let clip = Clip {
        width: settings.width,
        height: settings.height,
        fps: settings.delivered_fps(),
        frames: footage.frames.clone(),
    };
    let analysis = product::settings(settings, Delay::Unknown, Estimator::Continuous, LOOKAHEAD);
    row_of(&settings.name, &clip, footage.readout(), analysis, asked, out)
}

/// A row of the table for a clip.
///
/// # Errors
/// If ffmpeg with vid.stab is missing, or the clip cannot be decoded.
pub fn row_of_clip(file: &Path, asked: Asked, out: Option<&Path>) -> Result<String> {
    let clip = media::decode(file)?;
    let mut analysis = Settings::default();
    analysis.lookahead = LOOKAHEAD;
    let solutions = solve(&clip, analysis)?;
    let readout = *solutions.last().context("a clip without frames")?.motion.readout();
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    row_of(&name, &clip, readout, analysis, asked, out)
}

fn row_of(
    name: &str,
    clip: &Clip,
    readout: Readout,
    analysis: Settings,
    asked: Asked,
    out: Option<&Path>,
) -> Result<String> {
    let judge = |message, pictures: &mut dyn Iterator<Item = Rectified>| {
        let seen = seen(clip, readout, message, pictures)?;
        let jitter = jitter::content([clip.width, clip.height], &seen.motions).rms;
        anyhow::Ok(Steadiness { jitter, wobble: Stats::of(seen.wobble).rms })
    };
    let original = judge("measuring the input", &mut clip.frames.iter().map(as_it_is))?;
    let (steady, its_zoom) = vid_stab(clip)?;
    let theirs = judge("measuring vid.stab's", &mut steady.frames.iter().map(as_it_is))?;
    let zoom = asked.zoom.unwrap_or(its_zoom).max(1.0);
    let mut analysis = analysis;
    analysis.stabilization = asked.deviation;
    analysis.margin = (1.0 - 1.0 / zoom) / 2.0;
    // As `fix` does, which looks for the readout beforehand.
    let first = solve(clip, analysis)?;
    let found = first.last().context("a clip without frames")?;
    if found.readout_deviation < 0.1 {
        analysis.readout_time = ReadoutTime::Seconds(found.motion.readout().time());
        analysis.direction = Some(found.motion.readout().direction());
    }
    let solutions = solve(clip, analysis)?;
    let warp = WarpSettings::default();
    let least = solutions.iter().map(|solution| least_zoom(&solution.motion, &warp)).fold(1.0, f64::max);
    let shown: Vec<Rectified> = clip
        .frames
        .iter()
        .zip(&solutions)
        .map(|(frame, solution)| rectified(frame, &Shown { motion: solution.motion.clone(), zoom }))
        .collect();
    let ours = judge("measuring the output", &mut shown.iter().cloned())?;
    if let Some(folder) = out {
        std::fs::create_dir_all(folder)?;
        let write = |kind: &str, frames: &mut dyn Iterator<Item = Frame>| {
            video::write(
                &folder.join(format!("{name}-{kind}.y4m")),
                [clip.width, clip.height],
                clip.fps,
                frames,
            )
        };
        write("rsrectify", &mut shown.iter().map(|picture| picture.frame.clone()))?;
        write("vidstab", &mut steady.frames.iter().cloned())?;
        write("original", &mut clip.frames.iter().cloned())?;
    }
    Ok(format!(
        "| {name} | {:.2} | {:.2} | {its_zoom:.3} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {least:.3} |",
        original.jitter,
        original.wobble,
        theirs.jitter / original.jitter,
        theirs.wobble / original.wobble,
        ours.jitter / original.jitter,
        ours.wobble / original.wobble,
        ours.jitter / theirs.jitter,
        ours.wobble / theirs.wobble,
    ))
}

/// Where the output shows a pixel.
struct Shown {
    motion: FrameMotion,
    zoom: f64,
}

impl Correction for Shown {
    fn correct(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        let readout = self.motion.readout();
        let centre = image_centre(readout.width(), readout.height());
        (carried(&self.motion, pixel) - centre) * self.zoom + centre
    }
}

/// What vid.stab makes of a clip in two passes at its defaults, and its zoom.
fn vid_stab(clip: &Clip) -> Result<(Clip, f64)> {
    let folder = tempfile::tempdir()?;
    let [input, output] = ["in.y4m", "out.y4m"].map(|name| folder.path().join(name));
    video::write(&input, [clip.width, clip.height], clip.fps, clip.frames.iter().cloned())?;
    let ffmpeg = |filter: &str, output: &[&str]| -> Result<String> {
        let mut command = Command::new("ffmpeg");
        command
            .current_dir(folder.path())
            .args(["-nostdin", "-y", "-i", "in.y4m", "-vf", filter])
            .args(output);
        let ran = command.output().context("cannot run ffmpeg")?;
        let said = String::from_utf8_lossy(&ran.stderr).into_owned();
        ensure!(ran.status.success(), "ffmpeg: {said}");
        Ok(said)
    };
    ffmpeg("vidstabdetect=result=found.trf", &["-f", "null", "-"])?;
    let said = ffmpeg("vidstabtransform=input=found.trf", &["out.y4m"])?;
    let zoom = said.lines().find_map(|line| line.split_once("Final zoom: ").map(|(_, zoom)| zoom.trim()));
    let zoom: f64 = zoom.context("vid.stab does not tell its zoom")?.parse()?;
    Ok((media::decode(&output)?, 1.0 + zoom / 100.0))
}
