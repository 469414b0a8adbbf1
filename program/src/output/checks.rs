// SPDX-License-Identifier: MIT OR Apache-2.0

//! What is looked at before a file is written.

use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};

/// Refuses a file that cannot be written, before any work is done for it; `file` is where it is written to.
pub fn check_writable(file: &Path) -> Result<()> {
    let about = std::fs::metadata(file).ok();
    if about.as_ref().is_some_and(|about| !about.is_file() && !about.is_dir()) {
        // Who reads a pipe would take this for its end.
        return Ok(());
    }
    let opened = std::fs::File::options().append(true).create(true).open(file);
    opened.with_context(|| format!("cannot write {}", file.display()))?;
    if about.is_none() {
        std::fs::remove_file(file).with_context(|| format!("cannot write {}", file.display()))?;
    }
    Ok(())
}

/// Refuses to write over what should stay.
pub fn check(input: &Path, output: &Path, overwrite: bool) -> Result<()> {
    let same = |output: PathBuf| input.canonicalize().is_ok_and(|input| input == output);
    if output.canonicalize().is_ok_and(same) {
        bail!("the output is the same file");
    }
    if output.is_dir() {
        bail!("{} is a folder", output.display());
    }
    if output.exists() && !overwrite {
        bail!("{} is there already; --overwrite replaces it", output.display());
    }
    Ok(())
}
