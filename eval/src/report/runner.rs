// SPDX-License-Identifier: MIT OR Apache-2.0

//! Runs systems on sequences, one footage in memory at a time.

use super::pictures::likeness;
use super::progress::Progress;
use super::results::{FrameResult, Results, SequenceInfo, Trial};
use crate::metrics::readout;
use crate::systems::registry::Entry;
use anyhow::{Context, Result};
use baselines::correspondences::{Source, of_run};
use baselines::methods::Corrections;
use rayon::prelude::*;
use render::footage::Footage;
use render::sequence::Settings;
use render::stats::{Stats, distances};
use rsrectify::correspond::Correspondence;
use rsrectify::readout::Readout;

/// A sequence to be run.
pub struct Task {
    /// The sequence, with the seed of its scene.
    pub settings: Settings,
    /// Where the correspondences come from, each in its turn.
    pub sources: Vec<Source>,
    /// Whether the pictures from the first source are judged too, and not their displacement alone.
    pub pictures: bool,
}

/// Runs every system on every task, on what `footage` makes of its settings. Systems that find their own correspondences run once, as from
/// [`Source::Sampler`], which is theirs.
///
/// # Errors
/// Those of the systems, with the name of the sequence.
pub fn run(
    tasks: &[Task],
    entries: &[Entry],
    footage: &dyn Fn(&Settings) -> Result<Footage>,
    progress: &mut Progress,
) -> Result<Results> {
    let mut results = Results::default();
    for task in tasks {
        let name = &task.settings.name;
        progress.at(&format!("{name}, scene {}", task.settings.seed));
        if !results.sequences.iter().any(|info| info.name == *name) {
            results.sequences.push(info(&task.settings));
        }
        let footage = progress.time("rendering", || footage(&task.settings))?;
        for (index, source) in task.sources.iter().enumerate() {
            let pictures = task.pictures && index == 0;
            let found = trials(&footage, *source, pictures, entries, progress);
            results.trials.extend(found.with_context(|| format!("{name}, correspondences {source:?}"))?);
        }
        progress.step();
    }
    Ok(results)
}

fn info(settings: &Settings) -> SequenceInfo {
    SequenceInfo {
        name: settings.name.clone(),
        readout_ratio: settings.delivered_readout_time() * settings.fps,
        frames: settings.frames,
    }
}

fn trials(
    footage: &Footage,
    source: Source,
    pictures: bool,
    entries: &[Entry],
    progress: &mut Progress,
) -> Result<Vec<Trial>> {
    let are_wanted = entries.iter().any(Entry::takes_correspondences);
    let wanted = || footage.runs().into_iter().filter(|_| are_wanted);
    let find = || wanted().map(|run| of_run(footage, &run, source)).collect::<Result<Vec<_>>>();
    let pairs = progress.time("correspondences", find)?;
    let runs = |entry: &&Entry| entry.takes_correspondences() || source == Source::Sampler;
    let solve = |entry| solved(footage, &pairs, entry);
    let solved: Vec<Solved> =
        progress.time("methods", || entries.par_iter().filter(runs).map(solve).collect::<Result<_>>())?;
    let uncorrected = footage.uncorrected();
    let judge = |solved: &Solved| displacement(footage, source, &uncorrected, solved);
    let mut trials: Vec<Trial> = progress.time("displacement", || solved.par_iter().map(judge).collect());
    if pictures {
        progress.time("pictures", || judge_pictures(footage, &solved, &mut trials));
    }
    Ok(trials)
}

/// What a system found.
struct Solved<'a> {
    entry: &'a Entry,
    corrections: Corrections,
    /// The readout that was found, where it was not told.
    readout: Option<Readout>,
}

fn solved<'a>(footage: &Footage, pairs: &[Vec<Vec<Correspondence>>], entry: &'a Entry) -> Result<Solved<'a>> {
    let (corrections, readout) = entry.solve(footage, pairs).with_context(|| entry.id.clone())?;
    Ok(Solved { entry, corrections, readout })
}

fn displacement(footage: &Footage, source: Source, uncorrected: &Stats, solved: &Solved) -> Trial {
    let frames = footage.truth.iter().zip(&solved.corrections);
    let left: Vec<Vec<f64>> = frames
        .map(|(truth, correction)| distances(&truth.samples, |x| correction.correct(x)).collect())
        .collect();
    let frame = |left: &Vec<f64>| FrameResult { left: Stats::of(left.clone()).rms, likeness: None };
    let period = 1.0 / footage.settings().delivered_fps();
    Trial {
        readout_error: solved.readout.map(|found| readout::error(&found, &footage.readout(), period)),
        sequence: footage.settings().name.clone(),
        seed: footage.settings().seed,
        source,
        method: solved.entry.id.clone(),
        uncorrected: *uncorrected,
        frames: left.iter().map(frame).collect(),
        left: Stats::of(left.concat()),
    }
}

/// Frame by frame, so that only a few pictures are in memory.
fn judge_pictures(footage: &Footage, solved: &[Solved], trials: &mut [Trial]) {
    for index in 0..footage.frames.len() {
        trials.par_iter_mut().zip(solved).for_each(|(trial, solved)| {
            let correction = solved.corrections[index].as_ref();
            trial.frames[index].likeness = likeness(footage, index, correction);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::systems::registry;
    use render::sequence::named;

    #[test]
    fn the_uncorrected_trial_is_the_footage_as_it_arrives() {
        let settings = Settings { width: 160, height: 120, frames: 4, ..named("rot1_B0").unwrap() };
        let sources = vec![Source::Sampler, Source::Exact];
        let tasks = [Task { settings, sources, pictures: true }];
        let entries = registry::all();
        let results = run(&tasks, &entries, &Footage::of_settings, &mut Progress::new(1)).unwrap();
        let own = entries.iter().filter(|entry| !entry.takes_correspondences()).count();
        assert_eq!(results.trials.len(), 2 * entries.len() - own);
        let uncorrected = results.of("rot1_B0", Source::Exact, "uncorrected").next().unwrap();
        assert_eq!(uncorrected.share(), Some(1.0));
        assert!(uncorrected.frames.iter().all(|frame| frame.likeness.is_none()), "of the first source only");
        let judged = results.of("rot1_B0", Source::Sampler, "uncorrected").next().unwrap();
        assert!(judged.frames.iter().all(|frame| frame.likeness.is_some_and(|found| found.psnr < 30.0)));
        let squares: f64 = uncorrected.frames.iter().map(|frame| frame.left.powi(2)).sum();
        let mean = (squares / 4.0).sqrt();
        assert!((mean - uncorrected.left.rms).abs() < 0.05 * mean, "frames have nearly equal weight");
    }
}
