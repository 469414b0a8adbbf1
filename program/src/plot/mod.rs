// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify plot`: the motion of a clip as a figure.

mod figure;
pub mod panels;
pub mod series;

use crate::analysis::{Analysis, Frame};
use crate::clips;
use crate::drawing::Renderer;
use crate::input::{Clip, InputOptions};
use crate::interruption::Interruption;
use crate::output;
use crate::progress;
use crate::readout;
use crate::rectifier_options::AnalysisOptions;
use anyhow::{Context, Result, bail};
use clap::Args;
use series::Series;
use std::path::{Path, PathBuf};

/// What ends the names of figures that are written beside their clips.
const ENDING: &str = "-motion.svg";
/// What is seen of the readout is how it is found.
const READOUT_TIME: &str =
    "Readout time of the sensor in milliseconds, if known; without it the figure shows how it is found";
/// Pixels of a PNG file to one of the SVG.
const PNG_SCALE: f32 = 2.0;

/// What the user may ask of `plot`.
#[derive(Args, Debug)]
#[command(mut_arg("readout_time", |argument| argument.help(READOUT_TIME)))]
pub struct PlotOptions {
    /// The clip: a file, numbered images such as frames/%06d.png or their folder, or - for the standard input.
    pub clip: PathBuf,
    #[command(flatten)]
    pub input: InputOptions,
    /// The file to write, .svg or .png, or its folder; without it the figure goes beside the clip, its name ending in
    /// -motion.svg.
    #[arg(long, short, value_name = "FILE|FOLDER")]
    pub output: Option<PathBuf>,
    /// Replaces a file that is there.
    #[arg(long)]
    pub overwrite: bool,
    #[command(flatten)]
    pub analysis: AnalysisOptions,
}

/// What kind of file a figure is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Svg,
    Png,
}

impl Kind {
    /// The kind that a file's name asks for.
    fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "svg" => Some(Self::Svg),
            "png" => Some(Self::Png),
            _ => None,
        }
    }
}

/// Draws the figure of the clip; `false` where that fails for its sake.
pub fn run(options: &PlotOptions, interruption: &Interruption) -> Result<bool> {
    let clip = Clip::named(&options.clip, &options.input, interruption)?;
    let file = output::of_one(&clip, options.output.as_deref(), ENDING)?;
    let kind = Kind::of(&file).context("--output must end in .svg or .png")?;
    clips::finish(&clip, plot(options, &clip, &file, kind, interruption), interruption)
}

fn plot(
    options: &PlotOptions,
    clip: &Clip,
    file: &Path,
    kind: Kind,
    interruption: &Interruption,
) -> Result<()> {
    let unfinished = output::begin(clip, file, options.output.as_deref(), options.overwrite)?;
    let mut analysis = Analysis::open(clip, options.analysis.settings(), interruption)?;
    if options.analysis.wants_readout() {
        let camera = options.analysis.camera.of(clip.path())?;
        readout::expect(&mut analysis, camera.as_ref())?;
    }
    let bar = progress::spinner()?;
    let (mut series, mut frames) = (Series::default(), 0u64);
    analysis.run(None, interruption, &mut |frame: Frame| {
        series.add(frame.time, &frame.solution);
        frames += 1;
        bar.set_message(format!("{frames} frames"));
        bar.tick();
        Ok(())
    })?;
    bar.finish_and_clear();
    let points = series.points(analysis.period());
    if points.is_empty() {
        bail!("there are too few frames to plot");
    }
    let svg = figure::draw(&clip.name(), &points)?;
    let content = match kind {
        Kind::Svg => svg.into_bytes(),
        Kind::Png => Renderer::new().png(&svg, PNG_SCALE)?,
    };
    std::fs::write(unfinished.path(), content).with_context(|| format!("cannot write {}", file.display()))?;
    unfinished.finish(file)?;
    println!("{}: {frames} frames", file.display());
    analysis.check_whole()
}
