// SPDX-License-Identifier: MIT OR Apache-2.0

//! Where a rectified clip goes.

use super::checks::check;
use crate::input::{Clip, Numbered};
use anyhow::{Context, Result, bail};
use std::fmt;
use std::fs::DirBuilder;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

/// Where a rectified clip goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    File(PathBuf),
    /// Numbered images, from this number on.
    Images(Numbered, u64),
    /// The standard output.
    Pipe,
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(file) => file.display().fmt(f),
            Self::Images(pattern, _) => pattern.path().display().fmt(f),
            Self::Pipe => f.write_str("standard output"),
        }
    }
}

impl Target {
    /// Images with the numbers of the clip's where it is of images, else from 1 on.
    pub fn images(pattern: Numbered, clip: &Clip) -> Self {
        let own = clip.as_images().and_then(|images| images.pattern.range().ok());
        Self::Images(pattern, own.map_or(1, |[first, _]| first))
    }

    /// The file, where it is one.
    pub fn as_file(&self) -> Option<&Path> {
        match self {
            Self::File(file) => Some(file),
            Self::Images(..) | Self::Pipe => None,
        }
    }

    /// Its folder, unless it has none.
    pub fn folder(&self) -> Option<&Path> {
        match self {
            Self::File(file) => file.parent(),
            Self::Images(pattern, _) => Some(pattern.folder()),
            Self::Pipe => None,
        }
        .filter(|folder| !folder.as_os_str().is_empty())
    }

    /// Refuses to write over what should stay.
    pub fn check(&self, input: &Clip, overwrite: bool) -> Result<()> {
        match self {
            Self::File(file) => check(input.path(), file, overwrite),
            Self::Images(pattern, _) => {
                let folder = |pattern: &Numbered| pattern.folder_to_open().canonicalize().ok();
                let is_same = |own: &Numbered| {
                    own.name() == pattern.name() && folder(own).is_some() && folder(own) == folder(pattern)
                };
                if input.as_images().is_some_and(|images| is_same(&images.pattern)) {
                    bail!("the output is the same images");
                }
                let there = if pattern.folder().exists() { pattern.numbers()? } else { Vec::new() };
                if let Some(first) = there.first().filter(|_| !overwrite) {
                    bail!("{} is there already; --overwrite replaces images", pattern.file(*first).display());
                }
                Ok(())
            }
            Self::Pipe if std::io::stdout().is_terminal() => {
                bail!(
                    "--output - writes video to the standard output, which is a terminal: send it to a program or a file"
                )
            }
            Self::Pipe => Ok(()),
        }
    }

    /// Makes the folder; with those above it where the user named it alone.
    pub fn make_folder(&self, is_named: bool) -> Result<Option<MadeFolder>> {
        let Some(folder) = self.folder().filter(|folder| !folder.exists()) else { return Ok(None) };
        if is_named || matches!(self, Self::Images(..)) {
            MadeFolder::make(folder, is_named)
        } else {
            Ok(None)
        }
    }
}

/// A folder that was made, and goes again if nothing comes into it.
pub struct MadeFolder(PathBuf);

impl MadeFolder {
    /// Makes a folder, with those above it if asked to; `None` where it is there already.
    pub fn make(folder: &Path, with_parents: bool) -> Result<Option<Self>> {
        if folder.is_dir() {
            return Ok(None);
        }
        let made = DirBuilder::new().recursive(with_parents).create(folder);
        made.with_context(|| format!("cannot make {}", folder.display()))?;
        Ok(Some(Self(folder.to_owned())))
    }
}

impl Drop for MadeFolder {
    fn drop(&mut self) {
        // One with files in it stays.
        let _ = std::fs::remove_dir(&self.0);
    }
}
