// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify fix`, run as a user runs it, on clips made here.

use crate::common::shake::{FPS, RATIO, shake, write_shaken};
use crate::shared::{CLIP, Folder, TONE, buffers, rsrectify, size, times, undocumented};
use serde_json::Value;
use std::path::Path;
use std::process::Output;

const FRAMES: usize = 30;
fn fix(input: &Path, output: &Path, options: &[&str]) -> Output {
    rsrectify("fix").arg(input).arg("--output").arg(output).args(options).output().unwrap()
}

/// Runs the program to its end; its messages.
fn succeeds(input: &Path, output: &Path, options: &[&str]) -> String {
    let result = fix(input, output, options);
    assert!(result.status.success(), "{}", String::from_utf8_lossy(&result.stderr));
    String::from_utf8(result.stdout).unwrap()
}

/// Checks that the program gives up with one line that contains `reason`.
fn fails(input: &Path, output: &Path, reason: &str) {
    let result = fix(input, output, &[]);
    let message = String::from_utf8_lossy(&result.stderr);
    assert_eq!(result.status.code(), Some(1), "{message}");
    assert!(message.starts_with("error: ") && message.trim_end().lines().count() == 1, "{message}");
    assert!(message.contains(reason), "{message}");
}

/// Everything that comes out of a part of an MP4 file.
fn samples(path: &Path, part: &str) -> Vec<gst::Sample> {
    buffers(path, &format!("qtdemux name=d d.{part}"))
}

fn frames(path: &Path) -> Vec<gst::Sample> {
    samples(path, "video_0 ! h264parse ! avdec_h264 ! videoconvert ! video/x-raw,format=GRAY8")
}

fn audio(path: &Path) -> (String, Vec<u8>) {
    let samples = samples(path, "audio_0");
    let name = samples[0].caps().unwrap().structure(0).unwrap().name().to_string();
    let bytes = samples.iter().flat_map(|s| s.buffer().unwrap().map_readable().unwrap().to_vec()).collect();
    (name, bytes)
}

/// Mean grey level of a column.
fn column(frame: &gst::Sample, x: usize) -> f64 {
    let (_, height) = size(frame);
    let data = frame.buffer().unwrap().map_readable().unwrap();
    let stride = data.len() / height as usize;
    data.iter().skip(x).step_by(stride).map(|&v| f64::from(v)).sum::<f64>() / f64::from(height)
}

#[test]
fn frames_keep_their_times_and_audio_its_bytes() {
    let folder = Folder::new("copy");
    let output = folder.file("out.mp4");
    for (name, encoder) in [("aac", "avenc_aac"), ("mp3", "lamemp3enc"), ("opus", "opusenc")] {
        let tone = TONE.replace("44100", if name == "opus" { "48000" } else { "44100" });
        let input = folder.clip("in.mp4", "mp4mux", &format!("{CLIP} {tone} ! {encoder} ! mux."));
        succeeds(&input, &output, &["--overwrite"]);
        let (before, after) = (frames(&input), frames(&output));
        assert_eq!(before.len(), FRAMES);
        assert!(times(&before).iter().all(Option::is_some));
        assert_eq!(times(&before), times(&after), "{name}");
        assert_eq!(size(&after[0]), (320, 240));
        assert!(audio(&input) == audio(&output), "{name} is not copied");
    }
}

#[test]
fn audio_that_mp4_cannot_hold_is_encoded() {
    let folder = Folder::new("encode");
    let video = CLIP.replace("x264enc speed-preset=ultrafast", "x264enc speed-preset=ultrafast ! h264parse");
    let input = folder.clip("in.mkv", "matroskamux", &format!("{video} {TONE} ! flacenc ! mux."));
    let output = folder.file("out.mp4");
    succeeds(&input, &output, &[]);
    assert_eq!(audio(&output).0, "audio/mpeg");
    assert_eq!(frames(&output).len(), FRAMES);
}

#[test]
fn ten_bits_stay_ten_bits() {
    let folder = Folder::new("ten");
    let video = CLIP.replace("I420", "I420_10LE");
    let (input, output) = (folder.clip("in.mp4", "mp4mux", &video), folder.file("out.mp4"));
    succeeds(&input, &output, &[]);
    let decoded = samples(&output, "video_0 ! h264parse ! avdec_h264");
    let format: String = decoded[0].caps().unwrap().structure(0).unwrap().get("format").unwrap();
    assert_eq!((format.as_str(), decoded.len()), ("I420_10LE", FRAMES));
}

