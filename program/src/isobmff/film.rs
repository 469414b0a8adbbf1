// SPDX-License-Identifier: MIT OR Apache-2.0

//! The index of a QuickTime or MP4 file: its tracks, and what is said of the whole.

use super::tables::{self, Chunk};
use crate::boxes::{child, children, number, read_index, read_top_level};
use std::fs::File;
use std::path::{Path, PathBuf};

/// Tracks of these kinds describe the packets of another track's data, and are of no use once that is encoded anew.
const HINTS: &[u8; 4] = b"hint";
/// Of a data reference: the data lie in the file itself.
const SELF_CONTAINED: u32 = 1;

/// From the beginning of 1904, where dates count from, to that of 1970: 66 years, 17 of them leap years.
pub const EPOCH: i64 = (66 * 365 + 17) * 24 * 3600;

/// A film and its index.
#[derive(Clone, Debug)]
pub struct Film {
    pub path: PathBuf,
    moov: Vec<u8>,
    is_quicktime: bool,
    /// Whether the tables of its tracks lie in fragments, behind the index.
    is_fragmented: bool,
}

/// A track of a film.
#[derive(Clone, Copy, Debug)]
pub struct Track<'a> {
    pub id: u32,
    /// What kind of media it has: `vide`, `soun`, `text` and so on.
    pub handler: [u8; 4],
    /// The content of its box.
    pub content: &'a [u8],
}

impl Film {
    /// Reads the index of a file; `None` if it has none.
    pub fn read(path: &Path) -> Option<Self> {
        let mut file = File::open(path).ok()?;
        let moov = read_index(&mut file)?;
        let brand = read_top_level(&mut file, b"ftyp", 4);
        let is_quicktime = brand.is_none_or(|brand| brand == b"qt  ");
        let is_fragmented = child(&moov, &[b"mvex"]).is_some();
        let film = Self { path: path.to_owned(), moov, is_quicktime, is_fragmented };
        film.child(b"mvhd").is_some().then_some(film)
    }

    /// Whether it is a QuickTime file; those of old do not state what they are.
    pub fn is_quicktime(&self) -> bool {
        self.is_quicktime
    }

    /// Whether its tracks can be copied: their tables are in the index.
    pub fn has_tables(&self) -> bool {
        !self.is_fragmented
    }

    /// Whether the times of a track of the file count from its own start, by its tables alone: GStreamer's demuxer lets such a track of
    /// fragments begin with its first frame, whenever that is.
    pub fn is_unedited(&self, id: u32) -> bool {
        self.is_fragmented && self.track(id).is_some_and(|track| child(track.content, &[b"edts"]).is_none())
    }

    /// The track that is played: the first of video that is enabled, else the first of all.
    pub fn main_video(&self) -> Option<u32> {
        let count = |track: &Track<'_>| track.table().and_then(tables::sample_count).unwrap_or(0);
        let is_video =
            |track: &Track<'_>| &track.handler == b"vide" && (self.is_fragmented || count(track) > 0);
        let enabled = self.tracks().find(|track| is_video(track) && track.is_enabled());
        enabled.or_else(|| self.tracks().find(is_video)).map(|track| track.id)
    }

    /// The boxes of the index.
    pub fn boxes(&self) -> impl Iterator<Item = (&[u8], &[u8])> {
        children(&self.moov)
    }

    /// The content of the index's first box of a name.
    pub fn child(&self, name: &[u8; 4]) -> Option<&[u8]> {
        child(&self.moov, &[name])
    }

    /// Ticks a second of the film's clock, in which edit lists state durations.
    pub fn timescale(&self) -> u32 {
        let header = self.child(b"mvhd").unwrap_or_default();
        number(header, if header.first() == Some(&1) { 20 } else { 12 })
            .filter(|scale| *scale > 0)
            .unwrap_or(1000)
    }

    /// When the film was made, in seconds since 1970; `None` where it does not say.
    pub fn created(&self) -> Option<i64> {
        let header = self.child(b"mvhd")?;
        let created = match header.first()? {
            1 => crate::boxes::long_number(header, 4)?,
            _ => number(header, 4)?.into(),
        };
        i64::try_from(created).ok().filter(|created| *created > 0).map(|created| created - EPOCH)
    }

    /// The tracks.
    pub fn tracks(&self) -> impl Iterator<Item = Track<'_>> {
        self.boxes().filter(|(name, _)| name == b"trak").filter_map(|(_, content)| Track::of(content))
    }

    /// The track of a number.
    pub fn track(&self, id: u32) -> Option<Track<'_>> {
        self.tracks().find(|track| track.id == id)
    }
}

impl<'a> Track<'a> {
    fn of(content: &'a [u8]) -> Option<Self> {
        let header = child(content, &[b"tkhd"])?;
        let id = number(header, if header.first() == Some(&1) { 20 } else { 12 })?;
        let handler = child(content, &[b"mdia", b"hdlr"])?.get(8..12)?.try_into().ok()?;
        Some(Self { id, handler, content })
    }

    /// Whether players mirror its pictures: the matrix of its header has a negative determinant.
    pub fn is_mirrored(&self) -> bool {
        let header = child(self.content, &[b"tkhd"]).unwrap_or_default();
        // The last words of the header are the nine of the matrix, width and height.
        let matrix = header.len().checked_sub(44).and_then(|at| header.get(at..)).unwrap_or_default();
        let element = |index: usize| f64::from(number(matrix, 4 * index).unwrap_or(0) as i32);
        element(0) * element(4) < element(1) * element(3)
    }

    fn is_enabled(&self) -> bool {
        child(self.content, &[b"tkhd"]).and_then(|header| header.get(3)).is_some_and(|flags| flags & 1 != 0)
    }

    /// Whether it can be put into another file as it is.
    pub fn is_copied(&self) -> bool {
        let references = child(self.content, &[b"mdia", b"minf", b"dinf", b"dref"]);
        let is_inside = references.and_then(|table| table.get(8..)).is_none_or(|table| {
            children(table)
                .all(|(_, entry)| number(entry, 0).is_some_and(|flags| flags & SELF_CONTAINED != 0))
        });
        &self.handler != HINTS && is_inside
    }

    /// The content of its sample table.
    pub fn table(&self) -> Option<&'a [u8]> {
        child(self.content, &[b"mdia", b"minf", b"stbl"])
    }

    /// Ticks a second of its clock.
    pub fn timescale(&self) -> u32 {
        let header = child(self.content, &[b"mdia", b"mdhd"]).unwrap_or_default();
        number(header, if header.first() == Some(&1) { 20 } else { 12 })
            .filter(|scale| *scale > 0)
            .unwrap_or(1000)
    }

    /// Where its samples lie in the file; `None` where the tables are damaged.
    pub fn chunks(&self) -> Option<Vec<Chunk>> {
        tables::chunks(self.table()?, self.timescale())
    }
}
