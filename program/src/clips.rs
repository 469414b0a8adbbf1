// SPDX-License-Identifier: MIT OR Apache-2.0

//! Arguments → the clips that they name.

use crate::input::{Clip, InputOptions, Numbered};
use crate::interruption::Interruption;
use anyhow::{Context, Result, bail};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// What ends the names of rectified clips that are written beside their originals.
pub const RECTIFIED: &str = "-rectified";
/// The same of those over which the motion is drawn.
pub const SHOWN: &str = "-shown";

/// Extensions of the files that are taken from a folder.
const EXTENSIONS: [&str; 19] = [
    "3gp", "avi", "flv", "insv", "m2ts", "m4v", "mkv", "mov", "mp4", "mpeg", "mpg", "mts", "mxf", "ogv",
    "qt", "ts", "webm", "wmv", "y4m",
];

/// The clips of one argument: a file itself; the clips in a folder, by their extensions and without those that this program
/// wrote there, or else the numbered images in it; or what a pattern with `*`, `?`, `[…]` or `**` matches.
fn named_by(
    argument: &Path,
    is_recursive: bool,
    options: &InputOptions,
    interruption: &Interruption,
) -> Result<Vec<Clip>> {
    if argument.is_dir() {
        let clips = clips_in(argument, is_recursive)?;
        if !clips.is_empty() {
            return Ok(clips.iter().map(|clip| Clip::file(clip)).collect());
        }
        return match Numbered::in_folder(argument)? {
            Some(images) => Ok(vec![Clip::images(images, options)]),
            None => bail!("{}: there is no video in this folder", argument.display()),
        };
    }
    let pattern = argument.to_str().filter(|text| text.contains(['*', '?', '[']) && !argument.exists());
    let Some(pattern) = pattern.filter(|_| Clip::pattern(argument).is_none()) else {
        return Ok(vec![Clip::named(argument, options, interruption)?]);
    };
    let matches = glob::glob(pattern).with_context(|| format!("{pattern} is not a pattern"))?;
    let files = matches.collect::<Result<Vec<_>, _>>().with_context(|| pattern.to_owned())?;
    let clips = sorted(files.into_iter().filter(|file| file.is_file() && !is_written(file)).collect());
    if clips.is_empty() {
        bail!("{pattern}: no file matches");
    }
    Ok(clips.iter().map(|clip| Clip::file(clip)).collect())
}

/// The clips right in a folder, and then, where that is asked for, those of the folders in it.
fn clips_in(folder: &Path, is_recursive: bool) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let entries = entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<Vec<_>, _>>();
    let entries = sorted(entries.with_context(|| folder.display().to_string())?);
    let is_wanted = |entry: &&PathBuf| entry.is_file() && is_clip(entry);
    let mut clips: Vec<_> = entries.iter().filter(is_wanted).cloned().collect();
    // A link to a folder above would lead round in a circle; what is hidden are other programs' files.
    let is_entered = |entry: &&PathBuf| entry.is_dir() && !entry.is_symlink() && !is_hidden(entry);
    if is_recursive {
        for folder in entries.iter().filter(is_entered) {
            clips.extend(clips_in(folder, is_recursive)?);
        }
    }
    Ok(clips)
}

fn is_hidden(file: &Path) -> bool {
    file.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'))
}

fn sorted(mut files: Vec<PathBuf>) -> Vec<PathBuf> {
    files.sort();
    files
}

fn is_clip(file: &Path) -> bool {
    let extension = file.extension().and_then(|extension| extension.to_str()).map(str::to_ascii_lowercase);
    extension.is_some_and(|extension| EXTENSIONS.contains(&extension.as_str())) && !is_written(file)
}

/// Whether the name is one that this program gives.
fn is_written(file: &Path) -> bool {
    let stem = file.file_stem().and_then(|stem| stem.to_str());
    stem.is_some_and(|stem| [RECTIFIED, SHOWN].iter().any(|ending| stem.ends_with(ending)))
}

/// A clip that an argument names.
#[derive(Clone, Debug)]
pub struct Named {
    pub clip: Clip,
    /// The folder in which it lies, below the one that was named; empty right in that one, or where none was.
    pub below: PathBuf,
}

/// The clips of all arguments, each once, in the order in which they were named; those of folders in folders where
/// that is asked for.
pub fn expand(
    arguments: &[PathBuf],
    is_recursive: bool,
    options: &InputOptions,
    interruption: &Interruption,
) -> Result<Vec<Named>> {
    let mut clips: Vec<Named> = Vec::new();
    let mut seen = HashSet::new();
    for argument in arguments {
        for clip in named_by(argument, is_recursive, options, interruption)? {
            clip.check_options(options)?;
            let below = clip.path().parent().and_then(|folder| folder.strip_prefix(argument).ok());
            let below = below.unwrap_or(Path::new("")).to_owned();
            if seen.insert(clip.path().to_owned()) {
                clips.push(Named { clip, below });
            }
        }
    }
    Ok(clips)
}

/// Says why a command failed for its only clip; whether it did not.
pub fn finish(clip: &Clip, result: Result<()>, interruption: &Interruption) -> Result<bool> {
    let Err(error) = result else { return Ok(true) };
    interruption.check()?;
    log::error!("{}: {error:#}", clip.display());
    Ok(false)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_and_patterns_name_clips_once() {
        let folder = std::env::temp_dir().join(format!("rsrectify-clips-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("sub.mov")).unwrap();
        for name in ["b.MP4", "a.mkv", "a-rectified.mkv", "b-shown.mp4", "notes.txt", "sub.mov/c.mov"] {
            std::fs::write(folder.join(name), "").unwrap();
        }
        let options = InputOptions::default();
        let names = |arguments: &[&str]| {
            let arguments: Vec<_> = arguments.iter().map(|name| folder.join(name)).collect();
            let clips = expand(&arguments, false, &options, &Interruption::default())
                .map_err(|error| error.to_string())?;
            let name =
                |clip: &Named| clip.clip.path().strip_prefix(&folder).unwrap().to_str().unwrap().to_owned();
            Ok::<_, String>(clips.iter().map(name).collect::<Vec<_>>())
        };
        let all = names(&["", "*.mkv", "**/*.mov", "missing.mp4", "a-rectified.mkv"]).unwrap();
        assert_eq!(all, ["a.mkv", "b.MP4", "sub.mov/c.mov", "missing.mp4", "a-rectified.mkv"]);
        assert!(names(&["*.avi"]).unwrap_err().contains("no file matches"));

        std::fs::create_dir_all(folder.join(".hidden")).unwrap();
        std::fs::write(folder.join(".hidden/d.mov"), "").unwrap();
        let below = expand(std::slice::from_ref(&folder), true, &options, &Interruption::default()).unwrap();
        let below: Vec<_> = below.iter().map(|clip| clip.below.to_str().unwrap()).collect();
        assert_eq!(below, ["", "", "sub.mov"]);
        std::fs::remove_dir_all(folder).unwrap();
    }
}
