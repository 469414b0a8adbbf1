// SPDX-License-Identifier: MIT OR Apache-2.0

//! A film of numbered frames on disk.

use super::*;
use std::path::PathBuf;

/// Frames in the clip.
pub const FRAMES: usize = 60;

/// A film of [`FRAMES`] numbered frames, in groups of 15 pictures; its file goes when it is dropped.
pub struct Film(pub PathBuf);

impl Drop for Film {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Encodes the film for a test.
pub fn film(test: &str) -> Film {
    init();
    let path = std::env::temp_dir().join(format!("rsrectify-{}-{test}.mp4", std::process::id()));
    let pipeline = launch(&format!(
        "appsrc name=in format=time ! videoconvert ! x264enc key-int-max=15 speed-preset=ultrafast ! mp4mux \
         ! filesink location={}",
        path.display()
    ));
    let input = pipeline.by_name("in").unwrap().downcast::<gst_app::AppSrc>().unwrap();
    input.set_caps(Some(&numbered_caps()));
    pipeline.set_state(gst::State::Playing).unwrap();
    for number in 0..FRAMES {
        input.push_buffer(numbered(number)).unwrap();
    }
    input.end_of_stream().unwrap();
    wait_for(&pipeline, gst::MessageType::Eos);
    pipeline.set_state(gst::State::Null).unwrap();
    Film(path)
}

/// A pipeline from its description.
pub fn launch(description: &str) -> gst::Pipeline {
    init();
    gst::parse::launch(description).unwrap().downcast().unwrap()
}

/// The number that a sample shows.
pub fn shown(sample: &gst::Sample) -> usize {
    let info = gst_video::VideoInfo::from_caps(sample.caps().unwrap()).unwrap();
    let map = sample.buffer().unwrap().map_readable().unwrap();
    number_of(&map, info.stride()[0] as usize)
}
