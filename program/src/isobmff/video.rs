// SPDX-License-Identifier: MIT OR Apache-2.0

//! The track of the encoded video: its boxes, from what the encoder states and when each frame is shown.

use super::film::Track;
use super::tables;
use crate::boxes::{boxed, child, children, words};
use crate::colour::Colour;
use anyhow::{Context, Result, bail};

/// Times are stated to at least this, in nanoseconds, where a usual clock can.
const EXACT: f64 = 1_000.0;

/// An encoded frame.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// When it is shown, in nanoseconds of the film.
    pub time: i64,
    /// For how long, in nanoseconds, where that is known.
    pub duration: Option<u64>,
    pub is_key: bool,
    pub size: u32,
}

/// When the samples of a track are decoded and shown, in ticks of its clock.
#[derive(Debug, PartialEq, Eq)]
pub struct Timing {
    /// Ticks a second.
    pub timescale: u32,
    /// When the first frame is shown, in the film.
    pub start: u64,
    /// When each sample is decoded, in the file's order, from 0 on, and the end of the last.
    pub decoded: Vec<u64>,
    /// By how much it is shown later.
    pub offsets: Vec<u32>,
    /// By how much the frame that is shown first is: by so much decoding is ahead.
    pub ahead: u32,
}

impl Timing {
    /// The times of samples on the first of these clocks that states all of them to a microsecond, else in microseconds.
    ///
    /// # Errors
    /// If there are none, or they are further apart than a table can state.
    pub fn of(samples: &[Sample], earlier: i64, clocks: &[u32]) -> Result<Self> {
        let is_exact = |clock: &&u32| {
            let tick = 1e9 / f64::from(**clock);
            samples.iter().all(|sample| {
                let time = (sample.time - earlier) as f64;
                ((time / tick).round() * tick - time).abs() <= EXACT
            })
        };
        let timescale =
            clocks.iter().filter(|clock| **clock > 0).find(is_exact).copied().unwrap_or(1_000_000);
        let ticks =
            |time: i64| (i128::from(time) * i128::from(timescale) + 500_000_000).div_euclid(1_000_000_000);
        let shown: Vec<i128> = samples.iter().map(|sample| ticks(sample.time - earlier)).collect();
        let mut sorted = shown.clone();
        sorted.sort_unstable();
        let (first, last) = sorted.first().zip(sorted.last()).context("there is no frame")?;
        // The last frame is shown for as long as it says, else as long as the one before it.
        let last_sample = samples.iter().max_by_key(|sample| sample.time);
        let stated = last_sample.and_then(|sample| sample.duration).and_then(|ns| i64::try_from(ns).ok());
        let before = || sorted.iter().rev().nth(1).map(|before| last - before);
        let duration = stated.map(ticks).filter(|ticks| *ticks > 0).or_else(before).unwrap_or(1).max(1);
        let ahead = sorted.iter().zip(&shown).map(|(due, shown)| due - shown).max().unwrap_or(0);
        let offsets = sorted.iter().zip(&shown).map(|(due, shown)| u32::try_from(shown + ahead - due));
        let end = last + duration;
        let decoded = sorted.iter().chain([&end]).map(|due| u64::try_from(due - first));
        Ok(Self {
            timescale,
            start: u64::try_from(*first).unwrap_or(0),
            decoded: decoded.collect::<Result<_, _>>()?,
            offsets: offsets.collect::<Result<_, _>>()?,
            ahead: u32::try_from(ahead)?,
        })
    }

    /// From the first frame to the end of the last, in ticks.
    pub fn duration(&self) -> u64 {
        self.decoded.last().copied().unwrap_or(0)
    }

    fn durations(&self) -> impl Iterator<Item = u32> {
        self.decoded.windows(2).map(|pair| u32::try_from(pair[1] - pair[0]).unwrap_or(u32::MAX))
    }
}

/// A track of video, but for where its chunks lie.
pub struct VideoTrack<'a> {
    /// What the encoder states of its stream.
    pub caps: &'a gst::CapsRef,
    pub colour: Colour,
    pub timing: &'a Timing,
    pub samples: &'a [Sample],
    /// How many samples each chunk has.
    pub chunks: &'a [u32],
    /// The track of the clip in whose place it is, where the clip is such a file.
    pub original: Option<Track<'a>>,
    pub is_quicktime: bool,
}

