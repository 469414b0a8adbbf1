// SPDX-License-Identifier: MIT OR Apache-2.0

//! Colours and HDR in AV1 streams (AV1 Bitstream & Decoding Process Specification): the encoder of GStreamer 1.22 leaves them open.
//!
//! A stream is a row of units (OBU): a header of one or two bytes, the length of the content, the content. Colours lie in the middle of the
//! bits of the sequence header, which is written anew; the light is in units of metadata behind it.

use crate::colour::{Colour, UNSPECIFIED};
use crate::picture::Picture;
use gst_video::{VideoContentLightLevel, VideoMasteringDisplayInfo};

const SEQUENCE_HEADER: u8 = 1;
const METADATA: u8 = 5;
const HAS_SIZE: u8 = 2;
const HAS_EXTENSION: u8 = 4;

/// A temporal unit whose sequence headers state all this; `None` where it has none, or what cannot be read.
pub fn stated(unit: &[u8], picture: &Picture) -> Option<Vec<u8>> {
    let mut result = Vec::with_capacity(unit.len() + 64);
    let mut rest = unit;
    let mut has_changed = false;
    while let Some(header) = rest.first() {
        let start = if header & HAS_EXTENSION == 0 { 1 } else { 2 };
        let (size, content) = match header & HAS_SIZE {
            0 => (rest.len().checked_sub(start)?, start),
            _ => {
                let (size, length) = read_leb128(rest.get(start..)?)?;
                (size, start + length)
            }
        };
        let end = content.checked_add(size)?;
        let whole = rest.get(..end)?;
        if header >> 3 & 15 == SEQUENCE_HEADER {
            let header = sequence_header(whole.get(content..)?, picture.colour)?;
            append(&mut result, SEQUENCE_HEADER, &header);
            for metadata in [light_level(picture), mastering_display(picture)].into_iter().flatten() {
                append(&mut result, METADATA, &metadata);
            }
            has_changed = true;
        } else {
            result.extend_from_slice(whole);
        }
        rest = rest.get(end..)?;
    }
    has_changed.then_some(result)
}

fn append(stream: &mut Vec<u8>, kind: u8, content: &[u8]) {
    stream.push(kind << 3 | HAS_SIZE);
    let mut size = content.len();
    while size >= 0x80 {
        stream.push(size as u8 | 0x80);
        size >>= 7;
    }
    stream.push(size as u8);
    stream.extend_from_slice(content);
}

/// A number of seven bits a byte, the least first, and how many bytes it takes.
fn read_leb128(bytes: &[u8]) -> Option<(usize, usize)> {
    let mut value = 0;
    for (place, byte) in bytes.iter().take(4).enumerate() {
        value |= usize::from(byte & 0x7f) << (7 * place);
        if byte & 0x80 == 0 {
            return Some((value, place + 1));
        }
    }
    None
}

/// Bits that are read, and copied as they are.
struct Bits<'a> {
    bytes: &'a [u8],
    place: usize,
    copy: Vec<bool>,
}

impl Bits<'_> {
    fn skip(&mut self) -> Option<bool> {
        let byte = self.bytes.get(self.place / 8)?;
        let bit = byte >> (7 - self.place % 8) & 1 != 0;
        self.place += 1;
        Some(bit)
    }

    fn flag(&mut self) -> Option<bool> {
        let bit = self.skip()?;
        self.copy.push(bit);
        Some(bit)
    }

    fn number(&mut self, length: u32) -> Option<u32> {
        (0..length).try_fold(0, |value, _| Some(value << 1 | u32::from(self.flag()?)))
    }

    fn put(&mut self, code: u8) {
        self.copy.extend((0..8).rev().map(|bit| code >> bit & 1 != 0));
    }

    /// Copies the rest and gives out all bytes: zeros after the last one fill the last byte.
    fn finish(mut self) -> Option<Vec<u8>> {
        while self.place < self.bytes.len() * 8 {
            self.flag()?;
        }
        let last = self.copy.iter().rposition(|bit| *bit)?;
        let bytes = self.copy.get(..=last)?.chunks(8);
        Some(
            bytes
                .map(|bits| {
                    (0..8).fold(0, |byte, place| byte << 1 | u8::from(bits.get(place) == Some(&true)))
                })
                .collect(),
        )
    }
}

