// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify track --motion` and `rsrectify fix --motion`, run as a user runs them.

use crate::common::shake::write_shaken;
use crate::shared::{CLIP, Folder, buffers, rsrectify};
use rsrectify::motion::file::MotionFile;
use std::path::{Path, PathBuf};
use std::process::Output;

/// The readout of the shaken film.
const READOUT: [&str; 4] = ["--readout-time", "20", "--readout-direction", "bottom-to-top"];

fn run(command: &str, clip: &Path, options: &[&str]) -> Output {
    rsrectify(command).arg(clip).args(options).output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// What the program said.
fn said(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr[..]].concat()).into_owned()
}

/// A command that succeeds; what it said.
fn succeeds(command: &str, clip: &Path, options: &[&str]) -> String {
    let output = run(command, clip, options);
    assert!(output.status.success(), "{}", said(&output));
    said(&output)
}

/// The shaken film and its motion.
fn shaken(folder: &Folder) -> [PathBuf; 2] {
    let (clip, motion) = (folder.file("shaken.mp4"), folder.file("shaken.motion"));
    write_shaken(&clip, 0.8);
    succeeds("track", &clip, &[&["--motion", text(&motion)], &READOUT[..]].concat());
    [clip, motion]
}

/// The decoded frames of an MP4 file.
fn frames(path: &Path) -> Vec<Vec<u8>> {
    let samples = buffers(path, "qtdemux ! h264parse ! avdec_h264 ! videoconvert ! video/x-raw,format=GRAY8");
    let data = |sample: &gst::Sample| sample.buffer().unwrap().map_readable().unwrap().to_vec();
    samples.iter().map(data).collect()
}

/// Mean absolute difference of two frames in grey levels.
fn difference(a: &[u8], b: &[u8]) -> f64 {
    let sum: u32 = a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
    f64::from(sum) / a.len() as f64
}

#[test]
fn a_motion_file_gives_the_same_bytes() {
    let folder = Folder::new("motion");
    let [clip, motion] = shaken(&folder);
    let (plain, filed) = (folder.file("plain.mp4"), folder.file("filed.mp4"));
    succeeds("fix", &clip, &[&["--output", text(&plain)], &READOUT[..]].concat());
    let told = succeeds("fix", &clip, &["--output", text(&filed), "--motion", text(&motion)]);
    assert!(!told.contains("warning") && !told.contains("readout:"), "{told}");
    assert!(told.contains("readout time  -20.0 ms, bottom-to-top, as in the motion file"), "{told}");
    assert!(std::fs::read(&plain).unwrap() == std::fs::read(&filed).unwrap(), "the files differ");
    let changed =
        frames(&clip).iter().zip(frames(&plain)).map(|(a, b)| difference(a, &b)).fold(0.0, f64::max);
    assert!(changed > 3.0, "nothing was rectified: {changed}");

    let file = MotionFile::open(&motion).unwrap();
    assert_eq!((file.clip().name.as_str(), file.frames()), ("shaken.mp4", frames(&clip).len()));
    assert_eq!(file.clip().bytes, std::fs::metadata(&clip).unwrap().len());
    let size = std::fs::metadata(&motion).unwrap().len();
    assert!(size < 3000 * file.frames() as u64, "{size} bytes of {} frames", file.frames());

    // What the picture alone tells is in it too.
    succeeds("track", &clip, &["--motion", text(&motion), "--overwrite"]);
    succeeds("fix", &clip, &["--output", text(&plain), "--overwrite"]);
    succeeds("fix", &clip, &["--output", text(&filed), "--overwrite", "--motion", text(&motion)]);
    assert!(std::fs::read(&plain).unwrap() == std::fs::read(&filed).unwrap(), "the files differ");
}

