// SPDX-License-Identifier: MIT OR Apache-2.0

//! Clips on the standard input, and video on the standard output.

use crate::common::shake::write_shaken;
use crate::shared::{Folder, rsrectify};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn ffmpeg(arguments: &[&str], file: &Path) {
    let mut command = Command::new("ffmpeg");
    command.args(["-nostdin", "-v", "error", "-y"]).args(arguments).arg(file);
    let output = command.output().expect("the tests need ffmpeg");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// A shaken film as Y4M of a format.
fn film(folder: &Folder, format: &str) -> std::path::PathBuf {
    let (encoded, film) = (folder.file("film.mp4"), folder.file("film.y4m"));
    write_shaken(&encoded, 0.8);
    ffmpeg(&["-i", encoded.to_str().unwrap(), "-pix_fmt", format, "-strict", "-1"], &film);
    film
}

/// Runs a command on what a file has, given through a pipe.
fn piped(command: &str, arguments: &[&str], input: &Path) -> Output {
    let mut child = rsrectify(command)
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let mut file = File::open(input).unwrap();
    // Where the program has ended the rest is not taken.
    let writer = std::thread::spawn(move || drop(std::io::copy(&mut file, &mut stdin)));
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap();
    output
}

fn succeeds(command: &str, arguments: &[&str], input: &Path) -> (Vec<u8>, String) {
    let output = piped(command, arguments, input);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    (output.stdout, said)
}

/// What the frames of a file are, decoded.
fn digest(file: &Path) -> Vec<u8> {
    let output = Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-i"])
        .arg(file)
        .args(["-f", "md5", "-"])
        .output();
    output.expect("the tests need ffmpeg").stdout
}

const READOUT: [&str; 4] = ["--readout-time", "20", "--readout-direction", "bottom-to-top"];

#[test]
fn y4m_through_pipes_is_as_through_files() {
    let folder = Folder::new("pipes");
    for format in ["yuv420p", "yuv422p10le", "gray"] {
        let input = film(&folder, format);
        let (bytes, said) = succeeds("fix", &[&["-", "--output", "-"], &READOUT[..]].concat(), &input);
        assert!(said.contains("standard output: 24 frames") && !said.contains("warning"), "{said}");
        let by_pipe = folder.file("pipe.y4m");
        std::fs::write(&by_pipe, &bytes).unwrap();
        let by_file = folder.file("file.y4m");
        let mut command = rsrectify("fix");
        command.arg(&input).args(["--overwrite", "--output"]).arg(&by_file).args(READOUT);
        assert!(command.status().unwrap().success());
        assert!(bytes == std::fs::read(&by_file).unwrap(), "{format}: other bytes");
        // As long as the original, of the same kind, with other frames.
        let original = std::fs::read(&input).unwrap();
        let frame = |bytes: &[u8]| bytes.len() - bytes.iter().position(|byte| *byte == b'\n').unwrap();
        assert_eq!(frame(&bytes), frame(&original), "{format}");
        assert!(digest(&by_pipe) != digest(&input), "nothing was rectified");
        // Lossless, as a film.
        let lossless = folder.file("film.mkv");
        let mut command = rsrectify("fix");
        command.arg(&input).args(["--overwrite", "--output"]).arg(&lossless).args(READOUT);
        assert!(command.status().unwrap().success());
        assert_eq!(digest(&lossless), digest(&by_pipe), "{format}");
    }
}

#[test]
fn matroska_goes_through_pipes_with_its_sound() {
    let folder = Folder::new("piped-mkv");
    let encoded = folder.file("film.mp4");
    write_shaken(&encoded, 0.8);
    let input = folder.file("in.mkv");
    let sound = ["-f", "lavfi", "-i", "sine=440:duration=0.8", "-c:v", "copy", "-c:a", "aac"];
    ffmpeg(&[&["-i", encoded.to_str().unwrap()], &sound[..]].concat(), &input);
    let (bytes, said) =
        succeeds("fix", &[&["-", "--output", "-", "--container", "mkv"], &READOUT[..]].concat(), &input);
    // FFmpeg took over tags of the MP4 file.
    assert!(said.lines().all(|line| !line.contains("warning") || line.contains("tags")), "{said}");
    let output = folder.file("out.mkv");
    std::fs::write(&output, bytes).unwrap();
    let probe = Command::new("ffprobe")
        .args([
            "-v",
            "error",
            "-count_packets",
            "-show_entries",
            "stream=codec_name,nb_read_packets",
            "-of",
            "csv=p=0",
        ])
        .arg(&output)
        .output()
        .unwrap();
    let streams = String::from_utf8(probe.stdout).unwrap();
    assert!(streams.contains("h264,24") && streams.contains("aac,"), "{streams}");
    // To a file, too; and of Y4M nothing is told but the frames.
    let file = folder.file("out.mp4");
    let to_file = ["-", "--output", file.to_str().unwrap()];
    succeeds("fix", &[&to_file, &READOUT[..]].concat(), &input);
    assert!(file.exists());
    let (_, said) = succeeds("fix", &[&["-", "--output", "-"], &READOUT[..]].concat(), &input);
    assert!(said.contains("a stream of audio/mpeg is left out: it cannot go into Y4M files"), "{said}");
}

#[test]
fn a_readout_time_of_0_is_found_and_not_reported_as_given() {
    let folder = Folder::new("piped-unknown");
    let input = film(&folder, "yuv420p");
    let (_, said) = succeeds("fix", &["-", "--output", "-", "--readout-time", "0"], &input);
    assert!(said.contains("readout: sought while") && !said.contains("as given"), "{said}");
}

#[test]
fn a_reader_that_has_gone_ends_the_program() {
    let folder = Folder::new("closed");
    let input = film(&folder, "yuv420p");
    for container in ["y4m", "mkv"] {
        let mut command = rsrectify("fix");
        command
            .arg(&input)
            .args(["--output", "-", "--container", container, "--bitrate", "90000"])
            .args(READOUT);
        if container == "y4m" {
            command = rsrectify("fix");
            command.arg(&input).args(["--output", "-"]).args(READOUT);
        }
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut some = [0; 100];
        let mut stdout = child.stdout.take().unwrap();
        stdout.read_exact(&mut some).unwrap();
        drop(stdout);
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{container}: {said}");
        assert!(said.contains("closed it"), "{container}: {said}");
    }
}

#[test]
fn what_a_pipe_cannot_do_is_said() {
    let folder = Folder::new("no-pipe");
    let input = film(&folder, "yuv420p");
    let garbage = folder.file("garbage");
    std::fs::write(&garbage, "anything else").unwrap();
    let none = folder.file("none");
    std::fs::write(&none, "").unwrap();
    let cut = folder.file("cut.y4m");
    let bytes = std::fs::read(&input).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() - 100]).unwrap();
    for (arguments, input, code, reason) in [
        (&["-", "--output", "-"][..], &garbage, 1, "neither Y4M nor Matroska"),
        (&["-", "--output", "-"], &none, 1, "neither Y4M nor Matroska"),
        (&["-"], &input, 2, "has no name: give --output"),
        (&["-", "--output", "-", "--container", "mp4"], &input, 2, "give --container y4m or mkv"),
        (&["-", "--output", "-", "--codec", "h264"], &input, 1, "leave --codec out"),
        (&["-", "--output", "-", "--stabilize", "0.2"], &input, 1, "give --crop PERCENT"),
        (&["-", "--output", "-", "--border-mode", "crop"], &input, 1, "give --crop PERCENT"),
        (&["-", "--output", "-", "--frames", "1:2"], &input, 1, "takes a file, not the standard input"),
        (&["-", "-", "--output", "-", "--fps", "25"], &input, 2, "--fps is of numbered images"),
        (&["-", "film.y4m", "--output", "-"], &input, 2, "takes one clip, not 2"),
    ] {
        let output = piped("fix", arguments, input);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(
            output.stdout.is_empty() && said.contains("error: ") && said.contains(reason),
            "{reason}: {said}"
        );
    }
    let named = folder.file("named.y4m");
    assert!(Command::new("mkfifo").arg(&named).status().unwrap().success());
    let refused = rsrectify("fix").arg(&named).output().unwrap();
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(1) && said.contains("on the standard input, as -"), "{said}");
    let (bytes, said) = succeeds("fix", &[&["-", "--output", "-"], &READOUT[..]].concat(), &cut);
    assert!(said.contains("warning: the stream ends within a frame") && said.contains("23 frames"), "{said}");
    assert!(!bytes.is_empty());
    let (_, said) = succeeds("fix", &["-", "--output", "-", "--stabilize", "0.2", "--crop", "8"], &input);
    assert!(said.contains("readout: sought while the clip is rectified"), "{said}");
}

