//! Arguments → the clips that they name.

use crate::boxes;
use crate::interruption::Interruption;
use anyhow::{Context, Result, bail};
use std::fs::File;
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

/// The clips of one argument: a file itself; the clips right in a folder, by their extensions and without those that
/// this program wrote there; or what a pattern with `*`, `?`, `[…]` or `**` matches.
fn named_by(argument: &Path) -> Result<Vec<PathBuf>> {
    if argument.is_dir() {
        let entries = std::fs::read_dir(argument).with_context(|| argument.display().to_string())?;
        let files = entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<Vec<_>, _>>();
        let files = files.with_context(|| argument.display().to_string())?;
        let clips = sorted(files.into_iter().filter(|file| file.is_file() && is_clip(file)).collect());
        if clips.is_empty() {
            bail!("{}: there is no video in this folder", argument.display());
        }
        return Ok(clips);
    }
    let pattern = argument.to_str().filter(|text| text.contains(['*', '?', '[']) && !argument.exists());
    let Some(pattern) = pattern else { return Ok(vec![argument.to_owned()]) };
    let matches = glob::glob(pattern).with_context(|| format!("{pattern} is not a pattern"))?;
    let files = matches.collect::<Result<Vec<_>, _>>().with_context(|| pattern.to_owned())?;
    let clips = sorted(files.into_iter().filter(|file| file.is_file() && !is_written(file)).collect());
    if clips.is_empty() {
        bail!("{pattern}: no file matches");
    }
    Ok(clips)
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

/// The clips of all arguments, each once, in the order in which they were named.
pub fn expand(arguments: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut clips: Vec<PathBuf> = Vec::new();
    for argument in arguments {
        for clip in named_by(argument)? {
            if !clips.contains(&clip) {
                clips.push(clip);
            }
        }
    }
    Ok(clips)
}

/// Refuses what cannot be a clip, before a pipeline says so in its own words.
pub fn check(clip: &Path) -> Result<()> {
    let metadata = std::fs::metadata(clip).context("cannot be read")?;
    if metadata.is_dir() {
        bail!("is a folder");
    }
    // GStreamer may wait for ever for what is not there.
    if metadata.is_file() && boxes::lacks_index(&mut File::open(clip).context("cannot be read")?) {
        bail!("has no index of its frames: it was not written to its end");
    }
    Ok(())
}

/// Says why a command failed for its only clip; whether it did not.
pub fn finish(clip: &Path, result: Result<()>, interruption: &Interruption) -> Result<bool> {
    let Err(error) = result else { return Ok(true) };
    interruption.check()?;
    eprintln!("error: {}: {error:#}", clip.display());
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
        let names = |arguments: &[&str]| {
            let arguments: Vec<_> = arguments.iter().map(|name| folder.join(name)).collect();
            let clips = expand(&arguments).map_err(|error| error.to_string())?;
            let name = |clip: &PathBuf| clip.strip_prefix(&folder).unwrap().to_str().unwrap().to_owned();
            Ok::<_, String>(clips.iter().map(name).collect::<Vec<_>>())
        };
        let all = names(&["", "*.mkv", "**/*.mov", "missing.mp4", "a-rectified.mkv"]).unwrap();
        assert_eq!(all, ["a.mkv", "b.MP4", "sub.mov/c.mov", "missing.mp4", "a-rectified.mkv"]);
        assert!(names(&["*.avi"]).unwrap_err().contains("no file matches"));
        std::fs::remove_dir_all(folder).unwrap();
    }
}