impl VideoTrack<'_> {
    /// The boxes of the sample table, but for the chunks' offsets.
    pub fn sample_table(&self) -> Result<Vec<u8>> {
        let sizes: Vec<u32> = self.samples.iter().map(|sample| sample.size).collect();
        let description = boxed(b"stsd", &[words(&[0, 1]), self.sample_entry()?].concat());
        Ok([
            description,
            tables::durations(self.timing.durations()),
            tables::composition(self.timing.offsets.iter().copied()),
            tables::key_frames(self.samples.iter().map(|sample| sample.is_key)),
            tables::sizes(&sizes),
            tables::chunk_lengths(self.chunks.iter().copied()),
        ]
        .concat())
    }

    /// Width and height of the encoded frames.
    pub fn size(&self) -> Result<[u16; 2]> {
        let format = self.format()?;
        Ok([u16::try_from(format.get::<i32>("width")?)?, u16::try_from(format.get::<i32>("height")?)?])
    }

    /// Width over height of a pixel.
    pub fn pixel_aspect(&self) -> [u32; 2] {
        let ratio =
            self.format().ok().and_then(|format| format.get::<gst::Fraction>("pixel-aspect-ratio").ok());
        let positive = |number: i32| u32::try_from(number).unwrap_or(1).max(1);
        ratio.map_or([1, 1], |ratio| [positive(ratio.numer()), positive(ratio.denom())])
    }

    fn format(&self) -> Result<&gst::StructureRef> {
        self.caps.structure(0).context("the encoder does not state its format")
    }

    /// The entry of the sample description, with the decoder's configuration and what is known of the picture.
    fn sample_entry(&self) -> Result<Vec<u8>> {
        let format = self.format()?;
        let (name, configuration): (&[u8; 4], Option<&[u8; 4]>) = match format.name().as_str() {
            "video/x-h264" => (b"avc1", Some(b"avcC")),
            "video/x-h265" => (b"hvc1", Some(b"hvcC")),
            "video/x-av1" => (b"av01", Some(b"av1C")),
            "video/x-prores" => match format.get::<&str>("variant") {
                Ok("proxy") => (b"apco", None),
                Ok("lt") => (b"apcs", None),
                Ok("hq") => (b"apch", None),
                Ok("4444") => (b"ap4h", None),
                Ok("4444xq") => (b"ap4x", None),
                _ => (b"apcn", None),
            },
            other => bail!("{other} cannot be put into MP4 or MOV files"),
        };
        let mut boxes = Vec::new();
        if let Some(configuration) = configuration {
            let content = match format.get::<gst::Buffer>("codec_data") {
                Ok(data) => data.map_readable()?.to_vec(),
                Err(_) if configuration == b"av1C" => av1_configuration(format).to_vec(),
                Err(_) => bail!("the encoder states no configuration"),
            };
            boxes.extend(boxed(configuration, &content));
        }
        boxes.extend(self.colour().unwrap_or_default());
        if self.pixel_aspect() != [1, 1] {
            boxes.extend(boxed(b"pasp", &words(&self.pixel_aspect())));
        }
        boxes.extend(fields(format));
        boxes.extend(mastering_display(format).unwrap_or_default());
        boxes.extend(light_level(format).unwrap_or_default());
        let [width, height] = self.size()?;
        let mut compressor = [0; 32];
        compressor[0] = 9;
        compressor[1..10].copy_from_slice(b"rsrectify");
        let entry = [
            // Reserved, index of the data reference, versions and reserved.
            &[0, 0, 0, 0, 0, 0, 0, 1][..],
            &[0; 16],
            &width.to_be_bytes(),
            &height.to_be_bytes(),
            // 72 dpi, reserved, one frame a sample.
            &words(&[72 << 16, 72 << 16, 0]),
            &[0, 1],
            &compressor,
            // Colour without a palette.
            &[0, 24, 0xff, 0xff],
            &boxes,
        ];
        Ok(boxed(name, &entry.concat()))
    }

    /// `colr`: code points of ITU-T H.273; none where nothing is known.
    fn colour(&self) -> Option<Vec<u8>> {
        let Colour { primaries, transfer, matrix, full_range } = self.colour;
        let is_full = full_range == Some(true);
        if self.colour == Colour::default() {
            return None;
        }
        // QuickTime's own has no range; limited is that of the stream too, where it states anything.
        let is_own = self.is_quicktime && !is_full && !self.colour.is_untagged();
        let points = [0, primaries, 0, transfer, 0, matrix];
        Some(match is_own {
            true => boxed(b"colr", &[b"nclc", &points[..]].concat()),
            false => boxed(b"colr", &[b"nclx", &points[..], &[u8::from(is_full) << 7]].concat()),
        })
    }
}

