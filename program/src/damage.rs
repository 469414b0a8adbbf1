// SPDX-License-Identifier: MIT OR Apache-2.0

//! Damage of a clip: whether its file ends too early, and what its decoder complains of.

use crate::boxes::{long_number, number};
use crate::input::Clip;
use crate::interruption::Interruption;
use crate::packets::Packets;
use anyhow::{Result, bail};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// GStreamer's category of the decoders of FFmpeg, whose errors come in no other way.
const CATEGORY: &str = "libav";

/// The size that a file should have by its own account, where it has fewer bytes: it was cut short. `None` where nothing is
/// missing, or the file does not say how large it is.
pub fn missing_bytes(clip: &Path) -> Option<u64> {
    let mut file = File::open(clip).ok()?;
    let size = file.metadata().ok()?.len();
    let mut start = [0; 12];
    file.read_exact(&mut start).ok()?;
    let end = match &start[..4] {
        b"RIFF" => u64::from(u32::from_le_bytes(start[4..8].try_into().ok()?)) + 8,
        [0x1a, 0x45, 0xdf, 0xa3] => end_of_segment(&mut file)?,
        b"FLV\x01" => end_of_tags(&mut file, number(&start, 5)?.into())?,
        b"OggS" => end_of_pages(&mut file, size)?,
        [0x30, 0x26, 0xb2, 0x75] => end_of_objects(&mut file)?,
        _ if [b"ftyp", b"moov", b"mdat", b"wide"].iter().any(|name| &start[4..8] == *name) => {
            end_of_boxes(&mut file)?
        }
        _ => return None,
    };
    end.checked_sub(size).filter(|missing| *missing > 0)
}

/// Where the last box of a file ends that begins inside it (ISO/IEC 14496-12).
fn end_of_boxes(file: &mut File) -> Option<u64> {
    let mut end = 0;
    loop {
        let mut header = [0; 16];
        file.seek(SeekFrom::Start(end)).ok()?;
        let read = file.take(16).read(&mut header).ok()?;
        if read < 8 {
            return Some(end);
        }
        let length = match number(&header, 0)? {
            // To the end of the file, wherever that is.
            0 => return None,
            1 => long_number(&header, 8)?,
            length => length.into(),
        };
        end = end.checked_add(length).filter(|_| length >= 8)?;
    }
}

/// Where the last tag of a Flash video ends that begins inside it (Adobe, *Flash Video File Format*): a header of eleven bytes, content,
/// and its length once more.
fn end_of_tags(file: &mut File, header: u64) -> Option<u64> {
    let mut end = header.checked_add(4)?;
    loop {
        let mut tag = [0; 11];
        file.seek(SeekFrom::Start(end)).ok()?;
        let read = file.take(11).read(&mut tag).ok()?;
        match read {
            0 => return Some(end),
            1..11 => return end.checked_add(11),
            // Its length has three bytes.
            _ => end = end.checked_add(u64::from(number(&tag, 0)? & 0xff_ffff) + 15)?,
        }
    }
}

/// Where the last object of an ASF file ends that begins inside it: an identifier of 16 bytes, a length of eight, content.
fn end_of_objects(file: &mut File) -> Option<u64> {
    let mut end = 0u64;
    loop {
        let mut header = [0; 24];
        file.seek(SeekFrom::Start(end)).ok()?;
        let read = file.take(24).read(&mut header).ok()?;
        if read < 24 {
            return Some(end);
        }
        let length = u64::from_le_bytes(header[16..].try_into().ok()?);
        // Who writes to a stream does not know how long it becomes.
        end = end.checked_add(length).filter(|_| length >= 24)?;
    }
}

/// Where the last page of an Ogg file ends that begins inside it (RFC 3533).
fn end_of_pages(file: &mut File, size: u64) -> Option<u64> {
    /// The longest page: a header, 255 lengths, and as many pieces of 255 bytes.
    const LONGEST: u64 = 27 + 255 + 255 * 255;
    let start = size.saturating_sub(LONGEST);
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(start)).ok()?;
    file.take(LONGEST).read_to_end(&mut bytes).ok()?;
    let last = bytes.windows(5).rposition(|window| window == b"OggS\0")?;
    let page = bytes.get(last..)?;
    let count = usize::from(*page.get(26)?);
    let pieces: u64 = page.get(27..27 + count)?.iter().map(|piece| u64::from(*piece)).sum();
    Some(start + last as u64 + 27 + count as u64 + pieces)
}

/// Where the segment of a Matroska file ends (RFC 9559): behind the header of the file, where its size is known.
fn end_of_segment(file: &mut File) -> Option<u64> {
    const SEGMENT: [u8; 4] = [0x18, 0x53, 0x80, 0x67];
    let mut at = 4;
    let (header, length) = element_size(file, at)?;
    at += length + header?;
    let mut name = [0; 4];
    file.seek(SeekFrom::Start(at)).ok()?;
    file.read_exact(&mut name).ok()?;
    let (size, length) = element_size(file, at + 4)?;
    (name == SEGMENT).then_some(at + 4 + length + size?)
}

