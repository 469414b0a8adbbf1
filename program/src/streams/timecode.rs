// SPDX-License-Identifier: MIT OR Apache-2.0

//! The timecode of a QuickTime or MP4 file, which GStreamer's demuxer passes over.
//!
//! It is a track of type `tmcd` (Apple, *QuickTime File Format Specification*, "Timecode Media"): its sample description
//! tells how frames are counted, its first sample is the number of the first frame.

use crate::boxes::{child, children, number, read_index};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// Frames are counted so that the numbers follow the clock: at 29.97 frames/s two a minute are left out.
const DROP_FRAME: u32 = 1;
/// The number is a counter, no time.
const COUNTER: u32 = 8;

/// The timecode of a clip's first frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timecode {
    /// Frames since 00:00:00:00.
    pub frame: u32,
    /// Frames a second, a fraction.
    pub rate: [u32; 2],
    /// Whether numbers are left out.
    pub drops: bool,
}

impl Timecode {
    /// The timecode of a file; `None` if it has none, or is no such file.
    pub fn of(path: &Path) -> Option<Self> {
        let mut file = File::open(path).ok()?;
        let index = read_index(&mut file)?;
        children(&index).filter(|(name, _)| name == b"trak").find_map(|(_, track)| of_track(&mut file, track))
    }

    /// That of a frame, as its decoder states it.
    pub fn of_frame(code: &gst_video::ValidVideoTimeCode) -> Option<Self> {
        let rate = code.fps();
        Some(Self {
            frame: u32::try_from(code.frames_since_daily_jam()).ok()?,
            rate: [u32::try_from(rate.numer()).ok()?, u32::try_from(rate.denom()).ok()?],
            drops: code.flags().contains(gst_video::VideoTimeCodeFlags::DROP_FRAME),
        })
    }

    /// That of a later frame.
    pub fn after(self, frames: usize) -> Option<Self> {
        Some(Self { frame: self.frame.checked_add(u32::try_from(frames).ok()?)?, ..self })
    }

    /// The same as GStreamer counts.
    pub fn to_gst(self) -> Option<gst_video::ValidVideoTimeCode> {
        let rate = gst::Fraction::new(i32::try_from(self.rate[0]).ok()?, i32::try_from(self.rate[1]).ok()?);
        let flags = match self.drops {
            true => gst_video::VideoTimeCodeFlags::DROP_FRAME,
            false => gst_video::VideoTimeCodeFlags::empty(),
        };
        let start = gst_video::VideoTimeCode::new(rate, None, flags, 0, 0, 0, 0, 0);
        let mut code = gst_video::ValidVideoTimeCode::try_from(start).ok()?;
        code.add_frames(self.frame.into());
        Some(code)
    }
}

fn of_track(file: &mut File, track: &[u8]) -> Option<Timecode> {
    let handler = child(track, &[b"mdia", b"hdlr"])?;
    if handler.get(8..12)? != b"tmcd" {
        return None;
    }
    let table = child(track, &[b"mdia", b"minf", b"stbl"])?;
    // Version, count of entries; of the first: size, format, reserved and index of the data reference, reserved.
    let description = child(table, &[b"stsd"])?.get(8 + 16 + 4..)?;
    let [flags, scale, duration] =
        [number(description, 0)?, number(description, 4)?, number(description, 8)?];
    if flags & COUNTER != 0 || scale == 0 || duration == 0 {
        return None;
    }
    let offset = match (child(table, &[b"stco"]), child(table, &[b"co64"])) {
        (Some(offsets), _) => u64::from(number(offsets, 8)?),
        (None, Some(offsets)) => u64::from(number(offsets, 8)?) << 32 | u64::from(number(offsets, 12)?),
        (None, None) => return None,
    };
    file.seek(SeekFrom::Start(offset)).ok()?;
    let mut sample = [0; 4];
    file.read_exact(&mut sample).ok()?;
    let frame = u32::from_be_bytes(sample);
    Some(Timecode { frame, rate: [scale, duration], drops: flags & DROP_FRAME != 0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::boxes::boxed;

    /// A film with a timecode track whose only sample lies at the start of the data.
    fn film(flags: u32, frame: u32) -> Vec<u8> {
        let words = |words: &[u32]| words.iter().flat_map(|word| word.to_be_bytes()).collect::<Vec<_>>();
        let data = boxed(b"mdat", &words(&[frame]));
        let entry = words(&[34, u32::from_be_bytes(*b"tmcd"), 0, 1, 0, flags, 30000, 1001]);
        let table = [
            boxed(b"stsd", &[words(&[0, 1]), entry, vec![30, 0]].concat()),
            boxed(b"stco", &words(&[0, 1, 8])),
        ];
        let handler = words(&[0, u32::from_be_bytes(*b"mhlr"), u32::from_be_bytes(*b"tmcd"), 0, 0, 0]);
        let media = boxed(b"minf", &boxed(b"stbl", &table.concat()));
        let track = boxed(b"trak", &boxed(b"mdia", &[boxed(b"hdlr", &handler), media].concat()));
        [data, boxed(b"moov", &[boxed(b"mvhd", &[0; 20]), track].concat())].concat()
    }

    fn read(bytes: &[u8]) -> Option<Timecode> {
        let name = format!("rsrectify-timecode-{:?}-{}", std::thread::current().id(), std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, bytes).unwrap();
        let found = Timecode::of(&path);
        std::fs::remove_file(path).unwrap();
        found
    }

    #[test]
    fn the_first_frame_is_numbered() {
        // Of 29.97 frames/s with drop frames, 01:00:00:00 is frame 107892.
        let found = read(&film(DROP_FRAME, 107_892)).unwrap();
        assert_eq!(found, Timecode { frame: 107_892, rate: [30000, 1001], drops: true });
        gst::init().unwrap();
        assert_eq!(found.to_gst().unwrap().to_string(), "01:00:00;00");
        assert_eq!(read(&film(COUNTER, 3)), None);
    }

    #[test]
    fn broken_files_have_none() {
        let whole = film(0, 5);
        for end in 0..whole.len() {
            assert_eq!(read(&whole[..end]), None, "{end}");
        }
        for (place, _) in whole.iter().enumerate() {
            let mut bytes = whole.clone();
            bytes[place] ^= 0xff;
            // Any answer will do.
            let _ = read(&bytes);
        }
    }
}
