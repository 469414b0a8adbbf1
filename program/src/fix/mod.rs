//! `rsrectify fix`: clips → rectified clips.

mod options;
mod pipeline;
mod plan;
mod steady;

use crate::damage::{self, Complaints};
use crate::input::Clip;
use crate::interruption::Interruption;
use crate::motions::Motions;
use crate::output::container::Container;
use crate::output::{self, Target, Unfinished, choice};
use crate::packets::Packets;
use crate::part;
use crate::picture::Picture;
use crate::playback::{Event, Playback, UndecodableAudio};
use crate::progress;
use crate::readout::{self, Extent};
use crate::streams::{Audio, Excerpt, Remux};
use anyhow::{Result, anyhow, bail};
use gst::prelude::*;
use indicatif::{ProgressBar, ProgressStyle};
pub use options::FixOptions;
use pipeline::Recipe;
use pipeline::{Progress, Rectification};
use plan::Job;
use std::sync::Arc;
use std::time::Instant;

/// Rectifies all clips; whether all could be.
pub fn run(options: &FixOptions, interruption: &Interruption) -> Result<bool> {
    let jobs = plan::jobs(options, interruption)?;
    if options.json {
        println!("{}", serde_json::to_string_pretty(&plan::Listing::of(&jobs, interruption)?)?);
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
    job.input.begin()?;
    job.output.check(&job.input, options.overwrite)?;
    let mut recipe = job.recipe.clone();
    recipe.encoding.check(recipe.container)?;
    // Where the standard output carries the video, nothing else may go there.
    let say = |text: &str| {
        if job.output == Target::Pipe { eprintln!("{text}") } else { println!("{text}") }
    };
    if options.dry_run {
        say(&format!("{} -> {}: {} in {}", job.input.display(), job.output, job.codec()?, recipe.container));
        return Ok(());
    }
    let picture = Picture::of(&job.input)?;
    let choice::Chosen { encoding, notes } = choice::choose(&recipe.encoding, &picture, recipe.container)?;
    // `--output` may name a folder that is not there yet.
    let _made = job.output.make_folder(job.is_in_folder)?;
    if let Some(file) = job.output.as_file() {
        output::check_writable(Unfinished::beside(file).path())?;
    }
    notes.iter().for_each(|note| say(note));
    if let Some(other) = recipe.motions.as_ref().and_then(|motions| motions.other_clip(job.input.path())) {
        eprintln!("warning: {other}");
    }
    let has_motion = recipe.motions.is_some();
    let analysis = &mut recipe.rectifier.analysis;
    // What cannot be analysed may still be played; if not, playing it says why.
    let mut unsearched = None;
    if has_motion {
        // Nothing is analysed.
    } else if job.input.is_pipe() {
        // It is read once, so that the readout is found on the way.
        if analysis.wants_readout() {
            say("readout: sought while the clip is rectified, as the standard input is read once");
        }
        analysis.expected = readout::expected(&job.input, analysis, interruption)?;
    } else if analysis.wants_readout() {
        let camera = analysis.camera.of(job.input.path())?;
        let settings = analysis.settings();
        match readout::find(&job.input, settings, camera.as_ref(), Extent::Stretches, interruption) {
            Ok(Some(found)) => {
                say(&format!("readout: {found}"));
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
        readout::report_stabilisation(job.input.path(), &analysis.camera)?;
    }
    interruption.check()?;
    let progress = Arc::new(Progress::default());
    if !has_motion {
        steady::set_lookahead(&job.input, &mut recipe.rectifier, interruption)?;
    }
    let lookahead = recipe.rectifier.analysis.settings().lookahead;
    let part = options.part.of(&job.input, lookahead, interruption)?;
    if !has_motion
        && let Some(found) = steady::set_crop(&job.input, &mut recipe.rectifier, part.as_ref(), interruption)?
    {
        say(&found);
    }
    let excerpt = part.map(|part| Arc::new(Excerpt::new(part)));
    let is_part = excerpt.is_some();
    let expected = excerpt.as_ref().map(|excerpt| excerpt.frames().len());
    // What was read from one, or written to it, is gone.
    let has_pipe = job.input.is_pipe() || job.output == Target::Pipe;
    let complaints = Complaints::listen();
    let start = |recipe: &Recipe| {
        progress.times().clear();
        let rectification =
            Rectification::new(recipe, &encoding, excerpt.clone(), &job.input, &job.output, &progress)?;
        let played = play(&rectification.remux, recipe.container, has_pipe, &progress, interruption);
        played.map(|()| rectification)
    };
    let rectification = match start(&recipe) {
        Err(error) if error.is::<UndecodableAudio>() && recipe.audio != Audio::None && !has_pipe => {
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
    let notes = rectification.finish(&progress.times(), interruption)?;
    notes.iter().for_each(|note| eprintln!("warning: {note}"));
    if let Some(error) = unsearched {
        eprintln!("warning: {}: the readout was not sought beforehand: {error:#}", job.input.display());
    }
    say(&format!("{}: {frames} frames", job.output));
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
    clip: &Clip,
    frames: usize,
    is_part: bool,
    complaint: Option<String>,
    interruption: &Interruption,
) -> Result<()> {
    if let Some(missing) = damage::missing_bytes(clip.path()) {
        bail!("the file was cut short, {missing} bytes are missing: what there is of it was rectified");
    }
    let Some(complaint) = complaint else { return Ok(()) };
    let stored = if is_part { frames } else { stored_frames(clip, interruption).unwrap_or(frames) };
    if let Some(lost) = stored.checked_sub(frames).filter(|lost| *lost > 0) {
        bail!(
            "is damaged: {lost} of {stored} frames cannot be decoded ({complaint}); the others were rectified"
        );
    }
    eprintln!("warning: {}: is damaged, some pictures may be wrong ({complaint})", clip.display());
    Ok(())
}

/// How many frames a clip has.
fn stored_frames(clip: &Clip, interruption: &Interruption) -> Result<usize> {
    match clip.as_images() {
        Some(images) => images.count(),
        None => Packets::count_shown(clip.only_file("counting frames")?, interruption),
    }
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
