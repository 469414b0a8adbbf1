// SPDX-License-Identifier: MIT OR Apache-2.0

//! The element between two pads of our own: an upstream that can do anything, and a downstream that
//! checks all it gets.

use super::frames::Timing;
use super::ledger::Ledger;
use super::setup::{self, Setup};
use super::trace::Trace;
use gst::prelude::*;
use gst_video::VideoInfo;
use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicIsize, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

/// Part of what GStreamer's Rust bindings say of a panic.
pub const PANIC: &str = "anicked";

/// What upstream has told the element; held while it pushes.
#[derive(Debug)]
pub struct Flow {
    /// Whether the stream has begun.
    pub started: bool,
    /// The caps that the element took.
    pub caps: Option<(gst::Caps, VideoInfo)>,
    /// The segment in force.
    pub segment: Option<gst::Seqnum>,
    /// The segment that a seek asks for: its start.
    pub sought: Option<u64>,
    /// Id of the stream.
    pub stream: String,
    /// Timestamps to come.
    pub timing: Timing,
    /// Whether the element said that strides of any kind are welcome.
    pub strides_welcome: bool,
    /// Whether the stream has ended.
    pub ended: bool,
    /// Whether frames with a defect may still be in the element.
    pub tainted: bool,
}

/// What may be called at any time and from any thread, chosen by random numbers.
pub type Call = fn(&Stage, &mut ChaCha8Rng);

/// A sequence's element and everything around it.
pub struct Stage {
    /// The choices of this sequence.
    pub setup: Setup,
    /// The element.
    pub element: gst::Element,
    /// Where the element posts.
    pub bus: gst::Bus,
    /// What went in and came out.
    pub ledger: Ledger,
    /// What was done.
    pub trace: Arc<Trace>,
    /// The pad that feeds the element.
    pub upstream: gst::Pad,
    /// The pad that the element feeds.
    pub downstream: gst::Pad,
    /// Formats that the element takes.
    pub formats: Vec<String>,
    /// Frames' memories that live.
    pub alive: Arc<AtomicIsize>,
    /// Whether downstream has failed since the streaming thread last looked.
    pub downstream_failed: AtomicBool,
    /// Set when the streaming thread has ended.
    pub done: AtomicBool,
    flow: Mutex<Flow>,
    /// Flushes and stops, one at a time.
    turn: Mutex<()>,
    /// Counts beginnings and ends of flushes and stops: odd while one goes on.
    interruptions: AtomicU64,
    /// The random numbers of downstream.
    rng: Mutex<ChaCha8Rng>,
    /// The random numbers of callbacks; locked while one calls, so that none calls within another.
    calls: Mutex<ChaCha8Rng>,
    /// What an application does to the element within a callback.
    call: Call,
    kept: Mutex<VecDeque<gst::Buffer>>,
    gate: (Mutex<bool>, Condvar),
    /// Texts of the errors posted.
    errors: Mutex<Vec<String>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Stage {
    /// A playing element for a sequence, and what its callbacks do to it.
    pub fn new(setup: Setup, call: Call) -> Result<Arc<Self>, gst::glib::BoolError> {
        let element = gst::ElementFactory::make("rsrectify").build()?;
        let bus = gst::Bus::new();
        element.set_bus(Some(&bus));
        if let Some(played) = setup.clock {
            let clock = gst::SystemClock::obtain();
            element.set_clock(Some(&clock))?;
            element.set_base_time(clock.time().saturating_sub(gst::ClockTime::from_nseconds(played)));
        }
        let stage = Arc::new_cyclic(|stage: &Weak<Self>| Self {
            upstream: upstream_pad(stage),
            downstream: downstream_pad(stage),
            formats: setup::formats(&element),
            ledger: Ledger::default(),
            trace: Trace::watched(setup.seed),
            alive: Arc::default(),
            downstream_failed: AtomicBool::new(false),
            done: AtomicBool::new(false),
            flow: Mutex::new(Flow {
                started: false,
                caps: None,
                segment: None,
                sought: None,
                stream: "stream 0".into(),
                timing: Timing::new(0, 1, false),
                strides_welcome: false,
                ended: false,
                tainted: false,
            }),
            turn: Mutex::default(),
            interruptions: AtomicU64::new(0),
            rng: Mutex::new(setup::rng(setup.seed, 1)),
            calls: Mutex::new(setup::rng(setup.seed, 3)),
            call,
            kept: Mutex::default(),
            gate: Default::default(),
            errors: Mutex::default(),
            element,
            bus,
            setup,
        });
        let weak = Arc::downgrade(&stage);
        stage.bus.set_sync_handler(move |_, message| {
            if let Some(stage) = weak.upgrade() {
                stage.note(message);
            }
            gst::BusSyncReply::Drop
        });
        let pad =
            |name| stage.element.static_pad(name).ok_or_else(|| gst::glib::bool_error!("no pad {name}"));
        stage.upstream.link(&pad("sink")?).map_err(|_| gst::glib::bool_error!("cannot link"))?;
        pad("src")?.link(&stage.downstream).map_err(|_| gst::glib::bool_error!("cannot link"))?;
        stage.upstream.set_active(true)?;
        stage.downstream.set_active(true)?;
        stage.element.set_state(gst::State::Playing).map_err(|_| gst::glib::bool_error!("cannot play"))?;
        Ok(stage)
    }

    /// The right to push.
    pub fn flow(&self) -> MutexGuard<'_, Flow> {
        lock(&self.flow)
    }

