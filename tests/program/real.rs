// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify measure` and `fix` on files that cameras and other programs write, unlike those of the program's own tests.

use crate::common::shake::{FPS, RATIO, write_shaken};
use crate::shared::{CLIP, Folder, READOUT, TONE, rsrectify};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Output;

/// Video of three seconds and sound of ten feed `mux`; video begins when the sound is nearly over.
const LATE: &str = "videotestsrc num-buffers=90 pattern=gradient timestamp-offset=8300000000 \
    ! video/x-raw,format=I420,width=320,height=240,framerate=30/1 ! x264enc speed-preset=ultrafast ! h264parse ! waiting. \
    queue name=waiting max-size-time=0 max-size-bytes=0 max-size-buffers=0 ! mux. \
    audiotestsrc num-buffers=430 ! audio/x-raw,rate=44100,channels=2 ! avenc_aac ! aacparse ! others. \
    queue name=others max-size-time=0 max-size-bytes=0 max-size-buffers=0 ! mux.";

/// What the program said.
fn said(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr[..]].concat()).into_owned()
}

/// What `measure` finds in a clip, and what it warns of.
fn measure(clip: &Path) -> (Value, String) {
    let output = rsrectify("measure").arg(clip).args(["--quick", "--json"]).output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    (report["clips"][0].clone(), String::from_utf8(output.stderr).unwrap())
}

/// A part of the clip of the tests with other frames: so many, of this size.
fn clip_of(frames: u32, width: u32, height: u32) -> String {
    CLIP.replace("num-buffers=30", &format!("num-buffers={frames}"))
        .replace("width=320,height=240", &format!("width={width},height={height}"))
}

#[test]
fn clips_that_do_not_state_their_colours_are_analysed() {
    let folder = Folder::new("untagged");
    let clip =
        folder.clip("untagged.avi", "avimux", &CLIP.replace("x264enc speed-preset=ultrafast", "avenc_mpeg4"));
    let (found, warnings) = measure(&clip);
    assert_eq!((&found["frames"], warnings.as_str()), (&Value::from(30), ""), "{found}");
}

#[test]
fn video_that_begins_late_is_analysed_and_rectified() {
    let folder = Folder::new("late");
    for (name, muxer) in [("late.mp4", "mp4mux"), ("late.mkv", "matroskamux"), ("late.ts", "mpegtsmux")] {
        let clip = folder.clip(name, muxer, LATE);
        let (found, _) = measure(&clip);
        assert_eq!(found["frames"], 90, "{name}: {found}");
        let output = folder.file(&format!("{name}.mkv"));
        let fixed = rsrectify("fix").arg(&clip).arg("--output").arg(&output).output().unwrap();
        let told = said(&fixed);
        assert!(
            fixed.status.success() && told.contains("90 frames") && told.contains("readout:"),
            "{name}: {told}"
        );
        assert!(!told.contains("not sought"), "{name}: {told}");
    }
}

#[test]
fn video_that_is_short_beside_its_sound_is_no_preview() {
    let folder = Folder::new("short");
    let clip = folder.clip("short.mp4", "mp4mux", &LATE.replace("num-buffers=90", "num-buffers=20"));
    assert_eq!(measure(&clip).0["frames"], 20);
}

#[test]
fn a_rate_that_is_not_kept_changes_neither_readout_nor_certainty() {
    let folder = Folder::new("rates");
    let shaken = folder.file("shaken.mp4");
    write_shaken(&shaken, 1.5);
    let stated = |rate: u32| {
        let streams = format!(
            "filesrc location={} ! qtdemux ! h264parse ! capssetter caps=video/x-h264,framerate={rate}/1 ! mux.",
            shaken.display()
        );
        measure(&folder.clip(&format!("{rate}.mkv"), "matroskamux", &streams)).0
    };
    let number = |value: &Value| value.as_f64().unwrap();
    let truth = stated(30);
    for rate in [90_000, 1000, 60, 10] {
        let found = stated(rate);
        assert!((number(&found["frame_rate"]) - FPS).abs() < 0.1, "{rate}: {found}");
        assert!((number(&found["signed_readout_ms"]) + 1e3 * RATIO / FPS).abs() < 2.0, "{rate}: {found}");
        let [ours, theirs] = [&found, &truth].map(|found| number(&found["readout_deviation_ms"]));
        assert!((ours / theirs - 1.0).abs() < 0.1, "{rate}: {ours} {theirs}");
    }
}

#[test]
fn frames_before_which_no_key_frame_is_near_are_measured_once() {
    let folder = Folder::new("key-frames");
    let streams = clip_of(700, 64, 48).replace("ultrafast", "ultrafast key-int-max=1000");
    let (found, _) = measure(&folder.clip("one-key-frame.mp4", "mp4mux", &streams));
    let frames = found["frames"].as_u64().unwrap();
    assert!((600..=700).contains(&frames), "{found}");
}

#[test]
fn what_comes_before_a_change_of_size_is_measured_and_that_is_told() {
    let folder = Folder::new("change");
    let [large, small] = [(320, 240), (160, 120)].map(|(width, height)| {
        let streams = clip_of(30, width, height).replace("! mux.", "! h264parse ! mux.");
        std::fs::read(folder.clip(&format!("{width}.ts"), "mpegtsmux", &streams)).unwrap()
    });
    let clip = folder.file("change.ts");
    std::fs::write(&clip, [large, small].concat()).unwrap();
    let (found, warnings) = measure(&clip);
    assert_eq!((&found["frames"], &found["width"]), (&Value::from(30), &Value::from(320)), "{found}");
    assert!(warnings.contains("320x240") && warnings.contains("160x120"), "{warnings}");
    // A table of half the clip is kept, and not passed off as whole.
    let table = folder.file("motion.csv");
    let output =
        rsrectify("track").arg(&clip).args(["--readout-time", "0", "--csv"]).arg(&table).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    assert!(said(&output).contains("160x120"), "{}", said(&output));
    assert_eq!(std::fs::read_to_string(&table).unwrap().lines().count(), 31);
}

