// SPDX-License-Identifier: MIT OR Apache-2.0

//! What is corrected in the index of MP4 and MOV files as it is read, so that GStreamer's demuxer finds their video.
//!
//! It passes over a track that is shorter than a fifth of the film, as a preview picture would be. Where all video would be lost so, it
//! is given these tracks with the film's length; their edit lists and frames stay what they are. It also passes over what begins at a
//! track's end: the last frame of a phone's clip, where that frame is stated to take no time. And it does not have all names of codecs,
//! although the decoder is there.

use crate::boxes::{child, children, number, read_index};
use gst::prelude::*;
use std::fs::File;
use std::io::Seek;
use std::path::Path;

/// Bytes that replace those at an offset in the file.
#[derive(Clone, Debug, PartialEq)]
struct Patch {
    offset: u64,
    bytes: Vec<u8>,
}

/// Names of codecs that the demuxer lacks, and those that it has for the same: DNxHR and DNxHD are one.
const NAMES: [(&[u8; 4], &[u8; 4]); 1] = [(b"AVdh", b"AVdn")];

/// Where the box with a length has it: ticks a second, ticks, the ticks' offset in the box and their number of bytes.
struct Length {
    rate: u64,
    ticks: u64,
    offset: usize,
    bytes: usize,
}

impl Length {
    /// Of the content of a `mvhd` or `mdhd`.
    fn of(content: &[u8]) -> Option<Self> {
        let long = |at| Some(u64::from(number(content, at)?) << 32 | u64::from(number(content, at + 4)?));
        match content.first()? {
            0 => {
                let (rate, ticks) = (number(content, 12)?.into(), number(content, 16)?.into());
                Some(Self { rate, ticks, offset: 16, bytes: 4 })
            }
            1 => Some(Self { rate: number(content, 20)?.into(), ticks: long(24)?, offset: 24, bytes: 8 }),
            _ => None,
        }
    }
}

/// Has what comes to a pad from a file changed so that its video is not passed over.
pub fn keep(clip: &Path, pad: &gst::Pad) {
    let Some(patches) = File::open(clip).ok().and_then(|mut file| {
        let index = read_index(&mut file)?;
        let start = file.stream_position().ok()?.checked_sub(index.len() as u64)?;
        Some([lengths(&index, start), names(&index, start)].concat())
    }) else {
        return;
    };
    if patches.is_empty() {
        return;
    }
    pad.add_probe(gst::PadProbeType::BUFFER, move |_, info| {
        if let Some(buffer) = info.buffer_mut() {
            patches.iter().for_each(|patch| apply(patch, buffer));
        }
        gst::PadProbeReturn::Ok
    });
}

/// Overwrites what a buffer has of the bytes.
fn apply(patch: &Patch, buffer: &mut gst::Buffer) {
    let start = buffer.offset();
    let end = start.saturating_add(buffer.size() as u64);
    if patch.offset >= end || patch.offset + patch.bytes.len() as u64 <= start {
        return;
    }
    let Ok(mut content) = buffer.make_mut().map_writable() else { return };
    for (at, byte) in (patch.offset..).zip(&patch.bytes) {
        let place = at.checked_sub(start).and_then(|at| content.get_mut(usize::try_from(at).ok()?));
        if let Some(place) = place {
            *place = *byte;
        }
    }
}

/// Where the names of codecs are to be changed in an index that begins at an offset.
fn names(index: &[u8], start: u64) -> Vec<Patch> {
    let tracks = children(index).filter(|(name, _)| *name == b"trak");
    let patch = |(_, track)| {
        let entries = child(track, &[b"mdia", b"minf", b"stbl", b"stsd"])?.get(8..)?;
        let (name, _) = children(entries).next()?;
        let (_, known) = NAMES.iter().find(|(unknown, _)| name == *unknown)?;
        // Both are of one piece of memory.
        let offset = (name.as_ptr() as usize).checked_sub(index.as_ptr() as usize)?;
        Some(Patch { offset: start + offset as u64, bytes: known.to_vec() })
    };
    tracks.filter_map(patch).collect()
}

