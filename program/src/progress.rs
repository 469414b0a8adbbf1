// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the user sees while a clip is worked on.

use anyhow::Result;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::{ErrorKind, Write};

/// A sign of life without a known end.
pub fn spinner() -> Result<ProgressBar> {
    Ok(ProgressBar::no_length().with_style(ProgressStyle::with_template("{spinner} {msg}")?))
}

/// Prints a text, as far as anybody reads it.
pub fn print(text: &[u8]) -> Result<()> {
    match std::io::stdout().write_all(text) {
        // Who reads has seen enough.
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => Ok(written?),
    }
}
