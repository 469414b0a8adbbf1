// SPDX-License-Identifier: MIT OR Apache-2.0

//! How far a run is, and where its time went.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::fmt;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// A bar on the terminal (none where the standard error is no terminal) and the time of each stage.
pub struct Progress {
    bar: ProgressBar,
    stages: Vec<(&'static str, Duration)>,
}

impl Progress {
    /// Of a run of so many steps.
    pub fn new(steps: usize) -> Self {
        let bar = ProgressBar::new(steps as u64);
        if !std::io::stderr().is_terminal() {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} {msg}, {eta} to go") {
            bar.set_style(style);
        }
        Self { bar, stages: Vec::new() }
    }

    /// Says what is being worked on.
    pub fn at(&self, what: &str) {
        self.bar.set_message(what.to_owned());
        self.bar.tick();
    }

    /// A step is done.
    pub fn step(&self) {
        self.bar.inc(1);
    }

    /// Does some work and counts its time for a stage.
    pub fn time<T>(&mut self, stage: &'static str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let done = work();
        self.add(stage, start.elapsed());
        done
    }

    fn add(&mut self, stage: &'static str, time: Duration) {
        match self.stages.iter_mut().find(|(name, _)| *name == stage) {
            Some((_, total)) => *total += time,
            None => self.stages.push((stage, time)),
        }
    }
}

/// The time of each stage, a line each, and of all.
impl fmt::Display for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (name, time) in &self.stages {
            writeln!(f, "{name:<18} {:>7.1} s", time.as_secs_f64())?;
        }
        let total: Duration = self.stages.iter().map(|(_, time)| *time).sum();
        write!(f, "{:<18} {:>7.1} s", "in all", total.as_secs_f64())
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
