// SPDX-License-Identifier: MIT OR Apache-2.0

//! Objects of GStreamer that nobody gives back, as its own tracer sees them.

use super::effort::Effort;
use crate::fuzz;
use crate::outcome::Outcome;
use gst::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Random sequences under the leak tracer.
pub fn traced(effort: Effort) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let tracer = gst::active_tracers().into_iter().find(|tracer| tracer.type_().name() == "GstLeaksTracer");
    let tracer =
        tracer.ok_or_else(|| anyhow::anyhow!("this GStreamer has no leak tracer, or it is not on"))?;
    // The tracer writes what is alive into GStreamer's log.
    let category = gst::DebugCategory::get("GST_TRACER").ok_or_else(|| anyhow::anyhow!("no tracer log"))?;
    category.set_threshold(gst::DebugLevel::Trace);
    gst::log::remove_default_log_function();
    let lines = Arc::new(AtomicU64::new(0));
    let count = lines.clone();
    gst::log::add_log_function(move |_, _, _, _, _, _, message| {
        let alive = message.get().is_some_and(|text| text.starts_with("object-alive"));
        count.fetch_add(u64::from(alive), Ordering::SeqCst);
    });
    let alive = || {
        lines.store(0, Ordering::SeqCst);
        tracer.emit_by_name::<()>("log-live-objects", &[]);
        lines.load(Ordering::SeqCst)
    };
    // What is made once for the process is made by the first sequences.
    let warm = 20;
    let mut before = 0;
    for seed in 0..effort.pick(60, 1000) {
        if seed == warm {
            before = alive();
        }
        fuzz::run(seed)?;
        outcome.tried += 1;
    }
    let now = alive();
    if now > before || now == 0 {
        outcome.fault(format!("{before} objects alive became {now}"));
    }
    Ok(outcome)
}
