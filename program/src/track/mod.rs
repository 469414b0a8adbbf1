// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify track`: the motion of a clip, for other programs.

mod gcsv;
mod motion;
mod table;
mod velocity;

use crate::analysis::{Analysis, Frame};
use crate::clips;
use crate::input::{Clip, InputOptions};
use crate::interruption::Interruption;
use crate::output;
use crate::progress;
use crate::readout::{self, Extent, Found};
use crate::rectifier_options::{AnalysisOptions, RectifierOptions, SteadinessOptions};
use crate::steady;
use anyhow::{Context, Result, bail};
use clap::Args;
use rsrectify::rectifier::Origin;
use serde::Serialize;
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use table::{FRAME_HEADER, FrameRow, LINE_HEADER, LineRow};

/// A focal length found with a standard deviation of more than this share of itself is not used: it scales the turns
/// about both axes across the view.
const FOCAL_SURE: f64 = 0.1;

const ADVICE: &str = "give --focal-length in frame widths: 0.5 / tan(half the field of view across)";

/// What the user may ask of `track`.
#[derive(Args, Debug)]
pub struct TrackOptions {
    /// The clip: a file, numbered images such as frames/%06d.png or their folder, or - for the standard input.
    pub clip: PathBuf,
    #[command(flatten)]
    pub input: InputOptions,
    /// Writes a line of CSV for each frame; this on the standard output is what is done without any of these options.
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Writes a line of CSV for each row of each frame, of each column where the readout runs sideways.
    #[arg(long, value_name = "FILE")]
    pub rows_csv: Option<PathBuf>,
    /// Writes frames, and in them their rows, as JSON: an array of one frame a line.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Writes the turns of the camera as a gyroscope would have measured them, in Gyroflow's format.
    #[arg(long, value_name = "FILE")]
    pub gcsv: Option<PathBuf>,
    /// Writes the motion of all frames for `rsrectify fix --motion` and for filters in editors.
    #[arg(long, value_name = "FILE")]
    pub motion: Option<PathBuf>,
    /// Replaces files that are there.
    #[arg(long)]
    pub overwrite: bool,
    #[command(flatten)]
    pub steadiness: SteadinessOptions,
    #[command(flatten)]
    pub analysis: AnalysisOptions,
}

/// A frame with its rows, as JSON.
#[derive(Serialize)]
struct JsonFrame<'a> {
    #[serde(flatten)]
    frame: &'a FrameRow,
    rows: Vec<LineRow>,
}

/// A file that is written; removed where it is not finished.
struct Output {
    path: PathBuf,
    file: BufWriter<File>,
    is_finished: bool,
}

impl Output {
    fn create(path: &Path, overwrite: bool) -> Result<Self> {
        let mut options = File::options();
        options.write(true);
        let opened =
            if overwrite { options.create(true).truncate(true) } else { options.create_new(true) }.open(path);
        let file = opened.with_context(|| {
            let advice = if path.exists() { ": it is there already; --overwrite replaces it" } else { "" };
            format!("cannot write {}{advice}", path.display())
        })?;
        Ok(Self { path: path.to_owned(), file: BufWriter::new(file), is_finished: false })
    }

