// SPDX-License-Identifier: MIT OR Apache-2.0

//! What a run of the evaluation found.

use super::pictures::Likeness;
use anyhow::{Context, Result};
use baselines::correspondences::Source;
use render::stats::Stats;
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;

/// All that was found.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Results {
    /// The sequences in the order in which they were run.
    pub sequences: Vec<SequenceInfo>,
    /// One for each sequence, scene, source of correspondences and system.
    pub trials: Vec<Trial>,
}

/// What tables say of a sequence.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SequenceInfo {
    /// Its name.
    pub name: String,
    /// Readout ratio γ of what is visible, in periods of the captures.
    pub readout_ratio: f64,
    /// Number of frames.
    pub frames: usize,
}

/// What one system made of one sequence.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Trial {
    /// Name of the sequence.
    pub sequence: String,
    /// The seed of path, textures and noise.
    pub seed: u64,
    /// Where the correspondences came from.
    pub source: Source,
    /// The system's [`id`](crate::systems::registry::Entry::id).
    pub method: String,
    /// The displacement left over all frames.
    pub left: Stats,
    /// The displacement of the sequence as it arrives.
    pub uncorrected: Stats,
    /// The frames, one by one.
    pub frames: Vec<FrameResult>,
    /// The distance of the readout that it found from the true one, in frame periods
    /// ([`readout::error`](crate::metrics::readout::error)), where it was not told.
    pub readout_error: Option<f64>,
}

/// What a system made of one frame.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct FrameResult {
    /// Displacement left, RMS in pixels.
    pub left: f64,
    /// Likeness of the picture to the truth, where it was judged.
    pub likeness: Option<Likeness>,
}

impl Trial {
    /// The displacement left as a share of the uncorrected one; `None` where nothing was displaced.
    pub fn share(&self) -> Option<f64> {
        self.left.share_of(&self.uncorrected)
    }

    /// The mean of a measure of likeness over the frames that were judged.
    pub fn mean(&self, measure: impl Fn(&Likeness) -> f64) -> Option<f64> {
        let judged = self.frames.iter().filter_map(|frame| frame.likeness.as_ref().map(&measure));
        Spread::of(judged).map(|spread| spread.mean)
    }
}

impl Results {
    /// The trials of a system on a sequence, one for each scene.
    pub fn of<'a>(
        &'a self,
        sequence: &'a str,
        source: Source,
        method: &'a str,
    ) -> impl Iterator<Item = &'a Trial> + 'a {
        self.trials.iter().filter(move |trial| {
            trial.sequence == sequence && trial.source == source && trial.method == method
        })
    }

    /// Whether nothing of the sequence is displaced, so that doing nothing is right.
    pub fn is_control(&self, sequence: &str) -> bool {
        let mut trials = self.trials.iter().filter(|trial| trial.sequence == sequence).peekable();
        trials.peek().is_some() && trials.all(|trial| trial.share().is_none())
    }

    /// Reads what [`write`](Self::write) wrote.
    ///
    /// # Errors
    /// Where the file cannot be read or is of another version.
    pub fn read(path: &Path) -> Result<Self> {
        let text = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        Ok(serde_json::from_slice(&text)?)
    }

    /// Writes a JSON file, and the folder it lies in.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        path.parent().map_or(Ok(()), fs::create_dir_all)?;
        fs::write(path, serde_json::to_vec(self)?).with_context(|| format!("cannot write {}", path.display()))
    }
}

/// Mean, lowest and highest of a set of figures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The mean.
    pub mean: f64,
    /// The lowest.
    pub lowest: f64,
    /// The highest.
    pub highest: f64,
}

impl Spread {
    /// Of these figures; `None` for none.
    pub fn of(figures: impl IntoIterator<Item = f64>) -> Option<Self> {
        let figures: Vec<f64> = figures.into_iter().collect();
        let lowest = figures.iter().copied().reduce(f64::min)?;
        let highest = figures.iter().copied().reduce(f64::max)?;
        Some(Self { mean: figures.iter().sum::<f64>() / figures.len() as f64, lowest, highest })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trial(sequence: &str, seed: u64, left: f64, uncorrected: f64) -> Trial {
        let stats = |rms| Stats { rms, p95: 2.0 * rms, count: 1 };
        Trial {
            sequence: sequence.into(),
            seed,
            source: Source::Sampler,
            method: "m".into(),
            left: stats(left),
            uncorrected: stats(uncorrected),
            frames: vec![FrameResult { left, likeness: None }],
            readout_error: None,
        }
    }

    #[test]
    fn trials_are_found_again_after_a_round_through_a_file() {
        let trials = vec![trial("a", 1, 2.0, 8.0), trial("a", 2, 4.0, 8.0), trial("still", 1, 0.1, 0.0)];
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deeper/results.json");
        Results { trials, ..Results::default() }.write(&path).unwrap();
        let results = Results::read(&path).unwrap();
        let shares = results.of("a", Source::Sampler, "m").filter_map(Trial::share);
        assert_eq!(Spread::of(shares), Some(Spread { mean: 0.375, lowest: 0.25, highest: 0.5 }));
        assert_eq!(results.of("a", Source::Exact, "m").count(), 0);
        assert!(results.is_control("still") && !results.is_control("a") && !results.is_control("none"));
    }
}