#[test]
fn a_comparison_shows_both_pictures() {
    let folder = Folder::new("compare");
    let (input, output) = (folder.clip("in.mp4", "mp4mux", CLIP), folder.file("out.mp4"));
    succeeds(&input, &output, &["--compare", "--lookahead", "12"]);
    let after = frames(&output);
    assert_eq!((after.len(), size(&after[0])), (FRAMES, (640, 240)));
    assert!((column(&after[9], 100) - column(&after[9], 420)).abs() < 2.0);
    // A white line between them, and in the upper left corner of each its label.
    let data = after[9].buffer().unwrap().map_readable().unwrap();
    let brightest = |row: usize, columns: std::ops::Range<usize>| {
        *data[640 * row + columns.start..640 * row + columns.end].iter().max().unwrap()
    };
    for row in [30, 120, 200] {
        assert!(brightest(row, 319..321) > 200, "row {row}");
    }
    for half in [0, 320] {
        // The gradient is dark there.
        assert!(brightest(14, half + 6..half + 60) > 200, "at {half}");
        assert!(brightest(14, half + 100..half + 300) < 100, "at {half}");
    }
}

/// Writes the rotation of a phone's portrait clip, 90° clockwise, into the header of the first track.
fn turn(path: &Path) {
    let mut file = std::fs::read(path).unwrap();
    let header = file.windows(4).position(|name| name == b"tkhd").unwrap();
    // Name, version and flags, five words of times and ids, 16 bytes of layer, group and volume.
    let matrix = header + 4 + 4 + 20 + 16;
    let one = 1 << 16;
    let values: [i32; 9] = [0, one, 0, -one, 0, 0, 240 * one, 0, 1 << 30];
    for (word, value) in file[matrix..matrix + 36].chunks_exact_mut(4).zip(values) {
        word.copy_from_slice(&value.to_be_bytes());
    }
    std::fs::write(path, file).unwrap();
}

#[test]
fn a_portrait_clip_comes_out_upright() {
    let folder = Folder::new("portrait");
    let (input, output) = (folder.clip("in.mp4", "mp4mux", CLIP), folder.file("out.mp4"));
    turn(&input);
    for (options, width) in [(&["--overwrite"][..], 240), (&["--overwrite", "--compare"], 480)] {
        succeeds(&input, &output, options);
        // As players show it, whether frames lie in the file as the sensor read them or upright.
        let shown = "video_0 ! h264parse ! avdec_h264 ! videoconvert ! videoflip video-direction=auto";
        let after = samples(&output, &format!("{shown} ! video/x-raw,format=GRAY8"));
        assert_eq!(size(&after[0]), (width, 320));
        // The gradient's dark top has gone to the right.
        assert!(column(&after[9], 20) > column(&after[9], 220) + 100.0);
    }
}

#[test]
fn failures_say_why_and_leave_nothing_behind() {
    let folder = Folder::new("fail");
    let output = folder.file("out.mp4");
    fails(&folder.file("none.mp4"), &output, "No such file");
    std::fs::write(folder.file("text.mp4"), "no video at all\n").unwrap();
    fails(&folder.file("text.mp4"), &output, "text.mp4");
    let sound = folder.clip("sound.mp4", "mp4mux", &format!("{TONE} ! avenc_aac ! mux."));
    fails(&sound, &output, "no video");
    fails(&sound, &sound, "same file");
    fails(&sound, &folder.file("text.mp4"), "--overwrite");
    fails(&folder.clip("in.mp4", "mp4mux", CLIP), &folder.file("none/out.mp4"), "none/out.mp4");
    assert_eq!(folder.names(), ["in.mp4", "sound.mp4", "text.mp4"]);
}

#[test]
fn the_readout_is_found_before_the_first_frame() {
    let folder = Folder::new("readout");
    let (input, output) = (folder.file("in.mp4"), folder.file("out.mp4"));
    write_shaken(&input, 1.5);
    let said = succeeds(&input, &output, &[]);
    let readout = said.lines().find_map(|line| line.strip_prefix("readout: ")).unwrap();
    let milliseconds: f64 = readout.split(' ').next().unwrap().parse().unwrap();
    assert!((milliseconds - 1e3 * RATIO / FPS).abs() < 2.0, "{said}");
    assert!(readout.contains("bottom-to-top"), "{said}");
    // One that is given is not looked for, however short the film.
    write_shaken(&input, 0.4);
    for given in
        [&["--readout-time", "20"][..], &["--inter-frame-delay", "40"], &["--estimator", "sequential"]]
    {
        let said = succeeds(&input, &output, &[given, &["--overwrite"]].concat());
        assert!(!said.contains("readout:"), "{said}");
    }
}

