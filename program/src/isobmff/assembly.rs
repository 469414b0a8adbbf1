// SPDX-License-Identifier: MIT OR Apache-2.0

//! Encoded video, and the tracks of other films beside it → a new film.
//!
//! The index comes first, so that players can begin before all is there, and chunks lie in the order in which they are played.
//! Tracks that are copied keep all their boxes but for the places of their chunks.

use super::encoded::EncodedVideo;
use super::film::{Film, Track};
use super::headers;
use super::tables::{self, Chunk};
use super::video::{self, Sample, Timing, VideoTrack};
use crate::boxes::boxed;
use crate::interruption::Interruption;
use crate::output::container::Container;
use crate::streams::timecode::Timecode;
use anyhow::{Context, Result};
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Chunks of video are about this long, in seconds: players read ahead by whole chunks.
const CHUNK: f64 = 0.5;
/// Offsets of chunks have 32 bits in files that are smaller than this: the rest is for the index.
const SMALL: u64 = (1 << 32) - (256 << 20);

/// What a film is made of.
pub struct Assembly<'a> {
    pub container: Container,
    pub video: &'a EncodedVideo,
    /// The clip, and the number of the track that the video replaces, where it is such a file.
    pub clip: Option<(&'a Film, u32)>,
    /// Whether other tracks of the clip are copied: given one, whether it is.
    pub copied: &'a dyn Fn(&Track<'_>) -> bool,
    /// A film with other tracks, and how much later than there they begin, in seconds.
    pub side: Option<(&'a Film, f64)>,
    /// By how much the video is to begin earlier than its frames say, in nanoseconds.
    pub earlier: i64,
    /// Whether the frames were turned upright, so that players must not turn them.
    pub is_turned: bool,
    /// A comment instead of what the clip says of itself.
    pub comment: Option<String>,
    /// The timecode of the first frame, where no track with it is copied.
    pub timecode: Option<Timecode>,
    /// When the clip was made, in seconds since 1970, where it is no such file.
    pub created: Option<i64>,
    /// The box of chapters, where the clip is no such file; may be empty.
    pub chapters: Vec<u8>,
}

/// Makes the boxes of a track whose chunks begin at these offsets, which have 64 bits or 32.
type Boxes<'a> = Box<dyn Fn(&[u64], bool) -> Result<Vec<u8>> + 'a>;

/// A track to be written: its chunks in a file, and its boxes once it is known where they lie in the new one.
struct Planned<'a> {
    source: PathBuf,
    chunks: Vec<Chunk>,
    boxes: Boxes<'a>,
    /// From the film's start to the track's end, in seconds.
    end: f64,
}

