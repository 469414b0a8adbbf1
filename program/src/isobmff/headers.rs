// SPDX-License-Identifier: MIT OR Apache-2.0

//! The boxes around the sample tables: of the film, and of its tracks.

use super::film::{EPOCH, Film, Track};
use super::tables;
use super::video::VideoTrack;
use crate::boxes::{boxed, child, children, number, words};
use crate::output::container::Container;
use crate::streams::timecode::Timecode;
use anyhow::Result;

/// A track is shown, belongs to the film, and to its preview.
const ENABLED: u32 = 7;
/// Ticks a second of a new film's clock: a multiple of most frame rates.
pub const NEW_SCALE: u32 = 90_000;
/// Rows of a transformation: as it is.
const IDENTITY: [u32; 9] = [1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30];
/// Language codes are three letters of five bits: `und`, none that is known.
const NO_LANGUAGE: u32 = 0x55c4;

/// The box that tells what kind of file it is.
pub fn brand(container: Container) -> Vec<u8> {
    match container {
        Container::Mov => boxed(b"ftyp", &[&b"qt  "[..], &words(&[0x200]), b"qt  "].concat()),
        _ => boxed(b"ftyp", &[&b"isom"[..], &words(&[0x200]), b"isomiso2avc1mp41"].concat()),
    }
}

/// The header of the data's box, in its long form.
pub fn data(bytes: u64) -> Vec<u8> {
    [&words(&[1])[..], b"mdat", &(bytes + 16).to_be_bytes()].concat()
}

fn ticks(seconds: f64, scale: u32) -> u64 {
    // Players drop a frame that begins at the end: rounded up.
    (seconds * f64::from(scale) - 1e-6).ceil().max(0.0) as u64
}

/// Writes a duration into a header: at one place in version 0, at another in version 1.
fn set_duration(header: &mut [u8], [short, long]: [usize; 2], duration: u64) {
    if header.first() == Some(&1) {
        if let Some(place) = header.get_mut(long..long + 8) {
            place.copy_from_slice(&duration.to_be_bytes());
        }
    } else if let Some(place) = header.get_mut(short..short + 4) {
        // All ones: longer than can be told.
        place.copy_from_slice(&u32::try_from(duration).unwrap_or(u32::MAX).to_be_bytes());
    }
}

fn set_word(header: &mut [u8], [short, long]: [usize; 2], word: u32) {
    let at = if header.first() == Some(&1) { long } else { short };
    if let Some(place) = header.get_mut(at..at + 4) {
        place.copy_from_slice(&word.to_be_bytes());
    }
}

/// The last eleven words of two headers: matrix, width and height of a track.
fn last_words<'a>(one: &'a mut [u8], other: &'a [u8]) -> Option<(&'a mut [u8], &'a [u8])> {
    let at = one.len().checked_sub(44)?;
    Some((one.get_mut(at..)?, other.get(other.len().checked_sub(44)?..)?))
}

/// The header of a film like another one.
pub fn film_like(film: &Film, end: f64, added: usize) -> Vec<u8> {
    let mut header = film.child(b"mvhd").unwrap_or_default().to_vec();
    set_duration(&mut header, [16, 24], ticks(end, film.timescale()));
    let most = film.tracks().map(|track| track.id).max().unwrap_or(0);
    if let Some(next) = header.len().checked_sub(4).and_then(|at| header.get_mut(at..)) {
        next.copy_from_slice(&most.saturating_add(added as u32).saturating_add(1).to_be_bytes());
    }
    boxed(b"mvhd", &header)
}

/// The header of a film that is like no other, made at a time in seconds since 1970.
pub fn film(created: Option<i64>, end: f64, tracks: usize) -> Vec<u8> {
    // 0: that is not known.
    let created = created.and_then(|created| u64::try_from(created + EPOCH).ok()).unwrap_or(0);
    let times = [created, created].map(u64::to_be_bytes).concat();
    let header = [
        words(&[1 << 24]),
        times,
        words(&[NEW_SCALE]),
        ticks(end, NEW_SCALE).to_be_bytes().to_vec(),
        // Speed, volume, reserved.
        words(&[1 << 16, 1 << 24, 0, 0]),
        words(&IDENTITY),
        words(&[0; 6]),
        words(&[tracks as u32 + 1]),
    ];
    boxed(b"mvhd", &header.concat())
}

