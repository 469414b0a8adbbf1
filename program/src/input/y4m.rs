// SPDX-License-Identifier: MIT OR Apache-2.0

//! Y4M streams → raw frames, of up to 12 bits: GStreamer's decoder has 8 only.

use super::clock;
use anyhow::{Context, Result, anyhow, bail};
use gst_video::prelude::*;
use gst_video::{
    VideoChromaSite, VideoColorMatrix, VideoColorPrimaries, VideoColorRange, VideoColorimetry,
    VideoFieldOrder, VideoFormat, VideoFrameRef, VideoInfo, VideoInterlaceMode, VideoTransferFunction,
};
use std::io::{self, BufRead, BufReader, Chain, Cursor, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use y4m::Colorspace;

/// How a stream begins.
pub const BEGINNING: &[u8] = b"YUV4MPEG2 ";
/// The longest header, in bytes.
const LONGEST: u64 = 1024;
/// The largest width and height in pixels: those of an MP4 file.
const LARGEST: u64 = u16::MAX as u64;

/// Reads the frames of a stream.
pub struct Frames<R: Read> {
    decoder: y4m::Decoder<Whole<R>>,
    info: VideoInfo,
    states_range: bool,
    states_site: bool,
    /// Bytes that have been read, and how many of them before the frame that is read now.
    read: Arc<AtomicU64>,
    whole: u64,
    number: u64,
}

/// A stream whose header has been looked at.
type Whole<R> = Counted<Chain<Cursor<Vec<u8>>, BufReader<R>>>;

/// Counts what is read.
struct Counted<R>(R, Arc<AtomicU64>);

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.0.read(buffer)?;
        self.1.fetch_add(read as u64, Ordering::Relaxed);
        Ok(read)
    }
}

/// What comes next in a stream.
pub enum Next {
    Frame(gst::Buffer),
    End,
    /// It ends within a frame.
    Cut,
}

impl<R: Read> Frames<R> {
    /// Reads the header.
    ///
    /// # Errors
    /// If that is damaged, or states pictures of another kind.
    pub fn new(reader: R) -> Result<Self> {
        let mut reader = BufReader::new(reader);
        let mut header = Vec::new();
        (&mut reader).take(LONGEST).read_until(b'\n', &mut header)?;
        if !is_of_possible_size(&header) {
            bail!("the header of the Y4M stream states no size that is possible");
        }
        let read = Arc::new(AtomicU64::new(0));
        let whole = Counted(Cursor::new(header).chain(reader), read.clone());
        let decoder = y4m::Decoder::new(whole).map_err(|error| match error {
            y4m::Error::UnknownColorspace => anyhow!(
                "the pictures of this Y4M stream are of a kind that is not read: 4:2:0, 4:2:2 and 4:4:4 of 8, 10 or 12 bits, and grey of 8 bits are"
            ),
            error => anyhow!("the header of the Y4M stream cannot be read: {error}"),
        })?;
        let info = info(&decoder)?;
        let states_range = states_full_range(&decoder);
        let states_site = matches!(
            decoder.get_colorspace(),
            Colorspace::C420jpeg | Colorspace::C420paldv | Colorspace::C420mpeg2
        );
        let whole = read.load(Ordering::Relaxed);
        Ok(Self { decoder, info, states_range, states_site, read, whole, number: 0 })
    }

    /// The bytes of a frame.
    pub fn size(&self) -> usize {
        self.info.size()
    }

    /// The frames as GStreamer describes them, without what it guesses of colours.
    pub fn caps(&self) -> Result<gst::Caps> {
        let mut caps = self.info.to_caps()?;
        let format = caps.make_mut().structure_mut(0).context("caps of nothing")?;
        if !self.states_range {
            format.remove_field("colorimetry");
        }
        if !self.states_site {
            format.remove_field("chroma-site");
        }
        Ok(caps)
    }