    /// To be compared with its value after a push: whether a flush or stop came between.
    pub fn interruptions(&self) -> u64 {
        self.interruptions.load(Ordering::SeqCst)
    }

    /// Whether nothing has come between since `before`.
    pub fn undisturbed(&self, before: u64) -> bool {
        before.is_multiple_of(2) && self.interruptions() == before
    }

    /// Takes over a message of the element.
    fn note(&self, message: &gst::Message) {
        match message.view() {
            gst::MessageView::Error(error) => {
                self.trace.step(format!("error: {}", error.error()));
                lock(&self.errors).push(format!("{} ({:?})", error.error(), error.debug()));
            }
            _ => self.call_back(),
        }
    }

    /// The application calls the element from within one of its callbacks.
    fn call_back(&self) {
        if self.setup.callbacks
            && let Ok(mut rng) = self.calls.try_lock()
        {
            (self.call)(self, &mut rng);
        }
    }

    /// The errors posted so far; starts a new list.
    pub fn take_errors(&self) -> Vec<String> {
        std::mem::take(&mut lock(&self.errors))
    }

    /// Flushes as a seek does: the streaming thread is thrown out of its push and waits.
    pub fn flush(&self, start: u64) {
        let _turn = lock(&self.turn);
        self.interruptions.fetch_add(1, Ordering::SeqCst);
        let seqnum = gst::Seqnum::next();
        self.upstream.push_event(gst::event::FlushStart::builder().seqnum(seqnum).build());
        let mut flow = self.flow();
        self.ledger.end_stretch("a flush");
        self.trace.step("flush stops");
        self.upstream.push_event(gst::event::FlushStop::builder(true).seqnum(seqnum).build());
        flow.segment = None;
        flow.sought = Some(start);
        flow.ended = false;
        self.forget_defects(&mut flow);
        self.interruptions.fetch_add(1, Ordering::SeqCst);
    }

    /// Stops the element, in the middle of whatever it does, and starts it again.
    pub fn restart(&self, state: gst::State) {
        let _turn = lock(&self.turn);
        self.interruptions.fetch_add(1, Ordering::SeqCst);
        self.open_gate(true);
        if self.element.set_state(state).is_err() {
            self.ledger.fault(format!("cannot go to {state:?}"));
        }
        let mut flow = self.flow();
        self.ledger.end_stretch("a stop");
        self.trace.step("starts again");
        self.open_gate(false);
        if self.element.set_state(gst::State::Playing).is_err() {
            self.ledger.fault("cannot play again");
        }
        (flow.started, flow.ended) = (false, false);
        self.forget_defects(&mut flow);
        (flow.caps, flow.segment) = (None, None);
        self.interruptions.fetch_add(1, Ordering::SeqCst);
    }

    /// No frame with a defect is left in the element; the errors so far may have been about one.
    fn forget_defects(&self, flow: &mut Flow) {
        if std::mem::replace(&mut flow.tainted, false) {
            lock(&self.errors).retain(|error| error.contains(PANIC));
        }
    }

    /// Another state of those that leave the stream alone.
    pub fn pause(&self, state: gst::State) {
        let _turn = lock(&self.turn);
        if self.element.set_state(state).is_err() {
            self.ledger.fault(format!("cannot go to {state:?}"));
        }
    }

    fn open_gate(&self, open: bool) {
        *lock(&self.gate.0) = open;
        self.gate.1.notify_all();
    }

    /// Waits until a flush or a stop, but not for ever.
    fn wait_at_gate(&self, most: Duration) {
        let gate = lock(&self.gate.0);
        let _ = self.gate.1.wait_timeout_while(gate, most, |open| !*open);
    }

    fn upstream_event(&self, event: &gst::Event) {
        if let gst::EventView::Seek(seek) = event.view() {
            let (_, flags, _, start, _, _) = seek.get();
            let start = match start {
                gst::GenericFormattedValue::Time(Some(time)) => time.nseconds(),
                _ => 0,
            };
            if flags.contains(gst::SeekFlags::FLUSH) {
                self.flush(start);
            } else {
                self.flow().sought = Some(start);
            }
        }
    }