/// The header of a track: number, duration in the film's ticks, width and height in pixels.
fn track_header(id: u32, duration: u64, [width, height]: [f64; 2]) -> Vec<u8> {
    let fixed = |number: f64| (number * 65536.0).round() as u32;
    let header = [
        words(&[1 << 24 | ENABLED, 0, 0, 0, 0, id, 0]),
        duration.to_be_bytes().to_vec(),
        words(&[0; 4]),
        words(&IDENTITY),
        words(&[fixed(width), fixed(height)]),
    ];
    header.concat()
}

fn media_header(timescale: u32, duration: u64, language: u32) -> Vec<u8> {
    let header =
        [words(&[1 << 24, 0, 0, 0, 0, timescale]), duration.to_be_bytes().to_vec(), words(&[language << 16])];
    boxed(b"mdhd", &header.concat())
}

fn handler(kind: &[u8; 4], name: &str) -> Vec<u8> {
    boxed(b"hdlr", &[&words(&[0, 0])[..], kind, &words(&[0; 3]), name.as_bytes(), &[0]].concat())
}

/// That the data are in the file itself.
fn data_information() -> Vec<u8> {
    boxed(b"dinf", &boxed(b"dref", &[words(&[0, 1]), boxed(b"url ", &words(&[1]))].concat()))
}

/// A reference to a track.
pub fn reference(kind: &[u8; 4], id: u32) -> Vec<u8> {
    boxed(b"tref", &boxed(kind, &words(&[id])))
}

/// The duration of a track in the film's ticks.
pub fn track_duration(track: &Track<'_>) -> u64 {
    let header = child(track.content, &[b"tkhd"]).unwrap_or_default();
    match header.first() {
        Some(1) => crate::boxes::long_number(header, 28).unwrap_or(0),
        _ => number(header, 20).unwrap_or(0).into(),
    }
}

/// The track of the encoded video. `film_scale` are the film's ticks a second; `places` the box of the chunks' offsets.
pub fn video_track(
    video: &VideoTrack<'_>,
    id: u32,
    film_scale: u32,
    is_turned: bool,
    references: &[u8],
    places: &[u8],
) -> Result<Vec<u8>> {
    let (timing, [width, height]) = (video.timing, video.size()?);
    let seconds = |ticks: u64| ticks as f64 / f64::from(timing.timescale);
    let start = (seconds(timing.start) * f64::from(film_scale)).round() as u64;
    let duration = ticks(seconds(timing.duration()), film_scale);
    let [across, down] = video.pixel_aspect().map(f64::from);
    let shown = [f64::from(width) * across / down, f64::from(height)];
    let mut header = track_header(id, start + duration, shown);
    let original = video.original.map_or(&[][..], |track| track.content);
    if let Some(like) = child(original, &[b"tkhd"]) {
        let turned = std::mem::replace(&mut header, like.to_vec());
        set_duration(&mut header, [20, 28], start + duration);
        // Matrix, width and height come last.
        if is_turned && let Some((place, from)) = last_words(&mut header, &turned) {
            place.copy_from_slice(from);
        }
    }
    let empty = (start > 0).then_some((start, -1));
    let edits: Vec<_> = empty.into_iter().chain([(duration, i64::from(timing.ahead))]).collect();
    let language = child(original, &[b"mdia", b"mdhd"]).and_then(|header| {
        number(header, if header.first() == Some(&1) { 32 } else { 20 }).map(|word| word >> 16)
    });
    let information = [
        boxed(b"vmhd", &words(&[1, 0, 0])),
        data_information(),
        boxed(b"stbl", &[video.sample_table()?, places.to_vec()].concat()),
    ];
    let media = [
        media_header(timing.timescale, timing.duration(), language.unwrap_or(NO_LANGUAGE)),
        child(original, &[b"mdia", b"hdlr"])
            .map_or_else(|| handler(b"vide", "video"), |like| boxed(b"hdlr", like)),
        boxed(b"minf", &information.concat()),
    ];
    let mut content = [
        boxed(b"tkhd", &header),
        tables::edit_list(&edits),
        references.to_vec(),
        boxed(b"mdia", &media.concat()),
    ]
    .concat();
    // What the clip says of the track: names, and how it is cut and shown.
    for (name, body) in children(original) {
        let is_kept = name == b"udta" || name == b"meta" || (name == b"tapt" && !is_turned);
        if let Some(name) = name.first_chunk::<4>().filter(|_| is_kept) {
            content.extend(boxed(name, body));
        }
    }
    Ok(boxed(b"trak", &content))
}

