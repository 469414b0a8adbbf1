// SPDX-License-Identifier: MIT OR Apache-2.0

//! Runs that are told nothing of the camera, from several frames of a sequence on and with several lookaheads: how often
//! the readout that they end with is wrong, whether they say so, and what they do to a picture.

use crate::metrics::displacement;
use crate::metrics::readout::{error, signed_ratio};
use crate::recorded::{self, Recording};
use crate::systems::product::{self, Delay};
use anyhow::{Context, Result};
use baselines::methods::Corrections;
use rayon::prelude::*;
use render::footage::Footage;
use render::stats;
use rsrectify::readout::Readout;
use rsrectify::rectifier::Estimator;

/// Frames of a run, or more where the sequence is longer.
const FRAMES: usize = 50;
/// Frames of a sequence at which runs start.
const STARTS: [usize; 5] = [0, 2, 5, 8, 12];
const LOOKAHEADS: [usize; 6] = [0, 1, 2, 3, 4, 8];
/// Fewer of both, which say nearly the same in a third of the time.
const FEW_STARTS: [usize; 3] = [0, 5, 12];
const FEW_LOOKAHEADS: [usize; 3] = [0, 2, 4];
/// A signed readout ratio that is off by more, in frame periods, is wrong.
const WRONG: f64 = 0.05;
/// A run that is off by more than so many of the deviations that it states is sure and wrong.
const SURE: f64 = 3.0;
/// A frame whose RMS displacement is above its input's by more pixels is bent.
const HARM: f64 = 0.3;
/// Standard deviations to either side in which 95 of 100 normal errors lie.
const INTERVAL: f64 = 1.96;

/// Frames that a sequence needs for all runs.
pub const NEEDED_FRAMES: usize = STARTS[STARTS.len() - 1] + FRAMES;

/// The heading of the rows of [`Blind::row`].
pub const HEADING: &str = "| sequence | seed | runs | wrong axis | wrong edge | off by more than 0.05 | these: sure | \
                           error, median | inside the 95 % interval | left, median | left, worst | worst frame above its input px | \
                           error over the expected one |\n\
                           |---|---|---|---|---|---|---|---|---|---|---|---|---|";

/// Which runs are done of a sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// From five frames on with six lookaheads.
    All,
    /// From three frames on with three lookaheads.
    Few,
    /// From three frames on with this lookahead.
    Ahead(usize),
}

impl Extent {
    /// First frame and lookahead of each run.
    fn cases(&self) -> Vec<[usize; 2]> {
        let (starts, lookaheads): (&[usize], &[usize]) = match self {
            Self::All => (&STARTS, &LOOKAHEADS),
            Self::Few => (&FEW_STARTS, &FEW_LOOKAHEADS),
            Self::Ahead(lookahead) => (&FEW_STARTS, std::slice::from_ref(lookahead)),
        };
        starts.iter().flat_map(|start| lookaheads.iter().map(|lookahead| [*start, *lookahead])).collect()
    }
}

/// What became of one run.
#[derive(Clone, Copy, Debug)]
struct Run {
    start: usize,
    lookahead: usize,
    /// Signed readout ratio and its stated deviation at the end.
    ratio: f64,
    deviation: f64,
    is_axis_right: bool,
    is_edge_right: bool,
    /// Of the readout ratio, in frame periods.
    error: f64,
    /// Share of the frames whose true readout ratio lies within the stated 95 % interval.
    covered: f64,
    /// Displacement left, RMS, as a share of the uncorrected one.
    left: f64,
    /// By how much the RMS displacement of a frame is above that of its input, in pixels, at most.
    harm: f64,
    /// Displacement left in a frame over the one that is expected: root mean square over the frames that say one.
    normalised: f64,
}

/// What is stated of a frame.
struct Stated {
    readout: Readout,
    readout_deviation: f64,
    expected_error: Option<f64>,
}

/// What became of the runs of a sequence.
pub struct Blind {
    name: String,
    seed: u64,
    runs: Vec<Run>,
}

impl Blind {
    /// Does the runs of a sequence.
    ///
    /// # Errors
    /// If the rectifier refuses a frame, or there are too few.
    pub fn of(footage: &Footage, extent: Extent) -> Result<Self> {
        Self::with(footage, extent, |start, lookahead| run(footage, start, lookahead))
    }

