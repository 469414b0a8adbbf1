// SPDX-License-Identifier: MIT OR Apache-2.0

//! What lies beside the video in an MP4 or MOV file that is written: tracks of the clip, copied as they are where the clip is
//! such a file, and a file with the other streams, as GStreamer's muxer writes it.

use super::destination::Destination;
use super::excerpt::Excerpt;
use super::label;
use super::routes::Audio;
use super::timecode::Timecode;
use super::unheld;
use crate::colour::Colour;
use crate::elements::{self, app_sink, make, write_samples};
use crate::interruption::Interruption;
use crate::isobmff::{Assembly, EncodedVideo, Film, Track};
use crate::output::container::Container;
use anyhow::{Context, Result};
use gst::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// What lies beside the video.
pub struct Beside {
    container: Container,
    audio: Audio,
    excerpt: Option<Arc<Excerpt>>,
    /// The clip, and its track whose frames are decoded, where it is a file of boxes.
    film: Option<(Film, u32)>,
    timecode: Option<Timecode>,
    side: Arc<Mutex<Side>>,
}

/// The file with the streams that are not copied as tracks; written once there is one.
#[derive(Default)]
struct Side {
    path: PathBuf,
    muxer: Option<gst::Element>,
    /// When the first of its streams begins: the muxer begins with it.
    start: Option<gst::ClockTime>,
    /// When the clip was made, as its demuxer says.
    created: Option<gst::DateTime>,
    /// Whether the first stream is to begin at time 0.
    begins_at_zero: bool,
}

impl Beside {
    /// Of a clip; `None` where GStreamer's muxer writes all of the file.
    pub fn of(clip: &Path, destination: &Destination<'_>, timecode: Option<Timecode>) -> Option<Self> {
        let container = Some(destination.container).filter(|container| container.is_isobmff())?;
        let film = Film::read(clip);
        let film = film.and_then(|film| film.main_video().map(|track| (film, track)));
        let side = Side { path: destination.output?.with_extension("side"), ..Side::default() };
        let (audio, excerpt) = (destination.audio, destination.excerpt.clone());
        Some(Self { container, audio, excerpt, film, timecode, side: Arc::new(Mutex::new(side)) })
    }

    /// What the clip has that the file will not have, in sentences.
    pub fn losses(&self) -> Vec<String> {
        // A part of a clip is not the place of all that is said of the whole.
        let film = self.film.as_ref().filter(|_| self.excerpt.is_none());
        film.map_or_else(Vec::new, |(film, _)| unheld::of(film, self.container, |track| self.copies(track)))
    }

    /// Whether frames of the clip are shown as they lie in the file, turned by the player.
    pub fn keeps_orientation(&self) -> bool {
        self.film.is_some()
    }

    /// Whether a stream that comes to a pad needs nothing to be done: it is copied as a track of the clip.
    pub fn is_copied(&self, pad: &gst::Pad) -> bool {
        let track = self.track(pad);
        track.is_some_and(|track| !self.is_main(&track) && self.copies(&track))
    }

    fn is_main(&self, track: &Track<'_>) -> bool {
        self.film.as_ref().is_some_and(|(_, main)| *main == track.id)
    }

