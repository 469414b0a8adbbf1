// SPDX-License-Identifier: MIT OR Apache-2.0

//! A pipeline from a clip to a file, with the muxer that puts its streams together.

use super::beside::Beside;
use super::destination::{Destination, Video};
use super::linker::{Linker, Muxer, set_date};
use super::timecode::Timecode;
use super::{early, label, programs, unheld};
use crate::elements::make;
use crate::input::{Clip, Opening};
use crate::interruption::Interruption;
use crate::isobmff::{EncodedVideo, Film};
use crate::matroska::{self, Delays};
use anyhow::{Context, Result, bail};
use gst::glib;
use gst::prelude::*;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

/// A pipeline that reads a clip and writes a file.
pub struct Remux {
    pub pipeline: gst::Pipeline,
    linker: Arc<Linker>,
}

impl Remux {
    /// The pipeline that puts a clip's streams into a file; `video` makes the branch of the video, told whether players of the
    /// file turn frames as those of the clip do, so that they must not be turned before, and by how much they come later than in the
    /// clip, which is known when the first has come.
    pub fn new(
        clip: &Clip,
        destination: Destination<'_>,
        video: impl FnOnce(bool, &early::Later) -> Result<Video>,
    ) -> Result<Self> {
        let pipeline = gst::Pipeline::new();
        let beginning = clip.beginning();
        let decoder = clip.open(&pipeline, Opening::Whole)?;
        let is_matroska = clip.is_matroska();
        let clip = clip.path();
        let first_frame = destination.excerpt.as_ref().map_or(0, |excerpt| excerpt.frames().start);
        let timecode = Timecode::of(clip).and_then(|timecode| timecode.after(first_frame));
        let muxer = match Beside::of(clip, &destination, timecode) {
            Some(beside) => Muxer::Boxes(beside),
            None if destination.container.is_of_frames_only() => {
                warn_of_timecode(&pipeline, &destination, timecode);
                Muxer::Nothing
            }
            None => Muxer::Whole(Self::muxer(clip, &pipeline, &destination, timecode)?),
        };
        let mut losses = match &muxer {
            Muxer::Boxes(beside) => beside.losses(),
            Muxer::Whole(_) | Muxer::Nothing => Film::read(clip)
                .filter(|_| destination.excerpt.is_none())
                .map_or_else(Vec::new, |film| unheld::of(&film, destination.container, |_| false)),
        };
        if destination.excerpt.is_none() {
            losses.extend(matroska::losses(&beginning));
        }
        for loss in losses {
            gst::element_warning!(pipeline, gst::StreamError::Format, ("{loss}"));
        }
        let Destination { container, audio, excerpt, .. } = destination;
        let later = early::Later::default();
        let is_upright = matches!(&muxer, Muxer::Boxes(beside) if beside.keeps_orientation());
        let video = video(is_upright, &later)?;
        if excerpt.is_none() && matches!(video, Video::Decoded(_)) {
            let begin_at_zero: Box<dyn Fn() + Send + Sync> = match &muxer {
                Muxer::Whole(muxer) => {
                    let muxer = muxer.clone();
                    Box::new(move || muxer.set_property("offset-to-zero", true))
                }
                Muxer::Boxes(beside) => beside.begin_at_zero(),
                Muxer::Nothing => Box::new(|| {}),
            };
            early::keep(&pipeline, &later, begin_at_zero);
        }
        let (has_video, stored) = (AtomicBool::new(false), Mutex::default());
        let delays = Delays::of(&beginning);
        let owner = pipeline.downgrade();
        let linker = Linker {
            pipeline: owner,
            muxer,
            video,
            container,
            audio,
            excerpt,
            is_matroska,
            film: Film::read(clip),
            delays,
            has_video,
            has_warned_of_files: AtomicBool::new(false),
            stored,
        };
        let linker = Arc::new(linker);
        Linker::watch(&linker, &decoder);
        if let Some(count) = programs::count(clip).filter(|count| *count > 1) {
            gst::element_warning!(
                pipeline,
                gst::StreamError::Format,
                ("the file has {count} programs: the first is taken, the others are left out")
            );
        }
        Ok(Self { pipeline, linker })
    }

    /// The muxer of all streams, with the file that it writes.
    fn muxer(
        clip: &Path,
        pipeline: &gst::Pipeline,
        destination: &Destination<'_>,
        timecode: Option<Timecode>,
    ) -> Result<gst::Element> {
        let Destination { output, container, excerpt, .. } = destination;
        let muxer = make(container.muxer().context("no muxer")?)?;
        let sink = match output {
            Some(file) => {
                let sink = make("filesink")?;
                sink.set_property("location", file);
                sink
            }
            None => {
                let sink = make("fdsink")?;
                // The standard output, in which it cannot go back to write down how long the clip is.
                sink.set_property("fd", 1i32);
                muxer.set_property("streamable", true);
                sink
            }
        };
        pipeline.add_many([&muxer, &sink])?;
        muxer.link(&sink)?;
        if let Some((excerpt, tags)) = excerpt.as_ref().zip(muxer.dynamic_cast_ref::<gst::TagSetter>()) {
            let label = label::of(&excerpt.frames());
            tags.add_tag::<gst::tags::Comment>(&label.as_str(), gst::TagMergeMode::ReplaceAll);
        }
        let created = Film::read(clip).and_then(|film| film.created());
        set_date(&muxer, created.and_then(|created| glib::DateTime::from_unix_utc(created).ok()));
        warn_of_timecode(pipeline, destination, timecode);
        Ok(muxer)
    }

    /// Writes the file, where this program does so itself: the encoded video, its frames turned upright or not, and what the
    /// pipeline has taken of the other streams.
    pub fn write(
        &self,
        video: &EncodedVideo,
        is_turned: bool,
        output: &Path,
        interruption: &Interruption,
    ) -> Result<()> {
        match &self.linker.muxer {
            Muxer::Boxes(beside) => beside.write(video, is_turned, output, interruption),
            Muxer::Whole(_) | Muxer::Nothing => bail!("the pipeline writes the file"),
        }
    }

    /// Goes to the part of the clip that is wanted, and lets the streams go, which are held until then.
    pub fn release(&self) -> Result<()> {
        let Some(excerpt) = &self.linker.excerpt else { return Ok(()) };
        excerpt.release(|pad| self.linker.link(pad))?;
        self.linker.check()
    }
}

/// Warns that a timecode is left out, where there is one.
fn warn_of_timecode(pipeline: &gst::Pipeline, destination: &Destination<'_>, timecode: Option<Timecode>) {
    let container = destination.container;
    if let Some(timecode) = timecode.and_then(Timecode::to_gst) {
        gst::element_warning!(
            pipeline,
            gst::StreamError::Format,
            ("the timecode, from {timecode} on, is left out: it cannot go into {container} files")
        );
    }
}
