// SPDX-License-Identifier: MIT OR Apache-2.0

//! The attacks of `reliability` in their short forms: frames are counted, time is not measured.

use std::process::Command;

fn passes(args: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_reliability")).args(args).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(output.status.success(), "{args:?}\n{}{}", text(&output.stdout), text(&output.stderr));
}

/// A sequence that fails is printed with its seed: `cargo run -p reliability -- fuzz --sequences 1 --seed …`.
#[test]
fn random_sequences_lose_no_frame() {
    passes(&["fuzz", "--sequences", "150", "--seed", "0"]);
}

#[test]
fn files_that_are_broken_or_change() {
    passes(&["soak", "damaged-files", "--short"]);
    passes(&["soak", "other-sizes", "--short"]);
}

#[test]
fn pools_and_sinks_of_all_kinds() {
    passes(&["soak", "small-pools", "--short"]);
    passes(&["soak", "raw-sinks", "--short"]);
    passes(&["soak", "slow-sinks", "--short"]);
}

#[test]
fn seeks_and_ways_to_play() {
    passes(&["soak", "seeks", "--short"]);
    passes(&["soak", "playback", "--short"]);
}

#[test]
fn many_starts_many_frames_many_elements() {
    for attack in ["restarts", "long-film", "many-elements", "leaks"] {
        passes(&["soak", attack, "--short"]);
    }
}