/// The content of a sequence header (section 5.5) with these colours.
fn sequence_header(content: &[u8], colour: Colour) -> Option<Vec<u8>> {
    let mut bits = Bits { bytes: content, place: 0, copy: Vec::with_capacity(content.len() * 8 + 32) };
    let profile = bits.number(3)?;
    bits.flag()?; // still_picture
    let is_reduced = bits.flag()?;
    if is_reduced {
        bits.number(5)?;
    } else {
        operating_points(&mut bits)?;
    }
    let (width, height) = (bits.number(4)? + 1, bits.number(4)? + 1);
    bits.number(width)?;
    bits.number(height)?;
    if !is_reduced && bits.flag()? {
        bits.number(4 + 3)?; // lengths of frame numbers
    }
    bits.number(3)?; // superblocks of 128, filter_intra, intra_edge
    if !is_reduced {
        bits.number(4)?; // interintra, masked, warped, dual_filter
        let has_order_hints = bits.flag()?;
        if has_order_hints {
            bits.number(2)?;
        }
        let may_force_screen = bits.flag()? || bits.flag()?;
        if may_force_screen && !bits.flag()? {
            bits.flag()?; // force_integer_mv
        }
        if has_order_hints {
            bits.number(3)?;
        }
    }
    bits.number(3)?; // superres, cdef, restoration
    colours(&mut bits, profile, colour)?;
    bits.finish()
}

fn operating_points(bits: &mut Bits<'_>) -> Option<()> {
    let mut decoder_delay = None;
    if bits.flag()? {
        bits.number(32)?;
        bits.number(32)?;
        if bits.flag()? {
            unsigned_exp_golomb(bits)?;
        }
        if bits.flag()? {
            decoder_delay = Some(bits.number(5)? + 1);
            bits.number(32)?;
            bits.number(5 + 5)?;
        }
    }
    let has_display_delay = bits.flag()?;
    for _ in 0..=bits.number(5)? {
        bits.number(12)?;
        if bits.number(5)? > 7 {
            bits.flag()?; // tier
        }
        if let Some(length) = decoder_delay
            && bits.flag()?
        {
            bits.number(length)?;
            bits.number(length)?;
            bits.flag()?;
        }
        if has_display_delay && bits.flag()? {
            bits.number(4)?;
        }
    }
    Some(())
}

fn unsigned_exp_golomb(bits: &mut Bits<'_>) -> Option<()> {
    let mut zeros = 0;
    while !bits.flag()? {
        zeros += 1;
    }
    bits.number(zeros)?;
    Some(())
}

/// The first half of `color_config`, up to the range.
fn colours(bits: &mut Bits<'_>, profile: u32, colour: Colour) -> Option<()> {
    let has_high_depth = bits.flag()?;
    if profile == 2 && has_high_depth {
        bits.flag()?;
    }
    if profile != 1 {
        bits.flag()?; // monochrome
    }
    // Whether colours are there, and then which.
    if bits.skip()? {
        for _ in 0..24 {
            bits.skip()?;
        }
    }
    bits.copy.push(!colour.is_untagged());
    if !colour.is_untagged() {
        // The identity matrix would change the fields that follow; it stands for RGB, which is not encoded here.
        let matrix = if colour.matrix == 0 { UNSPECIFIED } else { colour.matrix };
        for code in [colour.primaries, colour.transfer, matrix] {
            bits.put(code);
        }
    }
    bits.skip()?;
    bits.copy.push(colour.full_range == Some(true));
    Some(())
}

/// Metadata of type 1: the brightest pixel and the brightest frame, cd/m².
fn light_level(picture: &Picture) -> Option<Vec<u8>> {
    let level = picture.light_level.as_ref()?.parse::<VideoContentLightLevel>().ok()?;
    let words = [level.max_content_light_level(), level.max_frame_average_light_level()];
    Some([&[1][..], words[0].to_be_bytes().as_slice(), words[1].to_be_bytes().as_slice(), &[0x80]].concat())
}

