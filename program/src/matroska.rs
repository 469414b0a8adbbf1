// SPDX-License-Identifier: MIT OR Apache-2.0

//! What Matroska files state (RFC 9559) and GStreamer's demuxer does otherwise.

use gst::prelude::*;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Bytes from the beginning of a file in which its tracks are described.
const SEARCHED: u64 = 1 << 20;
pub const FILE: &[u8] = &[0x1a, 0x45, 0xdf, 0xa3];
const SEGMENT: &[u8] = &[0x18, 0x53, 0x80, 0x67];
const TRACKS: &[u8] = &[0x16, 0x54, 0xae, 0x6b];
const ENTRY: &[u8] = &[0xae];
const NUMBER: &[u8] = &[0xd7];
const CODEC: &[u8] = &[0x86];
const DELAY: &[u8] = &[0x56, 0xaa];
const ATTACHMENTS: &[u8] = &[0x19, 0x41, 0xa4, 0x69];
const TAGS: &[u8] = &[0x12, 0x54, 0xc3, 0x67];
const TAG: &[u8] = &[0x73, 0x73];
const SIMPLE_TAG: &[u8] = &[0x67, 0xc8];
const TAG_NAME: &[u8] = &[0x45, 0xa3];
/// Tags that say of the file itself, or of its streams, what is no longer so once it is written anew.
const PASSING: [&str; 6] = ["ENCODER", "DURATION", "BPS", "BITSPS", "NUMBER_OF_", "_STATISTICS_"];
/// The demuxer itself takes this codec's delay into account.
const OPUS: &[u8] = b"A_OPUS";

/// By how much what a decoder makes of a track comes earlier than its packets say.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Delays {
    /// Numbers of tracks, and nanoseconds.
    tracks: Vec<(u64, i64)>,
}

impl Delays {
    /// Those of a file that begins so; none of one that is no Matroska file.
    pub fn of(beginning: &[u8]) -> Self {
        if beginning.starts_with(FILE) { Self { tracks: delays(beginning) } } else { Self::default() }
    }

    /// By how much later than its times a stream is to be written, in nanoseconds, so that no time is negative: the demuxer ends
    /// a stream's name with its number and its identifier.
    pub fn offset(&self, pad: &gst::Pad) -> i64 {
        let Some(longest) = self.tracks.iter().map(|(_, delay)| *delay).max() else { return 0 };
        let stream = pad.stream_id();
        let number =
            stream.as_deref().and_then(|stream| stream.rsplit('/').next()?.split(':').next()?.parse().ok());
        let own = self.tracks.iter().find(|(track, _)| Some(*track) == number).map_or(0, |(_, delay)| *delay);
        longest - own
    }
}

/// What a Matroska file has that the demuxer does not give out, or the muxers do not take, in sentences.
pub fn losses(beginning: &[u8]) -> Vec<String> {
    if !beginning.starts_with(FILE) {
        return Vec::new();
    }
    let mut all = Vec::new();
    if parts(beginning, ATTACHMENTS).next().is_some() {
        all.push("attached files, such as a cover picture or fonts, are left out".to_owned());
    }
    let tags = parts(beginning, TAGS).filter(|(name, _)| *name == TAG).flat_map(|(_, tag)| elements(tag));
    let entries = tags.filter(|(name, _)| *name == SIMPLE_TAG).flat_map(|(_, entry)| elements(entry));
    let mut names = entries.filter(|(name, _)| *name == TAG_NAME).map(|(_, name)| name);
    let is_passing = |name: &[u8]| PASSING.iter().any(|passing| name.starts_with(passing.as_bytes()));
    if names.any(|name| !is_passing(name)) {
        all.push("tags, such as place and camera, are left out but for a few".to_owned());
    }
    all
}

/// The elements in those of a name in the segment of a file.
fn parts<'a>(file: &'a [u8], wanted: &'static [u8]) -> impl Iterator<Item = (&'a [u8], &'a [u8])> {
    let segment = elements(file).find(|(name, _)| *name == SEGMENT).map_or(&[][..], |(_, content)| content);
    elements(segment).filter(move |(name, _)| *name == wanted).flat_map(|(_, content)| elements(content))
}

