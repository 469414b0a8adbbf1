// SPDX-License-Identifier: MIT OR Apache-2.0

//! The programs of MPEG transport streams (ISO/IEC 13818-1), which are clips of their own: the decoder takes the first.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Bytes from the beginning of a file in which its list of programs is sought.
const SEARCHED: u64 = 1 << 20;
const SYNC: u8 = 0x47;
/// The lengths of packets: as they are, with a time before each, with a checksum behind each.
const LENGTHS: [(usize, usize); 3] = [(188, 0), (192, 4), (204, 0)];

/// How many programs a file has; `None` of one that is no transport stream.
pub fn count(clip: &Path) -> Option<usize> {
    let mut bytes = Vec::new();
    // What is read of a pipe is gone.
    let file = Some(clip).filter(|clip| clip.is_file()).and_then(|clip| File::open(clip).ok())?;
    file.take(SEARCHED).read_to_end(&mut bytes).ok()?;
    count_in(&bytes)
}

fn count_in(bytes: &[u8]) -> Option<usize> {
    let is_sync = |at: usize| bytes.get(at) == Some(&SYNC);
    let (length, start) =
        LENGTHS.into_iter().find(|(length, start)| (0..3).all(|number| is_sync(start + number * length)))?;
    bytes.get(start..)?.chunks(length).find_map(programs)
}

/// The number of programs that a packet lists; `None` of other packets.
fn programs(packet: &[u8]) -> Option<usize> {
    let [SYNC, high, low, control, ..] = *packet else { return None };
    let is_start = high & 0x40 != 0;
    if !is_start || high & 0x1f != 0 || low != 0 || control & 0x10 == 0 {
        return None;
    }
    let adaptation = if control & 0x20 == 0 { 0 } else { 1 + usize::from(*packet.get(4)?) };
    let content = packet.get(4 + adaptation..188)?;
    let section = content.get(1 + usize::from(*content.first()?)..)?;
    let length = usize::from(section.get(1)? & 0x0f) << 8 | usize::from(*section.get(2)?);
    // Behind a header of eight bytes, before a checksum of four.
    let entries = section.get(8..(length + 3).checked_sub(4)?)?;
    // Program 0 is information on the network.
    Some(entries.chunks_exact(4).filter(|entry| entry[..2] != [0, 0]).count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn programs_are_counted() {
        let list = |programs: &[u8]| {
            let mut packet =
                vec![SYNC, 0x40, 0, 0x10, 0, 0, 0xb0, 9 + 4 * programs.len() as u8, 0, 1, 0xc1, 0, 0];
            packet.extend(programs.iter().flat_map(|number| [0, *number, 0xe1, 0]));
            packet.resize(188, 0xff);
            packet
        };
        let other = [&[SYNC, 0x41, 0, 0x10][..], &[0; 184]].concat();
        let file = [other.clone(), list(&[0, 1, 2]), other.clone()].concat();
        assert_eq!(count_in(&file), Some(2));
        let timed: Vec<u8> = file.chunks(188).flat_map(|packet| [&[0; 4], packet].concat()).collect();
        assert_eq!(count_in(&timed), Some(2));
        assert_eq!(count_in(&[list(&[1]), other.clone(), other].concat()), Some(1));
        assert_eq!(count_in(&[0; 1000]), None);
        for end in 0..file.len() {
            let _ = count_in(&file[..end]);
        }
    }
}
