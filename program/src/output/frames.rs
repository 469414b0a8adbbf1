// SPDX-License-Identifier: MIT OR Apache-2.0

//! Files of frames that are not encoded as a stream: Y4M, and numbered PNG images.

use super::encoder::Encoding;
use super::target::Target;
use super::unfinished::Unfinished;
use crate::elements::{app_sink, write_samples};
use crate::input::Numbered;
use anyhow::{Context, Result, anyhow, bail};
use gst_video::prelude::*;
use gst_video::{
    VideoChromaSite, VideoFieldOrder, VideoFormat, VideoFrameRef, VideoInfo, VideoInterlaceMode,
};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Frames a second of clips that state none.
const USUAL_RATE: (i32, i32) = (30, 1);

/// Writes frames.
pub struct FrameWriter {
    form: Form,
    /// Whether the clip has no transparency.
    is_opaque: bool,
    frames: u64,
    info: Option<VideoInfo>,
}

enum Form {
    Y4m { out: Box<dyn Write + Send>, file: Option<Unfinished>, is_full_range: bool },
    Images { pattern: Numbered, first: u64, files: Vec<Unfinished> },
}

impl FrameWriter {
    /// To a target that holds frames only.
    pub fn new(target: &Target, encoding: &Encoding) -> Result<Self> {
        let is_full_range = encoding.colour().full_range == Some(true);
        let is_opaque = !encoding.has_alpha();
        let form = match target {
            Target::File(path) => {
                let file = Unfinished::beside(path);
                let out =
                    File::create(file.path()).with_context(|| format!("cannot write {}", path.display()))?;
                Form::Y4m { out: Box::new(BufWriter::new(out)), file: Some(file), is_full_range }
            }
            Target::Pipe => {
                Form::Y4m { out: Box::new(BufWriter::new(std::io::stdout())), file: None, is_full_range }
            }
            Target::Images(pattern, first) => {
                Form::Images { pattern: pattern.clone(), first: *first, files: Vec::new() }
            }
        };
        Ok(Self { form, is_opaque, frames: 0, info: None })
    }

    /// Takes the frames that come to the appsink `encoded` of a branch.
    pub fn collect(self, branch: &gst::Bin) -> Result<Arc<Mutex<Self>>> {
        let writer = Arc::new(Mutex::new(self));
        write_samples(&app_sink(branch, "encoded")?, &writer, Self::write);
        Ok(writer)
    }

    fn write(&mut self, sample: &gst::Sample) -> Result<()> {
        let info = VideoInfo::from_caps(sample.caps().context("a frame of an unknown kind")?)?;
        let kind = |info: &VideoInfo| (info.width(), info.height(), info.format());
        if self.info.as_ref().is_some_and(|first| kind(first) != kind(&info)) {
            bail!("the frames change their size or kind");
        }
        let frame =
            VideoFrameRef::from_buffer_ref_readable(sample.buffer().context("a frame without data")?, &info)
                .map_err(|_| anyhow!("a frame cannot be read"))?;
        match &mut self.form {
            Form::Y4m { out, is_full_range, .. } => {
                if self.frames == 0 {
                    out.write_all(y4m_header(&info, *is_full_range)?.as_bytes()).map_err(closed)?;
                }
                out.write_all(b"FRAME\n").map_err(closed)?;
                for_rows(&frame, |row| out.write_all(row).map_err(closed))?;
                // Who reads a pipe waits for each frame.
                out.flush().map_err(closed)?;
            }
            Form::Images { pattern, first, files } => {
                let image = pattern.file(*first + self.frames);
                let file = Unfinished::beside(&image);
                write_png(file.path(), self.is_opaque, &frame)
                    .with_context(|| format!("cannot write {}", image.display()))?;
                files.push(file);
            }
        }
        self.info.get_or_insert(info);
        self.frames += 1;
        Ok(())
    }

    /// Gives the file or images their names, once all frames have come; `times` are those of the frames. What is to be said of them.
    pub fn finish(&mut self, target: &Target, times: &[Option<gst::ClockTime>]) -> Result<Vec<String>> {
        let mut notes = Vec::new();
        if self.frames != times.len() as u64 {
            bail!("{} frames were written where there should be {}", self.frames, times.len());
        }
        match (&mut self.form, target) {
            (Form::Y4m { out, file, .. }, target) => {
                out.flush().map_err(closed)?;
                if let Some((file, path)) = file.as_ref().zip(target.as_file()) {
                    file.finish(path)?;
                }
            }
            (Form::Images { pattern, first, files }, _) => {
                for (number, file) in (*first..).zip(files.iter()) {
                    file.finish(&pattern.file(number))?;
                }
                let own = *first..*first + self.frames;
                let numbers = pattern.numbers()?;
                if let Some(other) = numbers.iter().find(|number| !own.contains(*number)) {
                    let (other, others) = (pattern.file(*other), numbers.len() as u64 - self.frames - 1);
                    let more = if others > 0 { format!(", and {others} more") } else { String::new() };
                    notes.push(format!("{} was there before and is not of this clip{more}", other.display()));
                }
            }
        }
        let rate = self.info.as_ref().map_or(gst::Fraction::from(USUAL_RATE), rate);
        if !are_even(times, rate) {
            notes.push(format!(
                "the clip's frames are not evenly spaced, but what is written holds no times: it is played at {:.2} frames/s",
                f64::from(rate.numer()) / f64::from(rate.denom())
            ));
        }
        Ok(notes)
    }
}

/// An error of writing; where nobody reads any more it says so.
fn closed(error: std::io::Error) -> anyhow::Error {
    match error.kind() {
        std::io::ErrorKind::BrokenPipe => anyhow!("whoever read the standard output has closed it"),
        _ => anyhow!(error).context("cannot write the frames"),
    }
}

