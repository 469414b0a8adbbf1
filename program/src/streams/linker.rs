// SPDX-License-Identifier: MIT OR Apache-2.0

//! A clip's streams → the muxer: the video by a branch of its own, the others as they are where the container can hold them.

use super::beside::Beside;
use super::destination::Video;
use super::excerpt::Excerpt;
use super::markup;
use super::routes::{Audio, Kind, Route, beside_video, is_copied, route};
use crate::elements::{self, NO_VIDEO, comes_from, named, parse};
use crate::isobmff::Film;
use crate::matroska::{self, Delays};
use crate::output::container::Container;
use anyhow::{Context, Result, anyhow, bail};
use gst::glib;
use gst::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// What waits for video from elsewhere, at most: streams of a file lie that close together, even sparse ones.
const LONGEST_WAIT: gst::ClockTime = gst::ClockTime::from_seconds(60);

/// What puts the streams together.
pub(super) enum Muxer {
    /// An element that takes all of them.
    Whole(gst::Element),
    /// This program takes the video, and what lies beside it.
    Boxes(Beside),
    /// There is nothing to put together: this program takes the video, and the other streams are left out.
    Nothing,
}

/// Links what the decoder finds to the muxer.
pub(super) struct Linker {
    pub(super) pipeline: glib::WeakRef<gst::Pipeline>,
    pub(super) muxer: Muxer,
    pub(super) video: Video,
    pub(super) container: Container,
    pub(super) audio: Audio,
    pub(super) excerpt: Option<Arc<Excerpt>>,
    pub(super) is_matroska: bool,
    /// The clip, where it is a file of boxes.
    pub(super) film: Option<Film>,
    pub(super) delays: Delays,
    pub(super) has_video: AtomicBool,
    pub(super) has_warned_of_files: AtomicBool,
    /// The streams of the file by their identifiers, in its order, with what they were before they were decoded.
    pub(super) stored: Mutex<Vec<(glib::GString, gst::Caps)>>,
}

impl Linker {
    /// Whether the decoder goes on with a stream that has come to a pad inside it.
    fn decodes(&self, pad: &gst::Pad, caps: &gst::CapsRef) -> bool {
        // A whole MP4 file, before it is demuxed, calls itself video too.
        let is_demuxed = comes_from(pad, "Demuxer") || comes_from(pad, "Parser");
        if is_demuxed {
            self.note_stream(pad, caps);
        }
        let is_dropped = self.drops_video() && Kind::of(caps) == Kind::Video && is_demuxed;
        let is_track = is_demuxed && self.copies(pad);
        // Subtitles that are pictures are no video.
        let is_picture = caps.structure(0).is_some_and(|format| format.name().starts_with("subpicture/"));
        let is_beside = is_demuxed && self.beside_video(pad, caps).is_some();
        let is_left_out = matches!(self.muxer, Muxer::Nothing) && Kind::of(caps) != Kind::Video;
        let is_silenced = self.audio == Audio::None && Kind::of(caps) == Kind::Audio;
        let is_unwanted = is_demuxed && (is_left_out || is_silenced);
        !is_dropped
            && !is_track
            && !is_picture
            && !is_beside
            && !is_unwanted
            && !is_copied(self.container, self.audio, caps)
    }

    /// Notes what a stream is as it lies in the file.
    fn note_stream(&self, pad: &gst::Pad, caps: &gst::CapsRef) {
        let Some(stream) = pad.stream_id() else { return };
        let mut stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        if !stored.iter().any(|(other, _)| *other == stream) {
            stored.push((stream, caps.to_owned()));
        }
    }

    /// What the stream of a pad is as it lies in the file.
    fn stored(&self, pad: &gst::Pad) -> Option<gst::Caps> {
        let stream = pad.stream_id()?;
        let stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        stored.iter().find(|(other, _)| *other == stream).map(|(_, caps)| caps.clone())
    }

