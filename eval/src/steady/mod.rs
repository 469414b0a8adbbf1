// SPDX-License-Identifier: MIT OR Apache-2.0

//! How steady the library makes a picture, beside vid.stab in two passes at its defaults, ffmpeg's deshake, and the two published
//! stabilisers of Liu et al. that are reported to reduce rolling shutter ([`published`]).
//!
//! Of a rendered sequence, and of a clip with a gyroscope, it is known where each frame sees a far point, and of each system where it
//! shows it ([`tracks`]). Of other clips, outputs are judged alike from their pictures: successive frames are followed and the
//! motion between them fitted. Either way the jitter is the root mean square second difference of places, and the wobble what
//! rows are displaced by beside the motion of the picture. The library is given the crop that vid.stab took, so that both
//! keep the same share of the picture; so are the published stabilisers, which show borders where that is not enough.
//!
//! The displacement from the truth does not measure the rolling shutter that a stabiliser leaves, because a stabiliser also moves the whole
//! frame. For rendered sequences the *distortion* is measured beside the wobble: the displacement that remains after the
//! rotation and the zoom of the true camera that fit it best ([`placement`]).

mod gyroscope;
mod others;
mod placement;
mod published;
mod tracks;

pub use gyroscope::Gyroscope;
pub use tracks::Steadiness;

use crate::clip::{as_it_is, seen, solve};
use crate::metrics::jitter;
use crate::metrics::resample::{Rectified, rectified};
use crate::systems::product::{self, Delay, carried};
use anyhow::{Context, Result};
use baselines::methods::{Correction, Corrections};
use nalgebra::Vector2;
use others::{Stabilised, deshake, vid_stab};
use placement::Views;
use render::footage::Footage;
use render::media::{self, Clip};
use render::scene::Frame;
use render::stats::Stats;
use render::video;
use rsrectify::motion::{FrameMotion, image_centre};
use rsrectify::readout::{Readout, ReadoutTime};
use rsrectify::rectifier::{Estimator, FrameSolution, Settings};
use std::path::Path;
use tracks::Tracks;

/// The heading of the table: jitter, wobble and distortion of the input in pixels, and what each system leaves of them.
pub const HEADING: &str = "| clip | jitter px | wobble px | zoom | vid.stab: jitter | wobble | zoom without borders \
     | deshake: jitter | wobble | rsrectify: jitter | wobble | zoom without borders | share of vid.stab's jitter | wobble \
     | distortion px | vid.stab | rsrectify \
     | subspace: jitter | wobble | distortion | zoom without borders \
     | content-preserving: jitter | wobble | distortion | zoom without borders |\n\
     |---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|";

/// Frames that are looked ahead: all that the smoothing takes.
const LOOKAHEAD: usize = 200;

/// What is asked of the library.
#[derive(Clone, Copy, Debug)]
pub struct Asked {
    /// Standard deviation of the smoothing in seconds.
    pub deviation: f64,
    /// Standard deviation of the low-pass filters of the published stabilisers in seconds.
    pub published: f64,
    /// Zoom; that of vid.stab where it is not given.
    pub zoom: Option<f64>,
}

/// A clip, its shutter, and the far points in it.
struct Given<'a> {
    name: String,
    clip: &'a Clip,
    /// The true shutter; that which the library finds where there is no truth.
    readout: Option<Readout>,
    /// How the library is to look at it.
    analysis: Settings,
    /// Empty where the places of far points are not known.
    tracks: Tracks,
    /// Empty where the truth is not known, or the camera moves far.
    views: Views,
    /// Focal length in pixels, for a method that is told it.
    focal: f64,
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
    let (mut tracks, mut views) = (Tracks::default(), Views::default());
    for run in footage.runs() {
        let captures: Vec<_> = run.iter().map(|index| (*index, footage.capture(*index))).collect();
        tracks.add(&captures);
        views.add(&captures);
    }
    let given = Given {
        name: settings.name.clone(),
        clip: &clip,
        readout: Some(footage.readout()),
        analysis: product::settings(settings, Delay::Unknown, Estimator::Continuous, LOOKAHEAD),
        tracks,
        views,
        focal: footage.sequence.focal(),
    };
    given.row(asked, out)
}

/// A row of the table for a clip, with the recording of a gyroscope or without.
///
/// # Errors
/// If ffmpeg with vid.stab is missing, or the clip cannot be decoded.
pub fn row_of_clip(
    file: &Path,
    gyroscope: Option<&Gyroscope>,
    asked: Asked,
    out: Option<&Path>,
) -> Result<String> {
    let clip = media::decode(file)?;
    let mut analysis = Settings::default();
    analysis.lookahead = LOOKAHEAD;
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let tracks = gyroscope.map_or_else(|| Ok(Tracks::default()), |gyroscope| gyroscope.tracks(&clip))?;
    // A common value for phones, where it is not known.
    let focal = gyroscope.map_or(clip.width as f64, |gyroscope| gyroscope.focal);
    let views = Views::default();
    Given { name, clip: &clip, readout: None, analysis, tracks, views, focal }.row(asked, out)
}