/// What is to be changed in the lengths of an index that begins at an offset: nothing where any video would be found.
fn lengths(index: &[u8], start: u64) -> Vec<Patch> {
    let Some(film) = child(index, &[b"mvhd"]).and_then(Length::of) else { return Vec::new() };
    let is_video = |track: &[u8]| {
        child(track, &[b"mdia", b"hdlr"]).and_then(|handler| handler.get(8..12)) == Some(b"vide")
    };
    let tracks = children(index).filter(|(name, content)| *name == b"trak" && is_video(content));
    let lengths: Vec<_> = tracks
        .filter_map(|(_, track)| {
            let header = child(track, &[b"mdia", b"mdhd"])?;
            // Both are of one piece of memory.
            let place = (header.as_ptr() as usize).checked_sub(index.as_ptr() as usize)?;
            Some((Length::of(header)?, place, last_decoded(track)))
        })
        .collect();
    // As it is computed there, in integers.
    let is_passed_over = |track: &Length| {
        let whole = u128::from(film.ticks) * u128::from(track.rate);
        whole != 0 && u128::from(track.ticks) * u128::from(film.rate) * 10 / whole < 2
    };
    let are_all_passed_over = lengths.iter().all(|(track, ..)| is_passed_over(track));
    let wanted = |(track, _, last): &(Length, usize, Option<u64>)| match *last {
        _ if are_all_passed_over => {
            let whole = u128::from(film.ticks) * u128::from(track.rate);
            u64::try_from(whole.div_ceil(u128::from(film.rate).max(1))).ok()
        }
        Some(last) if last >= track.ticks => last.checked_add(1),
        _ => None,
    };
    let changed: Vec<_> = lengths.iter().filter_map(|one| Some((&one.0, one.1, wanted(one)?))).collect();
    // The film is as long as its longest track.
    let in_film = |(track, _, ticks): &(&Length, usize, u64)| {
        (u128::from(*ticks) * u128::from(film.rate)).div_ceil(u128::from(track.rate).max(1))
    };
    let longest = changed.iter().map(in_film).max().and_then(|ticks| u64::try_from(ticks).ok());
    let film_header =
        child(index, &[b"mvhd"]).map(|header| header.as_ptr() as usize - index.as_ptr() as usize);
    let of_film = longest.filter(|ticks| *ticks > film.ticks).zip(film_header);
    let patches = changed.into_iter().chain(of_film.map(|(ticks, header)| (&film, header, ticks)));
    let patch = |(length, header, ticks): (&Length, usize, u64)| {
        let bytes = ticks.to_be_bytes();
        let (unused, bytes) = bytes.split_at(8 - length.bytes);
        let fits = unused.iter().all(|byte| *byte == 0);
        let offset = start + (header + length.offset) as u64;
        fits.then(|| Patch { offset, bytes: bytes.to_vec() })
    };
    patches.filter_map(patch).collect()
}

