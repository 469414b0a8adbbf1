// SPDX-License-Identifier: MIT OR Apache-2.0

//! The boxes of which QuickTime and MP4 files are made (ISO/IEC 14496-12): a length, a name of four bytes, content.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

/// The largest index of a film that is read: hours of video have a few megabytes.
const LARGEST_INDEX: u64 = 256 << 20;
/// The most boxes at the top level that are looked at: a day of fragments has fewer.
const MOST_BOXES: usize = 1 << 20;

/// The content of the box `moov`, the index of a film.
pub fn read_index(file: &mut File) -> Option<Vec<u8>> {
    read_top_level(file, b"moov", LARGEST_INDEX)
}

/// Whether a file is a film that lacks its index, which is written last: the recording was broken off.
pub fn lacks_index(file: &mut File) -> bool {
    let mut start = [0; 8];
    file.read_exact(&mut start).is_ok()
        && &start[4..] == b"ftyp"
        && read_top_level(file, b"moov", 0).is_none()
}

/// The content of the first box of a name that lies in no other one, as far as `largest` bytes.
pub fn read_top_level(file: &mut File, wanted: &[u8; 4], largest: u64) -> Option<Vec<u8>> {
    let mut start = 0;
    for _ in 0..MOST_BOXES {
        file.seek(SeekFrom::Start(start)).ok()?;
        let mut header = [0; 16];
        file.read_exact(&mut header[..8]).ok()?;
        let mut length = u64::from(number(&header, 0)?);
        let mut content = start + 8;
        if length == 1 {
            file.read_exact(&mut header[8..]).ok()?;
            length = u64::from(number(&header, 8)?) << 32 | u64::from(number(&header, 12)?);
            content += 8;
        }
        // None: up to the end of the file.
        let end = if length == 0 { u64::MAX } else { start.checked_add(length)? };
        if end < content {
            return None;
        }
        if &header[4..8] == wanted {
            let mut bytes = Vec::new();
            file.take((end - content).min(largest)).read_to_end(&mut bytes).ok()?;
            return Some(bytes);
        }
        start = end;
    }
    None
}

/// Names and contents of the boxes in a box.
pub fn children(mut bytes: &[u8]) -> impl Iterator<Item = (&[u8], &[u8])> {
    std::iter::from_fn(move || {
        let length = number(bytes, 0)? as usize;
        let (name, content) = (bytes.get(4..8)?, bytes.get(8..length)?);
        bytes = bytes.get(length..)?;
        Some((name, content))
    })
}

/// The content of the first box at a path of names.
pub fn child<'a>(bytes: &'a [u8], path: &[&[u8; 4]]) -> Option<&'a [u8]> {
    path.iter().try_fold(bytes, |bytes, wanted| {
        children(bytes).find(|(name, _)| name == wanted).map(|(_, content)| content)
    })
}

/// The big-endian number at an offset.
pub fn number(bytes: &[u8], at: usize) -> Option<u32> {
    array(bytes, at).map(u32::from_be_bytes)
}

/// The bytes from an offset on.
pub fn array<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..at.checked_add(N)?)?.try_into().ok()
}

/// The big-endian number of eight bytes at an offset.
pub fn long_number(bytes: &[u8], at: usize) -> Option<u64> {
    let bytes = bytes.get(at..at.checked_add(8)?)?;
    Some(u64::from_be_bytes(bytes.try_into().ok()?))
}

/// A box of a name and content; of more than 4 GiB in the long form.
pub fn boxed(name: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let length = content.len() + 8;
    match u32::try_from(length) {
        Ok(length) => [&length.to_be_bytes()[..], name, content].concat(),
        Err(_) => [&1u32.to_be_bytes()[..], name, &(length as u64 + 8).to_be_bytes(), content].concat(),
    }
}

/// Numbers one after another, big-endian.
pub fn words(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_be_bytes()).collect()
}
