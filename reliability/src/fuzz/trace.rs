// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the threads of a sequence did last, and the alarm that rings when they do nothing any more.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

/// Lines that are kept.
const KEPT: usize = 400;

/// The last steps of a sequence, by all its threads.
#[derive(Debug, Default)]
pub struct Trace {
    seed: u64,
    lines: Mutex<VecDeque<String>>,
    steps: AtomicU64,
}

impl Trace {
    /// An empty trace, watched for standstill.
    pub fn watched(seed: u64) -> Arc<Self> {
        let trace = Arc::new(Self { seed, ..Self::default() });
        *WATCHED.lock().unwrap_or_else(PoisonError::into_inner) = Arc::downgrade(&trace);
        trace
    }

    /// Notes a step.
    pub fn step(&self, line: impl Into<String>) {
        let thread = std::thread::current();
        let line = format!("{}: {}", thread.name().unwrap_or("element"), line.into());
        let mut lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        if lines.len() == KEPT {
            lines.pop_front();
        }
        lines.push_back(line);
        self.steps.fetch_add(1, Ordering::Relaxed);
    }

    /// The last steps, one a line.
    pub fn text(&self) -> String {
        let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        lines.iter().map(|line| format!("  {line}\n")).collect()
    }
}

static WATCHED: Mutex<Weak<Trace>> = Mutex::new(Weak::new());

/// Exit status of a process whose sequence stands still.
pub const HUNG: i32 = 86;

/// Ends the process with [`HUNG`] when the sequence that runs takes no step for `patience`.
pub fn watch(patience: Duration) {
    static ONCE: std::sync::Once = std::sync::Once::new();
    ONCE.call_once(|| {
        std::thread::spawn(move || {
            let mut last = (0, 0);
            let mut since = Instant::now();
            loop {
                std::thread::sleep(Duration::from_millis(200));
                let trace = WATCHED.lock().unwrap_or_else(PoisonError::into_inner).upgrade();
                let Some(trace) = trace else {
                    since = Instant::now();
                    continue;
                };
                let now = (trace.seed, trace.steps.load(Ordering::Relaxed));
                if now != last {
                    (last, since) = (now, Instant::now());
                } else if since.elapsed() > patience {
                    eprintln!("sequence {} hangs; its last steps:\n{}", trace.seed, trace.text());
                    std::process::exit(HUNG);
                }
            }
        });
    });
}