    /// The next frame with its time.
    ///
    /// # Errors
    /// If the stream is damaged or cannot be read.
    pub fn next(&mut self) -> Result<Next> {
        let frame = match self.decoder.read_frame() {
            Ok(frame) => frame,
            Err(y4m::Error::EOF) => {
                let is_whole = self.read.load(Ordering::Relaxed) == self.whole;
                return Ok(if is_whole { Next::End } else { Next::Cut });
            }
            Err(error) => bail!("frame {} of the Y4M stream cannot be read: {error}", self.number),
        };
        let mut buffer = gst::Buffer::with_size(self.info.size())?;
        let writable = buffer.get_mut().context("a new buffer is shared")?;
        clock::stamp(writable, self.number, self.info.fps());
        let planes = [frame.get_y_plane(), frame.get_u_plane(), frame.get_v_plane()];
        let mut picture = VideoFrameRef::from_buffer_ref_writable(writable, &self.info)
            .map_err(|_| anyhow!("a frame cannot be written"))?;
        let format = self.info.format_info();
        for (number, plane) in planes.into_iter().enumerate().take(self.info.n_planes() as usize) {
            let component = u8::try_from(number)?;
            let width = format.scale_width(component, self.info.width()) as usize;
            let row = width * if format.depth()[0] > 8 { 2 } else { 1 };
            let stride = usize::try_from(picture.plane_stride()[number])?;
            let target = picture.plane_data_mut(u32::from(component))?;
            for (to, from) in target.chunks_mut(stride).zip(plane.chunks_exact(row)) {
                to.get_mut(..row).context("a row does not fit")?.copy_from_slice(from);
            }
        }
        drop(picture);
        self.number += 1;
        self.whole = self.read.load(Ordering::Relaxed);
        Ok(Next::Frame(buffer))
    }
}

fn info<R: Read>(decoder: &y4m::Decoder<R>) -> Result<VideoInfo> {
    let (format, site) = match decoder.get_colorspace() {
        Colorspace::Cmono => (VideoFormat::Gray8, None),
        Colorspace::C420 => (VideoFormat::I420, None),
        Colorspace::C420jpeg => (VideoFormat::I420, Some(VideoChromaSite::JPEG)),
        Colorspace::C420paldv => (VideoFormat::I420, Some(VideoChromaSite::DV)),
        Colorspace::C420mpeg2 => (VideoFormat::I420, Some(VideoChromaSite::MPEG2)),
        Colorspace::C422 => (VideoFormat::Y42b, None),
        Colorspace::C444 => (VideoFormat::Y444, None),
        Colorspace::C420p10 => (VideoFormat::I42010le, None),
        Colorspace::C420p12 => (VideoFormat::I42012le, None),
        Colorspace::C422p10 => (VideoFormat::I42210le, None),
        Colorspace::C422p12 => (VideoFormat::I42212le, None),
        Colorspace::C444p10 => (VideoFormat::Y44410le, None),
        Colorspace::C444p12 => (VideoFormat::Y44412le, None),
        other => bail!("Y4M streams of {other:?} are not read"),
    };
    let [width, height] = [decoder.get_width(), decoder.get_height()].map(u32::try_from);
    let fraction = |ratio: y4m::Ratio| {
        let [num, den] = [ratio.num, ratio.den].map(|part| i32::try_from(part).ok().filter(|part| *part > 0));
        num.zip(den).map(|(num, den)| gst::Fraction::new(num, den))
    };
    let rate = fraction(decoder.get_framerate()).context("the Y4M stream does not state its frame rate")?;
    let mut info = VideoInfo::builder(format, width?, height?).fps(rate);
    // 0:0 is unknown.
    if let Some(aspect) = fraction(decoder.get_pixel_aspect()) {
        info = info.par(aspect);
    }
    if let Some(site) = site {
        info = info.chroma_site(site);
    }
    let states = |param: &[u8]| decoder.get_raw_params().split(|byte| *byte == b' ').any(|own| own == param);
    if states(b"It") || states(b"Ib") {
        let is_top_first = states(b"It");
        info = info.interlace_mode(VideoInterlaceMode::Interleaved).field_order(if is_top_first {
            VideoFieldOrder::TopFieldFirst
        } else {
            VideoFieldOrder::BottomFieldFirst
        });
    } else if states(b"Im") {
        info = info.interlace_mode(VideoInterlaceMode::Mixed);
    }
    let full_range = VideoColorimetry::new(
        VideoColorRange::Range0_255,
        VideoColorMatrix::Unknown,
        VideoTransferFunction::Unknown,
        VideoColorPrimaries::Unknown,
    );
    if states_full_range(decoder) {
        info = info.colorimetry(&full_range);
    }
    Ok(info.build()?)
}

