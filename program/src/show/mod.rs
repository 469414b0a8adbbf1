// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify show`: a clip with what was seen of its motion drawn over it, or a page of it for browsers.

mod overlay;
mod page;
mod strip;
mod videos;
mod writer;

use crate::analysis::{Analysis, Frame};
use crate::clips;
use crate::drawing::Renderer;
use crate::input::{Clip, InputOptions};
use crate::interruption::Interruption;
use crate::output::container::Container;
use crate::output::encoding::EncodingOptions;
use crate::output::{self, choice};
use crate::picture::Picture;
use crate::progress;
use crate::readout;
use crate::rectifier_options::AnalysisOptions;
use anyhow::{Context, Result, bail};
use clap::Args;
use overlay::Overlay;
use std::path::{Path, PathBuf};
use writer::Writer;

/// What the user may ask of `show`.
#[derive(Args, Debug)]
pub struct ShowOptions {
    /// The clip: a file, numbered images such as frames/%06d.png or their folder, or - for the standard input.
    pub clip: PathBuf,
    #[command(flatten)]
    pub input: InputOptions,
    /// The file to write, or its folder; without it the video goes beside the clip, its name ending in -shown.
    #[arg(long, short, value_name = "FILE|FOLDER")]
    pub output: Option<PathBuf>,
    /// Writes a page for browsers instead, with its videos, into this folder: the clip before and after, and its motion over time.
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["output", "magnify", "codec", "container", "quality", "bitrate"])]
    pub html: Option<PathBuf>,
    /// Replaces a file, or a page, that is there.
    #[arg(long)]
    pub overwrite: bool,
    /// By how much the arrows that show the correction are longer than it is.
    #[arg(long, value_name = "FACTOR", default_value_t = 5.0, value_parser = factor)]
    pub magnify: f64,
    #[command(flatten)]
    pub encoding: EncodingOptions,
    #[command(flatten)]
    pub analysis: AnalysisOptions,
}

fn factor(text: &str) -> Result<f64, String> {
    crate::rectifier_options::in_range(text, 0.1..=1000.0)
}

/// Draws over the clip; `false` where that fails for its sake.
pub fn run(options: &ShowOptions, interruption: &Interruption) -> Result<bool> {
    let clip = Clip::named(&options.clip, &options.input, interruption)?;
    let output = options.output.as_deref();
    if let Some(folder) = &options.html {
        let written = page::write(&clip, folder, options.overwrite, &options.analysis, interruption);
        return clips::finish(&clip, written, interruption);
    }
    let named = output.filter(|output| !output::is_folder(output));
    let container = options.encoding.container(&clip, named)?;
    let is_chosen = named.is_some() || options.encoding.container.is_some();
    let container = if container.is_of_frames_only() && !is_chosen { Container::Mkv } else { container };
    let ending = format!("{}.{}", clips::SHOWN, container.extension());
    let file = output::of_one(&clip, output, &ending)?;
    clips::finish(&clip, show(options, &clip, &file, container, interruption), interruption)
}

fn show(
    options: &ShowOptions,
    clip: &Clip,
    file: &Path,
    container: Container,
    interruption: &Interruption,
) -> Result<()> {
    options.encoding.check(container)?;
    let Some(muxer) = container.muxer() else { bail!("what is shown is written as MP4, MOV or MKV") };
    let unfinished = output::begin(clip, file, options.output.as_deref(), options.overwrite)?;
    let picture = Picture::of(clip)?;
    let chosen = choice::choose(&options.encoding, &picture, container)?;
    let mut told = options.analysis.clone();
    let found = if clip.is_pipe() { None } else { readout::find_first(clip, &mut told, interruption)? };
    let found = found.filter(|found| found.doubt().is_none());
    let mut settings = told.settings();
    settings.keep_correspondences = true;
    let mut analysis = Analysis::open(clip, settings, interruption)?;
    analysis.keep_pictures();
    let period = analysis.period().map(|period| 1e3 * period);
    let found = found.map(|found| found.estimate());
    let overlay = Overlay::new(analysis.size(), options.magnify, found, period);
    let renderer = Renderer::new();

    let mut writer =
        Writer::new(analysis.info(), picture, chosen.encoding.encoder(), muxer, unfinished.path())?;
    let bar = progress::spinner()?;
    let mut frames = 0u64;
    analysis.run(None, interruption, &mut |frame: Frame| {
        let picture = frame.picture.as_ref().context("the picture of a frame is gone")?;
        let svg = overlay.svg(frames, &frame);
        writer.write(picture, |pixels| renderer.draw(&svg, pixels), interruption)?;
        frames += 1;
        bar.set_message(format!("{frames} frames"));
        bar.tick();
        Ok(())
    })?;
    if frames == 0 {
        analysis.check_whole()?;
        bail!("no frame could be decoded");
    }
    writer.finish(interruption)?;
    bar.finish_and_clear();
    unfinished.finish(file)?;
    println!("{}: {frames} frames", file.display());
    analysis.check_whole()
}
