// SPDX-License-Identifier: MIT OR Apache-2.0

//! Parts of a clip: `index`, `fix --frames`, `join`, and `measure --frames`.

use crate::common::shake::{shaken, write_film};
use crate::shared::{Folder, TONE, buffers, rsrectify, times};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// What is decoded, as bytes.
const DECODED: &str = "decodebin ! videoconvert ! video/x-raw,format=I420";
/// A second and a half of moving video.
const BALL: &str = "videotestsrc num-buffers=45 pattern=ball \
    ! video/x-raw,format=I420,width=160,height=120,framerate=30/1 ! timeoverlay";
/// Where the parts begin and end.
const RANGES: [&str; 3] = [":14", "14:31", "31:"];

/// Runs a command that is to succeed; what it prints.
fn run(command: &str, arguments: &[&str]) -> String {
    let output = rsrectify(command).args(arguments).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{command} {arguments:?}: {said}");
    String::from_utf8(output.stdout).unwrap()
}

/// Runs a command that is to fail for the clip's sake; why it did.
fn refused(command: &str, arguments: &[&str]) -> String {
    let output = rsrectify(command).args(arguments).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{command} {arguments:?}: {said}");
    said
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Passes a clip through without rectifying it, so that every frame is known; `range` of it, or all.
fn pass(clip: &Path, output: &Path, codec: &str, range: Option<&str>) {
    let mut arguments = vec![text(clip), "--output", text(output), "--codec", codec];
    // The faster estimator: what it finds is not applied.
    arguments.extend(["--strength", "0", "--readout-time", "0", "--estimator", "sequential", "--overwrite"]);
    arguments.extend(range.into_iter().flat_map(|range| ["--frames", range]));
    run("fix", &arguments);
}

/// The whole, the parts, and what they are joined to.
fn joined(folder: &Folder, clip: &Path, codec: &str, ending: &str) -> (PathBuf, Vec<PathBuf>, PathBuf) {
    let named = |name: &str| folder.file(&format!("{name}.{ending}"));
    let (whole, output) = (named("whole"), named("joined"));
    pass(clip, &whole, codec, None);
    let parts: Vec<_> = RANGES.iter().enumerate().map(|(n, _)| named(&format!("part-{n}"))).collect();
    for (part, range) in parts.iter().zip(RANGES) {
        pass(clip, part, codec, Some(range));
    }
    let mut arguments = vec![text(clip)];
    arguments.extend(parts.iter().map(|part| text(part)));
    arguments.extend(["--output", text(&output), "--overwrite"]);
    run("join", &arguments);
    (whole, parts, output)
}

fn bytes(samples: &[gst::Sample]) -> Vec<Vec<u8>> {
    samples.iter().map(|sample| sample.buffer().unwrap().map_readable().unwrap().to_vec()).collect()
}

fn frames(path: &Path) -> Vec<gst::Sample> {
    buffers(path, DECODED)
}

#[test]
fn parts_have_the_frames_of_the_whole() {
    let folder = Folder::new("parts-frames");
    // Frames that refer to later ones, and across key frames.
    let pyramid = format!("{BALL} ! x264enc key-int-max=20 bframes=4 b-pyramid=true b-adapt=false ! mux.");
    let open = format!(
        "{BALL} ! x265enc option-string=open-gop=1:keyint=12:bframes=4:b-adapt=0:log-level=error ! h265parse ! mux."
    );
    for (clip, muxer, streams) in [
        ("pyramid.mp4", "mp4mux", pyramid),
        ("open.mkv", "matroskamux", open.clone()),
        ("open.ts", "mpegtsmux", open),
    ] {
        let clip = folder.clip(clip, muxer, &streams);
        let (whole, parts, output) = joined(&folder, &clip, "ffv1", "mkv");
        let truth = bytes(&frames(&clip));
        assert_eq!(truth.len(), 45);
        let apart: Vec<_> = parts.iter().map(|part| frames(part)).collect();
        assert_eq!(apart.iter().map(Vec::len).collect::<Vec<_>>(), [14, 17, 14], "{}", clip.display());
        assert!(apart.iter().all(|part| times(part)[0] == Some(0)), "{}", clip.display());
        assert!(apart.iter().flat_map(|part| bytes(part)).eq(truth.iter().cloned()), "{}", clip.display());
        let (whole, output) = (frames(&whole), frames(&output));
        assert!(bytes(&output) == truth, "{}", clip.display());
        assert_eq!(times(&output), times(&whole), "{}", clip.display());
    }
}

#[test]
fn a_joined_film_has_the_clips_streams_and_times() {
    let folder = Folder::new("parts-streams");
    // No frame rate holds.
    let video = format!(
        "{BALL} ! identity drop-probability=0.2 ! timecodestamper set=always set-internal-timecode=01:02:03:04 \
         ! x264enc key-int-max=20 bframes=0 ! mux."
    );
    let streams = format!("{video} {TONE} ! avenc_aac ! mux. {TONE} ! volume volume=0.5 ! avenc_aac ! mux.");
    let clip = folder.clip("clip.mov", "qtmux", &streams);
    let count = frames(&clip).len();
    assert!((32..45).contains(&count), "{count} frames");
    let (whole, parts, output) = joined(&folder, &clip, "hevc", "mov");
    let (ours, theirs) = (frames(&output), frames(&whole));
    // A muxer makes a clock of the average frame rate, a hundred ticks a frame, and rounds durations to it.
    let ticks = 2 * 1_000_000 / 2000;
    for other in [&theirs, &frames(&clip)] {
        let differences = times(&ours).into_iter().zip(times(other));
        let most = differences.map(|(a, b)| a.unwrap().abs_diff(b.unwrap())).max();
        assert!(ours.len() == other.len() && most.unwrap() <= ticks, "{most:?}");
    }
    // No frame is broken where parts meet.
    assert!(parts.iter().flat_map(|part| bytes(&frames(part))).eq(bytes(&ours)));
    for track in ["audio_0", "audio_1"] {
        let packets = |path: &Path| buffers(path, &format!("qtdemux name=d d.{track} ! queue"));
        let (ours, theirs) = (packets(&output), packets(&clip));
        assert!(ours.len() > 40 && bytes(&ours) == bytes(&theirs), "{track}");
        assert_eq!(times(&ours), times(&packets(&whole)), "{track}");
    }
    // The timecode track's sample is the number of the first frame: ((1·60 + 2)·60 + 3)·30 + 4.
    let number = 111_694_u32.to_be_bytes();
    for (file, range) in [(&output, None), (&folder.file("later.mov"), Some("2:"))] {
        let number = match range {
            None => number,
            Some(_) => {
                pass(&clip, file, "hevc", range);
                111_696_u32.to_be_bytes()
            }
        };
        let film = std::fs::read(file).unwrap();
        assert!(film.windows(4).any(|name| name == b"tmcd"), "{}", file.display());
        assert!(film.windows(4).any(|sample| sample == number), "{}", file.display());
    }
}

#[test]
fn what_is_joined_is_told_and_agrees_with_an_index_of_it() {
    let folder = Folder::new("parts-told");
    let clip =
        folder.clip("clip.mp4", "mp4mux", &format!("{BALL} ! x264enc ! mux. {TONE} ! avenc_aac ! mux."));
    let index = folder.file("clip.json");
    run("index", &[text(&clip), "--output", text(&index)]);
    let read = |text: &str| serde_json::from_str::<Value>(text).unwrap();
    let listed = read(&std::fs::read_to_string(&index).unwrap());
    let truth: Vec<_> = (0..45).map(|frame| Some((frame * 1_000_000 + 15) / 30)).collect();
    let micros = |value: &Value| value.as_u64().map(|time| (time + 500) / 1000);
    assert_eq!(listed["times_ns"].as_array().unwrap().iter().map(micros).collect::<Vec<_>>(), truth);
    let (_, parts, output) = joined(&folder, &clip, "ffv1", "mkv");
    let mut arguments = vec![text(&clip)];
    arguments.extend(parts.iter().map(|part| text(part)));
    arguments.extend(["-o", text(&output), "--overwrite", "--json", "--index", text(&index)]);
    let report = read(&run("join", &arguments));
    // Whatever file they are in, frames are the same.
    let again = read(&run("index", &[text(&output)]));
    assert_eq!((&report["frames"], &report["sha256"]), (&again["frames"], &again["sha256"]));
    for (part, file) in report["parts"].as_array().unwrap().iter().zip(&parts) {
        assert_eq!(part["sha256"], read(&run("index", &[text(file)]))["sha256"]);
    }
}

#[test]
fn what_is_no_whole_clip_is_refused() {
    let folder = Folder::new("parts-refused");
    let clip = folder.clip("clip.mp4", "mp4mux", &format!("{BALL} ! x264enc ! mux."));
    // Of one length, so that no count tells them apart.
    let part = |name: &str, range: &str, options: &[&str]| {
        let file = folder.file(name);
        let mut arguments = vec![text(&clip), "-o", text(&file), "--frames", range, "--readout-time", "0"];
        arguments.extend(["--estimator", "sequential"]);
        arguments.extend(options);
        run("fix", &arguments);
        file
    };
    let [a, b, c] = ["0:15", "15:30", "30:45"].map(|range| part(&format!("{}.mkv", &range[..2]), range, &[]));
    let worse = part("worse.mkv", "15:30", &["--codec", "hevc"]);
    let wide = part("wide.mkv", "15:30", &["--compare"]);
    let [cut, words] = ["cut.mkv", "words.mkv"].map(|name| folder.file(name));
    std::fs::write(&cut, &std::fs::read(&b).unwrap()[..2000]).unwrap();
    std::fs::write(&words, "no video").unwrap();
    let before = folder.names();
    let output = folder.file("out.mp4");
    let missing = folder.file("missing.mkv");
    for (parts, reason) in [
        (&[&a, &c, &b][..], "begins with frame 30 of the clip where frame 15 should follow"),
        (&[&a, &b], "the parts have 30 frames, the clip 45"),
        (&[&a, &b, &b, &c], "begins with frame 15 of the clip where frame 30"),
        (&[&a, &worse, &c], "worse.mkv is encoded otherwise"),
        (&[&a, &wide, &c], "wide.mkv is encoded otherwise"),
        (&[&a, &cut, &c], "frame"),
        (&[&a, &words, &c], "words.mkv"),
        (&[&a, &missing, &c], "missing.mkv: cannot be read"),
    ] {
        let mut arguments = vec![text(&clip), "--output", text(&output)];
        arguments.extend(parts.iter().map(|part| text(part)));
        let said = refused("join", &arguments);
        assert!(said.contains(reason), "{said}");
        assert_eq!(folder.names(), before, "{said}");
    }
    // The clip, or a file that is there, is not written over.
    for (output, reason) in [(&clip, "the same file"), (&worse, "--overwrite")] {
        let said = refused("join", &[text(&clip), text(&a), text(&b), text(&c), "--output", text(output)]);
        assert!(said.contains(reason), "{said}");
    }
    for output in ["out.avi", "out.y4m"] {
        let options = [text(&clip), text(&a), "--output", output];
        assert_eq!(rsrectify("join").args(options).output().unwrap().status.code(), Some(2), "{output}");
    }
}

#[test]
fn what_has_no_such_frames_is_refused() {
    let folder = Folder::new("parts-index");
    let clip = folder.clip("clip.mp4", "mp4mux", &format!("{BALL} ! x264enc ! mux."));
    let other = folder.clip("other.mp4", "mp4mux", &format!("{BALL} ! x264enc ! mux.").replace("=45", "=60"));
    let [index, same_size, words, broken] =
        ["other.json", "same_size.json", "words.json", "broken.mp4"].map(|name| folder.file(name));
    run("index", &[text(&other), "--output", text(&index)]);
    let mut listed = serde_json::from_slice::<Value>(&std::fs::read(&index).unwrap()).unwrap();
    listed["bytes"] = std::fs::metadata(&clip).unwrap().len().into();
    std::fs::write(&same_size, listed.to_string()).unwrap();
    std::fs::write(&words, "{}").unwrap();
    let whole = std::fs::read(&clip).unwrap();
    std::fs::write(&broken, &whole[..whole.len() / 2]).unwrap();
    let sound = folder.clip("sound.mov", "qtmux", &format!("{TONE} ! avenc_aac ! mux."));
    let before = folder.names();
    for (clip, options, reason) in [
        (&clip, &["--frames", "40:46"][..], "there are no frames 40 to 46: the clip has 45"),
        (&clip, &["--frames", "45:"], "there are no frames 45 to 45: the clip has 45"),
        (&clip, &["--frames", "0:5", "--index", text(&index)], "is the index of a clip of"),
        (&clip, &["--frames", "40:60", "--index", text(&same_size)], "its index of another one"),
        (&clip, &["--frames", "0:5", "--index", text(&words)], "is no index of frames"),
        (&broken, &["--frames", "0:5"], "not written to its end"),
        (&sound, &["--frames", "0:5"], "there is no video"),
    ] {
        let said = refused("fix", &[&[text(clip), "--readout-time", "0"], options].concat());
        assert!(said.contains(reason), "{said}");
        assert_eq!(folder.names(), before, "{said}");
    }
    let said = refused("measure", &[text(&clip), "--frames", "40:60", "--index", text(&same_size)]);
    assert!(said.contains("its index of another one"), "{said}");
    let said =
        refused("join", &[text(&clip), text(&clip), "--output", "joined.mp4", "--index", text(&index)]);
    assert!(said.contains("is the index of a clip of"), "{said}");
    for clip in [&broken, &sound, &words] {
        refused("index", &[text(clip)]);
    }
}

#[cfg(unix)]
#[test]
fn an_interrupted_join_leaves_no_file() {
    let folder = Folder::new("parts-interrupted");
    // Long, and its own only part.
    let video = "videotestsrc num-buffers=20000 ! video/x-raw,width=16,height=16 ! jpegenc ! mux.";
    let clip = folder.clip("clip.mkv", "matroskamux", video);
    let mut command = rsrectify("join");
    command.arg(&clip).arg(&clip).arg("--output").arg(folder.file("out.mkv"));
    let mut child = command.stderr(std::process::Stdio::piped()).spawn().unwrap();
    let unfinished = folder.file("out.mkv.part");
    let started = Instant::now();
    while !unfinished.exists() {
        assert!(started.elapsed() < Duration::from_secs(20), "nothing is written");
        assert_eq!(child.try_wait().unwrap(), None, "it is done already");
        std::thread::sleep(Duration::from_millis(1));
    }
    let id = child.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    assert_eq!(child.wait_with_output().unwrap().status.code(), Some(130));
    assert_eq!(folder.names(), ["clip.mkv"]);
}

#[test]
fn cuts_and_the_readout_of_a_part_are_told() {
    let folder = Folder::new("parts-measured");
    const CUT: usize = 32;
    let clip = folder.file("clip.mp4");
    // The second shot is upside down.
    write_film(&clip, 60, |number| {
        let mut buffer = shaken(number);
        if number >= CUT {
            buffer.get_mut().unwrap().map_writable().unwrap().reverse();
        }
        buffer
    });
    let measured = |clip: &Path, range: &str| {
        let said = run("measure", &[text(clip), "--frames", range, "--json"]);
        serde_json::from_str::<Value>(&said).unwrap()["clips"][0].clone()
    };
    let cuts = |range: &str| measured(&clip, range)["cuts"].clone();
    assert_eq!(cuts("20:45"), serde_json::json!([CUT]));
    assert_eq!(cuts(":20"), serde_json::json!([]));
    assert_eq!(cuts(&format!("{CUT}:")), serde_json::json!([CUT]));
    let part = measured(&clip, "0:24");
    assert_eq!(part["frames"], 24);
    let weights = part["hypotheses"].as_array().unwrap().iter().map(|h| h["weight"].as_f64().unwrap());
    assert!((weights.sum::<f64>() - 1.0).abs() < 1e-9, "{part}");
    let prior = &part["prior"];
    assert!((prior["rows"].as_f64().unwrap() + prior["columns"].as_f64().unwrap() - 1.0).abs() < 1e-9);
    // The same frames, with nothing or another shot after them.
    let other = folder.file("other.mp4");
    for frames in [24, 40] {
        write_film(&other, frames, |number| {
            let mut buffer = shaken(number);
            if number >= 24 {
                buffer.get_mut().unwrap().map_writable().unwrap().fill(0);
            }
            buffer
        });
        assert_eq!(measured(&other, ":24")["hypotheses"], part["hypotheses"], "{frames}");
    }
}