    fn upstream_query(&self, query: &mut gst::QueryRef) -> Option<bool> {
        match query.view_mut() {
            gst::QueryViewMut::Latency(query) => {
                let Some((live, least, most)) = self.setup.upstream_latency else { return Some(false) };
                query.set(
                    live,
                    gst::ClockTime::from_nseconds(least),
                    most.map(gst::ClockTime::from_nseconds),
                );
                Some(true)
            }
            _ => None,
        }
    }

    fn frame_out(&self, pad: &gst::Pad, buffer: gst::Buffer) -> Result<gst::FlowSuccess, gst::FlowError> {
        self.trace.step(format!("out {}", buffer.offset()));
        self.ledger.frame_arrived(pad, &buffer, self.setup.downstream_takes_meta);
        let mut rng = lock(&self.rng);
        let keeps = match self.setup.downstream_pool {
            0 => self.setup.downstream_keeps,
            pool => self.setup.downstream_keeps.min(pool as usize - 1),
        };
        let mut kept = lock(&self.kept);
        kept.push_back(buffer);
        while kept.len() > keeps {
            kept.pop_front();
        }
        drop(kept);
        let waits = rng.random_bool(self.setup.downstream_waits);
        let most = Duration::from_micros(rng.random_range(0..20_000));
        if rng.random_bool(self.setup.downstream_errors) {
            let errors = [gst::FlowError::Error, gst::FlowError::Eos, gst::FlowError::NotLinked];
            let error = *errors.choose(&mut *rng).unwrap_or(&gst::FlowError::Error);
            self.trace.step(format!("downstream answers {error:?}"));
            self.ledger.excuse_waiting();
            self.downstream_failed.store(true, Ordering::SeqCst);
            return Err(error);
        }
        drop(rng);
        self.call_back();
        if waits {
            self.wait_at_gate(most);
        }
        Ok(gst::FlowSuccess::Ok)
    }

    fn event_out(&self, event: &gst::Event) {
        self.trace.step(format!("out {}", event.type_().name().as_str()));
        match event.view() {
            gst::EventView::FlushStart(_) => self.open_gate(true),
            gst::EventView::FlushStop(_) => self.open_gate(false),
            _ => self.ledger.event_arrived(event),
        }
    }

    /// What downstream takes.
    fn taken(&self) -> gst::Caps {
        let formats = self.formats.iter().filter(|format| {
            !self.setup.downstream_is_choosy || !(format.starts_with('R') || format.starts_with('A'))
        });
        gst_video::VideoCapsBuilder::new()
            .format_list(formats.map(|format| gst_video::VideoFormat::from_string(format)))
            .build()
    }

    fn downstream_query(&self, query: &mut gst::QueryRef) -> bool {
        match query.view_mut() {
            gst::QueryViewMut::Caps(query) => {
                let caps = self.taken();
                let caps = match query.filter() {
                    Some(filter) => filter.intersect_with_mode(&caps, gst::CapsIntersectMode::First),
                    None => caps,
                };
                query.set_result(&caps);
                true
            }
            gst::QueryViewMut::AcceptCaps(query) => {
                let accepted = query.caps().is_subset(&self.taken());
                query.set_result(accepted);
                true
            }
            gst::QueryViewMut::Allocation(query) => {
                let (caps, _) = query.get();
                let info = caps.and_then(|caps| VideoInfo::from_caps(caps).ok());
                if self.setup.downstream_takes_meta {
                    query.add_allocation_meta::<gst_video::VideoMeta>(None);
                }
                if self.setup.downstream_pool > 0
                    && let Some(info) = info
                {
                    let pool = gst_video::VideoBufferPool::new();
                    query.add_allocation_pool(Some(&pool), info.size() as u32, 1, self.setup.downstream_pool);
                }
                true
            }
            _ => false,
        }
    }
}

fn upstream_pad(stage: &Weak<Stage>) -> gst::Pad {
    let (events, queries) = (stage.clone(), stage.clone());
    gst::Pad::builder(gst::PadDirection::Src)
        .name("upstream")
        .event_function(move |_, _, event| {
            if let Some(stage) = events.upgrade() {
                stage.upstream_event(&event);
            }
            true
        })
        .query_function(move |pad, parent, query| {
            let answer = queries.upgrade().and_then(|stage| stage.upstream_query(query));
            answer.unwrap_or_else(|| gst::Pad::query_default(pad, parent, query))
        })
        .build()
}

fn downstream_pad(stage: &Weak<Stage>) -> gst::Pad {
    let (frames, events, queries) = (stage.clone(), stage.clone(), stage.clone());
    gst::Pad::builder(gst::PadDirection::Sink)
        .name("downstream")
        .chain_function(move |pad, _, buffer| match frames.upgrade() {
            Some(stage) => stage.frame_out(pad, buffer),
            None => Err(gst::FlowError::Flushing),
        })
        .event_function(move |_, _, event| {
            if let Some(stage) = events.upgrade() {
                stage.event_out(&event);
            }
            true
        })
        .query_function(move |_, _, query| {
            queries.upgrade().is_some_and(|stage| stage.downstream_query(query))
        })
        .build()
}