#[test]
fn a_few_frames_are_too_few() {
    let folder = Folder::new("few");
    for frames in [1, 3] {
        let clip = folder.clip(&format!("{frames}.mp4"), "mp4mux", &clip_of(frames, 320, 240));
        let (found, _) = measure(&clip);
        assert_eq!(
            (&found["frames"], &found["certain"]),
            (&Value::from(frames), &Value::from(false)),
            "{found}"
        );
        assert!(found["doubts"][0].as_str().unwrap().contains("too few frames"), "{found}");
    }
}

#[test]
fn h264_in_a_program_stream_without_a_map_is_decoded() {
    let folder = Folder::new("program-stream");
    // GStreamer's muxer writes a map of its streams; without it the demuxer takes each for MPEG video.
    // The demuxer ends with the last pack, which are as many as fill with data.
    let streams = CLIP
        .replace("pattern=gradient", "pattern=snow")
        .replace("! mux.", "! video/x-h264,stream-format=byte-stream ! h264parse ! mux.");
    let mut bytes = std::fs::read(folder.clip("mapped.mpg", "mpegpsmux", &streams)).unwrap();
    let mut maps = 0;
    for at in 0..bytes.len() - 4 {
        if bytes[at..at + 4] == [0, 0, 1, 0xbc] {
            // Padding.
            bytes[at + 3] = 0xbe;
            maps += 1;
        }
    }
    assert!(maps > 0);
    let clip = folder.file("unmapped.mpg");
    std::fs::write(&clip, bytes).unwrap();
    assert_eq!(measure(&clip).0["frames"], 30);
}

#[test]
fn a_clip_that_cannot_be_searched_is_played_and_the_reason_told() {
    let folder = Folder::new("unsearched");
    let streams = CLIP
        .replace("framerate=30/1", "framerate=30/1,interlace-mode=interleaved")
        .replace("! mux.", "interlaced=true ! h264parse ! mux.");
    let clip = folder.clip("interlaced.mkv", "matroskamux", &streams);
    let output = rsrectify("fix").arg(&clip).output().unwrap();
    let told = said(&output);
    assert!(output.status.success() && told.contains("30 frames"), "{told}");
    assert!(told.contains("warning") && told.contains("is interlaced"), "{told}");
}

#[test]
fn outputs_that_cannot_be_written_are_refused_before_the_search() {
    let folder = Folder::new("unwritable");
    let clip = folder.clip("clip.mp4", "mp4mux", &format!("{CLIP} {TONE} ! avenc_aac ! mux."));
    let missing = |name: &str| folder.file("missing").join(name);
    std::fs::create_dir_all(folder.file("taken/clip-rectified.mp4")).unwrap();
    let run = |command: &str, option: &str, output: PathBuf| {
        let output =
            rsrectify(command).arg(&clip).arg(option).arg(output).arg("--overwrite").output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{command}: {}", said(&output));
        let told = said(&output);
        assert!(!told.contains("readout") && !told.contains("panicked"), "{command}: {told}");
        told
    };
    for (command, option, name) in [
        ("fix", "--output", "a.mp4"),
        ("show", "--output", "a.mp4"),
        ("plot", "--output", "a.svg"),
        ("track", "--csv", "a.csv"),
    ] {
        let told = run(command, option, missing(name));
        assert!(told.contains("cannot write") && told.contains("No such file"), "{command}: {told}");
    }
    assert!(run("fix", "--output", folder.file("taken")).contains("is a folder"));
    // What was there stays, and nothing else is left.
    let kept = folder.file("kept.csv");
    std::fs::write(&kept, "mine").unwrap();
    let output = rsrectify("track").arg(&clip).arg("--csv").arg(&kept).output().unwrap();
    assert!(said(&output).contains("--overwrite"), "{}", said(&output));
    assert_eq!(std::fs::read_to_string(&kept).unwrap(), "mine");
    assert_eq!(folder.names(), ["clip.mp4", "kept.csv", "taken"]);
}

#[test]
fn who_reads_half_of_the_completions_is_no_error() {
    let mut child = rsrectify("completions")
        .arg("bash")
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{}", said(&output));
}

#[test]
fn a_portrait_clip_of_a_phone_is_compared() {
    let Some(data) = std::env::var_os("RSRECTIFY_DATA") else {
        eprintln!("skipped: RSRECTIFY_DATA is not set");
        return;
    };
    let folder = Folder::new("compared");
    let (clip, output) = (Path::new(&data).join("zoo/iphone-gps.mov"), folder.file("compared.mov"));
    let fixed =
        rsrectify("fix").arg(clip).arg("--output").arg(&output).arg("--compare").args(READOUT).output();
    let fixed = fixed.unwrap();
    assert!(fixed.status.success(), "{}", said(&fixed));
    let frames = crate::shared::buffers(&output, "decodebin ! videoconvert");
    // Two pictures of 320 x 568, upright.
    assert!(
        frames.len() >= 120 && crate::shared::size(&frames[0]).0 > crate::shared::size(&frames[0]).1,
        "{}",
        frames.len()
    );
}
