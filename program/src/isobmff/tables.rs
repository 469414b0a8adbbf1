// SPDX-License-Identifier: MIT OR Apache-2.0

//! Sample tables: where the samples of a track lie in the file, and when they are decoded and shown
//! (ISO/IEC 14496-12, 8.6 and 8.7).

use crate::boxes::{boxed, child, long_number, number, words};

/// A run of bytes of a file that holds consecutive samples of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chunk {
    pub offset: u64,
    pub length: u64,
    /// When its first sample is decoded, in seconds of the track.
    pub time: f64,
}

/// Samples of a table that are alike: how many, and their value.
fn runs(values: impl Iterator<Item = u32>) -> Vec<[u32; 2]> {
    let mut runs: Vec<[u32; 2]> = Vec::new();
    for value in values {
        match runs.last_mut() {
            Some([count, last]) if *last == value => *count += 1,
            _ => runs.push([1, value]),
        }
    }
    runs
}

/// A box of version 0 with a count and rows of numbers.
fn table<const N: usize>(name: &[u8; 4], rows: &[[u32; N]]) -> Vec<u8> {
    let count = u32::try_from(rows.len()).unwrap_or(u32::MAX);
    boxed(name, &[words(&[0, count]), words(rows.as_flattened())].concat())
}

/// The rows of a box of version 0 with a count, as many as there are.
fn rows<const N: usize>(table: &[u8]) -> Option<impl Iterator<Item = [u32; N]>> {
    let count = number(table, 4)? as usize;
    let row = move |row: &[u8]| {
        let mut numbers = [0; N];
        for (column, value) in numbers.iter_mut().enumerate() {
            *value = number(row, 4 * column).unwrap_or(0);
        }
        numbers
    };
    Some(table.get(8..)?.chunks_exact(4 * N).take(count).map(row))
}

/// `stts`: the durations of samples.
pub fn durations(durations: impl Iterator<Item = u32>) -> Vec<u8> {
    table(b"stts", &runs(durations))
}

/// `ctts`: by how much a sample is shown later than it is decoded; empty where that is never.
pub fn composition(offsets: impl Iterator<Item = u32>) -> Vec<u8> {
    let runs = runs(offsets);
    if runs.iter().all(|[_, offset]| *offset == 0) { Vec::new() } else { table(b"ctts", &runs) }
}

/// `stsz`: the sizes of samples in bytes.
pub fn sizes(sizes: &[u32]) -> Vec<u8> {
    let count = u32::try_from(sizes.len()).unwrap_or(u32::MAX);
    boxed(b"stsz", &[words(&[0, 0, count]), words(sizes)].concat())
}

/// `stss`: which samples are key frames; empty where all are.
pub fn key_frames(keys: impl Iterator<Item = bool>) -> Vec<u8> {
    let keys: Vec<bool> = keys.collect();
    if keys.iter().all(|is_key| *is_key) {
        return Vec::new();
    }
    let numbered = keys.iter().zip(1u32..).filter(|(is_key, _)| **is_key);
    table(b"stss", &numbered.map(|(_, sample)| [sample]).collect::<Vec<_>>())
}

/// `stsc`: how many samples each chunk has.
pub fn chunk_lengths(samples: impl Iterator<Item = u32>) -> Vec<u8> {
    let mut first = 1;
    let row = |[chunks, samples]: [u32; 2]| {
        let row = [first, samples, 1];
        first += chunks;
        row
    };
    table(b"stsc", &runs(samples).into_iter().map(row).collect::<Vec<_>>())
}

/// `stco`, or `co64` where offsets may pass 4 GiB: where chunks begin.
pub fn chunk_offsets(offsets: &[u64], is_long: bool) -> Vec<u8> {
    let count = u32::try_from(offsets.len()).unwrap_or(u32::MAX);
    let head = words(&[0, count]);
    if is_long {
        let offsets = offsets.iter().flat_map(|offset| offset.to_be_bytes());
        boxed(b"co64", &[head, offsets.collect()].concat())
    } else {
        let offsets: Vec<u32> = offsets.iter().map(|offset| u32::try_from(*offset).unwrap_or(0)).collect();
        boxed(b"stco", &[head, words(&offsets)].concat())
    }
}

