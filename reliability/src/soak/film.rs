//! Films made by GStreamer's own encoders: of numbered frames, of moving pictures, in any container.

use super::playback::Player;
use anyhow::Context;
use gst::prelude::*;
use gst_video::VideoFrameExt;
use std::path::Path;
use std::time::Duration;

/// Width and height of numbered frames.
const SIZE: (usize, usize) = (320, 240);
/// A frame's number is shown in so many blocks: 4 columns, 3 rows, bright for 1.
const BITS: usize = 12;

/// The middle of the block of a bit.
fn middle(bit: usize) -> (usize, usize) {
    ((bit % 4 * 2 + 1) * SIZE.0 / 8, (bit / 4 * 2 + 1) * SIZE.1 / 6)
}

/// Frame `number` of a film of 30 frames a second, in grey.
pub fn numbered(number: usize) -> gst::Buffer {
    let pixel = |i: usize| {
        let (x, y) = (i % SIZE.0, i / SIZE.0);
        let bit = (y * 3 / SIZE.1) * 4 + x * 4 / SIZE.0;
        if number >> bit & 1 == 1 { 220 } else { 30 }
    };
    let mut buffer = gst::Buffer::from_mut_slice((0..SIZE.0 * SIZE.1).map(pixel).collect::<Vec<u8>>());
    let inner = buffer.make_mut();
    inner.set_pts(gst::ClockTime::from_nseconds(number as u64 * 1_000_000_000 / 30));
    inner.set_duration(gst::ClockTime::from_nseconds(1_000_000_000 / 30));
    buffer
}

/// The number that a frame shows, if it has the size of numbered ones and a luma plane.
pub fn number(pad: &gst::Pad, buffer: &gst::BufferRef) -> Option<usize> {
    let info = gst_video::VideoInfo::from_caps(pad.current_caps()?.as_ref()).ok()?;
    if (info.width() as usize, info.height() as usize) != SIZE || info.comp_depth(0) != 8 {
        return None;
    }
    let frame = gst_video::VideoFrameRef::from_buffer_ref_readable(buffer, &info).ok()?;
    let (data, stride) = (frame.plane_data(0).ok()?, *frame.plane_stride().first()? as usize);
    let bright = |bit: usize| {
        let (x, y) = middle(bit);
        data.get(y * stride + x).is_some_and(|&value| value > 125)
    };
    Some((0..BITS).filter(|&bit| bright(bit)).map(|bit| 1 << bit).sum())
}

/// A source of numbered frames for a pipeline's description, to be fed by [`feed`].
pub const NUMBERED: &str =
    "appsrc name=numbered format=time caps=video/x-raw,format=GRAY8,width=320,height=240,framerate=30/1";

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

/// Writes a film of numbered frames, in groups of 15 pictures.
pub fn write_numbered(path: &Path, frames: usize) -> anyhow::Result<()> {
    let player = Player::new(&format!(
        "{NUMBERED} ! videoconvert ! x264enc key-int-max=15 speed-preset=ultrafast ! mp4mux \
         ! filesink name=sink location={}",
        path.display()
    ))?;
    feed(&player.pipeline, frames)?;
    finish(&player, path)
}

/// A pattern of `videotestsrc` that moves.
pub const MOVING: &str = "smpte75 horizontal-speed=3";

/// Writes a pattern through an encoder and a muxer.
pub fn write(
    path: &Path,
    pattern: &str,
    encoder: &str,
    size: (u32, u32),
    frames: usize,
) -> anyhow::Result<()> {
    let (width, height) = size;
    let player = Player::new(&format!(
        "videotestsrc pattern={pattern} num-buffers={frames} \
         ! video/x-raw,format=I420,width={width},height={height},framerate=30/1 ! {encoder} \
         ! filesink name=sink location={}",
        path.display()
    ))?;
    finish(&player, path)
}

fn finish(player: &Player, path: &Path) -> anyhow::Result<()> {
    player.write_out(Duration::from_secs(60)).with_context(|| format!("cannot write {}", path.display()))
}
