// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify fix` and `measure` on files that many cameras and programs wrote, which are not part of the repository.
//!
//! Needs `$RSRECTIFY_DATA/zoo`; skipped, and said so, where the variable is unset. `RSRECTIFY_ALL=1` runs the slow files, too,
//! `RSRECTIFY_ONLY=NAME,NAME` some files alone.

use crate::content::Content;
use crate::shared::{Folder, READOUT, rsrectify};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Output;

/// Files that take longest, with the seconds that `fix` and `measure` took of them on two busy cores.
const SLOW: [(&str, u32); 8] = [
    ("av1-hdr10.mp4", 34),
    ("cts-frag-24in30.mp4", 26),
    ("flir-thermal.mp4", 23),
    ("gopro-max-hero.mp4", 62),
    ("mac-screen-vfr.mov", 58),
    ("mapillary-h265.mp4", 38),
    ("mp4-rtp-hints.mp4", 24),
    ("dashcam-udacity.mp4", 25),
];

/// What the output cannot hold: file, property, words of the warning that names it.
const LEFT_OUT: [(&str, &str, &str); 4] = [
    // Voice of Windows Media, which FFmpeg decodes and GStreamer's wrapper of it does not.
    ("wmv3.wmv", "audio", "the audio cannot be decoded"),
    // A tag that an MP4 file left, beside the date of the file itself, which is kept.
    ("sub-ssa.mkv", "creation time", "tags"),
    // H.264 and HEVC have no 4:2:0 of odd sizes.
    ("odd-mpeg2.mp4", "chroma", "raised to 4:4:4"),
    // GStreamer's Matroska muxer takes no pictures as subtitles.
    ("sony-a7m3.mts", "subtitle", "subpicture/x-pgs is left out"),
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

/// What does not come out right yet: file, property (or `failure`), reason. What does must be taken off the list.
const NOT_YET: [(&str, &str, &str); 7] = [
    ("dnxhd-tc.mxf", "failure", "the demuxer of MXF gives up where the file is cut short"),
    ("mac-screen-vfr.mov", "frames", "times that contradict the order of frames"),
    ("mac-screen-vfr.mov", "times", "times that contradict the order of frames"),
    ("mapillary-h265.mp4", "times", "times that contradict the order of frames"),
    ("mpeg1-sar64-45.mpg", "audio 0", "the parser drops a packet that is cut off"),
    // Its muxer of Matroska writes texts as GStreamer serialises them.
    ("h264.avi", "title", "quoted by GStreamer"),
    ("msmpeg4v2.mkv", "title", "quoted by GStreamer"),
];

/// Files of which nothing is measured yet, with what is wrong.
const NOT_YET_MEASURED: [(&str, &str, &str); 1] =
    [("dnxhd-tc.mxf", "failure", "the demuxer of MXF gives up where the file is cut short")];

/// Files of which nothing can be measured: what `measure` must say.
const NOT_MEASURED: [(&str, &str); 1] = [("sony-a7m3.mts", "interlaced")];

/// The frames of some files, as many as ffprobe counts.
const FRAMES: [(&str, u64); 8] = [
    ("ac3.mp4", 30),
    ("chrome-noduration.webm", 74),
    ("editlist-shift.mp4", 270),
    ("h264-in-ps.mpeg", 180),
    ("h264.avi", 58),
    ("h264.ts", 30),
    ("mpeg1-sar64-45.mpg", 36),
    ("wmv3.wmv", 25),
];

/// A property, or `failure`, and what is wrong with it.
type Fault = (String, String);

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
    let only = std::env::var("RSRECTIFY_ONLY").ok();
    let wants_all = only.is_some() || std::env::var_os("RSRECTIFY_ALL").is_some();
    if !wants_all {
        eprintln!("skipped unless RSRECTIFY_ALL is set: {}", SLOW.map(|(name, _)| name).join(", "));
    }
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
fn fix(file: &Path, folder: &Path) -> Vec<Fault> {
    std::fs::create_dir_all(folder).unwrap();
    // How well it is rectified is not what is judged; the other estimator is that of `measure`.
    let fastest = [&READOUT[..], &["--effort", "fast", "--estimator", "sequential"]].concat();
    let output = rsrectify("fix").arg(file).args(fastest).arg("--output").arg(folder).output().unwrap();
    let (told, code) = (said(&output), output.status.code());
    let mut written = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let (twin, rest) = (written.next(), written.next());
    let mut faults = Vec::new();
    let mut check = |is_right: bool, fault: String| {
        if !is_right {
            faults.push(("failure".to_owned(), fault));
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
        let property = difference.property.clone();
        let allowed =
            LEFT_OUT.iter().find(|(name, listed, _)| *name == name_of(file) && property.starts_with(listed));
        match allowed {
            Some((_, _, words)) if told.contains(words) => {}
            _ => faults.push((property, format!("{difference:?}: {told}"))),
        }
    }
    faults
}

/// What is wrong with what is measured of a file.
fn measure(file: &Path) -> Vec<Fault> {
    let output = rsrectify("measure").arg(file).args(["--quick", "--json"]).output().unwrap();
    let (told, code) = (said(&output), output.status.code());
    if UNREADABLE.contains(&name_of(file)) {
        return failure(code == Some(1), told);
    }
    if let Some(words) = listed(&NOT_MEASURED, file) {
        return failure(code == Some(1) && told.contains(words), told);
    }
    let report: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
    let clip = &report["clips"][0];
    let has_reason = clip["doubts"].as_array().is_some_and(|doubts| !doubts.is_empty());
    let frames = clip["frames"].as_u64().unwrap_or(0);
    let is_right = code == Some(0)
        && frames > 0
        && listed(&FRAMES, file).is_none_or(|expected| frames == expected)
        && (clip["certain"] == true || has_reason);
    failure(is_right, told)
}

fn failure(is_right: bool, told: String) -> Vec<Fault> {
    (!is_right).then(|| ("failure".to_owned(), told)).into_iter().collect()
}

/// Fails with all that is wrong, and with what is right although it is listed as wrong.
fn judge(check: impl Fn(&Path) -> Vec<Fault>, known: &[(&str, &str, &str)]) {
    let mut wrong = String::new();
    for file in files() {
        let name = name_of(&file);
        let start = std::time::Instant::now();
        let faults = check(&file);
        println!("{name}: {:.1} s", start.elapsed().as_secs_f64());
        let listed: Vec<_> = known.iter().filter(|(listed, ..)| *listed == name).collect();
        for (property, fault) in &faults {
            if !listed.iter().any(|(_, listed, _)| listed == property) {
                wrong += &format!("{name}: {fault}\n");
            }
        }
        for (_, property, reason) in listed {
            if faults.iter().any(|(fault, _)| fault == property) {
                println!("{name}: {property} not yet right: {reason}");
            } else {
                wrong += &format!("{name}: {property} is right now, but listed: {reason}\n");
            }
        }
    }
    assert!(wrong.is_empty(), "\n{wrong}");
}

#[test]
fn all_that_real_files_have_is_kept() {
    let folder = Folder::new("zoo");
    judge(|file| fix(file, &folder.file(name_of(file))), &NOT_YET);
}

#[test]
fn real_files_are_measured_or_a_reason_is_given() {
    judge(measure, &NOT_YET_MEASURED);
}
