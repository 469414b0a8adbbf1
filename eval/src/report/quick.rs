// SPDX-License-Identifier: MIT OR Apache-2.0

//! A few minutes' check that nothing has become worse, in every kind of scene, against recorded figures.
//!
//! A figure is the displacement left in pixels (RMS) in one scene. Its noise is what
//! another processor's kernels may change, and is recorded with it.

use super::progress::Progress;
use super::results::Results;
use super::runner::{self, Task};
use super::tables::Table;
use crate::systems::registry::{self, Entry};
use anyhow::{Context, Result, bail};
use baselines::correspondences::Source;
use render::footage::Footage;
use render::sequence::{self, Settings};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Each kind of scene and of motion once.
const SEQUENCES: [&str; 16] = [
    "rot1_B40",
    "trans_rot1_B40",
    "shake_g042",
    "control_global",
    "vibration",
    "foreground",
    "low_texture",
    "selfie",
    "driving",
    "thin",
    "tracking",
    "crowd",
    "water",
    "blinds",
    "caption",
    "zoom",
];
const RECORDED_SYSTEMS: [&str; 2] = ["rsrectify-4", "rsrectify-4-unknown"];
const SEED: u64 = 1;
const FRAMES: usize = 60;
/// As small as the kinds of scene can still be told.
const SIZE: [usize; 2] = [320, 240];
/// Pixels, and share of the figure, by which figures may differ between processors whose kernels round differently: a
/// readout that is sought may settle a frame earlier or later.
const LEAST_NOISE: [f64; 2] = [0.01, 0.2];

/// The recorded figures.
const RECORDED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/recorded.json");

/// A figure and how far it may be off by chance, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Figure {
    left: f64,
    noise: f64,
}

/// Figures by sequence and system.
type Figures = BTreeMap<String, Figure>;

/// Runs the library on what `footage` makes of a few short sequences and compares with the recorded figures, or records.
///
/// # Errors
/// Where a figure is worse than recorded by more than its noise, with a table of all of them.
pub fn run(record: bool, footage: &dyn Fn(&Settings) -> Result<Footage>) -> Result<()> {
    let figures = measure(footage)?;
    if record {
        fs::write(RECORDED, serde_json::to_string_pretty(&figures)? + "\n")?;
        return Ok(());
    }
    let text = fs::read(Path::new(RECORDED)).context("nothing is recorded: run `quick --record`")?;
    let (table, worse) = compare(&figures, &serde_json::from_slice(&text)?);
    print!("{table}");
    if worse.is_empty() { Ok(()) } else { bail!("worse than recorded: {}", worse.join(", ")) }
}

fn measure(footage: &dyn Fn(&Settings) -> Result<Footage>) -> Result<Figures> {
    let entries: Vec<Entry> =
        registry::all().into_iter().filter(|entry| RECORDED_SYSTEMS.contains(&entry.id.as_str())).collect();
    let mut tasks = Vec::new();
    for name in SEQUENCES {
        let settings = sequence::named(name)?;
        tasks.push(Task {
            settings: Settings {
                seed: SEED,
                frames: FRAMES,
                width: SIZE[0],
                height: SIZE[1],
                ..settings.clone()
            },
            sources: vec![Source::Sampler],
            pictures: false,
        });
    }
    let mut progress = Progress::new(tasks.len());
    Ok(figures(&runner::run(&tasks, &entries, footage, &mut progress)?))
}

fn figures(results: &Results) -> Figures {
    let figures = results.trials.iter().map(|trial| {
        let left = trial.left.rms;
        let noise = LEAST_NOISE[0].max(LEAST_NOISE[1] * left);
        (format!("{} {}", trial.sequence, trial.method), Figure { left, noise })
    });
    figures.collect()
}

/// A table of all figures, and the names of those that are worse or missing.
fn compare(now: &Figures, recorded: &Figures) -> (String, Vec<String>) {
    let titles = ["figure", "recorded px left", "noise", "now", ""];
    let mut table = Table::new(titles.map(String::from));
    let mut worse = Vec::new();
    for (key, before) in recorded {
        let found = now.get(key);
        let verdict = match found {
            Some(found) if found.left <= before.left - before.noise => "better: record it",
            Some(found) if found.left <= before.left + before.noise => "",
            Some(_) => "**worse**",
            None => "**missing**",
        };
        if verdict.starts_with("**") {
            worse.push(key.clone());
        }
        let px = |value: f64| Some(format!("{value:.3}"));
        let now = found.and_then(|found| px(found.left));
        table.row(key, vec![px(before.left), px(before.noise), now, Some(verdict.into())]);
    }
    (table.markdown(), worse)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worse_by_more_than_the_noise_fails() {
        let of = |left: [f64; 3]| -> Figures {
            let keys = ["a", "b", "c"].map(String::from);
            keys.into_iter().zip(left.map(|left| Figure { left, noise: 0.1 })).collect()
        };
        let recorded = of([1.0, 1.0, 1.0]);
        assert_eq!(compare(&of([1.09, 0.8, 1.0]), &recorded).1, Vec::<String>::new());
        let (table, worse) = compare(&of([1.11, 1.0, 1.0]), &recorded);
        assert_eq!(worse, ["a"]);
        assert!(table.contains("| a | 1.000 | 0.100 | 1.110 | **worse** |"), "{table}");
        assert_eq!(compare(&Figures::new(), &recorded).1.len(), 3);
    }
}