impl Assembly<'_> {
    /// Writes the file.
    ///
    /// # Errors
    /// If a file cannot be read or written, the video cannot be in such a file, or the user interrupts.
    pub fn write(&self, output: &Path, interruption: &Interruption) -> Result<()> {
        let scratch = Scratch { path: self.video.path().with_extension("timecode") };
        let tracks = self.plan(&scratch)?;
        let (order, offsets) = layout(&tracks);
        let bytes: u64 = order.iter().map(|(_, chunk)| chunk.length).sum();
        let brand = headers::brand(self.container);
        let is_long = bytes > SMALL;
        let index = |start: u64| self.index(&tracks, &offsets, start, is_long);
        // The index is as long wherever the data begin.
        let start = (brand.len() + index(0)?.len() + 16) as u64;
        let file = File::create(output).with_context(|| format!("cannot write {}", output.display()))?;
        let mut file = BufWriter::with_capacity(1 << 20, file);
        file.write_all(&[brand, index(start)?, headers::data(bytes)].concat())?;
        let mut sources: Vec<_> = tracks
            .iter()
            .map(|track| File::open(&track.source).map(BufReader::new))
            .collect::<Result<_, _>>()?;
        for (track, chunk) in order {
            interruption.check()?;
            let source = sources.get_mut(track).context("no such track")?;
            source.seek(SeekFrom::Start(chunk.offset))?;
            let copied = std::io::copy(&mut source.take(chunk.length), &mut file)
                .with_context(|| format!("cannot write {}", output.display()))?;
            // Of a file that was cut short: the index stays right.
            std::io::copy(&mut std::io::repeat(0).take(chunk.length - copied), &mut file)?;
        }
        file.flush().with_context(|| format!("cannot write {}", output.display()))?;
        Ok(())
    }

    fn plan<'a>(&'a self, scratch: &Scratch) -> Result<Vec<Planned<'a>>> {
        let original = self.clip.and_then(|(film, id)| film.track(id));
        let caps = self.video.caps().context("no frame came from the encoder")?;
        let rate = caps.structure(0).and_then(|format| format.get::<gst::Fraction>("framerate").ok());
        // A whole number of ticks a frame, where the rate is steady; else what most rates divide.
        let steady = rate.and_then(|rate| u32::try_from(rate.numer()).ok()).unwrap_or(0);
        let steady = steady.saturating_mul(10_000u32.div_ceil(steady.max(1)));
        let clocks = [original.map_or(0, |track| track.timescale()), steady, 90_000];
        let timing = Timing::of(self.video.samples(), self.earlier, &clocks)?;
        let film_scale = self.clip.map_or(headers::NEW_SCALE, |(film, _)| film.timescale());
        let (chunks, lengths) = chunks_of_video(self.video.samples(), &timing);
        let is_kept = |track: &Track<'_>| {
            original.is_none_or(|original| original.id != track.id)
                && track.is_copied()
                && (self.copied)(track)
        };
        let film_tracks = || self.clip.iter().flat_map(|(film, _)| film.tracks());
        let kept: Vec<u32> = film_tracks().filter(&is_kept).map(|track| track.id).collect();
        let mut free = film_tracks().map(|track| track.id).max().unwrap_or(0) + 1;
        let video_id = original.map_or_else(|| take(&mut free), |track| track.id);
        let has_timecode = film_tracks().any(|track| &track.handler == b"tmcd" && kept.contains(&track.id));
        let timecode = self.timecode.filter(|_| !has_timecode).map(|timecode| (timecode, take(&mut free)));

        let mut planned = Vec::new();
        let end = timing.start + timing.duration();
        let seconds = end as f64 / f64::from(timing.timescale);
        let references = match (timecode, original) {
            (Some((_, id)), _) => headers::reference(b"tmcd", id),
            (None, Some(track)) => video::references(&track, |id| kept.contains(&id)),
            (None, None) => Vec::new(),
        };
        let path = self.video.path().to_owned();
        let (is_turned, is_quicktime) = (self.is_turned, self.container == Container::Mov);
        let video = Planned {
            source: path,
            chunks,
            end: seconds,
            boxes: Box::new(move |offsets, is_long| {
                let track = VideoTrack {
                    caps,
                    colour: self.video.colour(),
                    timing: &timing,
                    samples: self.video.samples(),
                    chunks: &lengths,
                    original,
                    is_quicktime,
                };
                let places = tables::chunk_offsets(offsets, is_long);
                headers::video_track(&track, video_id, film_scale, is_turned, &references, &places)
            }),
        };
        let mut video = Some(video);
        for track in film_tracks() {
            if original.is_some_and(|original| original.id == track.id) {
                planned.extend(video.take());
            } else if kept.contains(&track.id) {
                let chunks = track.chunks().context("the tables of a track are damaged")?;
                let references = video::references(&track, |id| id == video_id || kept.contains(&id));
                planned.push(Planned {
                    source: self.clip.map(|(film, _)| film.path.clone()).unwrap_or_default(),
                    end: headers::track_duration(&track) as f64 / f64::from(film_scale),
                    chunks,
                    boxes: Box::new(move |offsets, is_long| {
                        let places = tables::chunk_offsets(offsets, is_long);
                        Ok(boxed(b"trak", &headers::moved(track.content, &places, &references)))
                    }),
                });
            }
        }
        planned.extend(video);
        if let Some((film, later)) = self.side {
            for track in film.tracks() {
                let id = take(&mut free);
                let chunks = track.chunks().context("the tables of a track are damaged")?;
                let chunks = chunks.into_iter().map(|chunk| Chunk { time: chunk.time + later, ..chunk });
                let scale = [film.timescale(), film_scale];
                planned.push(Planned {
                    source: film.path.clone(),
                    chunks: chunks.collect(),
                    end: headers::track_duration(&track) as f64 / f64::from(film.timescale()) + later,
                    boxes: Box::new(move |offsets, is_long| {
                        let places = tables::chunk_offsets(offsets, is_long);
                        Ok(boxed(b"trak", &headers::side_track(&track, id, scale, later, &places)))
                    }),
                });
            }
        }
        if let Some((timecode, id)) = timecode {
            std::fs::write(&scratch.path, timecode.frame.to_be_bytes())?;
            planned.push(Planned {
                source: scratch.path.clone(),
                chunks: vec![Chunk { offset: 0, length: 4, time: 0.0 }],
                end: seconds,
                boxes: Box::new(move |offsets, is_long| {
                    let places = tables::chunk_offsets(offsets, is_long);
                    Ok(headers::timecode_track(&timecode, id, seconds, film_scale, is_quicktime, &places))
                }),
            });
        }
        Ok(planned)
    }

    /// The box `moov` of a file whose data begin at a place.
    fn index(
        &self,
        tracks: &[Planned<'_>],
        offsets: &[Vec<u64>],
        start: u64,
        is_long: bool,
    ) -> Result<Vec<u8>> {
        let end = tracks.iter().map(|track| track.end).fold(0.0, f64::max);
        let header = match self.clip {
            Some((film, _)) => headers::film_like(film, end, tracks.len()),
            None => headers::film(self.created, end, tracks.len()),
        };
        let mut content = header;
        for (track, offsets) in tracks.iter().zip(offsets) {
            let places: Vec<u64> = offsets.iter().map(|offset| start + offset).collect();
            content.extend((track.boxes)(&places, is_long)?);
        }
        if let Some(comment) = &self.comment {
            content.extend(headers::comment(comment));
        } else if let Some((film, _)) = self.clip {
            let is_of_whole = |name: &[u8]| {
                ![b"mvhd", b"trak", b"mvex", b"free", b"iods"].iter().any(|other| name == *other)
            };
            for (name, body) in film.boxes().filter(|(name, _)| is_of_whole(name)) {
                if let Some(name) = name.first_chunk::<4>() {
                    content.extend(boxed(name, body));
                }
            }
        } else if !self.chapters.is_empty() {
            content.extend(boxed(b"udta", &self.chapters));
        }
        Ok(boxed(b"moov", &content))
    }
}

