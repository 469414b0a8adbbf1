// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the pipeline tests share: set-up, numbered frames, a log of what leaves a pad.

// Each program of tests uses its own part of this.
#![allow(dead_code)]

pub mod film;
pub mod plugin;
pub mod shake;

use gst::prelude::*;
use gst_check::Harness;
use std::sync::{Arc, Mutex, Once};

/// Initialises GStreamer and registers the element.
pub fn init() {
    static INIT: Once = Once::new();
    INIT.call_once(|| {
        gst::init().unwrap();
        gstrsrectify::plugin_register_static().unwrap();
    });
}

/// Width and height of numbered frames.
pub const SIZE: (u32, u32) = (320, 240);
/// Frame duration of numbered frames, rounded down.
pub const FRAME: gst::ClockTime = gst::ClockTime::from_nseconds(1_000_000_000 / 30);
/// Bits of a frame number: 4 × 3 blocks.
const BITS: usize = 12;

/// Caps of the given format, size and frame rate.
pub fn caps(format: &str, width: u32, height: u32, fps: gst::Fraction) -> gst::Caps {
    init();
    gst::Caps::builder("video/x-raw")
        .field("format", format)
        .field("width", width as i32)
        .field("height", height as i32)
        .field("framerate", fps)
        .build()
}

/// Caps of numbered frames: grey, 30 frames a second.
pub fn numbered_caps() -> gst::Caps {
    caps("GRAY8", SIZE.0, SIZE.1, gst::Fraction::new(30, 1))
}

/// A harness around the element that knows its caps.
pub fn harness(lookahead: u32, caps: &gst::Caps) -> Harness {
    init();
    let mut harness = Harness::new("rsrectify");
    harness.element().unwrap().set_property("lookahead", lookahead);
    harness.set_src_caps(caps.clone());
    harness
}

/// Makes the element warp every frame, even one that does not move.
pub fn warp_always(harness: &Harness) {
    harness.element().unwrap().set_property_from_str("border-mode", "crop");
}

/// Pixels of frame `number`: each bit a block of 80 × 80, bright for 1.
pub fn numbered_pixels(number: usize) -> Vec<u8> {
    let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
    let pixel = |i: usize| {
        let (x, y) = (i % width, i / width);
        let bit = (y * 3 / height) * 4 + x * 4 / width;
        if number >> bit & 1 == 1 { 220 } else { 30 }
    };
    (0..width * height).map(pixel).collect()
}

/// The number of a frame from the middle of its blocks.
pub fn number_of(pixels: &[u8], stride: usize) -> usize {
    let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
    let bright = |bit: usize| {
        let (x, y) = ((bit % 4 * 2 + 1) * width / 8, (bit / 4 * 2 + 1) * height / 6);
        pixels[y * stride + x] > 125
    };
    (0..BITS).filter(|&bit| bright(bit)).map(|bit| 1 << bit).sum()
}

/// Frame `number` of a clip of 30 frames a second.
pub fn numbered(number: usize) -> gst::Buffer {
    let mut buffer = gst::Buffer::from_mut_slice(numbered_pixels(number));
    let inner = buffer.get_mut().unwrap();
    inner.set_pts(time(number));
    inner.set_duration(FRAME);
    buffer
}

/// Timestamp of frame `number`.
pub fn time(number: usize) -> gst::ClockTime {
    gst::ClockTime::from_nseconds(number as u64 * 1_000_000_000 / 30)
}

/// A flat frame, zero in every byte.
pub fn flat(caps: &gst::Caps, number: usize) -> gst::Buffer {
    let info = gst_video::VideoInfo::from_caps(caps).unwrap();
    let mut buffer = gst::Buffer::from_mut_slice(vec![0u8; info.size()]);
    buffer.get_mut().unwrap().set_pts(time(number));
    buffer.get_mut().unwrap().set_duration(FRAME);
    buffer
}

/// All buffers that have arrived.
pub fn arrived(harness: &mut Harness) -> Vec<gst::Buffer> {
    std::iter::from_fn(|| harness.try_pull()).collect()
}

/// The frame numbers of buffers by their timestamps.
pub fn numbers(buffers: &[gst::Buffer]) -> Vec<usize> {
    let number =
        |buffer: &gst::Buffer| (buffer.pts().unwrap().nseconds() * 30).div_ceil(1_000_000_000) as usize;
    buffers.iter().map(number).collect()
}