/// The content of a track whose chunks lie elsewhere than before, with these references to other tracks.
pub fn moved(content: &[u8], places: &[u8], references: &[u8]) -> Vec<u8> {
    let mut copy = Vec::with_capacity(content.len() + places.len());
    for (name, body) in children(content) {
        match name {
            b"stco" | b"co64" => copy.extend(places),
            b"tref" => copy.extend(references),
            b"mdia" | b"minf" | b"stbl" => {
                if let Some(name) = name.first_chunk::<4>() {
                    copy.extend(boxed(name, &moved(body, places, references)));
                }
            }
            name => {
                if let Some(name) = name.first_chunk::<4>() {
                    copy.extend(boxed(name, body));
                }
            }
        }
    }
    copy
}

/// A track of another film under a new number, in a film of another clock, and later by some seconds.
pub fn side_track(track: &Track<'_>, id: u32, [own, film]: [u32; 2], later: f64, places: &[u8]) -> Vec<u8> {
    let scaled = |ticks: u64| (ticks as f64 * f64::from(film) / f64::from(own.max(1))).ceil() as u64;
    let duration = track_duration(track);
    let mut header = child(track.content, &[b"tkhd"]).unwrap_or_default().to_vec();
    let later = (later * f64::from(film)).round() as u64;
    set_duration(&mut header, [20, 28], later + scaled(duration));
    set_word(&mut header, [12, 20], id);
    let edits = tables::edits(track.content).unwrap_or_else(|| vec![(duration, 0)]);
    let edits = edits.into_iter().map(|(duration, time)| (scaled(duration), time));
    let edits: Vec<_> = (later > 0).then_some((later, -1)).into_iter().chain(edits).collect();
    let mut content = [boxed(b"tkhd", &header), tables::edit_list(&edits)].concat();
    for (name, body) in children(track.content) {
        if let Some(name) = name.first_chunk::<4>().filter(|name| ![b"tkhd", b"edts", b"tref"].contains(name))
        {
            content.extend(moved(&boxed(name, body), places, &[]));
        }
    }
    content
}

/// A track whose only sample is the number of the first frame (Apple, *QuickTime File Format*, "Timecode Media").
pub fn timecode_track(
    timecode: &Timecode,
    id: u32,
    seconds: f64,
    film_scale: u32,
    is_quicktime: bool,
    places: &[u8],
) -> Vec<u8> {
    let [scale, duration] = timecode.rate;
    let duration_of_all = ticks(seconds, scale);
    let per_second = u8::try_from(scale.div_ceil(duration.max(1))).unwrap_or(u8::MAX);
    let entry = [
        &[0, 0, 0, 0, 0, 0, 0, 1][..],
        &words(&[0, u32::from(timecode.drops), scale, duration]),
        &[per_second, 0],
    ];
    let table = [
        boxed(b"stsd", &[words(&[0, 1]), boxed(b"tmcd", &entry.concat())].concat()),
        tables::durations(std::iter::once(u32::try_from(duration_of_all).unwrap_or(u32::MAX))),
        tables::sizes(&[4]),
        tables::chunk_lengths(std::iter::once(1)),
        places.to_vec(),
    ];
    let header = if is_quicktime {
        // Operations and colours of a text that nobody draws, in a font without a name.
        let look = boxed(b"tcmi", &[&words(&[0, 0, 12 << 16])[..], &[0; 12], &[0]].concat());
        let generic = boxed(b"gmin", &words(&[0, 0x0040_8000, 0x8000_8000, 0]));
        boxed(b"gmhd", &[generic, boxed(b"tmcd", &look)].concat())
    } else {
        boxed(b"nmhd", &words(&[0]))
    };
    let media = [
        media_header(scale, duration_of_all, NO_LANGUAGE),
        handler(b"tmcd", "timecode"),
        boxed(b"minf", &[header, data_information(), boxed(b"stbl", &table.concat())].concat()),
    ];
    let header = track_header(id, ticks(seconds, film_scale), [0.0; 2]);
    boxed(b"trak", &[boxed(b"tkhd", &header), boxed(b"mdia", &media.concat())].concat())
}

/// A comment among the tags of a film, in the form of iTunes.
pub fn comment(text: &str) -> Vec<u8> {
    let value = boxed(b"data", &[&words(&[1, 0])[..], text.as_bytes()].concat());
    let handler = boxed(b"hdlr", &[&words(&[0, 0])[..], b"mdirappl", &[0; 9]].concat());
    let meta = [words(&[0]), handler, boxed(b"ilst", &boxed(b"\xa9cmt", &value))];
    boxed(b"udta", &boxed(b"meta", &meta.concat()))
}