    /// The way to the muxer of video beside the first, which is copied as it is; `None` of the first, and where that cannot be: a
    /// part would begin between two frames that are coded by themselves.
    fn beside_video(&self, pad: &gst::Pad, caps: &gst::CapsRef) -> Option<String> {
        let stream = pad.stream_id()?;
        let stored = self.stored.lock().unwrap_or_else(PoisonError::into_inner);
        let (first, _) = stored.iter().find(|(_, caps)| Kind::of(caps) == Kind::Video)?;
        let is_beside = *first != stream && Kind::of(caps) == Kind::Video && self.excerpt.is_none();
        is_beside.then(|| beside_video(self.container, caps)).flatten()
    }

    /// Has what the decoder finds linked, or held.
    pub(super) fn watch(linker: &Arc<Self>, decoder: &gst::Element) {
        let on_stream = linker.clone();
        decoder.connect("autoplug-continue", false, move |values| {
            let pad = values.get(1).and_then(|v| v.get::<gst::Pad>().ok());
            let caps = values.get(2).and_then(|v| v.get::<gst::Caps>().ok());
            let goes_on = pad.zip(caps).is_none_or(|(pad, caps)| on_stream.decodes(&pad, &caps));
            Some(goes_on.to_value())
        });
        let on_pad = linker.clone();
        decoder.connect_pad_added(move |_, pad| {
            on_pad.watch_tags(pad);
            if let Some(excerpt) = &on_pad.excerpt {
                excerpt.hold(pad);
            } else if let Err(error) = on_pad.link(pad) {
                on_pad.report(&error);
            }
        });
        let linker = linker.clone();
        decoder.connect_no_more_pads(move |decoder| {
            if linker.excerpt.is_some() {
                let held = gst::Structure::new_empty("streams-are-held");
                let message = gst::message::Application::builder(held).src(decoder).build();
                // Where nobody listens any more, nobody waits.
                let _ = decoder.post_message(message);
            } else if let Err(error) = linker.check() {
                linker.report(&error);
            }
        });
    }

    /// Takes over when the clip was made, once its demuxer has said so, and warns of pictures and files beside the streams.
    fn watch_tags(self: &Arc<Self>, pad: &gst::Pad) {
        let linker = self.clone();
        let keeps_pictures = matches!(&self.muxer, Muxer::Boxes(_)) && self.film.is_some();
        pad.add_probe(gst::PadProbeType::EVENT_DOWNSTREAM, move |_, info| {
            if let Some(gst::EventView::Tag(tags)) = info.event().map(|event| event.view()) {
                let tags = tags.tag();
                if let Some(date) = tags.get::<gst::tags::DateTime>() {
                    linker.note_date(date.get());
                }
                let has_files = tags.get::<gst::tags::Image>().is_some()
                    || tags.get::<gst::tags::PreviewImage>().is_some()
                    || tags.get::<gst::tags::Attachment>().is_some();
                if has_files && !keeps_pictures && !linker.has_warned_of_files.swap(true, Ordering::Relaxed) {
                    linker.warn_of("cover pictures and attached files are left out");
                }
            }
            gst::PadProbeReturn::Ok
        });
    }

    fn note_date(&self, created: gst::DateTime) {
        match &self.muxer {
            Muxer::Boxes(beside) => beside.note_date(created),
            Muxer::Whole(muxer) => set_date(muxer, created.to_g_date_time().ok()),
            Muxer::Nothing => {}
        }
    }