#[test]
fn a_steadied_clip_is_steadied_by_its_motion_file() {
    let folder = Folder::new("motion-steadied");
    let [clip, motion] = shaken(&folder);
    let [plain, filed, other] = ["plain.mp4", "filed.mp4", "other.mp4"].map(|name| folder.file(name));
    let steadied = [&["--stabilize=0.2"], &READOUT[..]].concat();
    let told = succeeds("fix", &clip, &[&["--output", text(&plain)], &steadied[..]].concat());
    let crop = told.lines().find(|line| line.starts_with("crop: ")).unwrap();
    let told =
        succeeds("track", &clip, &[&["--motion", text(&motion), "--overwrite"], &steadied[..]].concat());
    assert!(told.contains(crop), "{told}");
    succeeds("fix", &clip, &["--output", text(&filed), "--motion", text(&motion)]);
    assert!(std::fs::read(&plain).unwrap() == std::fs::read(&filed).unwrap(), "the files differ");
    let file = MotionFile::open(&motion).unwrap();
    assert!(file.clip().zoom > 1.0 && file.record(10).unwrap().motion.placement().is_some());
    // What is asked for wins.
    succeeds("fix", &clip, &["--output", text(&other), "--motion", text(&motion), "--border-mode", "mirror"]);
    assert!(difference(&frames(&other)[10], &frames(&filed)[10]) > 1.0);
    let refused = run("track", &clip, &["--stabilize=0.2"]);
    assert!(!refused.status.success() && said(&refused).contains("--motion"), "{}", said(&refused));
}

#[test]
fn the_least_crop_is_found_in_a_motion_file() {
    let folder = Folder::new("motion-crop");
    let [clip, motion] = shaken(&folder);
    let [plain, filed] = ["plain.mp4", "filed.mp4"].map(|name| folder.file(name));
    let found = succeeds("fix", &clip, &[&["--output", text(&plain), "--crop=auto"], &READOUT[..]].concat());
    let read = succeeds("fix", &clip, &["--output", text(&filed), "--motion", text(&motion), "--crop=auto"]);
    let crop = found.lines().find(|line| line.starts_with("crop: ")).unwrap();
    assert!(read.contains(crop), "{read}");
    assert!(std::fs::read(&plain).unwrap() == std::fs::read(&filed).unwrap(), "the files differ");
}

#[test]
fn the_phone_clip_has_the_same_bytes() {
    let Some(data) = std::env::var_os("RSRECTIFY_DATA") else {
        return eprintln!("skipped: RSRECTIFY_DATA is not set");
    };
    let folder = Folder::new("motion-phone");
    let [clip, motion, plain, filed] =
        ["clip.mp4", "motion", "plain.mp4", "filed.mp4"].map(|name| folder.file(name));
    // Its first frames: what is done of a frame is the same for each that follows.
    let mut cut = std::process::Command::new("ffmpeg");
    cut.args(["-nostdin", "-v", "error", "-i"]).arg(PathBuf::from(data).join("phone/phone.mp4"));
    assert!(cut.args(["-frames:v", "20", "-c", "copy"]).arg(&clip).status().unwrap().success());
    succeeds("track", &clip, &["--motion", text(&motion)]);
    succeeds("fix", &clip, &["--output", text(&plain)]);
    succeeds("fix", &clip, &["--output", text(&filed), "--motion", text(&motion)]);
    assert!(std::fs::read(&plain).unwrap() == std::fs::read(&filed).unwrap(), "the files differ");
}

#[test]
fn parts_and_proxies_are_rectified_by_the_file_of_the_whole() {
    let folder = Folder::new("motion-parts");
    let [clip, motion] = shaken(&folder);
    let whole = folder.file("whole.mp4");
    // Nearly without loss, so that frames can be compared between encodings.
    let given = ["--motion", text(&motion), "--quality", "2"];
    succeeds("fix", &clip, &[&["--output", text(&whole)], &given[..]].concat());
    let part = folder.file("part.mp4");
    succeeds("fix", &clip, &[&["--output", text(&part), "--frames", "10:20"], &given[..]].concat());
    let (whole, part) = (frames(&whole), frames(&part));
    assert_eq!(part.len(), 10);
    for (index, frame) in part.iter().enumerate() {
        let wrong = difference(frame, &whole[10 + index]);
        // What two encodings differ by.
        assert!(wrong < 1.0, "frame {index}: {wrong}");
    }

    let half = folder.file("half.mp4");
    let pipeline = format!(
        "filesrc location={} ! qtdemux ! h264parse ! avdec_h264 ! videoscale method=4 ! video/x-raw,width=160,height=120 \
         ! x264enc pass=qual quantizer=2 ! mp4mux ! filesink location={}",
        text(&clip),
        text(&half)
    );
    let mut launch = std::process::Command::new("gst-launch-1.0");
    let launched = launch.arg("-q").args(pipeline.split_whitespace()).status().unwrap();
    assert!(launched.success());
    let (fixed, own) = (folder.file("half-fixed.mp4"), folder.file("half-own.mp4"));
    let told = succeeds("fix", &half, &[&["--output", text(&fixed)], &given[..]].concat());
    assert!(told.contains("is of shaken.mp4"), "{told}");
    succeeds("fix", &half, &[&["--output", text(&own), "--quality", "2"], &READOUT[..]].concat());
    let (half, fixed, own) = (frames(&half), frames(&fixed), frames(&own));
    let mean = |other: &[Vec<u8>]| {
        let pairs = fixed.iter().zip(other).skip(5);
        pairs.map(|(a, b)| difference(a, b)).sum::<f64>() / (fixed.len() - 5) as f64
    };
    assert!(mean(&own) < 0.25 * mean(&half), "{} of {}", mean(&own), mean(&half));
}