    /// The same from measurements that are made once, by which estimators are compared on the same data.
    ///
    /// # Errors
    /// If there are too few frames.
    pub fn recorded(footage: &Footage, extent: Extent) -> Result<Self> {
        let recording = Recording::of(footage)?;
        Self::with(footage, extent, |start, lookahead| replay(footage, &recording, start, lookahead))
    }

    fn with(
        footage: &Footage,
        extent: Extent,
        run: impl Fn(usize, usize) -> Result<Run> + Sync,
    ) -> Result<Self> {
        let runs: Result<Vec<Run>> =
            extent.cases().into_par_iter().map(|[start, lookahead]| run(start, lookahead)).collect();
        let settings = footage.settings();
        Ok(Self { name: settings.name.clone(), seed: settings.seed, runs: runs? })
    }

    /// The row of the table.
    pub fn row(&self) -> String {
        let count = |is: &dyn Fn(&Run) -> bool| self.runs.iter().filter(|run| is(run)).count();
        let sorted = |of: fn(&Run) -> f64| {
            let mut values: Vec<f64> = self.runs.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let (errors, left, harm) = (sorted(|run| run.error), sorted(|run| run.left), sorted(|run| run.harm));
        let normalised = self.runs.iter().map(|run| run.normalised.powi(2)).sum::<f64>();
        let covered = self.runs.iter().map(|run| run.covered).sum::<f64>() / self.runs.len() as f64;
        let [middle, last] = [self.runs.len() / 2, self.runs.len() - 1];
        format!(
            "| {} | {} | {} | {} | {} | {} | {} | {:.3} | {:.0} % | {:.1} % | {:.1} % | {:+.2} | {:.2} |",
            self.name,
            self.seed,
            self.runs.len(),
            count(&|run| !run.is_axis_right),
            count(&|run| run.is_axis_right && !run.is_edge_right),
            count(&Run::is_wrong),
            count(&|run| run.is_wrong() && run.is_sure()),
            errors[middle],
            100.0 * covered,
            100.0 * left[middle],
            100.0 * left[last],
            harm[last],
            (normalised / self.runs.len() as f64).sqrt(),
        )
    }

    /// A line for each run that ends with a wrong readout, or that bends a frame.
    pub fn wrong(&self) -> impl Iterator<Item = String> {
        self.runs.iter().filter(|run| run.is_wrong() || run.harm > HARM).map(|run| {
            format!(
                "  from frame {}, lookahead {}: {:+.3} ± {:.3}{}, left {:.1} %, worst frame {:+.2} px",
                run.start,
                run.lookahead,
                run.ratio,
                run.deviation,
                if run.is_axis_right { "" } else { " along the wrong axis" },
                100.0 * run.left,
                run.harm
            )
        })
    }
}

impl Run {
    fn is_wrong(&self) -> bool {
        !self.is_axis_right || self.error > WRONG
    }

