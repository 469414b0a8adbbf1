// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the program's tests share: a folder of clips, and the program.

use gst::prelude::*;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A second of video, encoded, that feeds `mux`.
pub const CLIP: &str = "videotestsrc num-buffers=30 pattern=gradient \
    ! video/x-raw,format=I420,width=320,height=240,framerate=30/1 ! x264enc speed-preset=ultrafast ! mux.";
/// Sound of the same length.
pub const TONE: &str = "audiotestsrc num-buffers=40 ! audio/x-raw,rate=44100,channels=2";

/// A folder of its own for each test, removed at the end.
pub struct Folder(pub PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        gst::init().unwrap();
        let path = std::env::temp_dir().join(format!("rsrectify-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Writes a clip: `streams` feed `mux`.
    pub fn clip(&self, name: &str, muxer: &str, streams: &str) -> PathBuf {
        self.prepared_clip(name, muxer, streams, |_| {})
    }

    /// The same of a pipeline that is prepared before it plays.
    pub fn prepared_clip(
        &self,
        name: &str,
        muxer: &str,
        streams: &str,
        prepare: impl Fn(&gst::Pipeline),
    ) -> PathBuf {
        let path = self.file(name);
        let description = format!("{muxer} name=mux ! filesink name=out {streams}");
        let pipeline = gst::parse::launch(&description).unwrap().downcast::<gst::Pipeline>().unwrap();
        pipeline.by_name("out").unwrap().set_property("location", &path);
        prepare(&pipeline);
        pipeline.set_state(gst::State::Playing).unwrap();
        let last = [gst::MessageType::Eos, gst::MessageType::Error];
        let message = pipeline.bus().unwrap().timed_pop_filtered(gst::ClockTime::NONE, &last);
        assert_eq!(message.unwrap().type_(), gst::MessageType::Eos, "{description}");
        pipeline.set_state(gst::State::Null).unwrap();
        path
    }

    /// Names of all files.
    pub fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(&self.0).unwrap();
        let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// The keys of a JSON value, at any depth, that a section of `docs/program.md` does not name.
pub fn undocumented<'a>(value: &'a Value, heading: &str) -> Vec<&'a str> {
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/program.md");
    let text = std::fs::read_to_string(page).unwrap();
    let begin = text.find(&format!("\n{heading}\n")).unwrap() + heading.len();
    let end = text[begin..].find("\n#").map_or(text.len(), |length| begin + length);
    keys(value).into_iter().filter(|key| !text[begin..end].contains(&format!("`{key}`"))).collect()
}

fn keys(value: &Value) -> Vec<&str> {
    match value {
        Value::Object(fields) => {
            fields.iter().flat_map(|(key, value)| [vec![key.as_str()], keys(value)].concat()).collect()
        }
        // The others have the same.
        Value::Array(values) => values.first().map_or(Vec::new(), keys),
        _ => Vec::new(),
    }
}

/// Everything that comes out of a part of a pipeline that a file goes into.
pub fn buffers(path: &Path, description: &str) -> Vec<gst::Sample> {
    let description = format!("filesrc name=in ! {description} ! appsink name=out sync=false");
    let pipeline = gst::parse::launch(&description).unwrap().downcast::<gst::Pipeline>().unwrap();
    pipeline.by_name("in").unwrap().set_property("location", path);
    pipeline.set_state(gst::State::Playing).unwrap();
    let sink = pipeline.by_name("out").unwrap().downcast::<gst_app::AppSink>().unwrap();
    let samples = std::iter::from_fn(|| sink.pull_sample().ok()).collect();
    pipeline.set_state(gst::State::Null).unwrap();
    samples
}

/// When each frame is shown, in microseconds: what MP4 stores is rounded to a track's clock.
///
/// Encoders with B-frames shift timestamps and segment alike, so running time is compared.
pub fn times(frames: &[gst::Sample]) -> Vec<Option<u64>> {
    let running = |frame: &gst::Sample| {
        let segment = frame.segment()?.downcast_ref::<gst::ClockTime>()?;
        Some((segment.to_running_time(frame.buffer()?.pts())?.nseconds() + 500) / 1000)
    };
    frames.iter().map(running).collect()
}

/// Width and height of a frame.
pub fn size(frame: &gst::Sample) -> (i32, i32) {
    let caps = frame.caps().unwrap().structure(0).unwrap();
    (caps.get("width").unwrap(), caps.get("height").unwrap())
}

/// The program, with one of its commands.
pub fn rsrectify(subcommand: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rsrectify"));
    // The element is in the program.
    command.env_remove("GST_PLUGIN_PATH").arg(subcommand);
    command
}

/// A readout, for tests of which it is no part: it need not be sought then, which takes longest of all.
pub const READOUT: [&str; 4] = ["--readout-time", "20", "--readout-direction", "top-to-bottom"];

/// Rectifies a clip, its readout given. Its warnings.
pub fn fix(input: &Path, output: &Path, options: &[&str]) -> String {
    let mut command = rsrectify("fix");
    command.arg(input).arg("--output").arg(output).args(READOUT).arg("--overwrite").args(options);
    let result = command.output().unwrap();
    let said = String::from_utf8(result.stderr).unwrap();
    assert!(result.status.success(), "{said}");
    said
}