/// When the last frame of a track without an edit list is decoded, in its ticks.
fn last_decoded(track: &[u8]) -> Option<u64> {
    if child(track, &[b"edts"]).is_some() {
        return None;
    }
    let table = child(track, &[b"mdia", b"minf", b"stbl", b"stts"])?;
    let count = number(table, 4)? as usize;
    let runs = table.get(8..)?.chunks_exact(8).take(count);
    let runs = runs.map(|run| Some((u64::from(number(run, 0)?), u64::from(number(run, 4)?))));
    let runs: Vec<_> = runs.collect::<Option<_>>()?;
    let end: u64 = runs.iter().map(|(samples, ticks)| samples * ticks).sum();
    runs.last().map(|(_, ticks)| end - ticks)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::boxes::boxed;

    /// A header of 1000 ticks a second and so many ticks.
    fn header(name: &[u8; 4], ticks: u32) -> Vec<u8> {
        let words = [0, 0, 0, 1000, ticks, 0].map(u32::to_be_bytes);
        boxed(name, &words.concat())
    }

    fn track(kind: &[u8; 4], ticks: u32) -> Vec<u8> {
        let handler = boxed(b"hdlr", &[&[0; 8], &kind[..], &[0; 12]].concat());
        boxed(b"trak", &boxed(b"mdia", &[header(b"mdhd", ticks), handler].concat()))
    }

    fn index(tracks: &[Vec<u8>]) -> Vec<u8> {
        [header(b"mvhd", 10_000), tracks.concat()].concat()
    }

    #[test]
    fn a_last_frame_that_takes_no_time_is_in_the_film() {
        let of = |last: u32| {
            let words = |words: &[u32]| words.iter().flat_map(|word| word.to_be_bytes()).collect::<Vec<_>>();
            let durations = boxed(b"stts", &words(&[0, 2, 5, 2000, 1, last]));
            let whole = 10_000 + last;
            let information = boxed(b"minf", &boxed(b"stbl", &durations));
            let handler = boxed(b"hdlr", &[&[0; 8], &b"vide"[..], &[0; 12]].concat());
            let media = [header(b"mdhd", whole), handler, information].concat();
            lengths(&index(&[boxed(b"trak", &boxed(b"mdia", &media))]), 0)
        };
        let ticks: Vec<_> = of(0).into_iter().map(|patch| patch.bytes).collect();
        assert_eq!(ticks, [10_001u32.to_be_bytes(), 10_001u32.to_be_bytes()]);
        assert_eq!(of(2000), []);
    }

    #[test]
    fn a_short_track_is_given_the_length_of_the_film() {
        let index = index(&[track(b"soun", 500), track(b"vide", 1999)]);
        let [patch] = &lengths(&index, 1000)[..] else { panic!() };
        assert_eq!(patch.bytes, 10_000u32.to_be_bytes());
        let at = usize::try_from(patch.offset).unwrap() - 1000;
        assert_eq!(index[at..at + 4], 1999u32.to_be_bytes());

        gst::init().unwrap();
        // In the middle of a buffer, and over the border of two.
        for (begin, end) in [(at - 3, at + 9), (at - 3, at + 2), (at + 2, at + 9)] {
            let mut buffer = gst::Buffer::from_slice(index[begin..end].to_vec());
            buffer.get_mut().unwrap().set_offset(begin as u64 + 1000);
            apply(patch, &mut buffer);
            let mut expected = index.clone();
            expected[at..at + 4].copy_from_slice(&10_000u32.to_be_bytes());
            assert_eq!(buffer.map_readable().unwrap()[..], expected[begin..end]);
        }
    }

    #[test]
    fn codecs_get_names_that_are_known() {
        let track = |name: &[u8; 4]| {
            let entries = [&[0, 0, 0, 0, 0, 0, 0, 1][..], &boxed(name, &[0; 78])].concat();
            let table = boxed(b"minf", &boxed(b"stbl", &boxed(b"stsd", &entries)));
            boxed(b"trak", &boxed(b"mdia", &table))
        };
        let index = [header(b"mvhd", 10_000), track(b"avc1"), track(b"AVdh")].concat();
        let [patch] = &names(&index, 1000)[..] else { panic!() };
        let at = usize::try_from(patch.offset).unwrap() - 1000;
        assert_eq!((&index[at..at + 4], &patch.bytes[..]), (&b"AVdh"[..], &b"AVdn"[..]));
        for end in 0..index.len() {
            let _ = names(&index[..end], 0);
        }
    }

    #[test]
    fn previews_stay_previews() {
        for tracks in [
            &[track(b"vide", 100), track(b"vide", 9000)][..],
            &[track(b"vide", 2000)],
            &[track(b"soun", 100)],
            &[],
        ] {
            assert_eq!(lengths(&index(tracks), 0), []);
        }
        assert_eq!(lengths(b"nonsense", 0), []);
    }
}
