// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the library promises whatever it is given, as functions of arbitrary bytes.
//!
//! Each module has a `check` that reads a case from the bytes and panics where a promise is broken. `fuzz_targets`
//! hands them to libFuzzer; `tests/fuzz.rs` of the library runs them over the corpus and over random bytes.
//!
//! Apart from the workspace, because the engine needs flags of its own, with which all else would be compiled anew.

pub mod correspondences;
pub mod input;
pub mod motion_file;
pub mod planes;
pub mod rectifier;
pub mod settings;

/// A check and the name of its target and corpus.
pub type Target = (&'static str, fn(&[u8]));

/// All of them.
pub const TARGETS: [Target; 5] = [
    ("planes", planes::check),
    ("rectifier", rectifier::check),
    ("correspondences", correspondences::check),
    ("settings", settings::check),
    ("motion_file", motion_file::check),
];
