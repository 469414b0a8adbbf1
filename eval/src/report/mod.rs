// SPDX-License-Identifier: MIT OR Apache-2.0

//! The report: systems run on sequences, and what people read of it.
//!
//! A run is kept as JSON, so that the document can be written anew, its prose changed, without
//! another run.

pub mod charts;
pub mod document;
pub mod figures;
pub mod pictures;
pub mod progress;
pub mod quick;
pub mod results;
pub mod runner;
pub mod stills;
pub mod tables;
pub mod textures;

use crate::systems::registry::{self, Entry};
use anyhow::{Context, Result};
use baselines::correspondences::Source;
use figures::PAPER;
use pictures::Likeness;
use progress::Progress;
use render::footage::Footage;
use render::sequence::{self, Settings};
use results::{Results, Trial};
use runner::Task;
use std::collections::HashSet;
use std::fs;
use std::path::Path;
use tables::{by_sequence, number, percent};

/// The document, but for its figures.
const TEMPLATE: &str = include_str!("accuracy.md");

/// The file of a run, the folder of runs on photographs, and the table of blind runs.
const RESULTS: &str = "results.json";
const BLIND: &str = "blind.md";
const PHOTOGRAPHS: &str = "photographs";

/// The folder in the workspace in which runs are kept.
const TARGET: &str = "target/eval";

/// Sources of correspondences that are compared, in the order of the table.
const SOURCES: [Source; 3] = [Source::Sampler, Source::Flow, Source::Exact];

/// What a report runs on.
pub struct Options {
    /// How many scenes: seeds 1, 2, and so on.
    pub scenes: u64,
    /// Names of sequences; all without any.
    pub sequences: Vec<String>,
    /// Frames of each sequence, if not its own number.
    pub frames: Option<usize>,
    /// Whether the textures are a user's photographs.
    pub photographs: bool,
    /// Whether an earlier run is written up anew, without another.
    pub redraw: bool,
}

impl Options {
    /// The folder of a run that is not what the docs are about, below that of the one that is.
    fn aside(&self) -> Option<&'static str> {
        let part = !self.sequences.is_empty() || self.frames.is_some();
        if self.photographs { Some(PHOTOGRAPHS) } else { part.then_some("part") }
    }
}

/// Runs all systems on what `footage` makes of all sequences and writes `docs/accuracy.md`; prints where the
/// time went. The run is kept in `target/eval/results.json`, charts and stills in `target/eval/figures/`. Where only
/// a part of the sequences is run, everything goes to `target/eval/part/`; with photographs as textures, to
/// `target/eval/photographs/`, from where the next document takes them for comparison.
///
/// # Errors
/// Where a system fails or a file cannot be written.
pub fn run(options: &Options, footage: &dyn Fn(&Settings) -> Result<Footage>) -> Result<()> {
    let root = root()?;
    let target = root.join(TARGET);
    let own = options.aside().map_or(target.clone(), |folder| target.join(folder));
    let docs = if options.aside().is_some() { own.clone() } else { root.join("docs") };
    let kept = own.join(RESULTS);
    let folder = own.join("figures");
    fs::create_dir_all(&folder)?;
    let entries = registry::all();
    let tasks = tasks(options)?;
    let mut progress = Progress::new(if options.redraw { 0 } else { tasks.len() });
    if !options.redraw {
        runner::run(&tasks, &entries, footage, &mut progress)?.write(&kept)?;
    }
    let results = Results::read(&kept)?;
    let is_whole = options.aside().is_none();
    progress.time("stills", || stills::write_all(&tasks, &entries, footage, &folder, is_whole))?;
    progress.time("charts", || figures::draw_all(&results, &entries, &folder))?;
    let [procedural, photographs] = [RESULTS.into(), Path::new(PHOTOGRAPHS).join(RESULTS)]
        .map(|file| Results::read(&target.join(file)).ok());
    let document = document::fill(TEMPLATE, |name| match name {
        "blind" => {
            Some(fs::read_to_string(target.join(BLIND)).unwrap_or("(There were no blind runs.)\n".into()))
        }
        "textures" => Some(textures::compared(procedural.as_ref(), photographs.as_ref())),
        _ => table(name, &results, &entries),
    })?;
    let path = docs.join("accuracy.md");
    fs::write(&path, document)?;
    println!("{progress}\n{}", path.display());
    Ok(())
}

/// Keeps the table of blind runs for the next document.
///
/// # Errors
/// Where the file cannot be written.
pub fn keep_blind(table: &str) -> Result<()> {
    let folder = root()?.join(TARGET);
    fs::create_dir_all(&folder)?;
    Ok(fs::write(folder.join(BLIND), table)?)
}

/// The workspace's folder.
fn root() -> Result<&'static Path> {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().context("the workspace has no root")
}

fn tasks(options: &Options) -> Result<Vec<Task>> {
    let catalogue: Vec<Settings> = if options.sequences.is_empty() {
        sequence::catalogue()
    } else {
        sequence::chosen(&options.sequences)?
    };
    let task = |settings: &Settings, seed: u64| {
        let frames = options.frames.unwrap_or(settings.frames);
        let paper = PAPER.contains(&settings.name.as_str());
        // One scene tells correspondences apart; flow takes the longest of all.
        let sources = if paper && seed == 1 { SOURCES.to_vec() } else { vec![Source::Sampler] };
        Task { settings: Settings { seed, frames, ..settings.clone() }, sources, pictures: paper }
    };
    let scenes = 1..=options.scenes;
    Ok(catalogue.iter().flat_map(|settings| scenes.clone().map(move |seed| task(settings, seed))).collect())
}

/// The table that the template calls by this name.
fn table(name: &str, results: &Results, entries: &[Entry]) -> Option<String> {
    let every: Vec<&Entry> = entries.iter().collect();
    let (controls, others): (Vec<&str>, Vec<&str>) = results
        .sequences
        .iter()
        .map(|info| info.name.as_str())
        .filter(|name| !PAPER.contains(name))
        .partition(|name| results.is_control(name));
    let likeness = |measure: fn(&Likeness) -> f64, digits| {
        by_sequence(results, &PAPER, &every, &|trial| trial.mean(measure), &number(digits))
    };
    Some(match name {
        "scenes" => scenes(results).to_string(),
        "sequences" => tables::sequences(results),
        "systems" => tables::systems(entries),
        "left: paper" => by_sequence(results, &PAPER, &every, &Trial::share, &percent),
        "left: others" => by_sequence(results, &others, &every, &Trial::share, &percent),
        "p95: paper" => by_sequence(results, &PAPER, &every, &|trial| Some(trial.left.p95), &number(1)),
        "readout" => tables::readouts(results),
        "controls" => by_sequence(results, &controls, &every, &|trial| Some(trial.left.rms), &number(2)),
        "accuracy" => likeness(|found| found.accuracy, 3),
        "psnr" => likeness(|found| found.psnr, 1),
        "ssim" => likeness(|found| found.ssim, 3),
        "correspondences" => tables::by_source(results, &PAPER, &every, &SOURCES),
        _ => return None,
    })
}

/// How many scenes were run.
fn scenes(results: &Results) -> usize {
    results.trials.iter().map(|trial| trial.seed).collect::<HashSet<_>>().len()
}