    /// The track of the clip that comes to a pad of the decoder: GStreamer's demuxer ends a stream's name with its number.
    fn track(&self, pad: &gst::Pad) -> Option<Track<'_>> {
        let stream = pad.stream_id()?;
        let (_, number) = stream.rsplit_once('/')?;
        self.film.as_ref()?.0.track(number.parse().ok()?)
    }

    /// Whether a track of the clip is copied as it is: MP4 and QuickTime describe sound and text each in its own way.
    fn copies(&self, track: &Track<'_>) -> bool {
        let is_alike = self.film.as_ref().is_some_and(|(film, _)| {
            film.has_tables() && film.is_quicktime() == (self.container == Container::Mov)
        });
        let is_wanted = &track.handler != b"soun" || self.audio == Audio::Copy;
        self.excerpt.is_none() && is_alike && is_wanted && track.is_copied()
    }

    /// Links the end of a branch to the muxer of the file beside.
    pub fn link(&self, pipeline: &gst::Pipeline, branch: &gst::Bin, muxer_pad: &str) -> Result<()> {
        let mut side = self.side.lock().unwrap_or_else(PoisonError::into_inner);
        if side.muxer.is_none() {
            let (muxer, sink) = (make(self.container.muxer().context("no muxer")?)?, make("filesink")?);
            sink.set_property("location", &side.path);
            // Not waited for at the start: sparse subtitles may come late.
            sink.set_property("async", false);
            pipeline.add_many([&muxer, &sink])?;
            muxer.link(&sink)?;
            sink.sync_state_with_parent()?;
            muxer.sync_state_with_parent()?;
            side.muxer = Some(muxer);
        }
        let muxer = side.muxer.clone().context("no muxer")?;
        drop(side);
        let output = elements::pad(branch, "src")?;
        branch.link_pads(Some("src"), &muxer, Some(muxer_pad))?;
        let side = self.side.clone();
        output.add_probe(gst::PadProbeType::BUFFER, move |pad, info| {
            let time = info.buffer().and_then(|buffer| buffer.dts_or_pts());
            if let Some(time) = time.and_then(|time| running_time(pad, time)) {
                let mut side = side.lock().unwrap_or_else(PoisonError::into_inner);
                side.start = Some(side.start.map_or(time, |start| start.min(time)));
            }
            gst::PadProbeReturn::Remove
        });
        Ok(())
    }

    /// Notes when the clip was made.
    pub fn note_date(&self, created: gst::DateTime) {
        self.side.lock().unwrap_or_else(PoisonError::into_inner).created = Some(created);
    }

    /// What has the first stream begin at time 0.
    pub fn begin_at_zero(&self) -> Box<dyn Fn() + Send + Sync> {
        let side = self.side.clone();
        Box::new(move || side.lock().unwrap_or_else(PoisonError::into_inner).begins_at_zero = true)
    }

    /// Writes the file: the video with all that lies beside it. `is_turned` of frames that were turned upright.
    pub fn write(
        &self,
        video: &EncodedVideo,
        is_turned: bool,
        output: &Path,
        interruption: &Interruption,
    ) -> Result<()> {
        let side = self.side.lock().unwrap_or_else(PoisonError::into_inner);
        let film = match side.muxer {
            Some(_) => {
                Some(Film::read(&side.path).context("the streams beside the video cannot be read again")?)
            }
            None => None,
        };
        let start = side.start.and_then(|start| i64::try_from(start.nseconds()).ok());
        let first = video.samples().iter().map(|sample| sample.time).chain(start).min();
        let earlier = first.filter(|_| side.begins_at_zero).unwrap_or(0);
        let later = start.map_or(0.0, |start| (start - earlier) as f64 * 1e-9);
        let label = self.excerpt.as_ref().map(|excerpt| label::of(&excerpt.frames()));
        let assembly = Assembly {
            container: self.container,
            video,
            clip: self.film.as_ref().map(|(film, track)| (film, *track)),
            copied: &|track| self.copies(track),
            side: film.as_ref().map(|film| (film, later)),
            earlier,
            is_turned,
            comment: label,
            timecode: self.timecode.or(video.timecode()),
            created: side.created.as_ref().and_then(|date| Some(date.to_g_date_time().ok()?.to_unix())),
            chapters: Vec::new(),
        };
        assembly.write(output, interruption)
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        let side = self.side.lock().unwrap_or_else(PoisonError::into_inner);
        // Where there was no such stream there is no such file.
        let _ = std::fs::remove_file(&side.path);
    }
}

/// The running time of what leaves by a pad at a time of its segment, with the pad's offset.
fn running_time(pad: &gst::Pad, time: gst::ClockTime) -> Option<gst::ClockTime> {
    let segment = pad.sticky_event::<gst::event::Segment>(0)?;
    let segment = segment.segment().downcast_ref::<gst::ClockTime>()?;
    // What an edit list passes over of the first packet lies before the start.
    let time = match segment.to_running_time_full(time)? {
        gst::Signed::Positive(time) => time,
        gst::Signed::Negative(_) => gst::ClockTime::ZERO,
    };
    let offset = pad.offset();
    match u64::try_from(offset) {
        Ok(later) => Some(time + gst::ClockTime::from_nseconds(later)),
        Err(_) => Some(time.saturating_sub(gst::ClockTime::from_nseconds(offset.unsigned_abs()))),
    }
}

/// Has the frames that come to the appsink `encoded` of a branch kept.
pub fn collect(branch: &gst::Bin, path: PathBuf, colour: Colour) -> Result<Arc<Mutex<EncodedVideo>>> {
    let video = Arc::new(Mutex::new(EncodedVideo::create(path, colour)?));
    write_samples(&app_sink(branch, "encoded")?, &video, take);
    Ok(video)
}

fn take(video: &mut EncodedVideo, sample: &gst::Sample) -> Result<()> {
    let buffer = sample.buffer().context("a frame without data")?;
    let segment = sample.segment().and_then(|segment| segment.downcast_ref::<gst::ClockTime>());
    let time = segment.zip(buffer.pts()).map(|(segment, time)| segment.to_running_time_full(time));
    let time = time.flatten().context("an encoded frame has no time")?;
    if let Some(caps) = sample.caps() {
        video.set_caps(caps);
    }
    if video.samples().is_empty()
        && let Some(code) = buffer.meta::<gst_video::VideoTimeCodeMeta>()
    {
        video.set_timecode(Timecode::of_frame(&code.tc()));
    }
    let time = match time {
        gst::Signed::Positive(time) => i64::try_from(time.nseconds())?,
        gst::Signed::Negative(time) => -i64::try_from(time.nseconds())?,
    };
    video.push(buffer, time)
}
