// SPDX-License-Identifier: MIT OR Apache-2.0

//! The encoded video of a file, packet by packet, in the file's order.

use crate::decoder;
use crate::elements::{NO_VIDEO, app_sink, drop_all, launch, named, pad};
use crate::input;
use crate::interruption::Interruption;
use crate::matroska;
use crate::playback::Playback;
use anyhow::{Context, Result};
use gst::prelude::*;
use std::path::Path;

/// How long each look for a message or a packet is.
const LOOK: gst::ClockTime = gst::ClockTime::from_mseconds(100);

/// An encoded frame.
pub struct Packet {
    pub buffer: gst::Buffer,
    /// When it is shown, in the clip; `None` where the file does not say, or shows it not at all.
    pub time: Option<gst::ClockTime>,
}

/// The first video stream of a file, which is not decoded.
pub struct Packets {
    playback: Playback,
    sink: gst_app::AppSink,
    /// The first one, until it is asked for.
    first: Option<gst::Sample>,
}

impl Packets {
    /// Opens a file.
    pub fn open(file: &Path, interruption: &Interruption) -> Result<Self> {
        input::check_file(file)?;
        let pipeline = launch(
            "filesrc name=source ! parsebin name=parser  appsink name=sink sync=false max-buffers=64",
        )?;
        named(&pipeline, "source")?.set_property("location", file);
        let sink = app_sink(&pipeline, "sink")?;
        let video = pad(&sink, "sink")?;
        let parser = named(&pipeline, "parser")?;
        decoder::correct(&parser, file)?;
        if matroska::is_matroska(file) {
            matroska::keep_first_time(&video);
        }
        parser.connect("autoplug-continue", false, |values| {
            let caps = values.get(2).and_then(|value| value.get::<gst::Caps>().ok());
            Some(caps.is_none_or(|caps| !is_whole(&caps)).to_value())
        });
        parser.connect_pad_added(move |parser, pad| {
            if is_video(pad) && !video.is_linked() {
                if let Err(error) = pad.link(&video) {
                    gst::element_error!(
                        parser,
                        gst::StreamError::Failed,
                        ("the video cannot be read: {error}")
                    );
                }
                return;
            }
            drop_all(pad);
            let (parser, video) = (parser.downgrade(), video.clone());
            pad.add_probe(gst::PadProbeType::EVENT_DOWNSTREAM, move |_, info| {
                let is_end = info.event().is_some_and(|event| event.type_() == gst::EventType::Eos);
                if let Some(parser) = parser.upgrade().filter(|_| is_end && !video.is_linked()) {
                    gst::element_error!(parser, gst::StreamError::WrongType, ("{NO_VIDEO}"));
                }
                gst::PadProbeReturn::Ok
            });
        });
        let mut packets = Self { playback: Playback::new(pipeline)?, sink, first: None };
        // Not paused first: a demuxer gives all streams out from one thread, which would wait at the first of them.
        packets.playback.set_state(gst::State::Playing);
        packets.first = packets.pull(interruption)?;
        Ok(packets)
    }

    /// How many frames of a file are shown.
    pub fn count_shown(file: &Path, interruption: &Interruption) -> Result<usize> {
        let mut packets = Self::open(file, interruption)?;
        let mut count = 0;
        while let Some(packet) = packets.next(interruption)? {
            count += usize::from(packet.time.is_some());
        }
        Ok(count)
    }

    /// What the packets are, before the first is taken; an error where the file has none.
    pub fn caps(&self) -> Result<gst::Caps> {
        let first = self.first.as_ref().and_then(|sample| sample.caps_owned());
        first.context("there is no frame in the file")
    }

    /// From which time of the clip on it is played, before the first is taken.
    pub fn start(&self) -> gst::ClockTime {
        let segment = self.first.as_ref().and_then(|sample| sample.segment());
        let segment = segment.and_then(|segment| segment.downcast_ref::<gst::ClockTime>());
        segment.and_then(|segment| segment.to_stream_time(segment.start())).unwrap_or_default()
    }

    /// Comments among the tags of the file, before the first packet is taken.
    pub fn comments(&self) -> Vec<String> {
        let mut comments = Vec::new();
        let Some(pad) = self.sink.static_pad("sink") else { return comments };
        pad.sticky_events_foreach(|event| {
            if let gst::EventView::Tag(tags) = event.view() {
                let texts = tags.tag().iter_tag::<gst::tags::Comment>();
                comments.extend(texts.map(|comment| comment.get().to_owned()));
            }
            std::ops::ControlFlow::Continue(gst::EventForeachAction::Keep)
        });
        comments
    }

    /// The next one; `None` at the end.
    pub fn next(&mut self, interruption: &Interruption) -> Result<Option<Packet>> {
        let sample = match self.first.take() {
            Some(sample) => Some(sample),
            None => self.pull(interruption)?,
        };
        let Some(sample) = sample else { return Ok(None) };
        let buffer = sample.buffer_owned().context("a frame without data")?;
        let time = shown(&sample, &buffer);
        Ok(Some(Packet { buffer, time }))
    }

    fn pull(&mut self, interruption: &Interruption) -> Result<Option<gst::Sample>> {
        loop {
            // An error before the end has been reported when the end is.
            let at_end = self.sink.is_eos();
            self.playback.check(interruption)?;
            if at_end {
                return Ok(None);
            }
            if let Some(sample) = self.sink.try_pull_sample(LOOK) {
                return Ok(Some(sample));
            }
        }
    }
}

/// Whether packets are as a decoder wants them: a parser would add the decoder's configuration to their data once more.
fn is_whole(caps: &gst::CapsRef) -> bool {
    caps.structure(0).is_some_and(|format| format.has_field("codec_data"))
}

fn is_video(pad: &gst::Pad) -> bool {
    let caps = pad.current_caps().unwrap_or_else(|| pad.query_caps(None));
    let name = caps.structure(0).map_or("", |format| format.name().as_str());
    name.starts_with("video/") || name.starts_with("image/")
}

/// When a packet is shown. An edit list may show a part of its time only, or nothing: decoders leave out such frames.
fn shown(sample: &gst::Sample, buffer: &gst::Buffer) -> Option<gst::ClockTime> {
    let segment = sample.segment()?.downcast_ref::<gst::ClockTime>()?;
    let start = buffer.pts()?;
    let end = buffer.duration().map(|duration| start + duration);
    let (start, _) = segment.clip(Some(start), end)?;
    segment.to_stream_time(start)
}