/// The content of `av1C` (AV1 Codec ISO Media File Format Binding, 2.3.3), which the parser of GStreamer 1.22 does not state: without
/// units, as each key frame has its own, and of the level without limits.
fn av1_configuration(format: &gst::StructureRef) -> [u8; 4] {
    const NO_LIMITS: u8 = 31;
    let profile = match format.get::<&str>("profile") {
        Ok("high") => 1,
        Ok("professional") => 2,
        _ => 0,
    };
    let bits = format.get::<u32>("bit-depth-luma").unwrap_or(8);
    let depth = u8::from(bits > 8) << 6 | u8::from(bits > 10) << 5;
    // Monochrome, colour halved across, halved down.
    let chroma = match format.get::<&str>("chroma-format") {
        Ok("4:0:0") => 0b111,
        Ok("4:2:2") => 0b010,
        Ok("4:4:4") => 0b000,
        _ => 0b011,
    };
    [0x81, profile << 5 | NO_LIMITS, depth | chroma << 2, 0]
}

/// `fiel`: how fields lie in a frame; none of progressive video.
fn fields(format: &gst::StructureRef) -> Vec<u8> {
    let mode = format.get::<&str>("interlace-mode").unwrap_or("progressive");
    if mode == "progressive" {
        return Vec::new();
    }
    let order = match format.get::<&str>("field-order") {
        Ok("top-field-first") => 9,
        Ok("bottom-field-first") => 14,
        _ => 0,
    };
    boxed(b"fiel", &[2, order])
}

/// `mdcv` (ISO/IEC 23001-17): primaries in the order green, blue, red, the white point, the range of luminance.
fn mastering_display(format: &gst::StructureRef) -> Option<Vec<u8>> {
    let numbers: Vec<u32> = numbers(format, "mastering-display-info")?;
    let [rx, ry, gx, gy, bx, by, wx, wy, brightest, darkest] = numbers.try_into().ok()?;
    let points = [gx, gy, bx, by, rx, ry, wx, wy];
    let points = points.iter().flat_map(|point| (*point as u16).to_be_bytes()).collect();
    Some(boxed(b"mdcv", &[points, words(&[brightest, darkest])].concat()))
}

/// `clli`: the brightest pixel, and the brightest frame on average.
fn light_level(format: &gst::StructureRef) -> Option<Vec<u8>> {
    let [pixel, frame] = numbers(format, "content-light-level")?.try_into().ok()?;
    Some(boxed(b"clli", &[(pixel as u16).to_be_bytes(), (frame as u16).to_be_bytes()].concat()))
}

fn numbers(format: &gst::StructureRef, field: &str) -> Option<Vec<u32>> {
    format.get::<&str>(field).ok()?.split(':').map(|number| number.parse().ok()).collect()
}

/// References of a track to others, of which those that are not in the file are left out.
pub fn references(track: &Track<'_>, is_there: impl Fn(u32) -> bool) -> Vec<u8> {
    let Some(references) = child(track.content, &[b"tref"]) else { return Vec::new() };
    let mut kept = Vec::new();
    for (name, ids) in children(references) {
        let ids = ids.chunks_exact(4).filter_map(|id| crate::boxes::number(id, 0)).filter(|id| is_there(*id));
        let ids: Vec<u32> = ids.collect();
        if let Some(name) = name.first_chunk::<4>().filter(|_| !ids.is_empty()) {
            kept.extend(boxed(name, &words(&ids)));
        }
    }
    if kept.is_empty() { kept } else { boxed(b"tref", &kept) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(milliseconds: i64) -> Sample {
        Sample { time: milliseconds * 1_000_000, duration: None, is_key: true, size: 1 }
    }

    #[test]
    fn frames_are_decoded_before_they_are_shown() {
        // I P B B, shown at 1.0, 1.3, 1.1, 1.2 s.
        let samples = [1000, 1300, 1100, 1200].map(sample);
        let timing = Timing::of(&samples, 0, &[0, 600]).unwrap();
        // The last B is decoded at 1.3 s at the latest, that is 0.1 s too late.
        assert_eq!((timing.timescale, timing.start, timing.ahead), (600, 600, 60));
        assert_eq!(timing.decoded, [0, 60, 120, 180, 240]);
        assert_eq!(timing.offsets, [60, 180, 0, 0]);
        assert_eq!(timing.duration(), 240);
    }

    #[test]
    fn the_clock_states_the_times() {
        let ntsc: Vec<_> = (0..100).map(|n| Sample { time: n * 1_001_000_000 / 30, ..sample(0) }).collect();
        assert_eq!(Timing::of(&ntsc, 0, &[600, 30000]).unwrap().timescale, 30000);
        assert_eq!(Timing::of(&ntsc, 0, &[600]).unwrap().timescale, 1_000_000);
        assert!(Timing::of(&[], 0, &[600]).is_err());
    }
}
