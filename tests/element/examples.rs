// SPDX-License-Identifier: MIT OR Apache-2.0

//! The examples in C and Python: compiled, run on a shaken film whose readout is known, and what they print and write.

use crate::common::film::launch;
use crate::common::plugin::PluginFolder;
use crate::common::shake::{FPS, RATIO, shaken, write_shaken};
use crate::common::{SIZE, init};
use gst::prelude::*;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Frames of the shaken film.
const FRAMES: usize = 75;

fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples").join(name)
}

/// Runs a command to its end; gives what it printed, and what it printed as errors.
fn run(command: &mut Command) -> (String, String) {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let (out, errors) =
        (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
    assert!(output.status.success(), "{command:?}:\n{out}{errors}");
    (out, errors)
}

/// Writes the shaken film as raw frames; gives its path.
fn raw_film(folder: &Path) -> PathBuf {
    init();
    let path = folder.join("in.raw");
    let pixels = |number| shaken(number).map_readable().unwrap().to_vec();
    std::fs::write(&path, (0..FRAMES).flat_map(pixels).collect::<Vec<_>>()).unwrap();
    path
}

/// What an example that takes raw frames makes of the shaken film: its output file is looked at, too.
fn check_raw_frames(plugins: &PluginFolder, mut command: Command) -> String {
    let (input, output) = (raw_film(&plugins.0), plugins.0.join("out.raw"));
    let (width, height, rate) = (SIZE.0.to_string(), SIZE.1.to_string(), FPS.to_string());
    command.args([&input, &output]).args(["GRAY8", &width, &height, &rate]);
    let (printed, errors) = run(&mut command);

    let lines: Vec<&str> = printed.lines().collect();
    assert_eq!(lines.len(), FRAMES, "{printed}");
    for (number, line) in lines.iter().enumerate() {
        // Number and time of each frame; the meta is there.
        let wanted = format!("frame {number}: {:.3} s, readout ", number as f64 / FPS);
        assert!(line.starts_with(&wanted) && line.contains("confidence"), "{line}");
    }
    let last = lines[FRAMES - 1];
    let field = |name: &str, unit: &str| {
        let value =
            last.split(", ").find_map(|part| part.strip_prefix(name)).unwrap_or_else(|| panic!("{last}"));
        value.split(unit).next().unwrap().parse::<f64>().unwrap()
    };
    let truth = 1e3 * RATIO / FPS;
    assert!((field("readout ", " ms") - truth).abs() < 0.1 * truth, "{last}");
    assert!(last.contains("ms bottom-to-top"), "{last}");
    assert!(field("confidence ", ",") > 0.9, "{last}");
    assert!(field("expected error ", " px") < 1.0, "{last}");

    let (before, after) = (std::fs::read(&input).unwrap(), std::fs::read(&output).unwrap());
    assert_eq!(after.len(), before.len());
    let frame = (SIZE.0 * SIZE.1) as usize;
    assert_ne!(after[frame * (FRAMES - 1)..], before[frame * (FRAMES - 1)..], "the last frame is rectified");
    errors
}

#[test]
fn raw_frames_in_c() {
    let plugins = PluginFolder::new("example-c");
    let flags = run(Command::new("pkg-config").args([
        "--cflags",
        "--libs",
        "gstreamer-app-1.0",
        "gstreamer-video-1.0",
    ]))
    .0;
    let program = plugins.0.join("rectify_frames");
    let mut compiler = Command::new("cc");
    compiler.args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-o"]).arg(&program);
    run(compiler.arg(example("c/rectify_frames.c")).args(flags.split_whitespace()));

    let mut command = plugins.command(&program);
    // Names every object that is not given back.
    command.env("GST_TRACERS", "leaks").env("GST_DEBUG", "GST_TRACER:7").env("GST_DEBUG_NO_COLOR", "1");
    let errors = check_raw_frames(&plugins, command);
    assert!(!errors.contains("Leaks detected"), "{errors}");

    let missing =
        plugins.command(&program).args(["no.raw", "out.raw", "I420", "64", "48", "30"]).output().unwrap();
    assert_eq!(missing.status.code(), Some(1));
    let wrong =
        plugins.command(&program).args(["no.raw", "out.raw", "I421", "64", "48", "30"]).output().unwrap();
    assert_eq!(wrong.status.code(), Some(2));
}

#[test]
fn raw_frames_in_python() {
    let plugins = PluginFolder::new("example-python");
    check_raw_frames(&plugins, plugins.command(example("python/rectify_frames.py")));
}

/// Luma and time of all frames of a file.
fn decode(path: &Path) -> Vec<(gst::ClockTime, Vec<u8>)> {
    let pipeline = launch(&format!(
        "filesrc location={} ! decodebin ! videoconvert ! video/x-raw,format=GRAY8 ! appsink name=out sync=false",
        path.display()
    ));
    let sink = pipeline.by_name("out").unwrap().downcast::<gst_app::AppSink>().unwrap();
    pipeline.set_state(gst::State::Playing).unwrap();
    let frames = std::iter::from_fn(|| sink.pull_sample().ok()).map(|sample| {
        let buffer = sample.buffer().unwrap();
        (buffer.pts().unwrap(), buffer.map_readable().unwrap().to_vec())
    });
    let frames = frames.collect();
    pipeline.set_state(gst::State::Null).unwrap();
    frames
}

#[test]
fn a_timeline_in_python() {
    init();
    let plugins = PluginFolder::new("example-timeline");
    let clips = ["first.mp4", "second.mp4"].map(|name| plugins.0.join(name));
    clips.iter().for_each(|clip| write_shaken(clip, FRAMES as f64 / FPS));
    let (output, project) = (plugins.0.join("out.mp4"), plugins.0.join("project.xges"));
    let mut command = plugins.command(example("python/edit_timeline.py"));
    run(command.arg(&output).args(&clips).args(["--seconds", "2", "--save"]).arg(&project));

    let frames = decode(&output);
    // The editor itself adds a frame at the end.
    let wanted = 2 * 2 * FPS as usize;
    assert!((wanted..=wanted + 1).contains(&frames.len()), "{} frames", frames.len());
    assert!(frames.windows(2).all(|pair| pair[0].0 < pair[1].0), "times in order");
    // Rectified: the clips are the same, and so are their frames, but not as they were.
    let mean_difference = |a: &[u8], b: &[u8]| {
        a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64
    };
    let (source, last) = (decode(&clips[0]), wanted / 2 - 1);
    assert!(mean_difference(&frames[last].1, &source[last].1) > 4.0);
    assert!(mean_difference(&frames[last].1, &frames[last + wanted / 2].1) < 2.0);

    let saved = std::fs::read_to_string(&project).unwrap();
    assert_eq!(saved.matches("asset-id='rsrectify'").count(), 2, "{saved}");
}
