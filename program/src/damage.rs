//! Damage of a clip: whether its file ends too early, and what its decoder complains of.

use crate::boxes::{long_number, number};
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
        _ if &start[4..8] == b"ftyp" => end_of_boxes(&mut file)?,
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
    file.take(8).read(&mut bytes).ok()?;
    let length = u64::from(bytes[0].leading_zeros()) + 1;
    if length > 8 {
        return None;
    }
    let bits = 7 * length as u32;
    let value = u64::from_be_bytes(bytes) >> (64 - 8 * length as u32) & ((1 << bits) - 1);
    Some((Some(value).filter(|value| *value != (1 << bits) - 1), length))
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
        for (whole, cut) in [(film, 100), (riff, 30), (matroska.concat(), 299)] {
            assert_eq!(missing(&whole), None);
            assert_eq!(missing(&whole[..whole.len() - cut]), Some(cut as u64));
            for end in 0..whole.len() {
                let _ = missing(&whole[..end]);
            }
        }
        assert_eq!(missing(b"something else of any length"), None);
    }
}