    fn finish(mut self) -> Result<()> {
        self.file.flush().with_context(|| format!("cannot write {}", self.path.display()))?;
        self.is_finished = true;
        println!("{}", self.path.display());
        Ok(())
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

impl Seek for Output {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.file.seek(to)
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if !self.is_finished {
            // Half a file would pass for a short clip.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Analyses the clip; `false` where that fails for its sake.
pub fn run(options: &TrackOptions, interruption: &Interruption) -> Result<bool> {
    let clip = Clip::named(&options.clip, &options.input, interruption)?;
    clips::finish(&clip, track(options, &clip, interruption), interruption)
}

fn track(options: &TrackOptions, clip: &Clip, interruption: &Interruption) -> Result<()> {
    clip.begin()?;
    let TrackOptions { csv, rows_csv, json, gcsv, motion, .. } = options;
    let tables = [csv, rows_csv, json, gcsv];
    if motion.is_none() && (options.steadiness.stabilize.is_some() || options.steadiness.crop.is_some()) {
        bail!(
            "--stabilize and --crop are for --motion: the tables hold the motion of the camera without them"
        );
    }
    for file in tables.into_iter().chain([motion]).flatten() {
        output::check(clip.path(), file, options.overwrite)?;
        output::check_writable(file)?;
    }
    let mut analysis = options.analysis.clone();
    let wants_focal = options.gcsv.is_some() && analysis.focal_length.is_none();
    let mut found = None;
    if clip.is_pipe() {
        // It is read once: the readout is found on the way.
        if wants_focal {
            bail!(
                "--gcsv takes the focal length, which cannot be looked for on the standard input; {ADVICE}"
            );
        }
    } else if analysis.wants_readout() || wants_focal {
        let camera = analysis.camera.of(clip.path())?;
        let settings = analysis.settings();
        found = readout::find(clip, settings, camera.as_ref(), Extent::Stretches, interruption)?;
    }
    if !clip.is_pipe() {
        readout::settle(found.as_ref(), &mut analysis);
    }
    if let Some(path) = motion {
        let mut rectifier = RectifierOptions {
            analysis: analysis.clone(),
            steadiness: options.steadiness.clone(),
            ..Default::default()
        };
        let analysis = &mut rectifier.analysis;
        if !options.analysis.wants_readout() && analysis.leaves_readout_open() {
            analysis.expected = readout::expected(clip, analysis, interruption)?;
        }
        if options.analysis.lookahead.is_none() {
            steady::set_lookahead(clip, &mut rectifier, interruption)?;
        }
        if let Some(crop) = steady::set_crop(clip, &mut rectifier, None, interruption)? {
            eprintln!("{crop}");
        }
        let output = Output::create(path, options.overwrite)?;
        let (file, frames) = motion::write(clip, &rectifier, output, interruption)?;
        file.finish()?;
        eprintln!("{frames} frames");
        if tables.into_iter().all(Option::is_none) {
            return Ok(());
        }
    }
    let mut focal = analysis.focal_length.filter(|focal| *focal > 0.0);
    if wants_focal {
        let widths = found_focal_length(found.as_ref())?;
        eprintln!("focal length: {widths:.3} frame widths");
        analysis.focal_length = Some(widths);
        focal = Some(widths);
    }
    write(options, clip, &analysis, focal, interruption)
}

/// The focal length that was found, if it can be relied on.
fn found_focal_length(found: Option<&Found>) -> Result<f64> {
    match found.and_then(|found| found.focal_length) {
        Some(focal) if focal.deviation <= FOCAL_SURE * focal.widths => Ok(focal.widths),
        Some(focal) => bail!(
            "--gcsv takes the focal length, which is not certain from this clip ({:.2} ± {:.2} frame widths); {ADVICE}",
            focal.widths,
            focal.deviation
        ),
        None => bail!("--gcsv takes the focal length, which could not be estimated from this clip; {ADVICE}"),
    }
}

fn write(
    options: &TrackOptions,
    clip: &Clip,
    analysis: &AnalysisOptions,
    focal: Option<f64>,
    interruption: &Interruption,
) -> Result<()> {
    let create = |path: &Option<PathBuf>| {
        path.as_deref().map(|path| Output::create(path, options.overwrite)).transpose()
    };
    let mut analysis = Analysis::open(clip, analysis.settings(), interruption)?;
    let (mut csv, mut rows_csv) = (create(&options.csv)?, create(&options.rows_csv)?);
    let (mut json, mut gcsv) = (create(&options.json)?, create(&options.gcsv)?);
    let is_silent = csv.is_some() || rows_csv.is_some() || json.is_some() || gcsv.is_some();
    let mut printed = (!is_silent).then(|| std::io::stdout().lock());
    if let Some(out) = &mut printed {
        writeln!(out, "{FRAME_HEADER}")?;
    }
    if let Some(out) = &mut csv {
        writeln!(out.file, "{FRAME_HEADER}")?;
    }
    if let Some(out) = &mut rows_csv {
        writeln!(out.file, "{LINE_HEADER}")?;
    }
    let bar = progress::spinner()?;
    let name = clip.name();
    let (mut index, mut without_motion) = (0, 0u64);
    analysis.run(None, interruption, &mut |frame: Frame| {
        let row = FrameRow::new(index, &frame);
        if let Some(out) = &mut printed {
            row.write(out)?;
        }
        if let Some(out) = &mut csv {
            row.write(&mut out.file)?;
        }
        if let Some(out) = &mut rows_csv {
            LineRow::of(&frame).try_for_each(|line| line.write(index, &mut out.file))?;
        }
        if let Some(out) = &mut json {
            out.file.write_all(if index == 0 { b"[\n" } else { b",\n" })?;
            let rows = LineRow::of(&frame).collect();
            serde_json::to_writer(&mut out.file, &JsonFrame { frame: &row, rows })?;
        }
        if let Some((out, focal)) = gcsv.as_mut().zip(focal) {
            if index == 0 {
                let direction = frame.solution.motion.readout().direction();
                gcsv::write_header(&mut out.file, &name, row.readout_ms, direction)?;
            }
            gcsv::write_frame(&mut out.file, &frame, focal)?;
        }
        without_motion += u64::from(frame.solution.origin == Origin::Untouched);
        index += 1;
        bar.set_message(format!("{index} frames"));
        bar.tick();
        Ok(())
    })?;
    bar.finish_and_clear();
    if index == 0 {
        analysis.check_whole()?;
        bail!("no frame could be decoded");
    }
    if without_motion > 0 {
        log::warn!("no motion was found in {without_motion} of {index} frames; they count as still");
    }
    if let Some(out) = &mut json {
        writeln!(out.file, "\n]")?;
    }
    [csv, rows_csv, json, gcsv].into_iter().flatten().try_for_each(Output::finish)?;
    analysis.check_whole()
}
