// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify join`: rectified parts of a clip → the whole, without encoding them again.

mod parts;

use crate::clips;
use crate::index::FrameIndex;
use crate::input::{self, Clip};
use crate::interruption::Interruption;
use crate::isobmff::EncodedVideo;
use crate::output::container::Container;
use crate::output::{self, Unfinished};
use crate::playback::{Event, Playback};
use crate::progress;
use crate::streams::{Audio, Destination, Remux, Video};
use anyhow::{Context, Result, bail};
use clap::Args;
use parts::Parts;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What the user may ask of `join`.
#[derive(Args, Debug)]
pub struct JoinOptions {
    /// The clip.
    pub clip: PathBuf,
    /// Its rectified parts in their order, as `fix --frames` has written them; together they have all its frames.
    #[arg(required = true, value_name = "PART")]
    pub parts: Vec<PathBuf>,
    /// The file to write.
    #[arg(long, short, value_name = "FILE")]
    pub output: PathBuf,
    /// Replaces a file that is there.
    #[arg(long)]
    pub overwrite: bool,
    /// The kind of file; without it the one that the output's name says.
    #[arg(long, value_enum)]
    pub container: Option<Container>,
    /// What becomes of the audio.
    #[arg(long, value_enum, default_value = "copy")]
    pub audio: Audio,
    /// What `rsrectify index` has written for the clip; without it the clip is read twice.
    #[arg(long, value_name = "FILE")]
    pub index: Option<PathBuf>,
    /// Prints what was joined as JSON.
    #[arg(long)]
    pub json: bool,
}

/// What is printed as JSON.
#[derive(Debug, Serialize)]
struct Report {
    file: String,
    frames: usize,
    /// SHA-256 of the encoded frames in the file's order.
    sha256: String,
    parts: Vec<ReportedPart>,
}

#[derive(Debug, Serialize)]
struct ReportedPart {
    file: String,
    frames: usize,
    sha256: String,
}

/// Joins the parts; `false` where that fails for the clip's sake.
pub fn run(options: &JoinOptions, interruption: &Interruption) -> Result<bool> {
    let container = options.container.or_else(|| Container::of(&options.output));
    let container = container.context("--output must end in .mp4, .mov or .mkv, or --container be given")?;
    if container.is_of_frames_only() {
        bail!("parts are joined as MP4, MOV or MKV");
    }
    clips::finish(&Clip::file(&options.clip), join(options, container, interruption), interruption)
}

fn join(options: &JoinOptions, container: Container, interruption: &Interruption) -> Result<()> {
    input::check_file(&options.clip)?;
    for input in std::iter::once(&options.clip).chain(&options.parts) {
        output::check(input, &options.output, options.overwrite)?;
    }
    let unfinished = Unfinished::beside(&options.output);
    output::check_writable(unfinished.path())?;
    let index = FrameIndex::given_or_of(options.index.as_deref(), &options.clip, interruption)?;
    let parts = Parts::read(&options.parts, index, interruption)?;
    let Some(caps) = container.taken("video_%u", parts.caps()) else {
        let format = parts.caps().structure(0).map_or("unknown", |format| format.name().as_str());
        bail!("{container} files cannot hold the parts' video, {format}");
    };
    let report = Report {
        file: options.output.display().to_string(),
        frames: parts.frames(),
        sha256: parts.sha256().to_owned(),
        parts: parts
            .files()
            .map(|(file, frames, sha256)| ReportedPart {
                file: file.display().to_string(),
                frames,
                sha256: sha256.to_owned(),
            })
            .collect(),
    };
    write(&options.clip, parts, &caps, unfinished.path(), container, options.audio, interruption)?;
    unfinished.finish(&options.output)?;
    if options.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        println!("{}: {} frames", report.file, report.frames);
    }
    Ok(())
}

fn write(
    clip: &Path,
    parts: Parts,
    caps: &gst::Caps,
    output: &Path,
    container: Container,
    audio: Audio,
    interruption: &Interruption,
) -> Result<()> {
    let parts = Arc::new(parts);
    let destination = Destination { output: Some(output), container, audio, excerpt: None };
    let video = match container.is_isobmff() {
        true => Video::Elsewhere,
        false => Video::Replaced(parts::branch(&parts, caps, interruption)?),
    };
    let remux = Remux::new(&Clip::file(clip), destination, |_, _| Ok(video))?;
    let bar = progress::spinner()?;
    let show = || {
        bar.set_message(format!("{} of {} frames joined", parts.joined(), parts.frames()));
        bar.tick();
    };
    let mut playback = Playback::new(remux.pipeline.clone())?;
    playback.set_state(gst::State::Playing);
    loop {
        show();
        match playback.next(gst::ClockTime::from_mseconds(100), interruption)? {
            Event::End => break,
            Event::Warning(warning) => bar.suspend(|| log::warn!("{warning}")),
            Event::Chapters | Event::Held | Event::Ready | Event::Nothing => {}
        }
    }
    if container.is_isobmff() {
        let mut video = EncodedVideo::create(output.with_extension("video"), parts.colour())?;
        parts.collect(&mut video, interruption, &mut || show())?;
        // As `fix` writes parts.
        let is_turned = true;
        remux.write(&video, is_turned, output, interruption)?;
    }
    bar.finish_and_clear();
    if parts.joined() != parts.frames() {
        bail!("{} frames were written where there should be {}", parts.joined(), parts.frames());
    }
    Ok(())
}