/// The size of an element (RFC 8794), `None` where it is left open, and how many bytes tell it.
fn element_size(file: &mut File, at: u64) -> Option<(Option<u64>, u64)> {
    let mut bytes = [0; 8];
    file.seek(SeekFrom::Start(at)).ok()?;
    // At the end of the file there may be fewer.
    let _ = file.take(8).read(&mut bytes).ok()?;
    let length = u64::from(bytes[0].leading_zeros()) + 1;
    if length > 8 {
        return None;
    }
    let bits = 7 * length as u32;
    let value = u64::from_be_bytes(bytes) >> (64 - 8 * length as u32) & ((1 << bits) - 1);
    Some((Some(value).filter(|value| *value != (1 << bits) - 1), length))
}

/// An error where a clip lacks something of what it should have, and so its rectified twin; a warning where frames are there, but
/// their decoder complained.
pub fn report(
    clip: &Clip,
    frames: usize,
    is_part: bool,
    complaint: Option<String>,
    interruption: &Interruption,
) -> Result<()> {
    if let Some(missing) = missing_bytes(clip.path()) {
        bail!("the file was cut short, {missing} bytes are missing: what there is of it was rectified");
    }
    let Some(complaint) = complaint else { return Ok(()) };
    let stored = if is_part { frames } else { stored_frames(clip, interruption).unwrap_or(frames) };
    if let Some(lost) = stored.checked_sub(frames).filter(|lost| *lost > 0) {
        bail!(
            "is damaged: {lost} of {stored} frames cannot be decoded ({complaint}); the others were rectified"
        );
    }
    log::warn!("{}: is damaged, some pictures may be wrong ({complaint})", clip.display());
    Ok(())
}

/// How many frames a clip has.
fn stored_frames(clip: &Clip, interruption: &Interruption) -> Result<usize> {
    match clip.as_images() {
        Some(images) => images.count(),
        None => Packets::count_shown(clip.only_file("counting frames")?, interruption),
    }
}

/// Listens to the decoders' complaints.
pub struct Complaints {
    first: Arc<Mutex<Option<String>>>,
    log: Option<gst::log::DebugLogFunction>,
}

impl Complaints {
    /// From now on.
    pub fn listen() -> Self {
        // Who looks at GStreamer's messages sees these too; nobody else does.
        if std::env::var_os("GST_DEBUG").is_none() {
            gst::log::remove_default_log_function();
            gst::log::set_threshold_for_name(CATEGORY, gst::DebugLevel::Error);
        }
        let first = Arc::new(Mutex::new(None));
        let heard = first.clone();
        let log = gst::log::add_log_function(move |category, level, _, _, _, _, message| {
            if category.name() == CATEGORY && level == gst::DebugLevel::Error {
                let message = message.get().map(|text| text.trim_matches([':', '0', ' ']).to_owned());
                let mut first = heard.lock().unwrap_or_else(PoisonError::into_inner);
                *first = first.take().or(message);
            }
        });
        Self { first, log: Some(log) }
    }

    /// The first one, if there was any.
    pub fn first(&self) -> Option<String> {
        self.first.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for Complaints {
    fn drop(&mut self) {
        if let Some(log) = self.log.take() {
            gst::log::remove_log_function(log);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::boxes::boxed;

    fn missing(bytes: &[u8]) -> Option<u64> {
        let name = format!("rsrectify-damage-{:?}-{}", std::thread::current().id(), std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, bytes).unwrap();
        let missing = missing_bytes(&path);
        std::fs::remove_file(path).unwrap();
        missing
    }

    #[test]
    fn files_that_were_cut_short_lack_bytes() {
        let film = [boxed(b"ftyp", &[0; 16]), boxed(b"moov", &[0; 40]), boxed(b"mdat", &[0; 400])].concat();
        let riff = [&b"RIFF"[..], &500u32.to_le_bytes(), &[0; 500]].concat();
        // A header of three bytes, a segment of 300.
        let matroska =
            [&[0x1a, 0x45, 0xdf, 0xa3, 0x83, 1, 2, 3, 0x18, 0x53, 0x80, 0x67, 0x41, 0x2c][..], &[0; 300]];
        let tag = |length: u8| {
            [&[9, 0, 0, length, 0, 0, 0, 0, 0, 0, 0][..], &vec![1; length.into()], &[0; 4]].concat()
        };
        let flash = [&b"FLV\x01\x05\0\0\0\x09"[..], &[0; 4], &tag(20), &tag(200)].concat();
        let object =
            |length: u64| [&[7; 16][..], &length.to_le_bytes(), &vec![0; length as usize - 24]].concat();
        let windows = [&[0x30, 0x26, 0xb2, 0x75][..], &object(60)[4..], &object(400)].concat();
        let page = [&b"OggS\0"[..], &[0; 21], &[2, 255, 45], &[3; 300]].concat();
        let ogg = [page.clone(), page].concat();
        let others = [(flash, 100), (windows, 100), (ogg, 100)];
        let all = [(film, 100), (riff, 30), (matroska.concat(), 299)].into_iter().chain(others);
        for (whole, cut) in all {
            assert_eq!(missing(&whole), None);
            assert_eq!(missing(&whole[..whole.len() - cut]), Some(cut as u64));
            for end in 0..whole.len() {
                let _ = missing(&whole[..end]);
            }
        }
        assert_eq!(missing(b"something else of any length"), None);
    }
}
