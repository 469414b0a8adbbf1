// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify fix`: several clips, and how it ends.

use crate::shared::{CLIP, Folder, rsrectify};
use std::path::Path;
use std::process::Output;
use std::time::{Duration, Instant};

/// What the program said.
fn said(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr[..]].concat()).into_owned()
}

/// Runs `fix`; the readout is beside the point here.
fn fix(arguments: &[&Path], options: &[&str]) -> Output {
    rsrectify("fix").args(arguments).args(["--readout-time", "0"]).args(options).output().unwrap()
}

#[test]
fn one_bad_clip_does_not_stop_the_rest() {
    let folder = Folder::new("batch");
    for name in ["a.mp4", "c.mp4"] {
        folder.clip(name, "mp4mux", CLIP);
    }
    std::fs::write(folder.file("b.mp4"), "no video").unwrap();
    let output = fix(&[&folder.0], &["--output", folder.file("out").to_str().unwrap()]);
    let told = said(&output);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("2 of 3 clips rectified"), "{told}");
    assert_eq!(told.matches("b.mp4").count(), 2, "{told}");
    let mut made: Vec<_> =
        std::fs::read_dir(folder.file("out")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    made.sort();
    assert_eq!(made, ["a-rectified.mp4", "c-rectified.mp4"]);
}

#[test]
fn beside_the_clips_nothing_is_rectified_twice() {
    let folder = Folder::new("twice");
    folder.clip("a.mov", "qtmux", CLIP);
    assert!(fix(&[&folder.0], &[]).status.success());
    assert_eq!(folder.names(), ["a-rectified.mov", "a.mov"]);
    // The result is no clip of the folder, and is not written over.
    let again = fix(&[&folder.0], &[]);
    assert_eq!(again.status.code(), Some(1));
    assert!(said(&again).contains("--overwrite"), "{}", said(&again));
    assert!(fix(&[&folder.file("*.mov")], &["--overwrite"]).status.success());
    assert_eq!(folder.names(), ["a-rectified.mov", "a.mov"]);
}

#[test]
fn a_dry_run_says_what_would_be_done() {
    let folder = Folder::new("dry");
    let clip = folder.clip("a.mkv", "matroskamux", &CLIP.replace("! mux.", "! h264parse ! mux."));
    let output = fix(&[&clip], &["--dry-run", "--codec", "hevc"]);
    assert!(output.status.success());
    let told = said(&output);
    assert!(told.contains("a-rectified.mkv: HEVC in MKV"), "{told}");
    let output = fix(&[&clip], &["--dry-run", "--codec", "hevc", "--json"]);
    let listed: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&listed[0]["codec"], &listed[0]["container"]), (&"hevc".into(), &"mkv".into()));
    assert_eq!(listed[0]["output"].as_str(), folder.file("a-rectified.mkv").to_str());
    // A container that cannot hold the codec is not taken over from the clip.
    let told = said(&fix(&[&clip], &["--dry-run", "--codec", "prores", "--container", "mp4"]));
    assert!(told.contains("--container mov"), "{told}");
    assert_eq!(folder.names(), ["a.mkv"]);
}

#[test]
fn what_cannot_be_asked_for_is_refused() {
    let folder = Folder::new("refused");
    std::fs::create_dir(folder.file("sub")).unwrap();
    let [a, b] = ["a.mp4", "sub/a.mp4"].map(|name| {
        std::fs::write(folder.file(name), "").unwrap();
        folder.file(name)
    });
    let out = folder.file("out");
    let out = out.to_str().unwrap();
    for (arguments, options, reason) in [
        (&[&a, &b][..], &["--output", out][..], "both be written"),
        (&[&a], &["--output", out], "--container"),
        (&[&folder.file("none*.mp4")], &[], "no file matches"),
        (&[&a], &["--codec", "vp8"], "possible values"),
        (&[&a], &["--quality", "3", "--bitrate", "100"], "cannot be used with"),
        (&[], &[], "required"),
    ] {
        let arguments: Vec<_> = arguments.iter().map(|path| path.as_path()).collect();
        let output = fix(&arguments, options);
        assert_eq!(output.status.code(), Some(2), "{}", said(&output));
        assert!(said(&output).contains(reason), "{}", said(&output));
    }
    let output = rsrectify("fix").arg(&a).args(["--readout-time", "-3"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(said(&output).contains("--readout-direction"), "{}", said(&output));
    let output = fix(&[&a], &["--codec", "ffv1", "--quality", "3"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(said(&output).contains("--quality"), "{}", said(&output));
}

#[cfg(unix)]
#[test]
fn an_interruption_leaves_no_half_file() {
    let folder = Folder::new("interrupted");
    let clip = folder.clip("a.mp4", "mp4mux", &CLIP.replace("num-buffers=30", "num-buffers=900"));
    let mut command = rsrectify("fix");
    command.arg(&clip).args(["--readout-time", "0"]);
    let mut child = command.stderr(std::process::Stdio::piped()).spawn().unwrap();
    let part = folder.file("a-rectified.mp4.part");
    let started = Instant::now();
    while !part.exists() {
        assert!(started.elapsed() < Duration::from_secs(20), "nothing is written");
        assert_eq!(child.try_wait().unwrap(), None, "it is done already");
        std::thread::sleep(Duration::from_millis(5));
    }
    let id = child.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130));
    assert!(said(&output).contains("interrupted"), "{}", said(&output));
    assert_eq!(folder.names(), ["a.mp4"]);
}

#[test]
fn manual_pages_and_completions_are_written() {
    let folder = Folder::new("manual");
    let output = rsrectify("man").arg(&folder.0).output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    let page = std::fs::read_to_string(folder.file("rsrectify-fix.1")).unwrap();
    assert!(page.contains("Exit codes") && page.contains("overwrite"), "{page}");
    for command in ["measure", "track", "index", "join", "plot", "show"] {
        assert!(folder.file(&format!("rsrectify-{command}.1")).exists(), "{command}");
    }
    let output = rsrectify("completions").arg("bash").output().unwrap();
    assert!(said(&output).contains("--same\\-camera") || said(&output).contains("--same-camera"));
}
