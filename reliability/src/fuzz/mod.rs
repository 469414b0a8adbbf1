// SPDX-License-Identifier: MIT OR Apache-2.0

//! Random sequences of all that can happen to the element.
//!
//! A sequence follows from its seed. One thread streams: caps, frames good and bad, events, queries.
//! Up to three others disturb: seeks, flushes, property writes, stops and starts, quality-of-service
//! events, queries. Downstream waits, refuses, keeps frames and calls back. Each frame and each serialised
//! event has a number, so that at the end it is known whether all came out, once, in order, unchanged
//! and not after a flush that should have dropped them. Sequences without disturbing threads are the
//! same each time they are run.

mod control;
mod frames;
mod ledger;
mod setup;
mod stage;
mod stream;
mod trace;

pub use ledger::Tally;
pub use trace::{HUNG, watch};

/// How long a sequence may stand still before it counts as hung: far longer than any single step takes,
/// even on a machine with other work.
pub const PATIENCE: Duration = Duration::from_secs(60);

use gst::glib;
use gst::prelude::*;
use rand::RngExt;
use std::sync::atomic::Ordering;
use std::sync::{Mutex, Once, PoisonError};
use std::time::Duration;

/// How a sequence went.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct Verdict {
    /// The sequence's number.
    pub seed: u64,
    /// Whether nothing disturbed the streaming thread from outside, so that it is the same each time.
    pub repeatable: bool,
    /// Frames, and what became of them.
    pub tally: Tally,
    /// What was wrong; nothing, it is hoped.
    pub faults: Vec<String>,
    /// The last steps.
    pub trace: String,
}

/// What GLib has complained of.
static COMPLAINTS: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// Initialises GStreamer, registers the element and lets no complaint of GLib go unnoticed.
pub fn init() -> anyhow::Result<()> {
    static ONCE: Once = Once::new();
    gst::init()?;
    let mut registered = Ok(());
    ONCE.call_once(|| {
        // This build of the element, whatever plugin is installed.
        registered = gstrsrectify::plugin_register_static();
        glib::log_set_default_handler(|domain, level, text| {
            if matches!(level, glib::LogLevel::Error | glib::LogLevel::Critical | glib::LogLevel::Warning) {
                let mut complaints = COMPLAINTS.lock().unwrap_or_else(PoisonError::into_inner);
                complaints.push(format!("{}: {text}", domain.unwrap_or("GLib")));
            }
        });
    });
    Ok(registered?)
}

/// What GLib has complained of since this was last asked.
pub fn complaints() -> Vec<String> {
    std::mem::take(&mut COMPLAINTS.lock().unwrap_or_else(PoisonError::into_inner))
}

/// Runs one sequence.
pub fn run(seed: u64) -> anyhow::Result<Verdict> {
    init()?;
    let stage = stage::Stage::new(setup::Setup::new(seed), control::call)?;
    std::thread::scope(|scope| -> std::io::Result<()> {
        let stage = &*stage;
        for disturber in 0..stage.setup.disturbers {
            let work = move || {
                let mut rng = setup::rng(seed, 10 + disturber as u64);
                while !stage.done.load(Ordering::SeqCst) {
                    control::disturb(stage, &mut rng);
                    std::thread::sleep(Duration::from_micros(rng.random_range(0..2000)));
                }
            };
            std::thread::Builder::new().name(format!("disturber {disturber}")).spawn_scoped(scope, work)?;
        }
        let streaming = std::thread::Builder::new().name("streaming".into());
        let play = streaming.spawn_scoped(scope, || {
            stream::play(stage);
            stage.done.store(true, Ordering::SeqCst);
        })?;
        let _ = play.join();
        Ok(())
    })?;
    stream::finish(&stage);
    let repeatable = stage.setup.disturbers == 0;
    let trace = stage.trace.clone();
    let alive = stage.alive.clone();
    let (tally, mut faults) = stage.ledger.close();
    let left = stop(stage);
    faults.extend(left);
    faults.extend(complaints().into_iter().map(|text| format!("GLib complains: {text}")));
    match alive.load(Ordering::SeqCst) {
        0 => (),
        left => faults.push(format!("the memories of {left} frames are never given back")),
    }
    Ok(Verdict { seed, repeatable, tally, faults, trace: trace.text() })
}

/// Takes the stage apart; what is left of it.
fn stop(stage: std::sync::Arc<stage::Stage>) -> Vec<String> {
    let mut faults = Vec::new();
    if stage.element.set_state(gst::State::Null).is_err() {
        faults.push("cannot stop".to_owned());
    }
    let _ = stage.upstream.set_active(false);
    let _ = stage.downstream.set_active(false);
    if let Some(sink) = stage.element.static_pad("sink") {
        let _ = stage.upstream.unlink(&sink);
    }
    if let Some(source) = stage.element.static_pad("src") {
        let _ = source.unlink(&stage.downstream);
    }
    stage.element.set_bus(None);
    stage.bus.unset_sync_handler();
    let element = stage.element.downgrade();
    let pads = [stage.upstream.downgrade(), stage.downstream.downgrade()];
    let bus = stage.bus.downgrade();
    drop(stage);
    if element.upgrade().is_some() {
        faults.push("the element lives on".to_owned());
    }
    if pads.iter().any(|pad| pad.upgrade().is_some()) || bus.upgrade().is_some() {
        faults.push("a pad or the bus lives on".to_owned());
    }
    faults
}
