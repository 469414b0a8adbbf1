// SPDX-License-Identifier: MIT OR Apache-2.0

//! Pipelines that are played while what arrives at their sink is written down.

use gst::prelude::*;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Long enough for any single film, on a machine that does other things too.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A frame as it arrived at the sink.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// Its time.
    pub pts: Option<gst::ClockTime>,
    /// The number that it shows, where it is one of [`super::numbered`].
    pub number: Option<usize>,
}

#[derive(Default)]
struct Seen {
    arrivals: Vec<Arrival>,
    /// Ends of the stream or of segments.
    ends: usize,
}

/// A pipeline with a sink named `sink`.
pub struct Player {
    /// The pipeline.
    pub pipeline: gst::Pipeline,
    seen: Arc<(Mutex<Seen>, Condvar)>,
}

/// How playing ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// With the end of the stream.
    Eos,
    /// With an error and no end of the stream.
    Error,
    /// Not at all within the time given.
    Hung,
}

fn lock(seen: &(Mutex<Seen>, Condvar)) -> MutexGuard<'_, Seen> {
    seen.0.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Player {
    /// The pipeline of a description.
    pub fn new(description: &str) -> anyhow::Result<Self> {
        let pipeline = gst::parse::launch(description)?
            .downcast::<gst::Pipeline>()
            .map_err(|_| anyhow::anyhow!("no pipeline: {description}"))?;
        let seen = Arc::<(Mutex<Seen>, Condvar)>::default();
        let sink = pipeline.by_name("sink").and_then(|sink| sink.static_pad("sink"));
        let sink = sink.ok_or_else(|| anyhow::anyhow!("no sink: {description}"))?;
        let kinds =
            gst::PadProbeType::BUFFER | gst::PadProbeType::EVENT_DOWNSTREAM | gst::PadProbeType::EVENT_FLUSH;
        let notes = seen.clone();
        sink.add_probe(kinds, move |pad, info| {
            let mut seen = lock(&notes);
            match &info.data {
                Some(gst::PadProbeData::Buffer(buffer)) => {
                    let number = super::numbered::number(pad, buffer);
                    seen.arrivals.push(Arrival { pts: buffer.pts(), number });
                }
                Some(gst::PadProbeData::Event(event)) => match event.type_() {
                    gst::EventType::Eos | gst::EventType::SegmentDone => seen.ends += 1,
                    gst::EventType::FlushStop => *seen = Seen::default(),
                    _ => (),
                },
                _ => (),
            }
            notes.1.notify_all();
            gst::PadProbeReturn::Ok
        });
        // Decoders with threads of their own answer damage with this or that number of frames.
        pipeline.connect_deep_element_added(|_, _, element| {
            if element.has_property("max-threads") {
                element.set_property_from_str("max-threads", "1");
            }
        });
        Ok(Self { pipeline, seen })
    }

    /// Goes to a state and waits until it is reached.
    pub fn go_to(&self, state: gst::State, limit: Duration) -> bool {
        self.pipeline.set_state(state).is_ok() && self.settled(limit)
    }

    /// Waits until a change of state has ended.
    pub fn settled(&self, limit: Duration) -> bool {
        let limit = gst::ClockTime::from_nseconds(limit.as_nanos() as u64);
        self.pipeline.state(limit).0.is_ok()
    }

    /// What has arrived since the last flush.
    pub fn arrivals(&self) -> Vec<Arrival> {
        lock(&self.seen).arrivals.clone()
    }

    /// Waits until so many frames have arrived, or the stream has ended.
    pub fn wait_for_frames(&self, count: usize, limit: Duration) -> bool {
        self.wait_until(limit, |seen| seen.arrivals.len() >= count || seen.ends > 0)
    }

    /// Waits until the stream or segments of it have ended so many times.
    pub fn wait_for_ends(&self, count: usize, limit: Duration) -> bool {
        self.wait_until(limit, |seen| seen.ends >= count)
    }

    fn wait_until(&self, limit: Duration, done: impl Fn(&Seen) -> bool) -> bool {
        let end = Instant::now() + limit;
        let mut seen = lock(&self.seen);
        while !done(&seen) {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            seen = self.seen.1.wait_timeout(seen, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }

    /// Waits for the end of the stream at the sink; after an error for a short time only.
    pub fn wait_for_end(&self, limit: Duration) -> End {
        let end = Instant::now() + limit;
        while Instant::now() < end {
            if self.wait_until(Duration::from_millis(50), |seen| seen.ends > 0) {
                return End::Eos;
            }
            if self.error().is_some() {
                let ended = self.wait_until(Duration::from_secs(1), |seen| seen.ends > 0);
                return if ended { End::Eos } else { End::Error };
            }
        }
        End::Hung
    }

    /// An error that was posted.
    pub fn error(&self) -> Option<String> {
        let message = self.pipeline.bus()?.pop_filtered(&[gst::MessageType::Error])?;
        let gst::MessageView::Error(error) = message.view() else { return None };
        Some(format!("{}: {} ({:?})", message.src()?.path_string(), error.error(), error.debug()))
    }

    /// Plays from the start to the end; what has arrived.
    pub fn play(&self, limit: Duration) -> (End, Vec<Arrival>) {
        if self.pipeline.set_state(gst::State::Playing).is_err() {
            return (End::Error, self.arrivals());
        }
        let end = self.wait_for_end(limit);
        (end, self.arrivals())
    }

    /// Plays from the start until the sink itself has told the end: one that writes has written all by then, whereas
    /// the end of the stream may have arrived at it with its last bytes still in memory.
    pub fn write_out(&self, limit: Duration) -> anyhow::Result<()> {
        self.pipeline.set_state(gst::State::Playing)?;
        let limit = gst::ClockTime::from_nseconds(limit.as_nanos() as u64);
        let bus = self.pipeline.bus().ok_or_else(|| anyhow::anyhow!("no bus"))?;
        let message = bus.timed_pop_filtered(limit, &[gst::MessageType::Eos, gst::MessageType::Error]);
        match message.as_ref().map(|message| message.view()) {
            Some(gst::MessageView::Eos(_)) => Ok(()),
            Some(gst::MessageView::Error(error)) => {
                anyhow::bail!("{} ({:?})", error.error(), error.debug())
            }
            _ => anyhow::bail!("no end"),
        }
    }
}

impl Drop for Player {
    fn drop(&mut self) {
        let _ = self.pipeline.set_state(gst::State::Null);
    }
}