fn rate(info: &VideoInfo) -> gst::Fraction {
    if info.fps().numer() > 0 { info.fps() } else { USUAL_RATE.into() }
}

/// Whether frames are shown at a rate, each within half of its duration.
fn are_even(times: &[Option<gst::ClockTime>], rate: gst::Fraction) -> bool {
    let period = 1e9 * f64::from(rate.denom()) / f64::from(rate.numer());
    let Some(first) = times.first().copied().flatten() else { return true };
    times.iter().enumerate().all(|(number, time)| {
        time.is_none_or(|time| {
            let due = first.nseconds() as f64 + number as f64 * period;
            (time.nseconds() as f64 - due).abs() < period / 2.0
        })
    })
}

/// The first line of a Y4M stream.
fn y4m_header(info: &VideoInfo, is_full_range: bool) -> Result<String> {
    let kind = match (info.format(), info.chroma_site()) {
        (VideoFormat::Gray8, _) => "mono",
        (VideoFormat::I420, VideoChromaSite::JPEG) => "420jpeg",
        (VideoFormat::I420, VideoChromaSite::MPEG2) => "420mpeg2",
        (VideoFormat::I420, VideoChromaSite::DV) => "420paldv",
        (VideoFormat::I420, _) => "420",
        (VideoFormat::Y42b, _) => "422",
        (VideoFormat::Y444, _) => "444",
        (VideoFormat::I42010le, _) => "420p10",
        (VideoFormat::I42210le, _) => "422p10",
        (VideoFormat::Y44410le, _) => "444p10",
        (VideoFormat::I42012le, _) => "420p12",
        (VideoFormat::I42212le, _) => "422p12",
        (VideoFormat::Y44412le, _) => "444p12",
        (format, _) => bail!("Y4M files hold no frames of the kind {format}"),
    };
    let fields = match (info.interlace_mode(), info.field_order()) {
        (VideoInterlaceMode::Progressive, _) => 'p',
        (VideoInterlaceMode::Mixed, _) => 'm',
        (_, VideoFieldOrder::BottomFieldFirst) => 'b',
        _ => 't',
    };
    let (width, height, par, rate) = (info.width(), info.height(), info.par(), rate(info));
    let range = if is_full_range { "FULL" } else { "LIMITED" };
    Ok(format!(
        "YUV4MPEG2 W{width} H{height} F{}:{} I{fields} A{}:{} C{kind} XCOLORRANGE={range}\n",
        rate.numer(),
        rate.denom(),
        par.numer(),
        par.denom()
    ))
}

/// Calls back with each row of each plane, without what pads it.
fn for_rows(frame: &VideoFrameRef<&gst::BufferRef>, mut call: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
    let format = frame.format_info();
    for plane in 0..frame.n_planes() {
        // The first component of a plane: those of interleaved pixels lie in one.
        let component = format.plane().iter().position(|own| *own == plane).context("an empty plane")?;
        let of = |number: usize| u8::try_from(number);
        let width = format.scale_width(of(component)?, frame.width()) as usize;
        let height = format.scale_height(of(component)?, frame.height()) as usize;
        let pixel = usize::try_from(format.pixel_stride()[component])?;
        let stride = usize::try_from(frame.plane_stride()[plane as usize])?;
        for row in frame.plane_data(plane)?.chunks(stride).take(height) {
            call(row.get(..width * pixel).context("a row is cut short")?)?;
        }
    }
    Ok(())
}

fn write_png(path: &Path, is_opaque: bool, frame: &VideoFrameRef<&gst::BufferRef>) -> Result<()> {
    let (colour, depth) = match frame.format() {
        VideoFormat::Gray8 => (png::ColorType::Grayscale, png::BitDepth::Eight),
        VideoFormat::Gray16Be => (png::ColorType::Grayscale, png::BitDepth::Sixteen),
        VideoFormat::Rgb => (png::ColorType::Rgb, png::BitDepth::Eight),
        VideoFormat::Rgba => (png::ColorType::Rgba, png::BitDepth::Eight),
        VideoFormat::Rgba64Be if is_opaque => (png::ColorType::Rgb, png::BitDepth::Sixteen),
        VideoFormat::Rgba64Be => (png::ColorType::Rgba, png::BitDepth::Sixteen),
        format => bail!("PNG images are not made of {format}"),
    };
    // GStreamer has no format of 16 bits without transparency.
    let is_stripped = frame.format() == VideoFormat::Rgba64Be && is_opaque;
    let mut out = BufWriter::new(File::create(path)?);
    let mut encoder = png::Encoder::new(&mut out, frame.width(), frame.height());
    encoder.set_color(colour);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Fast);
    let par = frame.info().par();
    if par.numer() != par.denom() {
        let sides = [par.denom(), par.numer()].map(u32::try_from);
        let [xppu, yppu] = [sides[0]?, sides[1]?];
        encoder.set_pixel_dims(Some(png::PixelDimensions { xppu, yppu, unit: png::Unit::Unspecified }));
    }
    let mut writer = encoder.write_header()?;
    let mut stream = writer.stream_writer()?;
    let mut colours = Vec::new();
    for_rows(frame, |row| {
        if !is_stripped {
            return Ok(stream.write_all(row)?);
        }
        colours.clear();
        colours.extend(row.chunks_exact(8).flat_map(|pixel| pixel.iter().take(6)));
        Ok(stream.write_all(&colours)?)
    })?;
    stream.finish()?;
    drop(writer);
    out.flush()?;
    Ok(())
}
