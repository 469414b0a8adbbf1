// SPDX-License-Identifier: MIT OR Apache-2.0

//! Outcomes kept beside the program, so that one attack can be tried again without the others.

use crate::outcome::Outcome;
use anyhow::Context;
use std::path::PathBuf;

fn path(name: &str) -> anyhow::Result<PathBuf> {
    let folder = std::env::current_exe()?.parent().context("no folder")?.join("reliability-outcomes");
    std::fs::create_dir_all(&folder)?;
    Ok(folder.join(format!("{name}.json")))
}

/// Keeps the outcome of an attack at full length.
pub fn keep(name: &str, outcome: &Outcome) -> anyhow::Result<()> {
    Ok(std::fs::write(path(name)?, serde_json::to_string(outcome)?)?)
}

/// The outcome kept last.
pub fn last(name: &str) -> anyhow::Result<Outcome> {
    let path = path(name)?;
    let text = std::fs::read_to_string(&path)
        .with_context(|| format!("{name} was not run yet: no {}", path.display()))?;
    Ok(serde_json::from_str(&text)?)
}