#[test]
fn clips_on_the_standard_input_are_measured_and_tracked() {
    let folder = Folder::new("measured");
    let input = film(&folder, "yuv420p");
    let (measured, _) = succeeds("measure", &["-", "--json"], &input);
    let report: serde_json::Value = serde_json::from_slice(&measured).unwrap();
    assert_eq!(report["clips"][0]["clip"], "standard input");
    let (by_pipe, _) = succeeds("track", &[&["-"], &READOUT[..]].concat(), &input);
    let by_file = rsrectify("track").arg(&input).args(READOUT).output().unwrap().stdout;
    assert!(by_pipe == by_file && by_pipe.iter().filter(|byte| **byte == b'\n').count() == 25);
    for command in ["plot", "show"] {
        let output = folder.file(if command == "plot" { "out.svg" } else { "out.mp4" });
        succeeds(command, &["-", "--output", output.to_str().unwrap()], &input);
        assert!(output.exists());
        let refused = piped(command, &["-"], &input);
        assert_eq!(refused.status.code(), Some(2));
    }
    let gcsv = folder.file("out.gcsv");
    let refused = piped("track", &["-", "--gcsv", gcsv.to_str().unwrap()], &input);
    assert!(String::from_utf8_lossy(&refused.stderr).contains("cannot be looked for on the standard input"));
    let motion = folder.file("out.motion");
    let refused = piped("track", &["-", "--motion", motion.to_str().unwrap()], &input);
    assert!(
        String::from_utf8_lossy(&refused.stderr).contains("--motion takes a file, not the standard input")
    );
    assert!(!gcsv.exists() && !motion.exists());
}
