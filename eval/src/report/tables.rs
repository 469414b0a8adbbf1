// SPDX-License-Identifier: MIT OR Apache-2.0

//! Tables in Markdown.

use super::results::{Results, Spread, Trial};
use crate::systems::registry::Entry;
use baselines::correspondences::Source;

/// Columns of sequences beside each other before a table starts anew below.
const COLUMNS: usize = 5;

/// A Markdown table.
#[derive(Default)]
pub struct Table {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table with these column titles.
    pub fn new(header: impl IntoIterator<Item = String>) -> Self {
        Self { header: header.into_iter().collect(), rows: Vec::new() }
    }

    /// Adds a row; one without any figure is left out.
    pub fn row(&mut self, title: impl Into<String>, figures: Vec<Option<String>>) {
        if figures.iter().any(Option::is_some) {
            let cells = figures.into_iter().map(|figure| figure.unwrap_or_else(|| "–".into()));
            self.rows.push(std::iter::once(title.into()).chain(cells).collect());
        }
    }

    /// The text, each row a line; empty without rows.
    pub fn markdown(&self) -> String {
        if self.rows.is_empty() {
            return String::new();
        }
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        let rule = format!("|{}\n", "---|".repeat(self.header.len()));
        line(&self.header) + &rule + &self.rows.iter().map(|row| line(row)).collect::<String>()
    }
}

/// A figure of a trial.
pub type Figure<'a> = &'a dyn Fn(&Trial) -> Option<f64>;

/// How a figure over several scenes is written.
pub type Format<'a> = &'a dyn Fn(Spread) -> String;

/// Percent, with the range over the scenes: `13.8 % (13.4–14.2)`.
pub fn percent(spread: Spread) -> String {
    let digits = if spread.mean < 0.1 { 1 } else { 0 };
    let [mean, lowest, highest] = [spread.mean, spread.lowest, spread.highest].map(|share| 100.0 * share);
    ranged(format!("{mean:.digits$} %"), format!("{lowest:.digits$}"), format!("{highest:.digits$}"))
}

/// A plain number with so many digits after the point, with the range over the scenes.
pub fn number(digits: usize) -> impl Fn(Spread) -> String {
    move |spread| {
        let write = |value: f64| format!("{value:.digits$}");
        ranged(write(spread.mean), write(spread.lowest), write(spread.highest))
    }
}

fn ranged(mean: String, lowest: String, highest: String) -> String {
    if lowest == highest { mean } else { format!("{mean} ({lowest}–{highest})") }
}

/// Systems down, sequences across; a new table for every few sequences.
pub fn by_sequence(
    results: &Results,
    sequences: &[&str],
    entries: &[&Entry],
    figure: Figure,
    format: Format,
) -> String {
    let tables = sequences.chunks(COLUMNS).map(|sequences| {
        let mut table = Table::new(titles(sequences));
        for entry in entries {
            let cell = |sequence: &&str| {
                let trials = results.of(sequence, Source::Sampler, &entry.id);
                Spread::of(trials.filter_map(figure)).map(format)
            };
            table.row(entry.label, sequences.iter().map(cell).collect());
        }
        table.markdown()
    });
    tables.collect::<Vec<_>>().join("\n")
}

fn titles(sequences: &[&str]) -> impl Iterator<Item = String> {
    std::iter::once("system".into()).chain(sequences.iter().map(|name| name.to_string()))
}

/// How far from the truth the readout comes out, sequence by sequence, after all frames.
pub fn readouts(results: &Results) -> String {
    let titles = ["sequence", "readout ratio", "frames", "error, frame periods"];
    let mut table = Table::new(titles.map(String::from));
    for info in &results.sequences {
        let trials = results.trials.iter().filter(|trial| trial.sequence == info.name);
        let error = Spread::of(trials.filter_map(|trial| trial.readout_error)).map(number(3));
        if let Some(error) = error {
            let ratio = format!("{:.2}", info.readout_ratio);
            table.row(&info.name, vec![Some(ratio), Some(info.frames.to_string()), Some(error)]);
        }
    }
    table.markdown()
}

/// The share left from each source of correspondences, on the scenes that all of them saw.
pub fn by_source(results: &Results, sequences: &[&str], entries: &[&Entry], sources: &[Source]) -> String {
    let mut table = Table::new(titles(sequences));
    for entry in entries.iter().filter(|entry| entry.takes_correspondences()) {
        let cell = |sequence: &&str| {
            let shares = shares_by_source(results, sequence, entry, sources)?;
            Some(shares.map(|share| format!("{:.1}", 100.0 * share)).collect::<Vec<_>>().join(" · ") + " %")
        };
        table.row(entry.label, sequences.iter().map(cell).collect());
    }
    table.markdown()
}

/// The mean share left for each source, over the scenes that every source was run on.
fn shares_by_source(
    results: &Results,
    sequence: &str,
    entry: &Entry,
    sources: &[Source],
) -> Option<impl Iterator<Item = f64>> {
    let seen =
        |seed: u64, source: &Source| results.of(sequence, *source, &entry.id).any(|trial| trial.seed == seed);
    let share = |source: &Source| {
        let trials = results.of(sequence, *source, &entry.id);
        let common = trials.filter(|trial| sources.iter().all(|source| seen(trial.seed, source)));
        Spread::of(common.filter_map(Trial::share)).map(|spread| spread.mean)
    };
    Some(sources.iter().map(share).collect::<Option<Vec<_>>>()?.into_iter())
}

/// The sequences themselves.
pub fn sequences(results: &Results) -> String {
    let titles = ["sequence", "frames", "readout ratio γ", "uncorrected px, RMS", "95th percentile"];
    let mut table = Table::new(titles.map(String::from));
    for info in &results.sequences {
        let uncorrected = |figure: fn(&Trial) -> f64| {
            let trials = results.of(&info.name, Source::Sampler, "uncorrected");
            Spread::of(trials.map(figure)).map(number(1))
        };
        table.row(
            &info.name,
            vec![
                Some(info.frames.to_string()),
                Some(format!("{:.2}", info.readout_ratio)),
                uncorrected(|trial| trial.uncorrected.rms),
                uncorrected(|trial| trial.uncorrected.p95),
            ],
        );
    }
    table.markdown()
}

/// What each system is told and where it was described.
pub fn systems(entries: &[Entry]) -> String {
    let mut table = Table::new(["system", "source"].map(String::from));
    for entry in entries {
        table.row(entry.label, vec![Some(entry.source.into())]);
    }
    table.markdown()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_is_written_where_there_is_one() {
        let spread = |mean, lowest, highest| Spread { mean, lowest, highest };
        assert_eq!(percent(spread(0.138, 0.134, 0.142)), "14 % (13–14)");
        assert_eq!(percent(spread(0.0514, 0.05, 0.053)), "5.1 % (5.0–5.3)");
        assert_eq!(percent(spread(1.0, 1.0, 1.0)), "100 %");
        assert_eq!(number(2)(spread(1.234, 1.0, 1.5)), "1.23 (1.00–1.50)");
    }

    #[test]
    fn rows_without_figures_are_left_out() {
        let mut table = Table::new(["a", "b", "c"].map(String::from));
        table.row("x", vec![Some("1".into()), None]);
        table.row("y", vec![None, None]);
        assert_eq!(table.markdown(), "| a | b | c |\n|---|---|---|\n| x | 1 | – |\n");
        assert_eq!(Table::new(["a".to_string()]).markdown(), "");
    }
}
