// SPDX-License-Identifier: MIT OR Apache-2.0

//! The paper's figures drawn from a run, and the displacement left beside them.

use super::charts::{Curve, Panel, Scale, draw};
use super::results::{FrameResult, Results};
use crate::systems::registry::Entry;
use anyhow::Result;
use baselines::correspondences::Source;
use std::path::Path;

/// The five sequences of the paper.
pub const PAPER: [&str; 5] = ["rot1_B0", "rot1_B40", "rot2_B40", "trans1_B40", "trans_rot1_B40"];

/// The scene whose frames are drawn: curves are of one run, as the paper's are.
const SEED: u64 = 1;

/// A figure of the paper: its number, the sequence, and the other model of each panel.
const COMPARISONS: [(&str, &str, [&str; 2]); 4] = [
    ("25-3", "rot1_B0", ["3d-rotation-2", "3d-rotation-3"]),
    ("25-4", "rot2_B40", ["3d-rotation-2", "3d-rotation-3"]),
    ("25-5", "trans1_B40", ["3d-rotation-2", "3d-translation-3"]),
    ("25-6", "trans_rot1_B40", ["3d-rotation-2", "3d-full-2"]),
];

/// The systems whose displacement is drawn for every sequence.
const LEFT: [&str; 7] = [
    "uncorrected",
    "translation",
    "3d-rotation-3",
    "paper-delay-0",
    "paper",
    "rsrectify-4-unknown",
    "rsrectify-4",
];

/// Draws all figures into a folder; nothing is drawn of the controls, where nothing is displaced.
///
/// # Errors
/// Where a file cannot be written.
pub fn draw_all(results: &Results, entries: &[Entry], folder: &Path) -> Result<()> {
    let source = Drawing { results, entries };
    for (number, sequence, others) in COMPARISONS {
        let panel = |other| {
            let methods = ["uncorrected", "paper-delay-0", other];
            source.panel(sequence, "accuracy (colour distance under 0.3)", &methods, accuracy)
        };
        draw(&folder.join(format!("fig-{number}.svg")), others.map(panel).into(), Scale::ToOne)?;
    }
    let delays = |sequence: &&str| {
        let methods = ["uncorrected", "paper-delay-0", "paper"];
        source.panel(sequence, "accuracy (colour distance under 0.3)", &methods, accuracy)
    };
    draw(&folder.join("fig-25-7.svg"), PAPER[1..].iter().map(delays).collect(), Scale::ToOne)?;
    for name in results.sequences.iter().map(|info| &info.name).filter(|name| !results.is_control(name)) {
        let panel = source.panel(name, "displacement left, px RMS", &LEFT, |frame| Some(frame.left));
        draw(&folder.join(format!("left-{name}.svg")), vec![panel], Scale::FromZero)?;
    }
    Ok(())
}

fn accuracy(frame: &FrameResult) -> Option<f64> {
    frame.likeness.map(|likeness| likeness.accuracy)
}

struct Drawing<'a> {
    results: &'a Results,
    entries: &'a [Entry],
}

impl Drawing<'_> {
    /// The curves of those of the methods that were run.
    fn panel(
        &self,
        sequence: &str,
        axis: &str,
        methods: &[&str],
        figure: fn(&FrameResult) -> Option<f64>,
    ) -> Panel {
        let curves = methods.iter().filter_map(|method| {
            let trials = &mut self.results.of(sequence, Source::Sampler, method);
            let trial = trials.find(|trial| trial.seed == SEED)?;
            let entry = self.entries.iter().find(|entry| entry.id == *method)?;
            let figures: Vec<f64> = trial.frames.iter().filter_map(figure).collect();
            Some(Curve { label: entry.label.into(), figures }).filter(|curve| !curve.figures.is_empty())
        });
        Panel { title: sequence.into(), axis: axis.into(), curves: curves.collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::systems::registry;
    use render::sequence::named;

    #[test]
    fn what_figures_show_exists() {
        let known = registry::all();
        let methods = COMPARISONS.iter().flat_map(|(_, _, others)| others).chain(&LEFT);
        for method in methods {
            assert!(known.iter().any(|entry| entry.id == **method), "{method}");
        }
        for sequence in PAPER.iter().chain(COMPARISONS.iter().map(|(_, sequence, _)| sequence)) {
            assert!(named(sequence).is_ok(), "{sequence}");
        }
    }
}