    fn is_sure(&self) -> bool {
        self.error > SURE * self.deviation
    }
}

/// Frames of each run: as many as there are from the last start on.
fn length(footage: &Footage) -> usize {
    FRAMES.max(footage.frames.len().saturating_sub(STARTS[STARTS.len() - 1]))
}

fn run(footage: &Footage, start: usize, lookahead: usize) -> Result<Run> {
    let told = product::settings(footage.settings(), Delay::Unknown, Estimator::Continuous, lookahead);
    let solutions = product::solve_frames(footage, start..start + length(footage), told)?;
    let stated = solutions.iter().map(|solution| Stated {
        readout: *solution.motion.readout(),
        readout_deviation: solution.readout_deviation,
        expected_error: solution.expected_error,
    });
    let stated = stated.collect();
    judged(footage, start, lookahead, stated, &product::corrections(solutions))
}

fn replay(footage: &Footage, recording: &Recording, start: usize, lookahead: usize) -> Result<Run> {
    let told = product::settings(footage.settings(), Delay::Unknown, Estimator::Continuous, lookahead);
    let estimates = recording.estimate(start..start + length(footage), &told)?;
    let stated = estimates.iter().map(|estimate| Stated {
        readout: estimate.readout,
        readout_deviation: estimate.readout_deviation,
        expected_error: estimate.expected,
    });
    let stated = stated.collect();
    judged(footage, start, lookahead, stated, &recorded::corrections(estimates))
}

/// Judges a run by what is stated of each frame and by its corrections.
fn judged(
    footage: &Footage,
    start: usize,
    lookahead: usize,
    stated: Vec<Stated>,
    corrections: &Corrections,
) -> Result<Run> {
    let truths =
        footage.truth.get(start..start + length(footage)).context("a sequence is shorter than its runs")?;
    let period = 1.0 / footage.settings().delivered_fps();
    let truth = footage.readout();
    let is_covered =
        |stated: &&Stated| error(&stated.readout, &truth, period) <= INTERVAL * stated.readout_deviation;
    let covered = stated.iter().filter(is_covered).count() as f64 / stated.len().max(1) as f64;
    let frames = stated.iter().zip(truths).zip(corrections);
    let frames = frames.filter(|((_, truth), _)| !truth.samples.is_empty());
    let normalised = frames.filter_map(|((stated, truth), correction)| {
        let left = displacement::left(std::slice::from_ref(truth), std::slice::from_ref(correction)).rms;
        stated.expected_error.filter(|expected| *expected > 0.0).map(|expected| (left / expected).powi(2))
    });
    let [sum, count] = normalised.fold([0.0; 2], |[sum, count], square| [sum + square, count + 1.0]);
    let Stated { readout, readout_deviation: deviation, .. } =
        *stated.last().context("a run needs a frame")?;
    let uncorrected = stats::uncorrected(truths.iter().flat_map(|truth| truth.samples.iter().copied()));
    Ok(Run {
        start,
        lookahead,
        ratio: signed_ratio(&readout, period),
        deviation,
        is_axis_right: readout.direction().is_by_rows() == truth.direction().is_by_rows(),
        is_edge_right: readout.direction() == truth.direction(),
        error: error(&readout, &truth, period),
        covered,
        left: displacement::left(truths, corrections).share_of(&uncorrected).unwrap_or(0.0),
        harm: displacement::worst_above_input(truths, corrections),
        normalised: (sum / f64::max(count, 1.0)).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use render::sequence::{Settings, named};

    fn ended(ratio: f64, deviation: f64, error: f64) -> Run {
        Run {
            start: 0,
            lookahead: 4,
            ratio,
            deviation,
            is_axis_right: true,
            is_edge_right: ratio > 0.0,
            error,
            covered: 1.0,
            left: 0.1,
            harm: -1.0,
            normalised: 1.0,
        }
    }

    #[test]
    fn wrong_and_sure_are_counted() {
        let sideways = Run { is_axis_right: false, ..ended(0.02, 0.1, 0.04) };
        let runs = vec![ended(0.8, 0.01, 0.001), ended(0.7, 0.05, 0.1), ended(-0.8, 0.02, 1.6), sideways];
        let blind = Blind { name: "one".into(), seed: 3, runs };
        let row = blind.row();
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        assert_eq!(cells[1..8], ["one", "3", "4", "1", "1", "3", "1"]);
        assert_eq!(blind.wrong().count(), 3);
    }

    #[test]
    fn a_shaken_camera_is_run_from_several_frames_on() {
        let settings =
            Settings { width: 160, height: 120, frames: NEEDED_FRAMES, ..named("rot2_B40").unwrap() };
        let footage = Footage::of_settings(&settings).unwrap();
        let blind = Blind::of(&footage, Extent::All).unwrap();
        assert_eq!(blind.runs.len(), STARTS.len() * LOOKAHEADS.len());
        let few = Blind::recorded(&footage, Extent::Few).unwrap();
        assert_eq!(few.runs.len(), FEW_STARTS.len() * FEW_LOOKAHEADS.len());
        assert!(blind.runs.iter().all(|run| run.left < 1.0 && run.harm < 0.5), "{}", blind.row());
        let short = Settings { frames: NEEDED_FRAMES - 1, ..settings };
        assert!(Blind::of(&Footage::of_settings(&short).unwrap(), Extent::Few).is_err());
    }
}