/// Metadata of type 2: primaries and white in 0.16 fixed point, luminances in 24.8 and 18.14.
fn mastering_display(picture: &Picture) -> Option<Vec<u8>> {
    let info = picture.mastering_display.as_ref()?.parse::<VideoMasteringDisplayInfo>().ok()?;
    // From units of 0.00002 and of 0.0001 cd/m².
    let place = |value: u16| u16::try_from((u32::from(value) * 65536 + 25_000) / 50_000).unwrap_or(u16::MAX);
    let light = |value: u32, bits: u32| {
        u32::try_from(((u64::from(value) << bits) + 5_000) / 10_000).unwrap_or(u32::MAX)
    };
    let mut content = vec![2];
    let [red, green, blue] = info.display_primaries();
    for point in [red, green, blue, info.white_point()] {
        content.extend([point.x, point.y].into_iter().flat_map(|value| place(value).to_be_bytes()));
    }
    content.extend(light(info.max_display_mastering_luminance(), 8).to_be_bytes());
    content.extend(light(info.min_display_mastering_luminance(), 14).to_be_bytes());
    content.push(0x80);
    Some(content)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gst::prelude::*;

    fn launch(description: &str) -> (gst::Pipeline, gst_app::AppSink) {
        let pipeline = gst::parse::launch(description).unwrap().downcast::<gst::Pipeline>().unwrap();
        pipeline.set_state(gst::State::Playing).unwrap();
        let sink = pipeline.by_name("out").unwrap().downcast().unwrap();
        (pipeline, sink)
    }

    /// Temporal units as the encoder gives them out.
    fn encoded(format: &str) -> Vec<Vec<u8>> {
        let (pipeline, sink) = launch(&format!(
            "videotestsrc num-buffers=3 ! video/x-raw,format={format},width=50,height=34 ! av1enc cpu-used=8 \
             ! appsink name=out sync=false"
        ));
        let bytes = |sample: gst::Sample| sample.buffer().unwrap().map_readable().unwrap().to_vec();
        let units = std::iter::from_fn(|| sink.pull_sample().ok()).map(bytes).collect();
        pipeline.set_state(gst::State::Null).unwrap();
        units
    }

    /// How GStreamer's parser, which reads all of the headers, understands a stream; and how many frames are decoded of it.
    fn parsed(units: &[Vec<u8>]) -> (gst::Caps, usize) {
        let (pipeline, sink) = launch(
            "appsrc name=in caps=video/x-av1,stream-format=obu-stream,alignment=tu format=time ! av1parse name=parse \
             ! av1dec ! appsink name=out sync=false",
        );
        let source = pipeline.by_name("in").unwrap().downcast::<gst_app::AppSrc>().unwrap();
        for unit in units {
            source.push_buffer(gst::Buffer::from_slice(unit.clone())).unwrap();
        }
        source.end_of_stream().unwrap();
        let frames = std::iter::from_fn(|| sink.pull_sample().ok()).count();
        let caps = pipeline.by_name("parse").unwrap().static_pad("src").unwrap().current_caps();
        pipeline.set_state(gst::State::Null).unwrap();
        (caps.unwrap(), frames)
    }

    #[test]
    fn streams_state_colours_and_are_else_the_same() {
        gst::init().unwrap();
        let colour = Colour { primaries: 9, transfer: 16, matrix: 9, full_range: Some(true) };
        let picture = Picture {
            colour,
            light_level: Some("1000:200".to_owned()),
            mastering_display: Some("34000:16000:13250:34500:7500:3000:15635:16450:10000000:50".to_owned()),
            ..Picture::default()
        };
        for format in ["I420", "Y42B", "Y444"] {
            let units = encoded(format);
            let restated: Vec<_> =
                units.iter().map(|unit| stated(unit, &picture).unwrap_or(unit.clone())).collect();
            assert!(restated != units);
            let ((before, frames), (after, restated_frames)) = (parsed(&units), parsed(&restated));
            assert_eq!((frames, restated_frames), (3, 3));
            assert_eq!(Colour::of_caps(&after), colour, "{format}");
            for field in ["width", "height", "profile", "chroma-format", "bit-depth-luma"] {
                let value = |caps: &gst::Caps| format!("{:?}", caps.structure(0).unwrap().value(field));
                assert_eq!(value(&before), value(&after), "{field}");
            }
            // What is stated twice is stated once.
            let first = &restated[0];
            let plain = Picture { colour, ..Picture::default() };
            let again = stated(&stated(&units[0], &plain).unwrap(), &picture).unwrap();
            assert_eq!(&again, first);
        }
    }

    #[test]
    fn broken_units_are_left_alone() {
        gst::init().unwrap();
        let picture = Picture { colour: Colour { primaries: 1, ..Colour::default() }, ..Picture::default() };
        let unit = encoded("I420").swap_remove(0);
        for end in 0..unit.len().min(40) {
            let _ = stated(&unit[..end], &picture);
        }
        for place in 0..unit.len().min(40) {
            let mut bytes = unit.clone();
            bytes[place] ^= 0xff;
            let _ = stated(&bytes, &picture);
        }
    }

    #[test]
    fn light_is_in_fixed_point() {
        gst::init().unwrap();
        let picture = Picture {
            mastering_display: Some("50000:25000:0:0:0:0:0:0:10000000:10000".to_owned()),
            light_level: Some("1000:200".to_owned()),
            ..Picture::default()
        };
        assert_eq!(light_level(&picture).unwrap(), [1, 0x03, 0xe8, 0, 200, 0x80]);
        let display = mastering_display(&picture).unwrap();
        // 1.0 is more than fits, 0.5 is 0x8000; 1000 cd/m² in 24.8, 1 cd/m² in 18.14.
        assert_eq!(display[..5], [2, 0xff, 0xff, 0x80, 0x00]);
        assert_eq!(display[17..], [0, 0x03, 0xe8, 0, 0, 0, 0x40, 0, 0x80]);
    }
}
