// SPDX-License-Identifier: MIT OR Apache-2.0

//! The checks of `fuzz` without an engine: over the corpus, over changed entries of it and over random bytes.
//!
//! `scripts/fuzz` runs the same checks for as long as one likes, guided by coverage and under AddressSanitizer.

#[path = "../fuzz/src/lib.rs"]
mod harness;

use harness::input::Random;
use std::path::Path;

/// Random inputs a target.
const INPUTS: usize = 60;
/// Changed copies of each entry of the corpus.
const COPIES: usize = 2;
/// Bytes of an input, at most.
const LENGTH: usize = 768;

fn run(name: &str) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(name);
    let files = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut corpus: Vec<Vec<u8>> = files.map(|file| std::fs::read(file.unwrap().path()).unwrap()).collect();
    corpus.sort();
    assert!(!corpus.is_empty(), "no corpus in {}", folder.display());
    let (_, check) = harness::TARGETS.into_iter().find(|(target, _)| *target == name).unwrap();
    let mut random = Random::new(0x9e37_79b9_7f4a_7c15);
    for entry in &corpus {
        check(entry);
        for _ in 0..COPIES {
            let mut entry = entry.clone();
            for _ in 0..1 + random.next() % 8 {
                let at = (random.next() >> 16) as usize % entry.len().max(1);
                entry.iter_mut().skip(at).take(1).for_each(|byte| *byte = (random.next() >> 24) as u8);
            }
            check(&entry);
        }
    }
    for _ in 0..INPUTS {
        let length = (random.next() >> 16) as usize % LENGTH;
        check(&random.bytes(length));
    }
}

#[test]
fn planes() {
    run("planes");
}

#[test]
fn rectifier() {
    run("rectifier");
}

#[test]
fn correspondences() {
    run("correspondences");
}

#[test]
fn settings() {
    run("settings");
}

#[test]
fn motion_file() {
    run("motion_file");
}
