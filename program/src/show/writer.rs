// SPDX-License-Identifier: MIT OR Apache-2.0

//! Frames that are drawn over → a video file.

use crate::elements::{launch, named};
use crate::interruption::Interruption;
use crate::output::encoder::{Encoder, Encoding};
use crate::picture::Picture;
use crate::playback::{Event, Playback};
use anyhow::{Context, Result, anyhow};
use gst::prelude::*;
use resvg::tiny_skia::PixmapMut;
use std::path::Path;

/// Frames that wait for the encoder.
const WAITING: u64 = 4;
/// How long each look for a message is while they do.
const LOOK: gst::ClockTime = gst::ClockTime::from_mseconds(5);

/// A file that is written frame by frame.
pub struct Writer {
    playback: Playback,
    source: gst_app::AppSrc,
    converter: gst_video::VideoConverter,
    /// The frames as they come, and as they are drawn over.
    info: gst_video::VideoInfo,
    drawn: gst_video::VideoInfo,
}

impl Writer {
    /// Starts to write frames of this kind, of a clip with such pictures.
    pub fn new(
        info: &gst_video::VideoInfo,
        mut picture: Picture,
        encoder: &Encoder,
        muxer: &str,
        file: &Path,
    ) -> Result<Self> {
        picture.info = Some(info.clone());
        let mut info = gst_video::VideoInfo::builder_from_info(info);
        let colorimetry = picture.colorimetry();
        if let Some(colorimetry) = &colorimetry {
            info = info.colorimetry(colorimetry);
        }
        let info = info.build()?;
        let encoding = Encoding::new(encoder.clone(), picture).of_rgb();
        let encoder = encoding.description();
        let pipeline =
            launch(&format!("appsrc name=source format=time ! {encoder} ! {muxer} ! filesink name=file"))?;
        named(&pipeline, "file")?.set_property("location", file);
        encoding.configure(&pipeline)?;
        let source = named(&pipeline, "source")?;
        let source =
            source.downcast::<gst_app::AppSrc>().map_err(|_| anyhow!("appsrc is another element"))?;
        // Pixels in the order of the library that draws.
        let format = gst_video::VideoFormat::Rgba;
        let drawn = gst_video::VideoInfo::builder(format, info.width(), info.height())
            .fps(info.fps())
            .par(info.par())
            .build()?;
        source.set_caps(Some(&drawn.to_caps()?));
        let converter = gst_video::VideoConverter::new(&info, &drawn, None)?;
        let playback = Playback::new(pipeline)?;
        playback.set_state(gst::State::Playing);
        Ok(Self { playback, source, converter, info, drawn })
    }

    /// Writes a frame of the clip, after `draw` has drawn over it.
    pub fn write(
        &mut self,
        frame: &gst::Sample,
        draw: impl FnOnce(&mut PixmapMut<'_>) -> Result<()>,
        interruption: &Interruption,
    ) -> Result<()> {
        while self.source.current_level_buffers() >= WAITING {
            self.listen(LOOK, interruption)?;
        }
        self.listen(gst::ClockTime::ZERO, interruption)?;
        let buffer = frame.buffer().context("a frame without data")?;
        let mut target = gst::Buffer::with_size(self.drawn.size())?;
        let written = target.get_mut().context("a new buffer is shared")?;
        {
            let picture = gst_video::VideoFrameRef::from_buffer_ref_readable(buffer, &self.info)
                .map_err(|_| anyhow!("a frame cannot be read"))?;
            let mut pixels = gst_video::VideoFrameRef::from_buffer_ref_writable(written, &self.drawn)
                .map_err(|_| anyhow!("a frame cannot be written"))?;
            self.converter.frame_ref(&picture, &mut pixels);
            let data = pixels.plane_data_mut(0)?;
            let mut pixmap = PixmapMut::from_bytes(data, self.drawn.width(), self.drawn.height())
                .context("the frames are too large to draw over")?;
            draw(&mut pixmap)?;
        }
        let segment = frame.segment().and_then(|segment| segment.downcast_ref::<gst::ClockTime>());
        written.set_pts(segment.and_then(|segment| segment.to_stream_time(buffer.pts())));
        written.set_duration(buffer.duration());
        // What went wrong is told by a message.
        let _ = self.source.push_buffer(target);
        Ok(())
    }

    /// Writes what waits and ends the file.
    pub fn finish(mut self, interruption: &Interruption) -> Result<()> {
        let _ = self.source.end_of_stream();
        while !self.listen(LOOK, interruption)? {}
        Ok(())
    }

    /// Waits for a message; whether it was the end of the file.
    fn listen(&mut self, time: gst::ClockTime, interruption: &Interruption) -> Result<bool> {
        match self.playback.next(time, interruption)? {
            Event::End => Ok(true),
            Event::Warning(warning) => {
                log::warn!("{warning}");
                Ok(false)
            }
            Event::Chapters | Event::Held | Event::Ready | Event::Nothing => Ok(false),
        }
    }
}
