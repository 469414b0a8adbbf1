// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the pictures of a clip are: format, size, scanning, colours and light.
//!
//! The stream itself states it better than the file around it: files call full range limited, and HDR standard. But demuxers' caps go
//! before what parsers and decoders find, so that they are read here without them, and fill only what is left open.

use crate::colour::{Colour, UNSPECIFIED};
use crate::decoder;
use crate::elements::{self, NO_VIDEO};
use crate::input::{Clip, Opening};
use crate::times::{Delay, Watch};
use anyhow::{Context, Result, bail};
use gst::prelude::*;
use gst_video::prelude::*;
use gst_video::{VideoBufferFlags, VideoColorMatrix, VideoColorRange, VideoColorimetry, VideoInfo};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How long the first frame is waited for.
const PATIENCE: Duration = Duration::from_secs(20);

/// The matrix of BT.601.
const BT601: u8 = 6;
/// Fields of caps in which a file may contradict its stream.
const STATED: [&str; 3] = ["colorimetry", MASTERING, LIGHT];
const MASTERING: &str = "mastering-display-info";
const LIGHT: &str = "content-light-level";

/// The pictures of a clip.
#[derive(Clone, Debug, Default)]
pub struct Picture {
    /// Format, size and scanning of the decoded frames; `None` where none could be decoded.
    pub info: Option<VideoInfo>,
    /// Whether they have no transparency although their format has.
    pub is_opaque: bool,
    /// What their stream is, as its decoder takes it; `None` where it is raw.
    pub coded: Option<gst::Caps>,
    pub colour: Colour,
    /// The display that the clip was mastered on, as caps state it.
    pub mastering_display: Option<String>,
    /// How bright the pictures are, as caps state it.
    pub light_level: Option<String>,
    /// By how many packets the decoder waits, where the file states only when they are decoded.
    pub delay: usize,
}

impl Picture {
    /// Those of a clip's first video stream, from its first frame.
    pub fn of(clip: &Clip) -> Result<Self> {
        let pipeline = gst::Pipeline::new();
        let opened = clip.open(&pipeline, Opening::Look)?;
        let demuxed = hide_what_files_state(&pipeline);
        let watch = Watch::of(&pipeline);
        let (found, first_frame) = channel();
        // Only video is decoded.
        opened.connect("autoplug-continue", false, |values| {
            let caps = values.get(2).and_then(|value| value.get::<gst::Caps>().ok());
            Some(caps.is_none_or(|caps| !decoder::is_beside_video(&caps)).to_value())
        });
        let (on_frame, videos) = (found.clone(), Arc::new(AtomicU32::new(0)));
        let counted = videos.clone();
        opened.connect_pad_added(move |_, pad| {
            let caps = pad.current_caps().unwrap_or_else(|| pad.query_caps(None));
            if is_of(&caps, "video/x-raw") {
                counted.fetch_add(1, Ordering::Relaxed);
                let (found, watch, first) = (on_frame.clone(), watch.clone(), Mutex::default());
                pad.add_probe(
                    gst::PadProbeType::BUFFER | gst::PadProbeType::EVENT_DOWNSTREAM,
                    move |pad, info| {
                        let mut first = first.lock().unwrap_or_else(PoisonError::into_inner);
                        report(pad, info, &watch, &mut first, &found)
                    },
                );
            } else {
                elements::drop_all(pad);
            }
        });
        opened.connect_no_more_pads(move |_| {
            if videos.load(Ordering::Relaxed) == 0 {
                let _ = found.send(None);
            }
        });
        let result = wait_for_frame(&pipeline, &first_frame);
        let _ = pipeline.set_state(gst::State::Null);
        let First { stream, caps, delay, coded } = result?;
        let caps = caps.context(NO_VIDEO)?;
        let demuxed = demuxed.lock().unwrap_or_else(PoisonError::into_inner);
        let of_file = demuxed.iter().find(|(id, _)| *id == stream).map(|(_, caps)| caps);
        // GStreamer's demuxer of films passes over ranges, and over what it cannot name.
        let film = Colour::of_film(clip.path()).or_else(|| of_file.map(|caps| Colour::of_caps(caps)));
        let stated = |field: &str| {
            let text = |caps: &gst::Caps| caps.structure(0)?.get::<String>(field).ok();
            text(&caps).or_else(|| of_file.and_then(text))
        };
        // Its streams have no other (RFC 6386, 9.2), and state none.
        let is_vp8 = of_file.is_some_and(|caps| is_of(caps, "video/x-vp8"));
        let by_codec = Colour { matrix: if is_vp8 { BT601 } else { UNSPECIFIED }, ..Colour::default() };
        Ok(Self {
            info: VideoInfo::from_caps(&caps).ok(),
            is_opaque: clip.is_opaque(),
            coded,
            colour: Colour::of_caps(&caps).or(film.unwrap_or_default()).or(by_codec),
            mastering_display: stated(MASTERING),
            light_level: stated(LIGHT),
            delay: delay.longest(),
        })
    }

    /// As RGB is made of the pictures and they of RGB: with a matrix in any case, which GStreamer chooses by the size where none is stated.
    pub fn colorimetry(&self) -> Option<VideoColorimetry> {
        let guess = self.info.as_ref()?.colorimetry();
        let stated = self.colour.colorimetry().unwrap_or(guess);
        let matrix = Some(stated.matrix()).filter(|matrix| *matrix != VideoColorMatrix::Unknown);
        Some(VideoColorimetry::new(
            if stated.range() == VideoColorRange::Unknown { guess.range() } else { stated.range() },
            matrix.unwrap_or(guess.matrix()),
            stated.transfer(),
            stated.primaries(),
        ))
    }

