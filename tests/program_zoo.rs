//! `rsrectify fix` and `measure` on files that many cameras and programs wrote, which are not part of the repository.
//!
//! Needs `$RSRECTIFY_DATA/zoo`; skipped, and said so, where the variable is unset. `RSRECTIFY_ALL=1` runs the slow files, too.

#[path = "common/kept.rs"]
mod kept;
#[path = "common/program.rs"]
mod program;

use kept::Content;
use program::{Folder, rsrectify};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Output;

/// Files that take longest, with the seconds of processor time of `fix` and `measure` together.
const SLOW: [(&str, u32); 0] = [];

/// What the output cannot hold: file, property, words of the warning that names it.
const LEFT_OUT: [(&str, &str, &str); 2] = [
    // H.264 and HEVC have no 4:2:0 of odd sizes.
    ("odd-mpeg2.mp4", "chroma", "raised to 4:4:4"),
    // GStreamer's Matroska muxer takes no pictures as subtitles.
    ("sony-a7m3.mts", "subtitle tracks", "subpicture/x-pgs is left out"),
];

/// Files that were cut short or whose pictures are damaged, and what must be said of them: what there is of them is rectified.
const DAMAGED: [(&str, &str); 4] = [
    ("corrupt-frames.mp4", "1 of 50 frames cannot be decoded"),
    ("cut-canon.avi", "cut short"),
    ("cut-ssa.mkv", "cut short"),
    ("cut-frag.mp4", "cut short"),
];

/// Files without a frame that ffprobe could decode.
const UNREADABLE: [&str; 3] = ["broken.mp4", "cut-karma.mp4", "empty.avi"];

/// Files that do not come out right yet, with what is wrong. One that does must be taken off the list.
const NOT_YET: [(&str, &str); 0] = [];

/// Files of which nothing is measured yet, with what is wrong.
const NOT_YET_MEASURED: [(&str, &str); 0] = [];

/// Files of which nothing can be measured: what `measure` must say.
const NOT_MEASURED: [(&str, &str); 1] = [("sony-a7m3.mts", "interlaced")];

/// What the program said.
fn said(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr[..]].concat()).into_owned()
}

/// The files, but for the slow ones unless these are wanted.
fn files() -> Vec<PathBuf> {
    let Some(data) = std::env::var_os("RSRECTIFY_DATA").map(|data| PathBuf::from(data).join("zoo")) else {
        eprintln!("skipped: RSRECTIFY_DATA does not name the folder with files that cameras wrote");
        return Vec::new();
    };
    let wants_all = std::env::var_os("RSRECTIFY_ALL").is_some();
    if !wants_all && !SLOW.is_empty() {
        eprintln!("skipped unless RSRECTIFY_ALL is set: {}", SLOW.map(|(name, _)| name).join(", "));
    }
    let only = std::env::var("RSRECTIFY_ONLY").ok();
    let entries = std::fs::read_dir(data).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = entries
        .filter(|file| !["md", "tsv"].map(Some).contains(&file.extension().and_then(|e| e.to_str())))
        .filter(|file| wants_all || !SLOW.iter().any(|(name, _)| *name == name_of(file)))
        .filter(|file| only.as_ref().is_none_or(|only| only.split(',').any(|name| name == name_of(file))))
        .collect();
    files.sort();
    files
}

fn name_of(file: &Path) -> &str {
    file.file_name().and_then(|name| name.to_str()).unwrap_or("")
}

/// The entry of a list for a file.
fn listed<T: Copy>(list: &[(&str, T)], file: &Path) -> Option<T> {
    list.iter().find(|(name, _)| *name == name_of(file)).map(|(_, entry)| *entry)
}

