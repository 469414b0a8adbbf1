//! The encoded video of a file, packet by packet, in the file's order.

use crate::clips;
use crate::elements::{NO_VIDEO, launch, make, named, pad};
use crate::interruption::Interruption;
use crate::playback::{Event, Playback};
use anyhow::{Context, Result, anyhow};
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
    /// What the packets are.
    caps: Option<gst::Caps>,
}

impl Packets {
    /// Opens a file.
    pub fn open(file: &Path, interruption: &Interruption) -> Result<Self> {
        clips::check(file)?;
        let pipeline = launch(
            "filesrc name=source ! parsebin name=parser  appsink name=sink sync=false max-buffers=64",
        )?;
        named(&pipeline, "source")?.set_property("location", file);
        let sink = named(&pipeline, "sink")?;
        let input = pad(&sink, "sink")?;
        let sink = sink.downcast::<gst_app::AppSink>().map_err(|_| anyhow!("appsink is another element"))?;
        let owner = pipeline.downgrade();
        let parser = named(&pipeline, "parser")?;
        parser.connect("autoplug-continue", false, |values| {
            let caps = values.get(2).and_then(|value| value.get::<gst::Caps>().ok());
            Some(caps.is_none_or(|caps| !is_whole(&caps)).to_value())
        });
        let video = input.clone();
        parser.connect_pad_added(move |parser, pad| {
            let joined = owner.upgrade().context("the pipeline is gone").and_then(|pipeline| {
                if is_video(pad) && !video.is_linked() {
                    pad.link(&video)?;
                    return Ok(());
                }
                // A stream that goes nowhere would be an error, and one that a sink holds until it plays holds the video too.
                pad.add_probe(gst::PadProbeType::BUFFER | gst::PadProbeType::BUFFER_LIST, |_, _| {
                    gst::PadProbeReturn::Drop
                });
                let rest = make("fakesink")?;
                rest.set_property("sync", false);
                rest.set_property("async", false);
                pipeline.add(&rest)?;
                rest.sync_state_with_parent()?;
                pad.link(&crate::elements::pad(&rest, "sink")?)?;
                Ok(())
            });
            if let Err(error) = joined {
                gst::element_error!(parser, gst::StreamError::Failed, ("{error:#}"));
            }
        });
        parser.connect("no-more-pads", false, move |values| {
            let parser = values.first().and_then(|value| value.get::<gst::Element>().ok());
            if let Some(parser) = parser.filter(|_| !input.is_linked()) {
                gst::element_error!(parser, gst::StreamError::WrongType, ("{NO_VIDEO}"));
            }
            None
        });
        let mut packets = Self { playback: Playback::new(pipeline)?, sink, caps: None };
        packets.playback.set_state(gst::State::Paused);
        while !matches!(packets.playback.next(LOOK, interruption)?, Event::Ready | Event::End) {}
        let first = packets.sink.try_pull_preroll(gst::ClockTime::ZERO);
        packets.caps = first.as_ref().and_then(|sample| sample.caps_owned());
        packets.playback.set_state(gst::State::Playing);
        Ok(packets)
    }

    /// What the packets are; an error where the file has none.
    pub fn caps(&self) -> Result<&gst::Caps> {
        self.caps.as_ref().context("there is no frame in the file")
    }

    /// The next one; `None` at the end.
    pub fn next(&mut self, interruption: &Interruption) -> Result<Option<Packet>> {
        while !self.sink.is_eos() {
            self.playback.next(gst::ClockTime::ZERO, interruption)?;
            let Some(sample) = self.sink.try_pull_sample(LOOK) else { continue };
            let Some(buffer) = sample.buffer_owned() else { continue };
            let time = shown(&sample, &buffer);
            return Ok(Some(Packet { buffer, time }));
        }
        Ok(None)
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