fn states_full_range<R: Read>(decoder: &y4m::Decoder<R>) -> bool {
    decoder.get_raw_params().split(|byte| *byte == b' ').any(|param| param == b"XCOLORRANGE=FULL")
}

/// Whether a header states a width and a height that can be multiplied.
fn is_of_possible_size(header: &[u8]) -> bool {
    let line = String::from_utf8_lossy(header);
    let side = |name: char| {
        let mut values = line.split_whitespace().filter_map(|param| param.strip_prefix(name));
        values.next_back().and_then(|value| value.parse::<u64>().ok())
    };
    ['W', 'H'].into_iter().all(|name| side(name).is_some_and(|side| (1..=LARGEST).contains(&side)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_read_until_the_stream_ends_or_is_cut() {
        gst::init().unwrap();
        // 4:2:0 of 3 x 3 pixels and 10 bits: rows of 6 and 4 bytes.
        let header = b"YUV4MPEG2 W3 H3 F30000:1001 It A4:3 C420p10 XCOLORRANGE=FULL\n";
        let frame = [&b"FRAME\n"[..], &(0..34).collect::<Vec<u8>>()].concat();
        let stream = [&header[..], &frame, &frame].concat();
        let mut frames = Frames::new(&stream[..]).unwrap();
        let info = frames.info.clone();
        assert_eq!((info.format(), info.fps()), (VideoFormat::I42010le, gst::Fraction::new(30000, 1001)));
        assert_eq!(
            (info.par(), info.field_order()),
            (gst::Fraction::new(4, 3), VideoFieldOrder::TopFieldFirst)
        );
        assert_eq!(info.colorimetry().range(), VideoColorRange::Range0_255);
        for time in [0, 33_366_666] {
            let Next::Frame(buffer) = frames.next().unwrap() else { panic!("no frame") };
            assert_eq!(buffer.pts().unwrap().nseconds(), time);
            let picture = VideoFrameRef::from_buffer_ref_readable(&buffer, &info).unwrap();
            let rows: Vec<u8> = picture
                .plane_data(1)
                .unwrap()
                .chunks(info.stride()[1] as usize)
                .flat_map(|row| row[..4].to_vec())
                .collect();
            assert_eq!(rows, (18..26).collect::<Vec<u8>>());
        }
        assert!(matches!(frames.next(), Ok(Next::End)));
        let mut cut = Frames::new(&stream[..stream.len() - 1]).unwrap();
        assert!(matches!(cut.next(), Ok(Next::Frame(_))));
        assert!(matches!(cut.next(), Ok(Next::Cut)));
        for end in 0..header.len() {
            let _ = Frames::new(&stream[..end]);
        }
    }

    #[test]
    fn headers_that_cannot_be_are_refused() {
        gst::init().unwrap();
        for (header, reason) in [
            ("YUV4MPEG2 W3 H99999999999 F25:1\n", "size"),
            ("YUV4MPEG2 W3 F25:1\n", "size"),
            ("YUV4MPEG2 W4 H4 F0:0\n", "frame rate"),
            ("YUV4MPEG2 W4 H4 F25:1 C411\n", "a kind that is not read"),
            ("YUV4MPEG3 W4 H4 F25:1\n", "cannot be read"),
        ] {
            let error = Frames::new(header.as_bytes()).err().unwrap().to_string();
            assert!(error.contains(reason), "{error}");
        }
    }
}