impl Given<'_> {
    fn row(&self, asked: Asked, out: Option<&Path>) -> Result<String> {
        let clip = self.clip;
        let mut analysis = self.analysis;
        analysis.stabilization = asked.deviation;
        // As `fix` does, which looks for the readout beforehand.
        let search = solve(clip, analysis)?;
        let found = search.last().context("a clip without frames")?;
        let readout = self.readout.unwrap_or(*found.motion.readout());
        let input: Corrections =
            clip.frames.iter().map(|_| Box::new(|pixel| pixel) as Box<dyn Correction>).collect();
        let original =
            self.judged(readout, "measuring the input", &input, &mut clip.frames.iter().map(as_it_is))?;
        let [stabilised, shaken] = [vid_stab(clip)?, deshake(clip)?];
        let [theirs, simple] = [(&stabilised, "measuring vid.stab's"), (&shaken, "measuring deshake's")]
            .map(|(other, message)| self.judged_other(readout, other, message));
        let [theirs, simple] = [theirs?, simple?];
        let zoom = asked.zoom.unwrap_or(stabilised.zoom).max(1.0);
        let shown = self.steadied(analysis, found, zoom)?;
        let pictures = || clip.frames.iter().zip(&shown).map(|(frame, shown)| rectified(frame, &**shown));
        let ours = self.judged(readout, "measuring the output", &shown, &mut pictures())?;
        if let Some(folder) = out {
            std::fs::create_dir_all(folder)?;
            let write = |kind: &str, frames: &mut dyn Iterator<Item = Frame>| {
                let file = folder.join(format!("{}-{kind}.y4m", self.name));
                video::write(&file, [clip.width, clip.height], clip.fps, frames)
            };
            write("rsrectify", &mut pictures().map(|picture| picture.frame))?;
            write("vidstab", &mut stabilised.clip.frames.iter().cloned())?;
            write("original", &mut clip.frames.iter().cloned())?;
        }
        let left = |of: Steadiness| {
            format!("{:.3} | {:.2}", of.jitter / original.jitter, of.wobble / original.wobble)
        };
        let distortion = self.views.distortion(&input);
        let distorted = |shown: &Corrections| {
            let left = self.views.distortion(shown).zip(distortion).map(|(left, all)| left / all);
            left.map_or("–".into(), |left| format!("{left:.2}"))
        };
        let mut published = Vec::new();
        for shown in published::solve(clip, readout, self.focal, asked.published, zoom)? {
            let pictures = clip.frames.iter().zip(&shown).map(|(frame, shown)| rectified(frame, &**shown));
            let steadiness = self.judged(readout, "measuring another's", &shown, &mut { pictures })?;
            let borders = borderless(clip, &shown, zoom);
            published.push(format!("{} | {} | {borders:.3}", left(steadiness), distorted(&shown)));
        }
        Ok(format!(
            "| {} | {:.2} | {:.2} | {zoom:.3} | {} | {:.3} | {} | {} | {:.3} | {:.2} | {:.2} | {} | {} | {} | {} |",
            self.name,
            original.jitter,
            original.wobble,
            left(theirs),
            borderless(clip, &stabilised.shown, stabilised.zoom),
            left(simple),
            left(ours),
            borderless(clip, &shown, zoom),
            ours.jitter / theirs.jitter,
            ours.wobble / theirs.wobble,
            distortion.map_or("–".into(), |distortion| format!("{distortion:.2}")),
            distorted(&stabilised.shown),
            distorted(&shown),
            published.join(" | "),
        ))
    }

    fn judged_other(
        &self,
        readout: Readout,
        other: &Stabilised,
        message: &'static str,
    ) -> Result<Steadiness> {
        self.judged(readout, message, &other.shown, &mut other.clip.frames.iter().map(as_it_is))
    }

    /// From where far points are shown, or from the pictures where that is not known.
    fn judged(
        &self,
        readout: Readout,
        message: &'static str,
        shown: &[Box<dyn Correction>],
        pictures: &mut dyn Iterator<Item = Rectified>,
    ) -> Result<Steadiness> {
        if !self.tracks.is_empty() {
            return Ok(self.tracks.steadiness(shown, &readout));
        }
        let seen = seen(self.clip, readout, message, pictures)?;
        let jitter = jitter::content([self.clip.width, self.clip.height], &seen.motions).rms;
        Ok(Steadiness { jitter, wobble: Stats::of(seen.wobble).rms })
    }

    /// Where the library shows the pixels of each frame, given what its search found at the end.
    fn steadied(&self, mut analysis: Settings, found: &FrameSolution, zoom: f64) -> Result<Corrections> {
        analysis.margin = (1.0 - 1.0 / zoom) / 2.0;
        if found.readout_deviation < 0.1 {
            analysis.readout_time = ReadoutTime::Seconds(found.motion.readout().time());
            analysis.direction = Some(found.motion.readout().direction());
        }
        let solutions = solve(self.clip, analysis)?;
        let shown = solutions.into_iter();
        let shown =
            shown.map(|solution| Box::new(Shown { motion: solution.motion, zoom }) as Box<dyn Correction>);
        Ok(shown.collect())
    }
}

/// The zoom without which some frame's edge would be seen, given where frames are shown at a zoom.
fn borderless(clip: &Clip, shown: &[Box<dyn Correction>], zoom: f64) -> f64 {
    let size = [clip.width, clip.height].map(|length| length as f64 - 1.0);
    let half = Vector2::from(size) / 2.0;
    let along = |at: f64| [[at, -1.0], [at, 1.0], [-1.0, at], [1.0, at]].map(Vector2::from);
    let edges: Vec<_> = (0..=16).flat_map(|index| along(f64::from(index) / 8.0 - 1.0)).collect();
    let outside = |correction: &dyn Correction, at: &Vector2<f64>| {
        let place = (correction.correct(half + at.component_mul(&half)) - half).component_div(&half);
        // Across the edge on which the point lies; a corner lies on two, and the farther one counts.
        let across = [0, 1].into_iter().filter(|axis| at[*axis].abs() == 1.0);
        across.map(|axis| place[axis] * at[axis]).fold(f64::NEG_INFINITY, f64::max)
    };
    let least = shown.iter().flat_map(|shown| edges.iter().map(|at| outside(&**shown, at)));
    zoom / least.fold(f64::INFINITY, f64::min)
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
