// SPDX-License-Identifier: MIT OR Apache-2.0

//! Samples of the tracks of a QuickTime or MP4 file (ISO/IEC 14496-12, 8.5 to 8.7): where a camera writes what it measures
//! while it records. Fragmented files have none in their index.

use crate::boxes::{array, child, children, number};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

/// Where a sample lies in its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    pub offset: u64,
    pub length: u64,
}

/// A track in the index of a film.
#[derive(Clone, Copy, Debug)]
pub struct Track<'a>(&'a [u8]);

/// More tracks than cameras write: in a damaged file each one may be a large read.
const MOST_TRACKS: usize = 64;

/// All tracks.
pub fn tracks(index: &[u8]) -> impl Iterator<Item = Track<'_>> {
    children(index).filter(|(name, _)| name == b"trak").map(|(_, content)| Track(content)).take(MOST_TRACKS)
}

impl<'a> Track<'a> {
    /// What is in it: `vide`, `soun`, `meta`.
    pub fn handler(self) -> Option<[u8; 4]> {
        array(child(self.0, &[b"mdia", b"hdlr"])?, 8)
    }

    /// The format of its samples.
    pub fn format(self) -> Option<[u8; 4]> {
        array(self.table(b"stsd")?, 12)
    }

    /// The boxes in it.
    pub fn content(self) -> &'a [u8] {
        self.0
    }

    fn table(self, name: &[u8; 4]) -> Option<&'a [u8]> {
        child(self.0, &[b"mdia", b"minf", b"stbl", name])
    }

    /// Where its first samples lie, at most so many; fewer where the tables are damaged.
    pub fn samples(self, most: usize) -> Vec<Place> {
        let [sizes, runs, near, far] = [b"stsz", b"stsc", b"stco", b"co64"].map(|name| self.table(name));
        let (Some(sizes), Some(runs)) = (sizes, runs) else { return Vec::new() };
        let start_of = |chunk: usize| match near {
            Some(table) => number(table, 8 + 4 * chunk).map(u64::from),
            None => array(far?, 8 + 8 * chunk).map(u64::from_be_bytes),
        };
        let mut places = Vec::new();
        let mut run = 0;
        // Each chunk has a sample: there is no need to look at more of them.
        for chunk in 0..most {
            let Some(start) = start_of(chunk) else { break };
            while number(runs, 8 + 12 * (run + 1)).is_some_and(|first| first as usize <= chunk + 1) {
                run += 1;
            }
            let Some(in_chunk) = number(runs, 8 + 12 * run + 4) else { break };
            let mut offset = start;
            for _ in 0..in_chunk {
                if places.len() == most {
                    return places;
                }
                let Some(length) = size(sizes, places.len()) else { return places };
                places.push(Place { offset, length });
                let Some(next) = offset.checked_add(length) else { return places };
                offset = next;
            }
        }
        places
    }
}

/// The length of a sample.
fn size(sizes: &[u8], index: usize) -> Option<u64> {
    let (all, count) = (number(sizes, 4)?, number(sizes, 8)?);
    match all {
        0 => number(sizes, 12 + 4 * index).map(u64::from),
        _ => (index < count as usize).then_some(u64::from(all)),
    }
}

/// A sample, as far as `largest` bytes.
pub fn read(file: &mut File, place: Place, largest: u64) -> Option<Vec<u8>> {
    file.seek(SeekFrom::Start(place.offset)).ok()?;
    let mut bytes = Vec::new();
    file.take(place.length.min(largest)).read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

/// A film whose only track has these samples, which lie right after its `ftyp`, one to a chunk.
#[cfg(test)]
pub fn film(handler: &[u8; 4], format: &[u8; 4], samples: &[Vec<u8>], beside: &[u8]) -> Vec<u8> {
    use crate::boxes::boxed;
    let words = |words: &[usize]| words.iter().flat_map(|word| (*word as u32).to_be_bytes()).collect();
    let full = |content: Vec<u8>| [vec![0; 4], content].concat();
    let start = boxed(b"ftyp", b"mp42\0\0\0\0");
    let mut offset = start.len() + 8;
    let offsets = samples.iter().map(|sample| {
        offset += sample.len();
        offset - sample.len()
    });
    let offsets: Vec<usize> = offsets.collect();
    let lengths: Vec<usize> = samples.iter().map(Vec::len).collect();
    let table = [
        boxed(b"stsd", &full([words(&[1]), boxed(format, &[0; 8])].concat())),
        boxed(b"stsz", &full([words(&[0, samples.len()]), words(&lengths)].concat())),
        boxed(b"stsc", &full(words(&[1, 1, 1, 1]))),
        boxed(b"stco", &full([words(&[samples.len()]), words(&offsets)].concat())),
    ];
    let hdlr = boxed(b"hdlr", &full([&[0; 4], &handler[..], &[0; 13]].concat()));
    let media = [hdlr, boxed(b"minf", &boxed(b"stbl", &table.concat()))].concat();
    let track = boxed(b"trak", &boxed(b"mdia", &media));
    [start, boxed(b"mdat", &samples.concat()), boxed(b"moov", &[&track, beside].concat())].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::boxes::boxed;

    fn words(words: &[u32]) -> Vec<u8> {
        words.iter().flat_map(|word| word.to_be_bytes()).collect()
    }

    /// Two chunks of two samples, one of three.
    fn track(sizes: &[u32]) -> Vec<u8> {
        let table = [
            boxed(b"stsz", &words(sizes)),
            boxed(b"stsc", &words(&[0, 2, 1, 2, 1, 3, 3, 1])),
            boxed(b"co64", &words(&[0, 3, 0, 100, 1, 0, 0, 300])),
        ];
        boxed(b"mdia", &boxed(b"minf", &boxed(b"stbl", &table.concat())))
    }

    #[test]
    fn samples_lie_in_their_chunks() {
        let track_of_sizes = track(&[0, 0, 7, 10, 11, 12, 13, 14, 15, 16]);
        let places = Track(&track_of_sizes).samples(100);
        let offsets: Vec<u64> = places.iter().map(|place| place.offset).collect();
        assert_eq!(offsets, [100, 110, 1 << 32, (1 << 32) + 12, 300, 314, 329]);
        assert_eq!(places[6].length, 16);
        assert_eq!(Track(&track_of_sizes).samples(3).len(), 3);
        let alike = track(&[0, 5, 6]);
        assert_eq!(Track(&alike).samples(100).len(), 6);
    }
}