/// A file that is removed at the end.
struct Scratch {
    path: PathBuf,
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

fn take(free: &mut u32) -> u32 {
    *free += 1;
    *free - 1
}

/// The chunks of the tracks in the order in which they are played, and where in the data those of each track begin.
fn layout(tracks: &[Planned<'_>]) -> (Vec<(usize, Chunk)>, Vec<Vec<u64>>) {
    let all = tracks.iter().enumerate().flat_map(|(track, planned)| {
        planned.chunks.iter().enumerate().map(move |(number, chunk)| (track, number, *chunk))
    });
    let mut all: Vec<_> = all.collect();
    all.sort_by(|(_, _, one), (_, _, other)| one.time.total_cmp(&other.time));
    let mut offsets: Vec<Vec<u64>> = tracks.iter().map(|track| vec![0; track.chunks.len()]).collect();
    let mut place = 0;
    for (track, number, chunk) in &all {
        if let Some(offset) = offsets.get_mut(*track).and_then(|offsets| offsets.get_mut(*number)) {
            *offset = place;
        }
        place += chunk.length;
    }
    (all.into_iter().map(|(track, _, chunk)| (track, chunk)).collect(), offsets)
}

/// The chunks of the encoded frames, and how many samples each has.
fn chunks_of_video(samples: &[Sample], timing: &Timing) -> (Vec<Chunk>, Vec<u32>) {
    let (mut chunks, mut lengths) = (Vec::<Chunk>::new(), Vec::<u32>::new());
    let mut offset = 0;
    for (sample, due) in samples.iter().zip(&timing.decoded) {
        let time = (timing.start + due) as f64 / f64::from(timing.timescale);
        match (chunks.last_mut(), lengths.last_mut()) {
            (Some(chunk), Some(length)) if time < chunk.time + CHUNK => {
                chunk.length += u64::from(sample.size);
                *length += 1;
            }
            _ => {
                chunks.push(Chunk { offset, length: sample.size.into(), time });
                lengths.push(1);
            }
        }
        offset += u64::from(sample.size);
    }
    (chunks, lengths)
}
