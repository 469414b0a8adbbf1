// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify fix`: clips → rectified clips. What it prints at the end, and as `--json`, is the `Summary` of `crate::summary`.

mod comparison;
mod options;
mod pipeline;
mod plan;

use crate::damage::{self, Complaints};
use crate::interruption::Interruption;
use crate::messages::{self, RESULT};
use crate::motions::Motions;
use crate::output::container::Container;
use crate::output::{self, Target, Unfinished, choice};
use crate::part;
use crate::picture::Picture;
use crate::playback::{Event, Playback, UndecodableAudio};
use crate::progress;
use crate::readout::{self, Extent};
use crate::steady;
use crate::streams::{Audio, Excerpt, Remux};
use crate::summary::{Source, Summary, Tally};
use anyhow::{Result, anyhow, bail};
use gst::prelude::*;
use indicatif::{ProgressBar, ProgressStyle};
pub use options::FixOptions;
use pipeline::Recipe;
use pipeline::{Progress, Rectification};
use plan::Job;
use serde::Serialize;
use std::sync::Arc;
use std::time::Instant;

/// Rectifies all clips; whether all could be.
pub fn run(options: &FixOptions, interruption: &Interruption) -> Result<bool> {
    if let Some(file) = &options.log {
        messages::add_to(file)?;
    }
    let jobs = plan::jobs(options, interruption)?;
    if options.json && options.dry_run {
        println!("{}", serde_json::to_string_pretty(&plan::Listing::of(&jobs, interruption)?)?);
        return Ok(true);
    }
    let is_output_taken = jobs.iter().any(|job| job.output == Target::Pipe);
    if options.json && is_output_taken {
        bail!("the standard output is taken by the video: --json has no place there");
    }
    if options.json || is_output_taken {
        messages::leave_standard_output();
    }
    let count = jobs.len();
    let mut failed = Vec::new();
    for job in jobs {
        interruption.check()?;
        let mut report = Report::of(&job);
        if let Err(error) = one(&job, options, &mut report, interruption) {
            interruption.check()?;
            log::error!("{}: {error:#}", job.input.display());
            report.error = Some(format!("{error:#}"));
            failed.push(job.input);
        }
        report.warnings = messages::take_warnings();
        if options.json {
            progress::print(format!("{}\n", serde_json::to_string(&report)?).as_bytes())?;
        }
    }
    if count > 1 {
        let done = if options.dry_run { "would be rectified" } else { "rectified" };
        log::info!(target: RESULT, "{} of {count} clips {done}", count - failed.len());
        failed.iter().for_each(|clip| log::info!(target: RESULT, "failed: {}", clip.display()));
    }
    Ok(failed.is_empty())
}

/// What became of a clip, as it is printed for programs.
#[derive(Debug, Serialize)]
struct Report {
    clip: String,
    output: String,
    /// Where a file was written.
    #[serde(flatten)]
    summary: Option<Summary>,
    warnings: Vec<String>,
    /// Why the clip counts as failed; of one that is damaged there may be a file all the same.
    error: Option<String>,
}

impl Report {
    fn of(job: &Job) -> Self {
        let (clip, output) = (job.input.display().to_string(), job.output.to_string());
        Self { clip, output, summary: None, warnings: Vec::new(), error: None }
    }
}