/// Where the chunks of a track lie, in the order of the table; `None` of a table that is damaged.
///
/// `stbl` is the content of the box, `timescale` the track's ticks a second.
pub fn chunks(stbl: &[u8], timescale: u32) -> Option<Vec<Chunk>> {
    let offsets: Vec<u64> = match (child(stbl, &[b"stco"]), child(stbl, &[b"co64"])) {
        (Some(offsets), _) => rows::<1>(offsets)?.map(|[offset]| offset.into()).collect(),
        (None, Some(offsets)) => {
            rows::<2>(offsets)?.map(|[high, low]| u64::from(high) << 32 | u64::from(low)).collect()
        }
        (None, None) => return None,
    };
    let sizes = Sizes::of(stbl)?;
    let lengths: Vec<[u32; 3]> = rows::<3>(child(stbl, &[b"stsc"])?)?.collect();
    let mut lengths = lengths.iter().peekable();
    let mut durations = rows::<2>(child(stbl, &[b"stts"])?)?;
    let (mut run, mut ticks) = ([0, 0], 0u64);
    let (mut sample, mut samples_in_chunk) = (0u64, 0u32);
    let mut chunks = Vec::with_capacity(offsets.len());
    for (chunk, offset) in (1u32..).zip(offsets) {
        if let Some([_, samples, _]) = lengths.next_if(|[first, _, _]| *first <= chunk) {
            samples_in_chunk = *samples;
        }
        let samples = u64::from(samples_in_chunk).min(sizes.count.saturating_sub(sample));
        let time = ticks as f64 / f64::from(timescale.max(1));
        let length = sizes.of_samples(sample, samples)?;
        chunks.push(Chunk { offset, length, time });
        sample += samples;
        let mut passed = samples;
        while passed > 0 {
            if run[0] == 0 {
                let Some(next) = durations.next() else { break };
                run = next;
                continue;
            }
            let step = passed.min(run[0].into());
            ticks += step * u64::from(run[1]);
            run[0] -= step as u32;
            passed -= step;
        }
    }
    Some(chunks)
}

/// How many samples a track has.
pub fn sample_count(stbl: &[u8]) -> Option<u64> {
    Some(Sizes::of(stbl)?.count)
}

/// The sizes of a track's samples.
struct Sizes<'a> {
    count: u64,
    kind: SizesKind<'a>,
}

enum SizesKind<'a> {
    /// The same for all: bytes of so many samples.
    Same { bytes: u64, samples: u64 },
    /// A number of so many bits for each.
    Each { bits: u32, numbers: &'a [u8] },
}

impl<'a> Sizes<'a> {
    fn of(stbl: &'a [u8]) -> Option<Self> {
        if let Some(table) = child(stbl, &[b"stz2"]) {
            let (bits, count) = (number(table, 4)? & 0xff, number(table, 8)?.into());
            return Some(Self { count, kind: SizesKind::Each { bits, numbers: table.get(12..)? } });
        }
        let table = child(stbl, &[b"stsz"])?;
        let (size, count) = (number(table, 4)?, number(table, 8)?.into());
        let kind = match (size, packed_audio(stbl)) {
            (0, _) => SizesKind::Each { bits: 32, numbers: table.get(12..)? },
            (_, Some([bytes, samples])) => SizesKind::Same { bytes, samples },
            (size, None) => SizesKind::Same { bytes: size.into(), samples: 1 },
        };
        Some(Self { count, kind })
    }

    /// The bytes of `count` samples from one on.
    fn of_samples(&self, first: u64, count: u64) -> Option<u64> {
        match self.kind {
            SizesKind::Same { bytes, samples } => count.checked_mul(bytes)?.checked_div(samples),
            SizesKind::Each { bits, numbers } => {
                let bits = bits as usize;
                let first = usize::try_from(first).ok()?;
                let mut sum = 0u64;
                for sample in first..first.checked_add(usize::try_from(count).ok()?)? {
                    let size = match bits {
                        32 => number(numbers, sample.checked_mul(4)?)?,
                        16 => {
                            let at = sample.checked_mul(2)?;
                            u16::from_be_bytes(numbers.get(at..at + 2)?.try_into().ok()?).into()
                        }
                        8 => (*numbers.get(sample)?).into(),
                        4 => u32::from(numbers.get(sample / 2)? >> (4 * (1 - sample % 2)) & 15),
                        _ => return None,
                    };
                    sum += u64::from(size);
                }
                Some(sum)
            }
        }
    }
}