/// What is wrong with the rectified twin of a file; nothing if all is right.
fn fix(file: &Path, folder: &Path) -> Vec<String> {
    std::fs::create_dir_all(folder).unwrap();
    let mut command = rsrectify("fix");
    let output = command.arg(file).args(["--readout-time", "16.7", "--output"]).arg(folder).output().unwrap();
    let (told, code) = (said(&output), output.status.code());
    let mut written = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let (twin, rest) = (written.next(), written.next());
    let mut faults = Vec::new();
    let mut check = |is_right: bool, fault: String| {
        if !is_right {
            faults.push(fault);
        }
    };
    check(rest.is_none(), format!("a file was left behind: {rest:?}"));
    if UNREADABLE.contains(&name_of(file)) {
        check(code == Some(1) && twin.is_none(), format!("was not refused: {told}"));
        return faults;
    }
    let Some(twin) = twin else {
        check(false, format!("no file was written: {told}"));
        return faults;
    };
    let after = Content::of(&twin);
    if let Some(words) = listed(&DAMAGED, file) {
        check(code == Some(1) && told.contains(words), format!("{code:?}, not named as damaged: {told}"));
        check(after.is_some(), "the output cannot be decoded".into());
        return faults;
    }
    check(code == Some(0), format!("{code:?}: {told}"));
    let Some((before, after)) = Content::of(file).zip(after) else {
        check(false, "clip or output cannot be decoded".into());
        return faults;
    };
    for difference in before.differences(&after) {
        let property = difference.property.as_str();
        let allowed =
            LEFT_OUT.iter().find(|(name, listed, _)| *name == name_of(file) && property.starts_with(listed));
        match allowed {
            Some((_, _, words)) => check(told.contains(words), format!("{property}: no warning: {told}")),
            None => check(false, format!("{difference:?}")),
        }
    }
    faults
}

/// What is wrong with what is measured of a file.
fn measure(file: &Path) -> Vec<String> {
    let output = rsrectify("measure").arg(file).args(["--quick", "--json"]).output().unwrap();
    let (told, code) = (said(&output), output.status.code());
    if UNREADABLE.contains(&name_of(file)) {
        return (code != Some(1)).then_some(told).into_iter().collect();
    }
    if let Some(words) = listed(&NOT_MEASURED, file) {
        let is_right = code == Some(1) && told.contains(words);
        return (!is_right).then(|| format!("{code:?}: {told}")).into_iter().collect();
    }
    let report: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
    let clip = &report["clips"][0];
    let has_reason = clip["doubts"].as_array().is_some_and(|doubts| !doubts.is_empty());
    let is_right = code == Some(0)
        && clip["frames"].as_u64().unwrap_or(0) > 0
        && (clip["certain"] == true || has_reason);
    (!is_right).then(|| format!("{code:?}: {told}")).into_iter().collect()
}

/// Fails with all that is wrong, and with what is right although it is listed as wrong.
fn judge(faults: Vec<(PathBuf, Vec<String>)>, known: &[(&str, &str)]) {
    let mut wrong = String::new();
    for (file, faults) in faults {
        match (faults.is_empty(), listed(known, &file)) {
            (false, None) => wrong += &format!("{}:\n  {}\n", name_of(&file), faults.join("\n  ")),
            (false, Some(reason)) => eprintln!("{}: not yet right: {reason}", name_of(&file)),
            (true, Some(reason)) => {
                wrong += &format!("{}: is right now, but listed: {reason}\n", name_of(&file));
            }
            (true, None) => {}
        }
    }
    assert!(wrong.is_empty(), "\n{wrong}");
}

#[test]
fn all_that_real_files_have_is_kept() {
    let folder = Folder::new("zoo");
    let faults = files().into_iter().map(|file| {
        let faults = fix(&file, &folder.file(name_of(&file)));
        (file, faults)
    });
    judge(faults.collect(), &NOT_YET);
}

#[test]
fn real_files_are_measured_or_a_reason_is_given() {
    let faults = files().into_iter().map(|file| {
        let faults = measure(&file);
        (file, faults)
    });
    judge(faults.collect(), &NOT_YET_MEASURED);
}
