// SPDX-License-Identifier: MIT OR Apache-2.0

//! The report for readers.

use crate::outcome::Outcome;
use crate::promises::PROMISES;
use crate::soak::Attack;

const HEAD: &str = "\
# Reliability

What was done to the element to break it, how often, and what became of the frames. This page is written by

```sh
cargo run --release -p reliability -- report
```

which takes an hour and a half on a machine with nothing else to do. Each number is a count; from `lost` on all are to be 0.

| what was done | tried | frames | lost | doubled | changed | crashed | hung |
|---|---|---|---|---|---|---|---|
";

const SEQUENCES: &str = "\
## Random sequences

A sequence is made from a number, its seed. One thread streams into the element: caps of all formats, sizes and rates,
frames that are packed, padded, split over several memories, read-only, shared, too small, empty or described by a false meta, with
timestamps missing, repeated, falling or at the end of time, flags of any kind, single and in lists; segments of any rate and format,
new streams, gaps, tags, custom events, ends, drain and allocation queries. Up to three more threads
disturb: flushing and other seeks, flushes in mid-push, stops and starts, pauses, writes to any property, quality-of-service
events, renegotiation, queries. Downstream may keep frames, offer a small pool, refuse formats, know nothing of
`GstVideoMeta`, wait until it is flushed, answer with errors, and call the element from within a frame or a message.

Frames and serialised events carry numbers. A sequence passes if

- each frame whose push succeeded came out once, in order, with its own timestamps and flags, under the caps, the segment and the stream that it
  was pushed with, and an event kept its place between the frames; after a flush or a stop some at the end may be
  missing, but nothing from before comes out;
- a frame of one colour has that colour, the frame that upstream still holds is as it was, and a sink that reads no strides gets
  the default layout;
- each push came back with success, or with a reason for it not to; a refused frame costs no other;
- the bus has no error without a reason, GLib has no complaint, nothing panics, nothing stands still for a minute;
- at the end, element, pads, bus and the memory of all frames are gone.

```sh
cargo run --release -p reliability -- fuzz --seconds 600 --seed 1     # from that seed on
cargo run --release -p reliability -- fuzz --sequences 1 --seed 1234  # one of them again
```

A sequence that fails is printed with its seed and its last steps. Those with one thread, some two fifths, are the same each time; with
several it may take some tries to meet the same again.

## The other attacks

Wherever it can be, a stream is played twice, with the element and with `identity` in its place, and the same frames must arrive.

```sh
cargo run --release -p reliability -- soak               # all
cargo run --release -p reliability -- soak small-pools   # one
```

| name | what is done |
|---|---|
";

const SHORT: &str = "
`./test` runs all but `live`, which measures time, in a short form, and a fixed set of sequences.

The library beneath is attacked by itself, with arbitrary bytes, guided by coverage and under AddressSanitizer:
`scripts/fuzz library 3600`.
";

const PROMISED: &str = "
## What is promised and which test shows it

`file::test` is a test in `tests/element` or `tests/element_alone`, or beside the code in `gst-plugin/src/rsrectify/`; an attack is one of the above, in its short form a test, too.

";

/// The text of `docs/reliability.md`.
pub fn write(fuzzed: &Outcome, outcomes: &[(&Attack, Outcome)]) -> String {
    let mut page = HEAD.to_owned();
    page += &row("Random sequences of all that can happen, from one to four threads", "sequences", fuzzed);
    for (attack, outcome) in outcomes {
        page += &row(attack.fault, attack.unit, outcome);
    }
    page.push('\n');
    for (name, outcome) in
        [("fuzz", fuzzed)].into_iter().chain(outcomes.iter().map(|(attack, outcome)| (attack.name, outcome)))
    {
        page.extend(outcome.notes.iter().map(|note| format!("- `{name}`: {note}.\n")));
        page.extend(outcome.faults.iter().map(|fault| format!("- `{name}`, wrong: {fault}\n")));
    }
    if outcomes.iter().any(|(_, outcome)| !outcome.notes.is_empty()) || !fuzzed.notes.is_empty() {
        page.push('\n');
    }
    page += SEQUENCES;
    page.extend(outcomes.iter().map(|(attack, _)| format!("| `{}` | {} |\n", attack.name, attack.fault)));
    page += SHORT;
    page += PROMISED;
    for (group, promises) in PROMISES {
        page += &format!("### {group}\n\n| promise | shown by |\n|---|---|\n");
        for promise in *promises {
            let tests: Vec<_> = promise.shown_by.iter().map(|test| format!("`{test}`")).collect();
            let tests = if tests.is_empty() { "nothing".to_owned() } else { tests.join(", ") };
            page += &format!("| {} | {tests} |\n", promise.text);
        }
        page.push('\n');
    }
    page.truncate(page.trim_end().len());
    page.push('\n');
    page
}

fn row(fault: &str, unit: &str, outcome: &Outcome) -> String {
    let Outcome { tried, frames, lost, doubled, changed, crashed, hung, .. } = outcome;
    let frames = if *frames == 0 { "–".to_owned() } else { grouped(*frames) };
    format!(
        "| {fault} | {} {unit} | {frames} | {lost} | {doubled} | {changed} | {crashed} | {hung} |\n",
        grouped(*tried)
    )
}

/// A number with its thousands apart.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::soak::ATTACKS;

    #[test]
    fn thousands_are_apart() {
        assert_eq!([0, 999, 1000, 1_234_567].map(grouped), ["0", "999", "1,000", "1,234,567"]);
    }

    #[test]
    fn the_page_has_all_attacks_and_their_counts() {
        let outcome = |tried| Outcome { tried, frames: 77, ..Outcome::default() };
        let outcomes: Vec<_> =
            ATTACKS.iter().zip(5..).map(|(attack, tried)| (attack, outcome(tried))).collect();
        let page = write(&outcome(4), &outcomes);
        for (attack, outcome) in &outcomes {
            assert!(page.contains(&format!("| {} | {} {} | 77 |", attack.fault, outcome.tried, attack.unit)));
            assert!(page.contains(&format!("| `{}` |", attack.name)));
        }
        assert!(!page.contains("\n\n\n"), "{page}");
    }
}
