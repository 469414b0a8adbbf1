// SPDX-License-Identifier: MIT OR Apache-2.0

//! Frames that show their number.

use gst::prelude::*;
use gst_video::VideoFrameExt;

/// Width and height of numbered frames.
const SIZE: (usize, usize) = (320, 240);
/// A frame's number is the level of its chroma, the same all over the frame, so that it can be read however the picture is
/// bent: `LEVELS` of them in U, as many in V, `STEP` apart.
const LEVELS: usize = 15;
const STEP: usize = 16;

/// Frame `number` of a film of 30 frames a second: a texture that a hand shakes, read from top to bottom.
pub fn numbered(number: usize) -> gst::Buffer {
    let (width, height) = SIZE;
    let luma = (0..width * height).map(|i| {
        let (x, y) = ((i % width) as f64, (i / width) as f64);
        let time = number as f64 + y / height as f64;
        let shake = |rate: f64| 8.0 * (rate * time).sin();
        let (x, y) = (x + shake(1.1) + shake(0.37), y + shake(0.83));
        (125.0 + 30.0 * ((0.31 * x).sin() * (0.23 * y).cos() + (0.05 * x * (0.07 * y).sin()).sin())) as u8
    });
    let level = |value: usize| std::iter::repeat_n((value * STEP + STEP / 2) as u8, width * height / 4);
    let chroma = level(number % LEVELS).chain(level(number / LEVELS % LEVELS));
    let mut buffer = gst::Buffer::from_mut_slice(luma.chain(chroma).collect::<Vec<u8>>());
    let inner = buffer.make_mut();
    inner.set_pts(gst::ClockTime::from_nseconds(number as u64 * 1_000_000_000 / 30));
    inner.set_duration(gst::ClockTime::from_nseconds(1_000_000_000 / 30));
    buffer
}

/// The number that a frame shows, if it has the size of numbered ones and chroma planes.
pub fn number(pad: &gst::Pad, buffer: &gst::BufferRef) -> Option<usize> {
    let info = gst_video::VideoInfo::from_caps(pad.current_caps()?.as_ref()).ok()?;
    if (info.width() as usize, info.height() as usize) != SIZE
        || info.format() != gst_video::VideoFormat::I420
    {
        return None;
    }
    let frame = gst_video::VideoFrameRef::from_buffer_ref_readable(buffer, &info).ok()?;
    let level = |plane: u32| {
        let stride = *frame.plane_stride().get(plane as usize)? as usize;
        let middle = SIZE.1 / 4 * stride + SIZE.0 / 4;
        frame.plane_data(plane).ok()?.get(middle).map(|value| usize::from(*value) / STEP)
    };
    Some(level(1)? + LEVELS * level(2)?)
}

/// A source of numbered frames for a pipeline's description, to be fed by [`feed`].
pub const NUMBERED: &str =
    "appsrc name=numbered format=time caps=video/x-raw,format=I420,width=320,height=240,framerate=30/1";

/// Feeds numbered frames to a pipeline and ends the stream.
pub fn feed(pipeline: &gst::Pipeline, frames: usize) -> anyhow::Result<()> {
    let source = pipeline.by_name("numbered").and_then(|source| source.downcast::<gst_app::AppSrc>().ok());
    let source = source.ok_or_else(|| anyhow::anyhow!("no source of numbered frames"))?;
    source.set_max_bytes(0);
    for number in 0..frames {
        source.push_buffer(numbered(number))?;
    }
    source.end_of_stream()?;
    Ok(())
}
