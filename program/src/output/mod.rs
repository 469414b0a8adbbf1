//! The files that the program writes: their names, how video in them is encoded, and that none is left half.

mod av1;
pub mod codec;
pub mod encoder;
pub mod encoding;
mod prores;
mod tags;
mod unfinished;
mod verify;

pub use unfinished::Unfinished;
pub use verify::verify;

use anyhow::{Context, Result, bail};
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
pub fn of_one(clip: &Path, output: Option<&Path>, ending: &str) -> Result<PathBuf> {
    match output {
        Some(file) if !is_folder(file) => Ok(file.to_owned()),
        folder => beside(clip, folder, ending),
    }
}

/// Makes the folder of a file if the user named the folder only.
pub fn make_folder(file: &Path, output: Option<&Path>) -> Result<()> {
    match file.parent().filter(|_| output.is_some_and(is_folder)) {
        Some(folder) => {
            std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))
        }
        None => Ok(()),
    }
}

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