/// QuickTime's sound of old: a "sample" is one instant of all channels, whatever the table of sizes says. Bytes of so many
/// samples; `None` of any other track. (Apple, *QuickTime File Format*, "Sound sample descriptions".)
fn packed_audio(stbl: &[u8]) -> Option<[u64; 2]> {
    const PCM: [&[u8; 4]; 11] =
        [b"raw ", b"twos", b"sowt", b"NONE", b"in24", b"in32", b"fl32", b"fl64", b"ulaw", b"alaw", b"lpcm"];
    let entry = child(stbl, &[b"stsd"])?.get(8..)?;
    let format = entry.get(4..8)?;
    // Size, format, reserved, index of the data reference; version, revision and vendor; channels and bits.
    let [version, _] = halves(number(entry, 16)?);
    let [channels, bits] = halves(number(entry, 24)?);
    let is_pcm = PCM.iter().any(|name| &name[..] == format);
    match version {
        0 if is_pcm => {
            let bits = if format == b"ulaw" || format == b"alaw" { 8 } else { bits };
            Some([u64::from(channels) * u64::from(bits.div_ceil(8)), 1])
        }
        // Samples a packet, bytes a packet (of one channel), bytes a frame.
        1 => {
            let [samples, bytes] = [number(entry, 36)?, number(entry, 44)?];
            (samples > 0 && bytes > 0).then_some([bytes.into(), samples.into()])
        }
        // Bytes a packet and frames a packet, both constant.
        2 if is_pcm => {
            let [bytes, frames] = [number(entry, 64)?, number(entry, 68)?];
            (bytes > 0 && frames > 0).then_some([bytes.into(), frames.into()])
        }
        _ => None,
    }
}

fn halves(word: u32) -> [u32; 2] {
    [word >> 16, word & 0xffff]
}

/// Segment durations and media times of an edit list, in ticks of the film and of the track; -1 for an empty edit.
pub fn edits(trak: &[u8]) -> Option<Vec<(u64, i64)>> {
    let list = child(trak, &[b"edts", b"elst"])?;
    let count = number(list, 4)? as usize;
    let is_long = list.first() == Some(&1);
    let size = if is_long { 20 } else { 12 };
    let edit = |row: &[u8]| match is_long {
        true => Some((long_number(row, 0)?, long_number(row, 8)?.cast_signed())),
        false => Some((number(row, 0)?.into(), i64::from(number(row, 4)?.cast_signed()))),
    };
    list.get(8..)?.chunks_exact(size).take(count).map(edit).collect()
}

/// The box of an edit list: each edit at the speed at which it was recorded.
pub fn edit_list(edits: &[(u64, i64)]) -> Vec<u8> {
    let count = u32::try_from(edits.len()).unwrap_or(u32::MAX);
    let mut list = words(&[1 << 24, count]);
    for (duration, time) in edits {
        list.extend([duration.to_be_bytes(), time.to_be_bytes()].concat());
        list.extend(words(&[1 << 16]));
    }
    boxed(b"edts", &boxed(b"elst", &list))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_are_found_again() {
        // Two chunks of two samples and one of one, at 10 ticks a second.
        let stbl = [
            durations([4, 4, 4, 6, 6].into_iter()),
            sizes(&[100, 20, 30, 40, 50]),
            chunk_lengths([2, 2, 1].into_iter()),
            chunk_offsets(&[1000, 5000, 7000], false),
        ]
        .concat();
        let expected = [(1000, 120, 0.0), (5000, 70, 0.8), (7000, 50, 1.8)]
            .map(|(offset, length, time)| Chunk { offset, length, time });
        assert_eq!(chunks(&stbl, 10).unwrap(), expected);
        let long = stbl[..stbl.len() - 28].to_vec();
        let long = [long, chunk_offsets(&[1000, 5000, 7000], true)].concat();
        assert_eq!(chunks(&long, 10).unwrap(), expected);
        for end in 0..stbl.len() {
            // A table that is cut short may still name chunks; none may be out of its bounds.
            let _ = chunks(&stbl[..end], 10);
        }
    }

    #[test]
    fn samples_of_sound_are_instants() {
        // Format, version 0, two channels, 16 bits: four bytes a sample, though the table says one.
        let entry = [
            words(&[36]),
            b"sowt".to_vec(),
            vec![0, 0, 0, 0, 0, 0, 0, 1],
            words(&[0, 0, 2 << 16 | 16, 0, 0]),
        ];
        let stbl = [
            boxed(b"stsd", &[words(&[0, 1]), entry.concat()].concat()),
            boxed(b"stsz", &words(&[0, 1, 300])),
            durations(std::iter::repeat_n(1, 300)),
            chunk_lengths([200, 100].into_iter()),
            chunk_offsets(&[8, 808], false),
        ]
        .concat();
        let lengths: Vec<_> = chunks(&stbl, 48000).unwrap().iter().map(|chunk| chunk.length).collect();
        assert_eq!(lengths, [800, 400]);
    }

    #[test]
    fn edit_lists_are_read_again() {
        let list = [(500, -1), (6_000_000_000, 1024)];
        assert_eq!(edits(&edit_list(&list)).unwrap(), list);
        let short = boxed(b"edts", &boxed(b"elst", &words(&[0, 1, 600, 0xffff_ffff, 1 << 16])));
        assert_eq!(edits(&short).unwrap(), [(600, -1)]);
    }
}