    pub(super) fn link(self: &Arc<Self>, pad: &gst::Pad) -> Result<()> {
        if self.is_matroska || (self.excerpt.is_none() && self.is_unedited(pad)) {
            matroska::keep_first_time(pad);
        }
        let caps = pad.current_caps().unwrap_or_else(|| pad.query_caps(None));
        let kind = Kind::of(&caps);
        if self.copies(pad) {
            elements::drop_all(pad);
            return Ok(());
        }
        let beside_video = self.beside_video(pad, &caps);
        let is_first_video =
            kind == Kind::Video && beside_video.is_none() && !self.has_video.swap(true, Ordering::Relaxed);
        if is_first_video {
            return match &self.video {
                Video::Decoded(branch) => {
                    self.add(branch, kind, pad)?;
                    link_to(pad, branch)
                }
                Video::Replaced(branch) => self.replace(pad, &caps, branch),
                // To its end: a pipeline without a sink would have none.
                Video::Elsewhere => {
                    let branch = parse("fakesink name=encoded sync=false async=false")?;
                    self.add(&branch, kind, pad)?;
                    link_to(pad, &branch)
                }
            };
        }
        let stored = self.stored(pad).unwrap_or_else(|| caps.clone());
        let is_pcm = stored.structure(0).is_some_and(|format| format.has_name("audio/x-raw"));
        let route = match beside_video {
            Some(branch) => Route::Copied(branch),
            None if matches!(self.muxer, Muxer::Nothing) => Route::LeftOut,
            None => route(self.container, self.audio, &caps, is_pcm),
        };
        let branch = match route {
            Route::Copied(branch) => parse(&branch)?,
            Route::Encoded(branch) => {
                if self.audio == Audio::Copy {
                    self.warn(&stored, "is encoded to AAC");
                }
                parse(&branch)?
            }
            Route::Stripped(branch) => {
                let branch = parse(&branch)?;
                markup::strip(&elements::pad(&named(&branch, "markup")?, "sink")?);
                branch
            }
            Route::LeftOut => {
                if !(kind == Kind::Audio && self.audio == Audio::None) {
                    self.warn(&stored, "is left out");
                }
                elements::drop_all(pad);
                return Ok(());
            }
        };
        if self.drops_video() {
            // The clip is read faster than it is written: its video is not waited for.
            named(&branch, "waiting")?.set_property("max-size-time", LONGEST_WAIT.nseconds());
        }
        if let Some(excerpt) = &self.excerpt {
            excerpt.keep_wanted(pad);
        }
        self.add(&branch, kind, pad)?;
        link_to(pad, &branch)
    }

    /// Whether a stream of a film counts its times by its tables alone: the demuxer ends its name with its number.
    fn is_unedited(&self, pad: &gst::Pad) -> bool {
        let number = |stream: glib::GString| stream.rsplit('/').next()?.parse().ok();
        let id = pad.stream_id().and_then(number);
        id.zip(self.film.as_ref()).is_some_and(|(id, film)| film.is_unedited(id))
    }

    fn drops_video(&self) -> bool {
        matches!(self.video, Video::Replaced(_) | Video::Elsewhere)
    }

    /// Whether a stream is copied as it lies in the clip, so that it need not be read here.
    fn copies(&self, pad: &gst::Pad) -> bool {
        matches!(&self.muxer, Muxer::Boxes(beside) if beside.is_copied(pad))
    }

    /// Has a branch give the muxer its video in place of the clip's, of which only tags and chapters are kept.
    fn replace(self: &Arc<Self>, pad: &gst::Pad, caps: &gst::CapsRef, branch: &gst::Bin) -> Result<()> {
        // A muxer takes no more streams once it has data of all that it knows.
        branch.set_locked_state(true);
        self.add(branch, Kind::Video, pad)?;
        let source =
            branch.iterate_sources().into_iter().flatten().next().context("the video has no source")?;
        // Muxers make a clock of the frame rate, which a part states otherwise where it varies.
        let rate = caps.structure(0).and_then(|format| format.get::<gst::Fraction>("framerate").ok());
        let rate = rate.filter(|rate| rate.numer() > 0);
        if let Some(rate) = rate {
            let mut caps = source.property::<gst::Caps>("caps");
            caps.make_mut().set("framerate", rate);
            source.set_property("caps", caps);
        }
        let linker = self.clone();
        let data = gst::PadProbeType::BUFFER | gst::PadProbeType::BUFFER_LIST;
        pad.add_probe(data | gst::PadProbeType::EVENT_DOWNSTREAM, move |pad, info| {
            if info.event().is_some_and(|event| event.type_() != gst::EventType::Eos) {
                return gst::PadProbeReturn::Ok;
            }
            // At the clip's first frame its streams are linked, and its tags known.
            linker.start(pad, &source);
            gst::PadProbeReturn::Remove
        });
        elements::drop_all(pad);
        Ok(())
    }

