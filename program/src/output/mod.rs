// SPDX-License-Identifier: MIT OR Apache-2.0

//! The files that the program writes: their names, how video in them is encoded, and that none is left half.

mod av1;
mod checks;
pub mod choice;
pub mod codec;
pub mod container;
pub mod encoder;
pub mod encoding;
mod frames;
mod hardware;
mod prores;
mod tags;
mod target;
mod unfinished;
mod verify;

pub use checks::{check, check_writable};
pub use frames::FrameWriter;
pub use target::{MadeFolder, Target};
pub use unfinished::Unfinished;
pub use verify::verify;

use crate::input::Clip;
use anyhow::{Context, Result};
use std::path::{Path, PathBuf};

/// Whether what `--output` names is a folder: one that is there, or a name that ends in a slash.
pub fn is_folder(output: &Path) -> bool {
    output.is_dir() || output.as_os_str().to_string_lossy().ends_with(std::path::is_separator)
}

/// The file that a clip becomes in a folder, beside the clip if none is given: its name with `ending` in place of its extension.
pub fn beside(clip: &Path, folder: Option<&Path>, ending: &str) -> Result<PathBuf> {
    let mut name = clip.file_stem().context("has no name")?.to_owned();
    name.push(ending);
    Ok(match folder {
        Some(folder) => folder.join(name),
        None => clip.with_file_name(name),
    })
}

/// The file that a command writes for one clip: `output`, or one in it if that is a folder, else beside the clip.
pub fn of_one(clip: &Clip, output: Option<&Path>, ending: &str) -> Result<PathBuf> {
    match output {
        Some(file) if !is_folder(file) => Ok(file.to_owned()),
        folder => beside(&clip.namesake()?, folder, ending),
    }
}

/// Begins the file that a command writes for one clip: refuses one that is there or cannot be written, and makes its folder if the
/// user named that only.
pub fn begin(clip: &Clip, file: &Path, output: Option<&Path>, is_overwritten: bool) -> Result<Unfinished> {
    clip.begin()?;
    check(clip.path(), file, is_overwritten)?;
    make_folder(file, output)?;
    let unfinished = Unfinished::beside(file);
    check_writable(unfinished.path())?;
    Ok(unfinished)
}

/// Makes the folder of a file if the user named the folder only.
fn make_folder(file: &Path, output: Option<&Path>) -> Result<()> {
    match file.parent().filter(|_| output.is_some_and(is_folder)) {
        Some(folder) => {
            std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))
        }
        None => Ok(()),
    }
}
