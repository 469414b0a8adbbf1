// SPDX-License-Identifier: MIT OR Apache-2.0

//! PNG images of 16 bits → frames: GStreamer 1.22 decodes those without transparency wrongly, one sample off.

use super::clock;
use super::images::Images;
use anyhow::{Context, Result, anyhow, bail};
use gst_video::prelude::*;
use gst_video::{VideoFormat, VideoFrameRef, VideoInfo};
use png::{BitDepth, ColorType, Transformations};
use std::fs::File;
use std::io::BufReader;
use std::ops::RangeInclusive;
use std::path::Path;

type Reader = png::Reader<BufReader<File>>;

/// Reads images of 16 bits.
pub struct DeepImages {
    images: Images,
    numbers: RangeInclusive<u64>,
    first: u64,
    info: VideoInfo,
}

/// What the images of a file are: whether they have 16 bits, and transparency. `None` of what is no PNG image.
pub fn depth(file: &Path) -> Option<(bool, bool)> {
    let reader = open(file).ok()?;
    let (colour, depth) = reader.output_color_type();
    Some((depth == BitDepth::Sixteen, matches!(colour, ColorType::Rgba | ColorType::GrayscaleAlpha)))
}

fn open(file: &Path) -> Result<Reader> {
    let mut decoder = png::Decoder::new(BufReader::new(File::open(file)?));
    decoder.set_transformations(Transformations::EXPAND);
    Ok(decoder.read_info()?)
}

impl DeepImages {
    pub fn new(images: &Images) -> Result<Self> {
        let [first, last] = images.pattern.range()?;
        let file = images.pattern.file(first);
        let reader = open(&file).with_context(|| format!("{} cannot be read", file.display()))?;
        let header = reader.info();
        let format = match header.color_type {
            ColorType::Grayscale => VideoFormat::Gray16Be,
            _ => VideoFormat::Rgba64Be,
        };
        let info = VideoInfo::builder(format, header.width, header.height).fps(images.fps.fraction());
        Ok(Self { images: images.clone(), numbers: first..=last, first, info: info.build()? })
    }

    /// The frames as GStreamer describes them.
    pub fn info(&self) -> &VideoInfo {
        &self.info
    }

    /// The next frame; `None` after the last.
    pub fn next(&mut self) -> Result<Option<gst::Buffer>> {
        let Some(number) = self.numbers.next() else { return Ok(None) };
        let file = self.images.pattern.file(number);
        let mut buffer = self.read(&file).with_context(|| format!("{} cannot be read", file.display()))?;
        let frame = buffer.get_mut().context("a new buffer is shared")?;
        clock::stamp(frame, number - self.first, self.info.fps());
        Ok(Some(buffer))
    }

    fn read(&self, file: &Path) -> Result<gst::Buffer> {
        let mut reader = open(file)?;
        let mut pixels = vec![0; reader.output_buffer_size().context("it is too large")?];
        let image = reader.next_frame(&mut pixels)?;
        let info = &self.info;
        if (image.width, image.height) != (info.width(), info.height()) {
            bail!("it is of another size than the first");
        }
        let bytes = if image.bit_depth == BitDepth::Sixteen { 2 } else { 1 };
        let samples = image.color_type.samples();
        let is_grey = info.format() == VideoFormat::Gray16Be;
        if is_grey && samples > 1 {
            bail!("it is of another kind than the first");
        }
        let mut buffer = gst::Buffer::with_size(info.size())?;
        let mut frame = VideoFrameRef::from_buffer_ref_writable(
            buffer.get_mut().context("a new buffer is shared")?,
            info,
        )
        .map_err(|_| anyhow!("a frame cannot be written"))?;
        let stride = usize::try_from(frame.plane_stride().first().copied().unwrap_or(0))?;
        let rows = pixels.chunks_exact(image.line_size);
        for (to, from) in frame.plane_data_mut(0)?.chunks_mut(stride).zip(rows) {
            let pixels = from.chunks_exact(samples * bytes);
            for (to, from) in to.chunks_exact_mut(if is_grey { 2 } else { 8 }).zip(pixels) {
                // A sample of 8 bits stands for both bytes of one of 16.
                let sample = |number: usize| match from.get(number * bytes..(number + 1) * bytes) {
                    Some([high, low]) => [*high, *low],
                    Some([byte]) => [*byte, *byte],
                    _ => [0xff, 0xff],
                };
                let order: &[usize] = match samples {
                    _ if is_grey => &[0],
                    1 => &[0, 0, 0, 4],
                    2 => &[0, 0, 0, 1],
                    _ => &[0, 1, 2, 3],
                };
                for (to, number) in to.chunks_exact_mut(2).zip(order) {
                    to.copy_from_slice(&sample(*number));
                }
            }
        }
        drop(frame);
        Ok(buffer)
    }
}
