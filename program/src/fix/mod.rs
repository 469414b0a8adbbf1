//! `rsrectify fix`: clips → rectified clips.

mod options;
mod pipeline;
mod plan;

use crate::clips;
use crate::damage::{self, Complaints};
use crate::interruption::Interruption;
use crate::motions::Motions;
use crate::output::codec::Container;
use crate::output::{self, Unfinished};
use crate::packets::Packets;
use crate::part;
use crate::playback::{Event, Playback, UndecodableAudio};
use crate::progress;
use crate::readout::{self, Extent};
use crate::steady;
use crate::streams::{Audio, Excerpt, Remux};
use anyhow::{Context, Result, anyhow, bail};
use gst::prelude::*;
use indicatif::{ProgressBar, ProgressStyle};
pub use options::FixOptions;
use pipeline::Recipe;
use pipeline::{Progress, Rectification};
use plan::Job;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Rectifies all clips; whether all could be.
pub fn run(options: &FixOptions, interruption: &Interruption) -> Result<bool> {
    let jobs = plan::jobs(options)?;
    if options.json {
        println!("{}", serde_json::to_string_pretty(&plan::Listing::of(&jobs)?)?);
        return Ok(true);
    }
    let count = jobs.len();
    let mut failed = Vec::new();
    for job in jobs {
        interruption.check()?;
        if let Err(error) = one(&job, options, interruption) {
            interruption.check()?;
            eprintln!("error: {}: {error:#}", job.input.display());
            failed.push(job.input);
        }
    }
    if count > 1 {
        let done = if options.dry_run { "would be rectified" } else { "rectified" };
        println!("{} of {count} clips {done}", count - failed.len());
        failed.iter().for_each(|clip| println!("failed: {}", clip.display()));
    }
    Ok(failed.is_empty())
}

/// Rectifies a clip.
fn one(job: &Job, options: &FixOptions, interruption: &Interruption) -> Result<()> {
    clips::check(&job.input)?;
    output::check(&job.input, &job.output, options.overwrite)?;
    let mut recipe = job.recipe.clone();
    recipe.codec.check(recipe.container, recipe.rate)?;
    if options.dry_run {
        let (codec, container) = (recipe.codec, recipe.container);
        println!("{} -> {}: {codec} in {container}", job.input.display(), job.output.display());
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
        eprintln!("warning: {other}");
    }
    let has_motion = recipe.motions.is_some();
    let asked_lookahead = recipe.rectifier.analysis.lookahead;
    let analysis = &mut recipe.rectifier.analysis;
    // What cannot be analysed may still be played; if not, playing it says why.
    let mut unsearched = None;
    if has_motion {
        // Nothing is analysed.
    } else if analysis.wants_readout() {
        let camera = analysis.camera.of(&job.input)?;
        let settings = analysis.settings();
        match readout::find(&job.input, settings, camera.as_ref(), Extent::Stretches, interruption) {
            Ok(Some(found)) => {
                println!("readout: {found}");
                found.apply(analysis);
            }
            Ok(None) => unsearched = Some(anyhow!("no frame could be analysed")),
            Err(error) => unsearched = Some(error),
        }
    } else if analysis.leaves_readout_open() {
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
        println!("{crop}");
    }
    let excerpt = part.map(|part| Arc::new(Excerpt::new(part)));
    let is_part = excerpt.is_some();
    let expected = excerpt.as_ref().map(|excerpt| excerpt.frames().len());
    let complaints = Complaints::listen();
    let start = |recipe: &Recipe| {
        progress.times().clear();
        let rectification = Rectification::new(recipe, excerpt.clone(), &job.input, &job.output, &progress)?;
        let played = play(&rectification.remux, recipe.container, &progress, interruption);
        played.map(|()| rectification)
    };
    let rectification = match start(&recipe) {
        Err(error) if error.is::<UndecodableAudio>() && recipe.audio != Audio::None => {
            eprintln!("warning: {}: {error:#}; it is left out", job.input.display());
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
        eprintln!("warning: {}: the readout was not sought beforehand: {error:#}", job.input.display());
    }
    println!("{}: {frames} frames", job.output.display());
    if let Some(uncovered) = uncovered {
        eprintln!("warning: {uncovered}");
    }
    let moved = rectification.moved_frames();
    if moved > 0 {
        let clip = job.input.display();
        eprintln!(
            "warning: {clip}: the times of frames contradict their order: {moved} are shown a little later"
        );
    }
    report_damage(&job.input, frames, is_part, complaints.first(), interruption)
}

/// An error where a clip lacks something of what it should have, and so its rectified twin; a warning where frames are there, but
/// their decoder complained.
fn report_damage(
    clip: &Path,
    frames: usize,
    is_part: bool,
    complaint: Option<String>,
    interruption: &Interruption,
) -> Result<()> {
    if let Some(missing) = damage::missing_bytes(clip) {
        bail!("the file was cut short, {missing} bytes are missing: what there is of it was rectified");
    }
    let Some(complaint) = complaint else { return Ok(()) };
    let stored = if is_part { frames } else { Packets::count_shown(clip, interruption).unwrap_or(frames) };
    if let Some(lost) = stored.checked_sub(frames).filter(|lost| *lost > 0) {
        bail!(
            "is damaged: {lost} of {stored} frames cannot be decoded ({complaint}); the others were rectified"
        );
    }
    eprintln!("warning: {}: is damaged, some pictures may be wrong ({complaint})", clip.display());
    Ok(())
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
            Event::Warning(warning) => bar.suspend(|| eprintln!("warning: {warning}")),
            Event::Chapters if container != Container::Mkv => {
                bar.suspend(|| {
                    eprintln!("warning: chapters are left out: {container} files cannot hold them here")
                });
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