#[test]
fn a_film_that_tells_nothing_of_the_readout_says_so() {
    let folder = Folder::new("still");
    let (input, output) = (folder.clip("in.mp4", "mp4mux", CLIP), folder.file("out.mp4"));
    assert!(succeeds(&input, &output, &[]).contains("readout: not certain"));
    assert_eq!(frames(&output).len(), FRAMES);
}

/// The objects that `fix --json` prints, one a line.
fn reports(result: &Output) -> Vec<Value> {
    let lines = std::str::from_utf8(&result.stdout).unwrap().lines();
    lines.map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn what_was_done_is_told_in_numbers() {
    let folder = Folder::new("summary");
    let (shaken, still) = (folder.file("shaken.mp4"), folder.clip("still.mp4", "mp4mux", CLIP));
    let (text, log) = (folder.file("text.mp4"), folder.file("log.txt"));
    write_shaken(&shaken, 1.5);
    std::fs::write(&text, "no video").unwrap();
    let output = folder.file("out.mp4");
    let said = succeeds(&shaken, &output, &["--readout-time", "20", "--readout-direction", "bottom-to-top"]);
    let lines: Vec<_> = said.lines().map(str::trim).collect();
    assert!(lines[0].starts_with(&format!("{}: 45 frames in ", output.display())), "{said}");
    assert_eq!(lines[1], "readout time  -20.0 ms, bottom-to-top, as given");
    assert!(
        lines[2].starts_with("corrected     ") && lines[2].contains(" px at most; confidence "),
        "{said}"
    );

    let results = folder.file("results/");
    std::fs::create_dir(&results).unwrap();
    let result = rsrectify("fix")
        .args([&shaken, &still, &text])
        .args(["--json", "--log", log.to_str().unwrap(), "--output", results.to_str().unwrap()])
        .output()
        .unwrap();
    assert_eq!(result.status.code(), Some(1));
    let reports = reports(&result);
    let number = |value: &Value, pointer: &str| value.pointer(pointer).and_then(Value::as_f64).unwrap();
    let [one, other, bad] = &reports[..] else { panic!("{reports:?}") };
    for report in &reports {
        assert_eq!(undocumented(report, "### What was done"), [""; 0]);
    }
    assert_eq!((&one["clip"], &one["frames"]), (&Value::from(shaken.to_str().unwrap()), &Value::from(45)));
    assert_eq!((&one["readout"]["certainty"], &one["error"]), (&Value::from("found"), &Value::Null));
    let truth = -1e3 * RATIO / FPS;
    let [low, high] = ["/readout/interval_ms/0", "/readout/interval_ms/1"].map(|bound| number(one, bound));
    assert!((number(one, "/readout/signed_ms") - truth).abs() < 2.0 && low < truth && high > truth, "{one}");
    assert_eq!(one["corrected_frames"], Value::from(45));
    // A row is corrected by what the picture moves from when it is read until mid-readout: at most in the first row or the last.
    let corrections: Vec<f64> = (0..45)
        .map(|number| {
            let at = |elapsed: f64| shake((f64::from(number) + RATIO * elapsed) / FPS);
            let middle = at(0.5);
            let moved = [0.0, 1.0].map(|end| (at(end).0 - middle.0).hypot(at(end).1 - middle.1));
            moved[0].max(moved[1])
        })
        .collect();
    let largest = corrections.iter().copied().fold(0.0, f64::max);
    assert!((number(one, "/correction_px/largest") - largest).abs() < 0.1 * largest, "{one} for {largest}");
    let frame = number(one, "/correction_px/largest_frame") as usize;
    assert!(corrections[frame] > 0.95 * largest, "frame {frame} of {corrections:?}");
    assert!(number(one, "/confidence") > 0.9 && number(one, "/zoom") == 1.0);
    assert_eq!((&other["corrected_frames"], &other["correction_px"]), (&Value::from(0), &Value::Null));
    assert_eq!(other["as_recorded"]["frames"], Value::from(30));
    assert_eq!(other["readout"]["certainty"], Value::from("not-found"));
    assert!(bad["error"].as_str().unwrap().contains("no video") && bad["frames"].is_null(), "{bad}");
    // All of it is in the log, too.
    let log = std::fs::read_to_string(log).unwrap();
    for part in
        ["45 frames in ", "30 frames in ", "error: ", "2 of 3 clips rectified", "as recorded   all of it"]
    {
        assert!(log.contains(part), "{part}: {log}");
        assert!(String::from_utf8_lossy(&result.stderr).contains(part), "{part}");
    }
}