#[test]
fn the_file_states_how_players_show_the_clip() {
    let folder = Folder::new("shown");
    let [clip, motion] = shaken(&folder);
    let shown = MotionFile::open(&motion).unwrap().clip().clone();
    assert_eq!((shown.mirrored, shown.turned, shown.pixel_aspect), (false, 0, [1, 1]));
    // The first element of the matrix in the header of the only track, by ISO/IEC 14496-12, made negative.
    let mut bytes = std::fs::read(&clip).unwrap();
    let header = bytes.windows(4).position(|name| name == b"tkhd").unwrap() + 4;
    let element = &mut bytes[header + 40..header + 44];
    assert_eq!(element, [0, 1, 0, 0]);
    element.copy_from_slice(&[0xff, 0xff, 0, 0]);
    let (mirrored, motion) = (folder.file("mirrored.mp4"), folder.file("mirrored.motion"));
    std::fs::write(&mirrored, bytes).unwrap();
    let told = succeeds("track", &mirrored, &[&["--motion", text(&motion)], &READOUT[..]].concat());
    assert!(told.contains("players mirror the clip"), "{told}");
    assert!(MotionFile::open(&motion).unwrap().clip().mirrored);

    let video = "videotestsrc num-buffers=12 ! video/x-raw,format=I420,width=160,height=120,framerate=25/1,pixel-aspect-ratio=2/1 \
        ! x264enc speed-preset=ultrafast ! mux.";
    let (narrow, motion) = (folder.clip("narrow.mkv", "matroskamux", video), folder.file("narrow.motion"));
    succeeds("track", &narrow, &[&["--motion", text(&motion)], &READOUT[..]].concat());
    assert_eq!(MotionFile::open(&motion).unwrap().clip().pixel_aspect, [2, 1]);
}

#[test]
fn a_file_that_does_not_fit_is_refused() {
    let folder = Folder::new("motion-misfit");
    let [clip, motion] = shaken(&folder);
    let output = folder.file("out.mp4");
    let fails = |clip: &Path, motion: &Path, code, reason: &str| {
        let failed = run("fix", clip, &["--output", text(&output), "--motion", text(motion)]);
        let told = said(&failed);
        assert!(failed.status.code() == Some(code) && told.contains(reason), "{told}");
        assert!(!output.exists());
    };
    fails(&clip, &folder.file("missing"), 2, "cannot use");
    fails(&clip, &clip, 2, "not a motion file");
    let wide = CLIP.replace("width=320", "width=426");
    let wide = folder.clip("wide.mp4", "mp4mux", &wide);
    fails(&wide, &motion, 1, "another shape");
    let late = CLIP.replace("num-buffers=30", "num-buffers=30 timestamp-offset=9000000000");
    let late = folder.clip("late.mkv", "matroskamux", &late.replace("ultrafast", "ultrafast ! h264parse"));
    fails(&late, &motion, 1, "of another clip");
    // It is longer than the file.
    let long = folder.file("long.mp4");
    write_shaken(&long, 1.0);
    let told = succeeds("fix", &long, &["--output", text(&output), "--motion", text(&motion)]);
    assert!(told.contains("does not have 6 of 30 frames: they stay as they are"), "{told}");
    let both = run("fix", &clip, &["--motion", text(&motion), "--readout-time", "20"]);
    assert_eq!(both.status.code(), Some(2));
    let two = rsrectify("fix").args([&clip, &long]).arg("--motion").arg(&motion).output().unwrap();
    assert!(two.status.code() == Some(2) && said(&two).contains("--motion is of one clip"), "{}", said(&two));
    // What was written stays unless it may be replaced.
    let again = run("track", &clip, &["--motion", text(&motion)]);
    assert!(said(&again).contains("--overwrite"), "{}", said(&again));
    assert!(MotionFile::open(&motion).is_ok());
}
