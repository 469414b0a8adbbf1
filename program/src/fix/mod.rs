//! `rsrectify fix`: clips → rectified clips.

mod comparison;
mod options;
mod pipeline;
mod plan;

use crate::clips;
use crate::damage::{self, Complaints};
use crate::interruption::Interruption;
use crate::messages::{self, RESULT};
use crate::motions::Motions;
use crate::output::codec::Container;
use crate::output::{self, Unfinished};
use crate::part;
use crate::playback::{Event, Playback, UndecodableAudio};
use crate::progress;
use crate::readout::{self, Extent};
use crate::steady;
use crate::streams::{Audio, Excerpt, Remux};
use crate::summary::{Source, Summary, Tally};
use anyhow::{Context, Result, anyhow, bail};
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
    let jobs = plan::jobs(options)?;
    if options.json && options.dry_run {
        println!("{}", serde_json::to_string_pretty(&plan::Listing::of(&jobs)?)?);
        return Ok(true);
    }
    if options.json {
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
        let [clip, output] = [&job.input, &job.output].map(|path| path.display().to_string());
        Self { clip, output, summary: None, warnings: Vec::new(), error: None }
    }
}

/// Rectifies a clip.
fn one(job: &Job, options: &FixOptions, report: &mut Report, interruption: &Interruption) -> Result<()> {
    let started = Instant::now();
    clips::check(&job.input)?;
    output::check(&job.input, &job.output, options.overwrite)?;
    let mut recipe = job.recipe.clone();
    recipe.codec.check(recipe.container, recipe.rate)?;
    if options.dry_run {
        let (codec, container) = (recipe.codec, recipe.container);
        let (input, output) = (job.input.display(), job.output.display());
        log::info!(target: RESULT, "{input} -> {output}: {codec} in {container}");
        return Ok(());
    }
    if let Some(folder) = job.output.parent() {
        // `--output` may name a folder that is not there yet.
        if options.output.is_some() && job.is_in_folder {
            std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        }
    }
    output::check_writable(Unfinished::beside(&job.output).path())?;
    if let Some(other) = recipe.motions.as_ref().and_then(|motions| motions.other_clip(&job.input)) {
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
    } else if analysis.wants_readout() {
        let camera = analysis.camera.of(&job.input)?;
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
        readout::report_stabilisation(&job.input, &analysis.camera)?;
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
    let (complaints, tally) = (Complaints::listen(), Tally::default());
    let start = |recipe: &Recipe| {
        progress.times().clear();
        let rectification =
            Rectification::new(recipe, excerpt.clone(), &job.input, &job.output, &progress, &tally)?;
        let played = play(&rectification.remux, recipe.container, &progress, interruption);
        played.map(|()| rectification)
    };
    let rectification = match start(&recipe) {
        Err(error) if error.is::<UndecodableAudio>() && recipe.audio != Audio::None => {
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
    let file = rectification.finish(interruption)?;
    output::verify(file.path(), &progress.times(), interruption)
        .context("the file is not as it should be")?;
    file.finish(&job.output)?;
    if let Some(error) = unsearched {
        log::warn!("{}: the readout was not sought beforehand: {error:#}", job.input.display());
    }
    let zoom = recipe.rectifier.zoom();
    let summary = Summary::new(&tally, &source, frames, started.elapsed(), zoom);
    log::info!(target: RESULT, "{}: {summary}", job.output.display());
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

/// Runs the pipeline to its end.
fn play(remux: &Remux, container: Container, progress: &Progress, interruption: &Interruption) -> Result<()> {
    let bar = progress::spinner()?;
    let mut playback = Playback::new(remux.pipeline.clone())?;
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
