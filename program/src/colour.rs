// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the numbers of a picture stand for, in the code points of ITU-T H.273.
//!
//! GStreamer's `colorimetry` cannot name all of them: xvYCC, SMPTE 428 or constant luminance among others come out as unknown. They
//! are read from the clip's own box `colr`, and given to encoders and containers as numbers.

use crate::boxes;
use gst_video::{
    VideoColorMatrix, VideoColorPrimaries, VideoColorRange, VideoColorimetry, VideoTransferFunction,
};
use std::fs::File;
use std::path::Path;

/// The code point of what is not specified.
pub const UNSPECIFIED: u8 = 2;

/// Colour primaries, transfer characteristics, matrix coefficients and range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Colour {
    pub primaries: u8,
    pub transfer: u8,
    pub matrix: u8,
    /// Whether samples use all numbers; `None` where that is not stated, which decoders take for no.
    pub full_range: Option<bool>,
}

impl Default for Colour {
    fn default() -> Self {
        Self { primaries: UNSPECIFIED, transfer: UNSPECIFIED, matrix: UNSPECIFIED, full_range: None }
    }
}

impl Colour {
    /// What caps state.
    pub fn of_caps(caps: &gst::CapsRef) -> Self {
        let stated = caps.structure(0).and_then(|format| format.get::<&str>("colorimetry").ok());
        let Some(stated) = stated.and_then(|text| text.parse::<VideoColorimetry>().ok()) else {
            return Self::default();
        };
        let code = |code: u32| u8::try_from(code).unwrap_or(UNSPECIFIED);
        // Unknown values have the code point of "unspecified", except that the matrix of RGB is 0.
        Self {
            primaries: code(stated.primaries().to_iso()),
            transfer: code(stated.transfer().to_iso()),
            matrix: code(stated.matrix().to_iso()),
            full_range: match stated.range() {
                VideoColorRange::Range0_255 => Some(true),
                VideoColorRange::Range16_235 => Some(false),
                _ => None,
            },
        }
    }

    /// What the box `colr` of the first video track of an MP4 or QuickTime file states.
    pub fn of_film(clip: &Path) -> Option<Self> {
        Self::of_index(&boxes::read_index(&mut File::open(clip).ok()?)?)
    }

    fn of_index(index: &[u8]) -> Option<Self> {
        /// A sample entry (ISO/IEC 14496-12): its own header, then that of its picture, then boxes.
        const ENTRY: usize = 78;
        let tracks = boxes::children(index).filter(|(name, _)| *name == b"trak");
        let mut tracks = tracks.filter_map(|(_, track)| boxes::child(track, &[b"mdia"]));
        let is_video = |media: &&[u8]| {
            let handler = boxes::child(media, &[b"hdlr"]);
            handler.and_then(|handler| handler.get(8..12)) == Some(b"vide")
        };
        let media = tracks.find(is_video)?;
        let entries = boxes::child(media, &[b"minf", b"stbl", b"stsd"])?.get(8..)?;
        let (_, entry) = boxes::children(entries).next()?;
        let colours = boxes::children(entry.get(ENTRY..)?).filter(|(name, _)| *name == b"colr");
        colours.filter_map(|(_, content)| Self::of_box(content)).next()
    }

    /// The content of a box `colr`, where that is not a profile of the ICC.
    fn of_box(content: &[u8]) -> Option<Self> {
        let kind = content.get(..4)?;
        if kind != b"nclx" && kind != b"nclc" {
            return None;
        }
        let code = |at: usize| {
            let bytes = content.get(at..at + 2)?.try_into().ok()?;
            Some(u8::try_from(u16::from_be_bytes(bytes)).unwrap_or(UNSPECIFIED))
        };
        let full_range = content.get(10).filter(|_| kind == b"nclx").map(|flags| flags & 0x80 != 0);
        Some(Self { primaries: code(4)?, transfer: code(6)?, matrix: code(8)?, full_range })
    }

    /// These, with those of `other` where these are not specified.
    pub fn or(self, other: Self) -> Self {
        let either = |own: u8, other: u8| if own == UNSPECIFIED { other } else { own };
        Self {
            primaries: either(self.primaries, other.primaries),
            transfer: either(self.transfer, other.transfer),
            matrix: either(self.matrix, other.matrix),
            full_range: self.full_range.or(other.full_range),
        }
    }

