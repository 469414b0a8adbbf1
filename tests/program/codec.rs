// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify fix`: which encoder a clip gets, as ffprobe finds it in the file.

use crate::content::Content;
use crate::shared::{Folder, READOUT, rsrectify};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Writes a clip of a few frames, by ffmpeg.
fn clip(folder: &Folder, name: &str, arguments: &str) -> PathBuf {
    let path = folder.file(name);
    let mut command = Command::new("ffmpeg");
    command.args([
        "-nostdin",
        "-v",
        "error",
        "-y",
        "-f",
        "lavfi",
        "-i",
        "testsrc2=size=128x96:rate=25:duration=0.4",
    ]);
    let output =
        command.args(arguments.split_whitespace()).arg(&path).output().expect("the tests need ffmpeg");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    path
}

fn fix(input: &Path, output: &Path, options: &[&str]) -> Output {
    let mut command = rsrectify("fix");
    command.arg(input).arg("--output").arg(output).args(READOUT).arg("--overwrite").args(options);
    command.output().unwrap()
}

/// Runs the program to its end; its messages.
fn said(input: &Path, output: &Path, options: &[&str]) -> String {
    let result = fix(input, output, options);
    let said = String::from_utf8([result.stdout, result.stderr].concat()).unwrap();
    assert!(result.status.success(), "{said}");
    said
}

/// Codec, bits and chroma of a file.
fn kind(file: &Path) -> [String; 3] {
    let content = Content::of(file).unwrap();
    let property = |name: &str| content.properties.get(name).cloned().unwrap_or_default();
    [content.codec.clone(), property("bits"), property("chroma")]
}

#[test]
fn codec_bits_and_chroma_are_those_of_the_clip() {
    let folder = Folder::new("codec");
    for (name, arguments) in [
        ("a.mp4", "-c:v libx264 -pix_fmt yuv422p10le"),
        ("b.mp4", "-c:v libx265 -x265-params log-level=none -pix_fmt yuv420p10le"),
        ("c.mkv", "-c:v libaom-av1 -cpu-used 8 -pix_fmt yuv420p"),
        ("d.mov", "-c:v prores_ks -pix_fmt yuv422p10le"),
        ("e.mkv", "-c:v ffv1 -pix_fmt yuv444p10le"),
    ] {
        let input = clip(&folder, name, arguments);
        let output = folder.file(&format!("out-{name}"));
        let told = said(&input, &output, &[]);
        assert!(!told.contains("codec: ") && !told.contains("warning"), "{told}");
        assert_eq!(kind(&output), kind(&input), "{name}");
    }
}

#[test]
fn what_cannot_be_kept_is_named_and_its_bits_are_kept() {
    let folder = Folder::new("other-codec");
    for (name, arguments, output, expected, words) in [
        ("a.avi", "-c:v mjpeg -pix_fmt yuvj422p", "a.mkv", ["h264", "8", "422"], "image/jpeg is not written"),
        (
            "b.mkv",
            "-c:v libaom-av1 -cpu-used 8 -pix_fmt yuv420p10le",
            "b.mp4",
            ["hevc", "10", "420"],
            "HEVC instead of AV1",
        ),
        (
            "c.mov",
            "-c:v prores_ks -pix_fmt yuv422p10le",
            "c.mp4",
            ["h264", "10", "422"],
            "cannot hold ProRes",
        ),
        ("d.avi", "-c:v huffyuv -pix_fmt yuv422p", "d.mkv", ["ffv1", "8", "422"], "lossless"),
        ("e.mov", "-c:v v210 -pix_fmt yuv422p10le", "e.mov", ["prores", "10", "422"], "cannot hold FFV1"),
    ] {
        let input = clip(&folder, name, arguments);
        let output = folder.file(&format!("out-{output}"));
        let told = said(&input, &output, &[]);
        assert!(told.lines().any(|line| line.starts_with("codec: ") && line.contains(words)), "{told}");
        assert_eq!(kind(&output), expected.map(str::to_owned), "{name}: {told}");
    }
}

#[test]
fn a_dry_run_names_the_codec_and_a_broken_clip_has_none() {
    let folder = Folder::new("codec-dry");
    let input = clip(&folder, "a.mp4", "-c:v libx265 -x265-params log-level=none -pix_fmt yuv420p");
    std::fs::write(folder.file("b.mp4"), "no video").unwrap();
    let run = |options: &[&str]| {
        let result = rsrectify("fix").arg(&input).arg("--dry-run").args(options).output().unwrap();
        assert!(result.status.success());
        String::from_utf8(result.stdout).unwrap()
    };
    assert!(run(&[]).ends_with("a-rectified.mp4: HEVC in MP4\n"));
    assert!(run(&["--codec", "h264"]).ends_with("a-rectified.mp4: H.264 in MP4\n"));
    let result = rsrectify("fix").arg(&folder.0).args(["--dry-run", "--json"]).output().unwrap();
    let listing: serde_json::Value = serde_json::from_slice(&result.stdout).unwrap();
    assert_eq!((&listing[0]["codec"], &listing[1]["codec"]), (&"hevc".into(), &serde_json::Value::Null));
    assert_eq!(folder.names(), ["a.mp4", "b.mp4"]);
}

#[test]
fn presets_change_the_file_and_are_refused_where_there_are_none() {
    let folder = Folder::new("preset");
    let input = clip(&folder, "a.mp4", "-c:v libx264 -pix_fmt yuv420p");
    for codec in ["h264", "hevc", "av1"] {
        let sizes = ["fast", "medium", "slow"].map(|preset| {
            let output = folder.file("out.mp4");
            said(&input, &output, &["--codec", codec, "--preset", preset]);
            assert_eq!(Content::of(&output).unwrap().codec, codec);
            std::fs::read(&output).unwrap()
        });
        assert!(sizes[0] != sizes[1] && sizes[1] != sizes[2], "{codec}");
    }
    let result = fix(&input, &folder.file("out.mov"), &["--codec", "prores", "--preset", "slow"]);
    assert_eq!(result.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&result.stderr).contains("ProRes has no --preset"));
}

#[test]
fn hardware_is_used_where_it_is_there_and_it_is_said_which() {
    let folder = Folder::new("hardware");
    let input = clip(&folder, "a.mp4", "-c:v libx264 -pix_fmt yuv420p");
    let output = folder.file("out.mp4");
    let told = said(&input, &output, &["--hardware"]);
    let line = told.lines().find(|line| line.starts_with("hardware: ")).unwrap();
    assert!(line.ends_with("in software") || line.ends_with(" encodes"), "{line}");
    assert_eq!(Content::of(&output).unwrap().codec, "h264");
    // There is no hardware for it anywhere.
    let told = said(&input, &folder.file("out.mov"), &["--hardware", "--codec", "prores"]);
    assert!(told.contains("no encoder of ProRes in hardware here; it is encoded in software"), "{told}");
}