/// What has left a pad, in order.
#[derive(Clone, Default)]
pub struct Log(Arc<Mutex<Vec<String>>>);

impl Log {
    /// Logs what leaves the element's source pad from now on: `frame <number>` by timestamp, or the
    /// event's type (custom events: their name).
    pub fn new(harness: &Harness) -> Self {
        let log = Self::default();
        let entries = log.0.clone();
        let events = gst::PadProbeType::EVENT_DOWNSTREAM | gst::PadProbeType::EVENT_FLUSH;
        let pad = harness.element().unwrap().static_pad("src").unwrap();
        pad.add_probe(gst::PadProbeType::BUFFER | events, move |_, info| {
            let entry = match &info.data {
                Some(gst::PadProbeData::Buffer(buffer)) => {
                    format!("frame {}", numbers(std::slice::from_ref(buffer))[0])
                }
                Some(gst::PadProbeData::Event(event)) => match event.structure() {
                    Some(s) if event.type_() == gst::EventType::CustomDownstream => s.name().to_string(),
                    _ => event.type_().to_string(),
                },
                _ => return gst::PadProbeReturn::Ok,
            };
            entries.lock().unwrap().push(entry);
            gst::PadProbeReturn::Ok
        });
        log
    }

    /// The entries so far; starts a new list.
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut self.0.lock().unwrap())
    }
}

/// A custom event that travels with the frames.
pub fn marker(name: &str) -> gst::Event {
    gst::event::CustomDownstream::new(gst::Structure::new_empty(name))
}

/// A bus that gets the element's messages.
pub fn bus(harness: &Harness) -> gst::Bus {
    let bus = gst::Bus::new();
    harness.element().unwrap().set_bus(Some(&bus));
    bus
}

/// The types of messages on a bus.
pub fn messages(bus: &gst::Bus, kind: gst::MessageType) -> Vec<gst::Message> {
    std::iter::from_fn(|| bus.pop_filtered(&[kind])).collect()
}

/// Plays a pipeline to its end.
pub fn run_to_eos(pipeline: &gst::Pipeline) {
    pipeline.set_state(gst::State::Playing).unwrap();
    wait_for(pipeline, gst::MessageType::Eos);
}

/// Waits for a message; an error message fails the test.
pub fn wait_for(pipeline: &gst::Pipeline, kind: gst::MessageType) -> gst::Message {
    let bus = pipeline.bus().unwrap();
    let message = bus.timed_pop_filtered(gst::ClockTime::from_seconds(60), &[kind, gst::MessageType::Error]);
    let message = message.expect("nothing happened for a minute");
    assert_ne!(message.type_(), gst::MessageType::Error, "{message:?}");
    message
}

/// A frame of these bytes, whose planes begin at these offsets and have these strides.
pub fn laid_out(
    data: Vec<u8>,
    info: &gst_video::VideoInfo,
    offsets: &[usize],
    strides: &[i32],
) -> gst::Buffer {
    let mut buffer = gst::Buffer::from_mut_slice(data);
    gst_video::VideoMeta::add_full(
        buffer.get_mut().unwrap(),
        gst_video::VideoFrameFlags::empty(),
        info.format(),
        info.width(),
        info.height(),
        offsets,
        strides,
    )
    .unwrap();
    buffer
}

/// A frame of fixed speckles, moved by `number` · (3, 2) pixels; every byte of the format is written.
pub fn speckled(caps: &gst::Caps, number: usize) -> gst::Buffer {
    let info = gst_video::VideoInfo::from_caps(caps).unwrap();
    let stride = info.stride()[0] as usize;
    let speckle = |i: usize| {
        let (x, y) = ((i % stride + 3 * number) / 5, (i / stride + 2 * number) / 5);
        let hash = (x * 0x9e37 + y * 0x85eb) ^ (x * y);
        ((hash * 0x2545) >> 4) as u8
    };
    let mut buffer = gst::Buffer::from_mut_slice((0..info.size()).map(speckle).collect::<Vec<_>>());
    buffer.get_mut().unwrap().set_pts(time(number));
    buffer.get_mut().unwrap().set_duration(FRAME);
    buffer
}
