// SPDX-License-Identifier: MIT OR Apache-2.0

//! A few minutes' check that nothing has become worse, in every kind of scene, against recorded figures.
//!
//! A figure is the displacement left in pixels (RMS) in one scene. Its noise, which is recorded with it, is how far figures are apart
//! of the same scene with one in 200 bytes of its frames a level darker or brighter: as little as another rounding in a kernel
//! changes, and in scenes where few pairs decide which of two solutions is kept it changes the figure more than any threshold for all would allow.

use super::progress::Progress;
use super::results::Results;
use super::runner::{self, Task};
use super::tables::Table;
use crate::systems::registry::{self, Entry};
use anyhow::{Context, Result, bail};
use baselines::correspondences::Source;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
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
/// Pixels, and share of the figure, that the noise of every figure has at least: a readout that is sought may settle a frame
/// earlier or later.
const LEAST_NOISE: [f64; 2] = [0.01, 0.2];
/// How often a scene is measured when its figure is recorded: as it is, and with other changes to its frames each time.
const REPLICAS: u64 = 5;
/// One byte of so many is changed in a replica.
const CHANGED: u32 = 200;

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
/// Pixels left by sequence and system, of one run.
type Left = BTreeMap<String, f64>;

/// Runs the library on what `footage` makes of a few short sequences and compares with the recorded figures, or records.
///
/// # Errors
/// Where a figure is worse than recorded by more than its noise, with a table of all of them.
pub fn run(record: bool, footage: &dyn Fn(&Settings) -> Result<Footage>) -> Result<()> {
    if record {
        let replicas =
            (0..REPLICAS).map(|replica| measure(&|settings| Ok(changed(footage(settings)?, replica))));
        let replicas: Vec<Left> = replicas.collect::<Result<_>>()?;
        return Ok(fs::write(RECORDED, serde_json::to_string_pretty(&summary(&replicas))? + "\n")?);
    }
    let now = measure(footage)?;
    let text = fs::read(Path::new(RECORDED)).context("nothing is recorded: run `quick --record`")?;
    let (table, worse) = compare(&now, &serde_json::from_slice(&text)?);
    print!("{table}");
    if worse.is_empty() { Ok(()) } else { bail!("worse than recorded: {}", worse.join(", ")) }
}

fn measure(footage: &dyn Fn(&Settings) -> Result<Footage>) -> Result<Left> {
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
    let Results { trials, .. } = runner::run(&tasks, &entries, footage, &mut progress)?;
    Ok(trials.iter().map(|trial| (format!("{} {}", trial.sequence, trial.method), trial.left.rms)).collect())
}

/// The footage of a replica: 0 is as it was, all others have bytes that are one level darker or brighter.
fn changed(mut footage: Footage, replica: u64) -> Footage {
    let mut random = ChaCha8Rng::seed_from_u64(replica);
    let bytes = footage.frames.iter_mut().flat_map(|frame| &mut frame.rgb).filter(|_| replica > 0);
    for byte in bytes {
        if random.random_ratio(1, CHANGED) {
            *byte = if random.random() { byte.saturating_add(1) } else { byte.saturating_sub(1) };
        }
    }
    footage
}

/// Of each figure the median of its replicas, and how far they are apart.
fn summary(replicas: &[Left]) -> Figures {
    let mut all: BTreeMap<&String, Vec<f64>> = BTreeMap::new();
    for (key, left) in replicas.iter().flatten() {
        all.entry(key).or_default().push(*left);
    }
    let summary = all.into_iter().map(|(key, mut values)| {
        values.sort_by(f64::total_cmp);
        let left = values[values.len() / 2];
        let apart = values[values.len() - 1] - values[0];
        let noise = apart.max(LEAST_NOISE[0]).max(LEAST_NOISE[1] * left);
        (key.clone(), Figure { left, noise })
    });
    summary.collect()
}

/// A table of all figures, and the names of those that are worse or missing.
fn compare(now: &Left, recorded: &Figures) -> (String, Vec<String>) {
    let titles = ["figure", "recorded px left", "noise", "now", ""];
    let mut table = Table::new(titles.map(String::from));
    let mut worse = Vec::new();
    for (key, before) in recorded {
        let found = now.get(key);
        let verdict = match found {
            Some(left) if *left <= before.left - before.noise => "better: record it",
            Some(left) if *left <= before.left + before.noise => "",
            Some(_) => "**worse**",
            None => "**missing**",
        };
        if verdict.starts_with("**") {
            worse.push(key.clone());
        }
        let px = |value: f64| Some(format!("{value:.3}"));
        let now = found.and_then(|left| px(*left));
        table.row(key, vec![px(before.left), px(before.noise), now, Some(verdict.into())]);
    }
    (table.markdown(), worse)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worse_by_more_than_the_noise_fails() {
        let keys = || ["a", "b", "c"].map(String::from).into_iter();
        let of = |left: [f64; 3]| -> Left { keys().zip(left).collect() };
        let recorded: Figures = keys().map(|key| (key, Figure { left: 1.0, noise: 0.1 })).collect();
        assert_eq!(compare(&of([1.09, 0.8, 1.0]), &recorded).1, Vec::<String>::new());
        let (table, worse) = compare(&of([1.11, 1.0, 1.0]), &recorded);
        assert_eq!(worse, ["a"]);
        assert!(table.contains("| a | 1.000 | 0.100 | 1.110 | **worse** |"), "{table}");
        assert_eq!(compare(&Left::new(), &recorded).1.len(), 3);
    }

    #[test]
    fn the_noise_is_what_small_changes_do() {
        let of = |left| Left::from([("a".into(), left)]);
        let Figure { left, noise } = summary(&[1.0, 1.1, 0.7].map(of))["a"];
        assert!(left == 1.0 && (noise - 0.4).abs() < 1e-12, "{left} {noise}");
        let Figure { left, noise } = summary(&[1.0, 1.01, 0.99].map(of))["a"];
        assert!(left == 1.0 && noise == 0.2, "{left} {noise}");
    }
}
