// SPDX-License-Identifier: MIT OR Apache-2.0

//! What is known to break filters, each tried many times. Wherever it can, an attack is played twice,
//! with the element and with `identity` in its place: the same frames must arrive.

mod effort;
mod endurance;
mod files;
mod film;
mod leaks;
mod live;
mod numbered;
mod playback;
mod pools;
mod process;
mod seeks;
mod sinks;

pub use effort::Effort;

use crate::outcome::Outcome;

/// An attack.
pub struct Attack {
    /// Its name on the command line.
    pub name: &'static str,
    /// What is done to the element.
    pub fault: &'static str,
    /// What one try is.
    pub unit: &'static str,
    /// Whether it measures time, and so needs a machine with nothing else to do.
    pub times: bool,
    /// What `GST_TRACERS` must be: tracers start with GStreamer.
    pub tracers: Option<&'static str>,
    /// Runs it.
    pub run: fn(Effort) -> anyhow::Result<Outcome>,
}

/// All attacks.
pub const ATTACKS: &[Attack] = &[
    Attack {
        name: "damaged-files",
        fault: "Files cut off, with bytes flipped, with holes of zeros: six pairs of codec and container",
        unit: "files",
        times: false,
        tracers: None,
        run: files::damaged,
    },
    Attack {
        name: "other-sizes",
        fault: "The picture's size or format changes in mid-stream: transport streams joined, JPEGs of all sizes, joined sources",
        unit: "streams",
        times: false,
        tracers: None,
        run: files::other_sizes,
    },
    Attack {
        name: "small-pools",
        fault: "Upstream has a fixed pool of 1 to 8 buffers; lookahead 0 to 8",
        unit: "streams",
        times: false,
        tracers: None,
        run: pools::fixed,
    },
    Attack {
        name: "raw-sinks",
        fault: "Sinks that write bytes (`filesink`, `fdsink`, `appsink`, `shmsink`) after decoders that pad: the bytes are those of `identity` where nothing is corrected, as many everywhere",
        unit: "streams",
        times: false,
        tracers: None,
        run: sinks::raw,
    },
    Attack {
        name: "slow-sinks",
        fault: "Sinks slower than the film, sinks with random delays; quality of service on",
        unit: "streams",
        times: false,
        tracers: None,
        run: sinks::slow,
    },
    Attack {
        name: "seeks",
        fault: "Accurate seeks to random times, paused and playing: the right frames, by number",
        unit: "seeks",
        times: false,
        tracers: None,
        run: seeks::random,
    },
    Attack {
        name: "playback",
        fault: "Reverse, fast, slow, looped and paused playback: the right frames, by number",
        unit: "films",
        times: false,
        tracers: None,
        run: seeks::playback,
    },
    Attack {
        name: "restarts",
        fault: "Stopped in mid-stream and started again; memory, threads and file descriptors stay level",
        unit: "starts",
        times: false,
        tracers: None,
        run: endurance::restarts,
    },
    Attack {
        name: "long-film",
        fault: "One film of 10,000 frames; memory, threads and file descriptors stay level",
        unit: "films",
        times: false,
        tracers: None,
        run: endurance::long_film,
    },
    Attack {
        name: "many-elements",
        fault: "64 elements at a time in one process",
        unit: "elements",
        times: false,
        tracers: None,
        run: endurance::many_elements,
    },
    Attack {
        name: "leaks",
        fault: "GStreamer's leak tracer over random sequences",
        unit: "sequences",
        times: false,
        tracers: Some("leaks"),
        run: leaks::traced,
    },
    Attack {
        name: "live",
        fault: "Live sources whose caps tell no frame rate or a false one, VP8 over RTP with a jitter buffer of 20 ms; at most 3 frames dropped by the sink",
        unit: "streams",
        times: true,
        tracers: None,
        run: live::sources,
    },
];

/// The attack of a name.
pub fn find(name: &str) -> anyhow::Result<&'static Attack> {
    let attack = ATTACKS.iter().find(|attack| attack.name == name);
    attack.ok_or_else(|| anyhow::anyhow!("no attack named {name}"))
}
