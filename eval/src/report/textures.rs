// SPDX-License-Identifier: MIT OR Apache-2.0

//! What photographs as textures change, against procedural ones.

use super::results::{Results, Spread, Trial};
use super::tables::{Table, percent};
use baselines::correspondences::Source;

/// The systems that are compared, and what the table calls them.
const SYSTEMS: [(&str, &str); 3] =
    [("paper-delay-0", "2D rotation, delay 0"), ("paper", "2D rotation"), ("rsrectify-4", "rsrectify")];

/// The share left on the sequences that both runs have; a hint where there are none.
pub fn compared(procedural: Option<&Results>, photographs: Option<&Results>) -> String {
    let columns =
        SYSTEMS.iter().flat_map(|(_, label)| [format!("{label}, procedural"), "photographs".into()]);
    let mut table = Table::new(std::iter::once("sequence".into()).chain(columns));
    if let (Some(procedural), Some(photographs)) = (procedural, photographs) {
        for info in &photographs.sequences {
            let share = |results: &Results, method: &str| {
                let trials = results.of(&info.name, Source::Sampler, method);
                Spread::of(trials.filter_map(Trial::share)).map(percent)
            };
            let shares =
                SYSTEMS.iter().flat_map(|(id, _)| [share(procedural, id), share(photographs, id)]).collect();
            table.row(&info.name, shares);
        }
    }
    let text = table.markdown();
    if text.is_empty() { "(There was no run with photographs.)\n".into() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::results::SequenceInfo;
    use render::stats::Stats;

    fn results(left: f64) -> Results {
        let stats = |rms| Stats { rms, p95: rms, count: 1 };
        let trial = |(method, _): &(&str, &str)| Trial {
            sequence: "a".into(),
            seed: 1,
            source: Source::Sampler,
            method: (*method).into(),
            left: stats(left),
            uncorrected: stats(4.0),
            frames: Vec::new(),
            readout_error: None,
        };
        let info = SequenceInfo { name: "a".into(), readout_ratio: 1.0, frames: 1 };
        Results { sequences: vec![info], trials: SYSTEMS.iter().map(trial).collect() }
    }

    #[test]
    fn both_runs_stand_side_by_side() {
        let table = compared(Some(&results(1.0)), Some(&results(2.0)));
        assert!(table.ends_with("| a | 25 % | 50 % | 25 % | 50 % | 25 % | 50 % |\n"), "{table}");
        assert!(compared(Some(&results(1.0)), None).contains("no run"));
    }
}