    /// States all this in caps of an encoded stream, and nothing else of the kind.
    pub fn state_in(&self, caps: &mut gst::CapsRef) {
        let Some(format) = caps.structure_mut(0) else { return };
        format.remove_fields(STATED);
        if let Some(colorimetry) = self.colour.colorimetry() {
            format.set("colorimetry", colorimetry.to_string());
        }
        for (field, text) in [(MASTERING, &self.mastering_display), (LIGHT, &self.light_level)] {
            if let Some(text) = text {
                format.set(field, text);
            }
        }
    }
}

/// The first frames of a stream.
#[derive(Default)]
struct First {
    stream: Option<gst::glib::GString>,
    caps: Option<gst::Caps>,
    coded: Option<gst::Caps>,
    delay: Delay,
}

/// Takes what comes to a pad; reports the first frames once enough is known of them, or that none come.
fn report(
    pad: &gst::Pad,
    info: &gst::PadProbeInfo<'_>,
    watch: &Watch,
    first: &mut First,
    found: &Sender<Option<First>>,
) -> gst::PadProbeReturn {
    // Nobody listens after the first report.
    let Some(frame) = info.buffer() else {
        if info.event().is_some_and(|event| event.type_() == gst::EventType::Eos) {
            let _ = found.send(first.caps.is_some().then(|| std::mem::take(first)));
        }
        return gst::PadProbeReturn::Ok;
    };
    if first.caps.is_none()
        && let Some(mut caps) = pad.current_caps()
    {
        state_order(caps.make_mut(), frame);
        first.caps = Some(caps);
        first.stream = pad.stream_id();
        first.coded = coded(pad);
    }
    if first.delay.take(watch, pad, frame).is_some() {
        let _ = found.send(Some(std::mem::take(first)));
    }
    gst::PadProbeReturn::Drop
}

/// What comes to the decoder that a pad belongs to; `None` where there is none, as the stream is raw.
fn coded(pad: &gst::Pad) -> Option<gst::Caps> {
    let inner = pad.downcast_ref::<gst::GhostPad>().and_then(|pad| pad.target());
    let decoder = inner.and_then(|pad| pad.parent_element());
    let decoder = decoder.filter(|element| elements::is_of_class(element, "Decoder"))?;
    decoder.static_pad("sink")?.current_caps()
}

/// Has caps of fields in one frame state their order, which some decoders state of each frame only.
fn state_order(caps: &mut gst::CapsRef, frame: &gst::BufferRef) {
    let Some(format) = caps.structure_mut(0) else { return };
    let is_interlaced = format.get::<&str>("interlace-mode").is_ok_and(|mode| mode != "progressive");
    if is_interlaced && !format.has_field("field-order") {
        let is_top_first = frame.video_flags().contains(VideoBufferFlags::TFF);
        format.set("field-order", if is_top_first { "top-field-first" } else { "bottom-field-first" });
    }
}

fn wait_for_frame(pipeline: &gst::Pipeline, first: &Receiver<Option<First>>) -> Result<First> {
    let bus = pipeline.bus().context("the pipeline has no bus")?;
    let _ = pipeline.set_state(gst::State::Paused);
    let started = Instant::now();
    while started.elapsed() < PATIENCE {
        match first.recv_timeout(Duration::from_millis(20)) {
            Ok(Some(frame)) => return Ok(frame),
            Err(RecvTimeoutError::Timeout) if bus.pop_filtered(&[gst::MessageType::Error]).is_none() => {}
            _ => break,
        }
    }
    bail!("{NO_VIDEO}")
}

fn is_of(caps: &gst::CapsRef, kind: &str) -> bool {
    caps.structure(0).is_some_and(|format| format.name().starts_with(kind))
}

/// The streams of a file by their identifiers, with the caps that its demuxer gives them.
type Demuxed = Arc<Mutex<Vec<(Option<gst::glib::GString>, gst::Caps)>>>;

/// Has the demuxer's word on colours not go on to parsers and decoders, but noted.
fn hide_what_files_state(pipeline: &gst::Pipeline) -> Demuxed {
    let demuxed = Demuxed::default();
    let noted = demuxed.clone();
    pipeline.connect_deep_element_added(move |_, _, element| {
        if elements::is_of_class(element, "Demux") {
            let noted = noted.clone();
            element.connect_pad_added(move |_, pad| hide(pad, noted.clone()));
        }
    });
    demuxed
}

fn hide(pad: &gst::Pad, noted: Demuxed) {
    pad.add_probe(gst::PadProbeType::EVENT_DOWNSTREAM, move |pad, info| {
        let caps = match info.event().map(|event| event.view()) {
            Some(gst::EventView::Caps(event)) if is_of(event.caps(), "video/") => event.caps_owned(),
            _ => return gst::PadProbeReturn::Ok,
        };
        let mut rest = caps.clone();
        if let Some(format) = rest.make_mut().structure_mut(0) {
            format.remove_fields(STATED);
        }
        noted.lock().unwrap_or_else(PoisonError::into_inner).push((pad.stream_id(), caps));
        elements::replace_caps(info, &rest);
        gst::PadProbeReturn::Ok
    });
}