    /// Lets the branch of the video go, with what belongs to all of the clip.
    fn start(&self, pad: &gst::Pad, source: &gst::Element) {
        pad.sticky_events_foreach(|event| {
            let is_of_clip = match event.view() {
                gst::EventView::Tag(tags) => tags.tag().scope() == gst::TagScope::Global,
                // Chapters.
                gst::EventView::Toc(_) => true,
                _ => false,
            };
            if is_of_clip {
                source.send_event(event.clone());
            }
            std::ops::ControlFlow::Continue(gst::EventForeachAction::Keep)
        });
        if let Video::Replaced(branch) = &self.video {
            branch.set_locked_state(false);
            if let Err(error) = branch.sync_state_with_parent() {
                self.report(&error.into());
            }
        }
    }

    /// An error where the clip has no video.
    pub(super) fn check(&self) -> Result<()> {
        if !self.has_video.load(Ordering::Relaxed) {
            bail!("{NO_VIDEO}");
        }
        Ok(())
    }

    /// Warns of what becomes of a stream that the container cannot hold as it is.
    fn warn(&self, caps: &gst::CapsRef, fate: &str) {
        let name = caps.structure(0).map_or("unknown", |format| format.name().as_str());
        self.warn_of(&format!("a stream of {name} {fate}: it cannot go into {} files", self.container));
    }

    fn warn_of(&self, loss: &str) {
        if let Some(pipeline) = self.pipeline.upgrade() {
            gst::element_warning!(pipeline, gst::StreamError::Format, ("{loss}"));
        }
    }

    /// Adds a branch whose end goes to the muxer.
    fn add(&self, branch: &gst::Bin, kind: Kind, stream: &gst::Pad) -> Result<()> {
        let pipeline = self.pipeline.upgrade().context("the pipeline is gone")?;
        // A branch without an output ends in a sink of its own.
        let end =
            branch.static_pad("src").map_or_else(|| elements::pad(&named(branch, "encoded")?, "sink"), Ok)?;
        match &self.excerpt {
            Some(excerpt) => excerpt.begin_at_zero(&end)?,
            // What comes from elsewhere is not told of delays.
            None if matches!(self.video, Video::Elsewhere) => {}
            None => end.set_offset(end.offset() + self.delays.offset(stream)),
        }
        pipeline.add(branch)?;
        match &self.muxer {
            Muxer::Whole(muxer) => branch.link_pads(Some("src"), muxer, Some(kind.muxer_pad()))?,
            Muxer::Boxes(_) | Muxer::Nothing if branch.static_pad("src").is_none() => {}
            Muxer::Nothing => bail!("a stream has nowhere to go"),
            Muxer::Boxes(beside) => beside.link(&pipeline, branch, kind.muxer_pad())?,
        }
        if !branch.is_locked_state() {
            branch.sync_state_with_parent()?;
        }
        Ok(())
    }

    fn report(&self, error: &anyhow::Error) {
        if let Some(pipeline) = self.pipeline.upgrade() {
            gst::element_error!(pipeline, gst::StreamError::Failed, ("{error:#}"));
        }
    }
}

/// Has a muxer state when the file was made, not when it was written.
pub(super) fn set_date(muxer: &gst::Element, created: Option<glib::DateTime>) {
    if let Some(created) = created.filter(|_| muxer.has_property("creation-time")) {
        muxer.set_property("creation-time", created);
    }
}

fn link_to(pad: &gst::Pad, branch: &gst::Bin) -> Result<()> {
    let input = elements::pad(branch, "sink")?;
    pad.link(&input).map_err(|e| anyhow!("the {} stream cannot be used: {e}", pad.name()))?;
    Ok(())
}