    /// Whether primaries, transfer and matrix are all unspecified.
    pub fn is_untagged(self) -> bool {
        [self.primaries, self.transfer, self.matrix] == [UNSPECIFIED; 3]
    }

    /// As caps state it, as far as they can; `None` where nothing is specified.
    pub fn colorimetry(self) -> Option<VideoColorimetry> {
        if self == Self::default() {
            return None;
        }
        let range = match self.full_range {
            Some(true) => VideoColorRange::Range0_255,
            Some(false) => VideoColorRange::Range16_235,
            None => VideoColorRange::Unknown,
        };
        Some(VideoColorimetry::new(
            range,
            VideoColorMatrix::from_iso(self.matrix.into()),
            VideoTransferFunction::from_iso(self.transfer.into()),
            VideoColorPrimaries::from_iso(self.primaries.into()),
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::boxes::boxed;

    fn colour(codes: [u8; 3], full_range: Option<bool>) -> Colour {
        let [primaries, transfer, matrix] = codes;
        Colour { primaries, transfer, matrix, full_range }
    }

    #[test]
    fn caps_state_code_points() {
        gst::init().unwrap();
        let stated = |text: &str| {
            Colour::of_caps(&gst::Caps::builder("video/x-raw").field("colorimetry", text).build())
        };
        assert_eq!(stated("bt709"), colour([1, 1, 1], Some(false)));
        assert_eq!(stated("bt2100-pq"), colour([9, 16, 9], Some(false)));
        // Display P3 primaries, transfer of BT.709, matrix of BT.601, full range.
        assert_eq!(stated("1:4:5:11"), colour([12, 1, 6], Some(true)));
        assert_eq!(stated("2:0:0:0"), colour([2, 2, 2], Some(false)));
        assert_eq!(Colour::of_caps(&gst::Caps::new_empty_simple("video/x-raw")), Colour::default());
        for text in ["bt709", "bt2100-pq", "1:4:5:11", "2:0:0:0", "2:3:7:1"] {
            let back = stated(text).colorimetry().unwrap().to_string();
            assert_eq!(back.parse::<VideoColorimetry>().unwrap(), text.parse().unwrap(), "{text}");
        }
        assert!(Colour::default().colorimetry().is_none());
    }

    /// A film whose video track has this in its sample entry, behind a track of sound.
    fn film(content: &[u8]) -> Vec<u8> {
        let track = |handler: &[u8; 4], entry: &[u8]| {
            let handler = boxed(b"hdlr", &[&[0; 8], &handler[..], &[0; 12]].concat());
            let entries = boxed(b"stsd", &[&[0, 0, 0, 0, 0, 0, 0, 1], entry].concat());
            let table = boxed(b"minf", &boxed(b"stbl", &entries));
            boxed(b"trak", &boxed(b"mdia", &[handler, table].concat()))
        };
        let entry = boxed(b"avc1", &[&[0; 78], content].concat());
        [track(b"soun", &boxed(b"mp4a", &[0; 28])), track(b"vide", &entry)].concat()
    }

    #[test]
    fn films_state_code_points() {
        let xvycc = boxed(b"colr", b"nclc\0\x01\0\x0b\0\x01");
        let full = boxed(b"colr", b"nclx\0\x05\0\x01\0\x06\x80");
        let profile = boxed(b"colr", b"prof1234567890");
        assert_eq!(Colour::of_index(&film(&xvycc)), Some(colour([1, 11, 1], None)));
        assert_eq!(Colour::of_index(&film(&full)), Some(colour([5, 1, 6], Some(true))));
        let both = [profile.clone(), full].concat();
        assert_eq!(Colour::of_index(&film(&both)), Some(colour([5, 1, 6], Some(true))));
        assert_eq!(Colour::of_index(&film(&profile)), None);
        let whole = film(&both);
        for end in 0..whole.len() {
            assert_eq!(Colour::of_index(&whole[..end]), None, "{end}");
        }
    }

    #[test]
    fn what_is_not_specified_is_taken_from_elsewhere() {
        let (stream, file) = (colour([2, 2, 6], Some(true)), colour([1, 11, 1], Some(false)));
        assert_eq!(stream.or(file), colour([1, 11, 6], Some(true)));
        assert_eq!(Colour::default().or(file), file);
    }
}
