// SPDX-License-Identifier: MIT OR Apache-2.0

//! A file in the making.

use anyhow::{Context, Result};
use std::path::{Path, PathBuf};

/// A file in the making, beside where it will be: removed unless it is finished.
pub struct Unfinished(PathBuf);

impl Unfinished {
    /// The file that becomes `output`.
    pub fn beside(output: &Path) -> Self {
        Self::with_ending(output, ".part")
    }

    /// The same under another name, where the usual one is that of an earlier step.
    pub fn with_ending(output: &Path, ending: &str) -> Self {
        let mut name = output.as_os_str().to_owned();
        name.push(ending);
        Self(name.into())
    }

    /// Where it is written.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Gives it its name.
    pub fn finish(&self, output: &Path) -> Result<()> {
        std::fs::rename(&self.0, output).with_context(|| format!("cannot write {}", output.display()))
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        // After `finish` there is nothing of that name.
        let _ = std::fs::remove_file(&self.0);
    }
}
