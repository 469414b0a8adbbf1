// SPDX-License-Identifier: MIT OR Apache-2.0

//! Editors: the element as an effect in a project of GStreamer Editing Services, rendered by
//! `ges-launch-1.0` with the plugin as it is built.

use crate::common::film::{FRAMES, Film, film, launch, shown};
use crate::common::plugin::PluginFolder;
use gst::prelude::*;
use std::ops::Range;
use std::path::Path;

/// Renders clips of a film, each with the effect, and reads the numbers of the frames.
fn render(plugins: &PluginFolder, film: &Film, clips: &[Range<usize>], effect: &str) -> Vec<usize> {
    let out = Film(plugins.0.join("out.mp4"));
    let mut command = plugins.command("ges-launch-1.0");
    for (index, clip) in clips.iter().enumerate() {
        let seconds = |frames: usize| format!("{:.6}", frames as f64 / 30.0);
        let start = clips[..index].iter().map(Range::len).sum();
        command.arg("+clip").arg(&film.0).arg(format!("start={}", seconds(start)));
        command.arg(format!("inpoint={}", seconds(clip.start)));
        command.arg(format!("duration={}", seconds(clip.len())));
        if !effect.is_empty() {
            command.args(["+effect", effect]);
        }
    }
    // The editor's mixer takes frame 48 for 47 at 30 frames a second behind any filter that needs
    // time, `identity sleep-time=5000` too.
    command.args(["--track-types", "video", "--no-interactive", "--disable-mixing"]);
    command.args(["--video-caps", "video/x-raw,width=320,height=240,framerate=30/1"]);
    command.args(["-f", "video/quicktime,variant=iso:video/x-h264"]).arg("-o").arg(&out.0);
    let result = command.output().expect("ges-launch-1.0 is installed");
    assert!(result.status.success(), "{}", String::from_utf8_lossy(&result.stderr));
    decode(&out.0)
}

fn decode(film: &Path) -> Vec<usize> {
    let pipeline = launch(&format!(
        "filesrc location={} ! decodebin ! videoconvert ! video/x-raw,format=GRAY8 ! appsink name=out sync=false",
        film.display()
    ));
    let sink = pipeline.by_name("out").unwrap().downcast::<gst_app::AppSink>().unwrap();
    pipeline.set_state(gst::State::Playing).unwrap();
    let numbers = std::iter::from_fn(|| sink.pull_sample().ok()).map(|sample| shown(&sample)).collect();
    pipeline.set_state(gst::State::Null).unwrap();
    numbers
}

#[test]
fn clips_have_the_frames_that_they_have_without_the_effect() {
    let film = film("editing");
    let plugins = PluginFolder::new("editing");
    let (whole, middle, early) = (0..FRAMES, 15..45, 5..25);
    for clips in [vec![whole], vec![middle.clone()], vec![middle, early]] {
        let truth = render(&plugins, &film, &clips, "");
        let wanted: Vec<usize> = clips.iter().cloned().flatten().collect();
        // The editor itself adds a black frame, number 0, at the end.
        assert_eq!(truth[..wanted.len()], wanted);
        for effect in ["rsrectify", "rsrectify lookahead=0", "rsrectify lookahead=64"] {
            assert_eq!(render(&plugins, &film, &clips, effect), truth, "{effect}");
        }
    }
}