fn delays(file: &[u8]) -> Vec<(u64, i64)> {
    let tracks = parts(file, TRACKS);
    let delay = |entry: &[u8]| {
        let field =
            |wanted: &[u8]| elements(entry).find(|(name, _)| *name == wanted).map(|(_, content)| content);
        let delay = number(field(DELAY)?);
        let is_open = delay > 0 && !field(CODEC)?.starts_with(OPUS);
        is_open.then_some((number(field(NUMBER)?), i64::try_from(delay).ok()?))
    };
    tracks.filter(|(name, _)| *name == ENTRY).filter_map(|(_, entry)| delay(entry)).collect()
}

fn number(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0, |number, byte| number << 8 | u64::from(*byte))
}

/// Names and contents of the elements in some bytes (RFC 8794); the last may be cut off.
fn elements(mut bytes: &[u8]) -> impl Iterator<Item = (&[u8], &[u8])> {
    std::iter::from_fn(move || {
        let name_length = bytes.first()?.leading_zeros() as usize + 1;
        let (name, rest) = bytes.split_at_checked(name_length)?;
        let size_length = rest.first()?.leading_zeros() as usize + 1;
        let (size, rest) = rest.split_at_checked(size_length)?;
        let bits = 7 * size_length as u32;
        let size = number(size) & 1u64.checked_shl(bits)?.wrapping_sub(1);
        // All ones: as long as there is something.
        let length = usize::try_from(size).unwrap_or(usize::MAX).min(rest.len());
        let (content, rest) = rest.split_at_checked(length)?;
        bytes = rest;
        Some((name, content))
    })
}

/// Has the first frames that come to a pad keep their time.
///
/// The demuxer lets its first segment start at the first frame that it finds and counts it as time 0, then goes on with segments of the
/// whole file: the first frame of a clip that begins later than 0 would come too early. After a seek, segments count from their start.
pub fn keep_first_time(pad: &gst::Pad) {
    pad.add_probe(gst::PadProbeType::EVENT_DOWNSTREAM, |_, info| {
        let new = info.event().and_then(|event| {
            let gst::EventView::Segment(segment) = event.view() else { return None };
            let mut segment = segment.segment().downcast_ref::<gst::ClockTime>()?.clone();
            let zero = Some(gst::ClockTime::ZERO);
            if segment.start() <= zero || segment.time() != zero || segment.base() != zero {
                return None;
            }
            segment.set_start(zero);
            segment.set_position(zero);
            Some(gst::event::Segment::builder(&segment).seqnum(event.seqnum()).build())
        });
        if let Some(event) = new {
            info.data = Some(gst::PadProbeData::Event(event));
        }
        gst::PadProbeReturn::Ok
    });
}

/// The bytes of a file in which all this is; none of what cannot be read.
pub fn beginning(file: &Path) -> Vec<u8> {
    let mut bytes = Vec::new();
    // What is read of a named pipe is gone.
    let file = Some(file).filter(|file| file.is_file()).and_then(|file| File::open(file).ok());
    match file.map(|file| file.take(SEARCHED).read_to_end(&mut bytes)) {
        Some(Ok(_)) => bytes,
        _ => Vec::new(),
    }
}

/// Whether a file is of this kind.
pub fn is_matroska(clip: &Path) -> bool {
    let mut start = [0; 4];
    File::open(clip).and_then(|mut file| file.read_exact(&mut start)).is_ok() && start == FILE
}

#[cfg(test)]
mod tests {
    use super::*;

    fn element(name: &[u8], content: &[u8]) -> Vec<u8> {
        [name, &[0x40 | (content.len() >> 8) as u8, content.len() as u8], content].concat()
    }

    #[test]
    fn delays_of_tracks_are_read() {
        let entry = |number: u8, codec: &[u8], delay: &[u8]| {
            let fields = [element(NUMBER, &[number]), element(CODEC, codec), element(DELAY, delay)];
            element(ENTRY, &fields.concat())
        };
        let tracks = [
            entry(1, b"V_MPEG4/ISO/AVC", &[0]),
            entry(2, b"A_AAC", &[0x01, 0x5e, 0xf3, 0xc0]),
            entry(3, b"A_OPUS", &[0x63, 0x2e, 0xa0]),
        ];
        let segment = [element(&[0xec], &[0; 9]), element(TRACKS, &tracks.concat())];
        let file = [element(FILE, &[0; 3]), element(SEGMENT, &segment.concat())].concat();
        assert_eq!(delays(&file), [(2, 23_000_000)]);
        for end in 0..file.len() {
            let _ = delays(&file[..end]);
        }
    }
}
