// SPDX-License-Identifier: MIT OR Apache-2.0

//! What a sequence is made of: all of it follows from its seed.

use gst::prelude::*;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The constant choices of one sequence.
#[derive(Clone, Debug)]
pub struct Setup {
    /// Number of the sequence.
    pub seed: u64,
    /// Threads that disturb the streaming thread; with 0 it does so itself and the sequence is the same
    /// each time.
    pub disturbers: usize,
    /// Steps of the streaming thread.
    pub steps: usize,
    /// Share of frames with a defect.
    pub defects: f64,
    /// Share of frames of one colour.
    pub flat: f64,
    /// Share of frames with strange timestamps.
    pub wild_times: f64,
    /// Share of frames with a flag.
    pub flags: f64,
    /// Whether frames are filled with a colour of their own at the edges.
    pub paints_borders: bool,
    /// How often caps change.
    pub caps_changes: f64,
    /// Share of steps that disturb.
    pub disturbance: f64,
    /// Most lookahead that is set.
    pub lookahead: u32,
    /// Whether sizes stay small.
    pub small: bool,
    /// Whether downstream understands `GstVideoMeta`.
    pub downstream_takes_meta: bool,
    /// Buffers of the pool that downstream offers; 0: it offers none.
    pub downstream_pool: u32,
    /// Frames that downstream keeps for a while.
    pub downstream_keeps: usize,
    /// Share of frames that downstream answers with an error.
    pub downstream_errors: f64,
    /// Whether downstream refuses some formats.
    pub downstream_is_choosy: bool,
    /// Share of frames in front of which downstream waits a little, or until a flush.
    pub downstream_waits: f64,
    /// Whether callbacks of the application call the element.
    pub callbacks: bool,
    /// Latency that upstream reports: live, least, most; `None`: it cannot say.
    pub upstream_latency: Option<(bool, u64, Option<u64>)>,
    /// Whether upstream asks what buffers are wanted.
    pub asks_allocation: bool,
    /// How long the pipeline has played by its clock, in nanoseconds, if it has one.
    pub clock: Option<u64>,
}

impl Setup {
    /// The setup of the sequence `seed`.
    pub fn new(seed: u64) -> Self {
        let mut rng = rng(seed, 0);
        let rng = &mut rng;
        let sometimes = |rng: &mut ChaCha8Rng, chance: f64, value: f64| {
            if rng.random_bool(chance) { rng.random_range(0.0..value) } else { 0.0 }
        };
        Self {
            seed,
            disturbers: *[0, 0, 1, 2, 3].choose(rng).unwrap_or(&0),
            steps: rng.random_range(5..120),
            defects: sometimes(rng, 0.3, 0.1),
            flat: *[0.0, 0.5, 1.0].choose(rng).unwrap_or(&0.5),
            wild_times: sometimes(rng, 0.5, 0.3),
            flags: sometimes(rng, 0.6, 0.4),
            paints_borders: rng.random_bool(0.3),
            caps_changes: sometimes(rng, 0.7, 0.1),
            disturbance: rng.random_range(0.0..0.5),
            lookahead: if rng.random_bool(0.05) { 64 } else { rng.random_range(0..10) },
            small: rng.random_bool(0.95),
            downstream_takes_meta: rng.random_bool(0.5),
            downstream_pool: if rng.random_bool(0.4) { rng.random_range(1..6) } else { 0 },
            downstream_keeps: rng.random_range(0..4),
            downstream_errors: sometimes(rng, 0.15, 0.1),
            downstream_is_choosy: rng.random_bool(0.1),
            downstream_waits: sometimes(rng, 0.4, 0.1),
            callbacks: rng.random_bool(0.4),
            upstream_latency: rng.random_bool(0.9).then(|| {
                let least = rng.random_range(0..3_000_000_000);
                let most = rng.random_bool(0.5).then(|| least + rng.random_range(0..3_000_000_000));
                (rng.random(), least, most)
            }),
            asks_allocation: rng.random_bool(0.8),
            clock: rng.random_bool(0.6).then(|| rng.random_range(0..70_000_000_000)),
        }
    }
}

/// The random numbers of one thread of a sequence.
pub fn rng(seed: u64, thread: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(thread))
}

const SIDES: [u32; 10] = [1, 2, 3, 5, 16, 17, 33, 64, 96, 130];
const RATES: [(i32, i32); 8] =
    [(30, 1), (30, 1), (30, 1), (25, 1), (0, 1), (60_000, 1001), (1, i32::MAX), (i32::MAX, 1)];

/// Caps that the element takes, mostly.
pub fn caps(rng: &mut ChaCha8Rng, setup: &Setup, formats: &[String]) -> gst::Caps {
    let side = |rng: &mut ChaCha8Rng| *SIDES.choose(rng).unwrap_or(&16) as i32;
    let (width, height) = if setup.small { (side(rng), side(rng)) } else { (320, 240) };
    let format = formats.choose(rng).map_or("I420", String::as_str);
    let (num, den) = *RATES.choose(rng).unwrap_or(&(30, 1));
    let mut caps = gst::Caps::builder("video/x-raw")
        .field("format", if rng.random_bool(0.02) { "v308" } else { format })
        .field("width", width)
        .field("height", height)
        .field("framerate", gst::Fraction::new(num, den));
    match rng.random_range(0..40) {
        0 => caps = caps.field("interlace-mode", "interleaved"),
        1 => caps = caps.field("interlace-mode", "mixed"),
        2 => caps = caps.field("multiview-mode", "side-by-side"),
        3..8 => caps = caps.field("pixel-aspect-ratio", gst::Fraction::new(4, 3)),
        8 => return caps.features(["memory:GLMemory"]).build(),
        _ => (),
    }
    caps.build()
}

/// A segment of any kind; whether time runs backwards in it.
pub fn segment(rng: &mut ChaCha8Rng, start: u64) -> (gst::Segment, bool) {
    if rng.random_bool(0.03) {
        let mut segment = gst::Segment::new();
        segment.set_format(
            *[gst::Format::Bytes, gst::Format::Default].choose(rng).unwrap_or(&gst::Format::Bytes),
        );
        return (segment, false);
    }
    let mut segment = gst::FormattedSegment::<gst::ClockTime>::new();
    let rate = *[1.0, 1.0, 1.0, 1.0, 2.0, 0.5, -1.0, -1.0, -4.0].choose(rng).unwrap_or(&1.0);
    segment.set_rate(rate);
    if rng.random_bool(0.1) {
        segment.set_applied_rate(*[-1.0, 2.0].choose(rng).unwrap_or(&2.0));
    }
    let start = gst::ClockTime::from_nseconds(start);
    if rng.random_bool(0.5) {
        segment.set_start(start);
        segment.set_time(start);
        segment.set_position(start);
    }
    if rng.random_bool(0.5) || rate < 0.0 {
        segment.set_stop(start + gst::ClockTime::from_seconds(rng.random_range(0..100)));
    }
    segment.set_base(gst::ClockTime::from_nseconds(rng.random_range(0..10_000_000_000)));
    (segment.upcast(), rate < 0.0)
}

/// The formats that an element takes.
pub fn formats(element: &gst::Element) -> Vec<String> {
    let caps = element.pad_template("sink").map(|template| template.caps().clone());
    let list = caps.as_ref().and_then(|caps| caps.structure(0)?.get::<gst::List>("format").ok());
    list.iter().flat_map(|list| list.iter()).filter_map(|format| format.get().ok()).collect()
}