/// Rectifies a clip.
fn one(job: &Job, options: &FixOptions, report: &mut Report, interruption: &Interruption) -> Result<()> {
    let started = Instant::now();
    job.input.begin()?;
    job.output.check(&job.input, options.overwrite)?;
    let mut recipe = job.recipe.clone();
    recipe.encoding.check(recipe.container)?;
    if options.dry_run {
        let (input, output, codec) = (job.input.display(), &job.output, job.codec()?);
        log::info!(target: RESULT, "{input} -> {output}: {codec} in {}", recipe.container);
        return Ok(());
    }
    let picture = Picture::of(&job.input)?;
    let choice::Chosen { encoding, notes } = choice::choose(&recipe.encoding, &picture, recipe.container)?;
    // `--output` may name a folder that is not there yet.
    let _made = job.output.make_folder(job.is_in_folder)?;
    if let Some(file) = job.output.as_file() {
        output::check_writable(Unfinished::beside(file).path())?;
    }
    notes.iter().for_each(|note| log::info!(target: RESULT, "{note}"));
    if let Some(other) = recipe.motions.as_ref().and_then(|motions| motions.other_clip(job.input.path())) {
        log::warn!("{other}");
    }
    let has_motion = recipe.motions.is_some();
    let asked_lookahead = recipe.rectifier.analysis.lookahead;
    let analysis = &mut recipe.rectifier.analysis;
    // What cannot be analysed may still be played; if not, playing it says why.
    let mut unsearched = None;
    let mut source = Source::Given;
    if has_motion {
        // Nothing is analysed.
        source = Source::MotionFile;
    } else if job.input.is_pipe() {
        // It is read once, so that the readout is found on the way.
        if analysis.leaves_readout_open() {
            source = Source::Sought(None);
            log::info!(target: RESULT, "readout: sought while the clip is rectified, as the standard input is read once");
        }
        analysis.expected = readout::expected(&job.input, analysis, interruption)?;
    } else if analysis.wants_readout() {
        let camera = analysis.camera.of(job.input.path())?;
        let settings = analysis.settings();
        source = Source::Sought(None);
        match readout::find(&job.input, settings, camera.as_ref(), Extent::Stretches, interruption) {
            Ok(Some(found)) => {
                log::info!(target: RESULT, "readout: {found}");
                found.apply(analysis);
                source = Source::Sought(Some(Box::new(found)));
            }
            Ok(None) => unsearched = Some(anyhow!("no frame could be analysed")),
            Err(error) => unsearched = Some(error),
        }
    } else if analysis.leaves_readout_open() {
        source = Source::Sought(None);
        match readout::expected(&job.input, analysis, interruption) {
            Ok(expected) => analysis.expected = expected,
            Err(error) => unsearched = Some(error),
        }
    } else {
        readout::report_stabilisation(job.input.path(), &analysis.camera)?;
    }
    interruption.check()?;
    let progress = Arc::new(Progress::default());
    if !has_motion && asked_lookahead.is_none() {
        steady::set_lookahead(&job.input, &mut recipe.rectifier, interruption)?;
    }
    let lookahead = recipe.rectifier.analysis.settings().lookahead;
    let part = options.part.of(&job.input, lookahead, interruption)?;
    let crop = match &recipe.motions {
        Some(motions) => motions.set_crop(&mut recipe.rectifier)?,
        None => steady::set_crop(&job.input, &mut recipe.rectifier, part.as_ref(), interruption)?,
    };
    if let Some(crop) = crop {
        log::info!(target: RESULT, "{crop}");
    }
    let excerpt = part.map(|part| Arc::new(Excerpt::new(part)));
    let is_part = excerpt.is_some();
    let expected = excerpt.as_ref().map(|excerpt| excerpt.frames().len());
    // What was read from one, or written to it, is gone.
    let has_pipe = job.input.is_pipe() || job.output == Target::Pipe;
    let (complaints, tally) = (Complaints::listen(), Tally::default());
    let start = |recipe: &Recipe| {
        progress.times().clear();
        let rectification = Rectification::new(
            recipe,
            &encoding,
            excerpt.clone(),
            &job.input,
            &job.output,
            &progress,
            &tally,
        )?;
        let played = play(&rectification.remux, recipe.container, has_pipe, &progress, interruption);
        played.map(|()| rectification)
    };
    let rectification = match start(&recipe) {
        Err(error) if error.is::<UndecodableAudio>() && recipe.audio != Audio::None && !has_pipe => {
            log::warn!("{}: {error:#}; it is left out", job.input.display());
            recipe.audio = Audio::None;
            start(&recipe)?
        }
        started => started?,
    };
    let frames = progress.frames();
    if frames == 0 {
        bail!("no frame could be decoded");
    }
    if let Some(expected) = expected {
        part::check_count(frames, expected)?;
    }
    let uncovered = recipe.motions.as_ref().map_or(Ok(None), Motions::check)?;
    let notes = rectification.finish(&progress.times(), interruption)?;
    notes.iter().for_each(|note| log::warn!("{note}"));
    if let Some(error) = unsearched {
        log::warn!("{}: the readout was not sought beforehand: {error:#}", job.input.display());
    }
    let zoom = recipe.rectifier.zoom();
    let summary = Summary::new(&tally, &source, frames, started.elapsed(), zoom);
    log::info!(target: RESULT, "{}: {summary}", job.output);
    report.summary = Some(summary);
    if let Some(uncovered) = uncovered {
        log::warn!("{uncovered}");
    }
    let moved = rectification.moved_frames();
    if moved > 0 {
        let clip = job.input.display();
        log::warn!("{clip}: the times of frames contradict their order: {moved} are shown a little later");
    }
    damage::report(&job.input, frames, is_part, complaints.first(), interruption)
}

/// Runs the pipeline to its end; `waits` for as long as it takes, where a pipe is read or written.
fn play(
    remux: &Remux,
    container: Container,
    waits: bool,
    progress: &Progress,
    interruption: &Interruption,
) -> Result<()> {
    let bar = progress::spinner()?;
    let mut playback = Playback::new(remux.pipeline.clone())?;
    if waits {
        playback.wait_for_ever();
    }
    playback.set_state(gst::State::Playing);
    let started = Instant::now();
    loop {
        show(&bar, playback.pipeline(), progress, started)?;
        match playback.next(gst::ClockTime::from_mseconds(100), interruption)? {
            Event::End => break,
            Event::Held => remux.release()?,
            Event::Warning(warning) => bar.suspend(|| log::warn!("{warning}")),
            Event::Chapters if container != Container::Mkv => {
                bar.suspend(|| log::warn!("chapters are left out: {container} files cannot hold them here"));
            }
            Event::Chapters | Event::Ready | Event::Nothing => {}
        }
    }
    bar.finish_and_clear();
    Ok(())
}

fn show(bar: &ProgressBar, pipeline: &gst::Pipeline, progress: &Progress, started: Instant) -> Result<()> {
    if bar.length().is_none()
        && let Some(encoder) = pipeline.by_name("encoder")
        && let Some(input) = encoder.static_pad("sink")
        && let Some(duration) = input.peer_query_duration::<gst::ClockTime>()
    {
        bar.set_length(duration.mseconds());
        bar.set_style(ProgressStyle::with_template("{wide_bar} {percent:>3} % {msg}, {eta} left")?);
    }
    bar.set_position(progress.milliseconds());
    let frames = progress.frames();
    let rate = frames as f64 / started.elapsed().as_secs_f64().max(1e-3);
    bar.set_message(format!("{frames} frames, {rate:.0} frames/s"));
    Ok(())
}
