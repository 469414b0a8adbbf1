// SPDX-License-Identifier: MIT OR Apache-2.0

//! Whether the pipeline keeps up with the work, judged by how late the sink says that frames are.
//!
//! A sink reports the lateness of each frame (QoS events). What it tolerates is not known, but lateness
//! that grows from frame to frame exceeds any tolerance in the end: then frames take longer than the
//! interval between them, and the work stops until there is time for it again. Lateness that stays
//! as it is means, in a live pipeline, that more latency must be reported.
//!
//! All times are in nanoseconds; nothing here depends on GStreamer.

/// Frames over which the correction fades out and in.
const FADE: u32 = 6;
/// Frames whose lateness is looked at. With fewer, a burst of other work on the machine looks like overload.
const HISTORY: usize = 12;
/// Lateness that every sink tolerates: `max-lateness` of video sinks (GStreamer's default).
const TOLERATED: i64 = 5_000_000;
/// Overload: the mean of what a frame adds to the lateness is more than this share of the frame interval, and
/// more than so many of its standard errors (Student's t with 10 degrees of freedom: once in 400 by chance).
const GROWTH: f64 = 0.01;
const SIGNIFICANT: f64 = 3.6;
/// Overload as well: still growing when this many frame intervals late.
const BACKLOG: u64 = 8;
/// Time without work after overload, if frames then come early by more than the work takes; doubles each time
/// overload returns soon after.
const FIRST_PAUSE: u64 = 1_000_000_000;
const LONGEST_PAUSE: u64 = 8_000_000_000;
/// Otherwise the work is tried again after this many times the pause: what slowed it down may be over.
const PATIENCE: u64 = 16;
/// Weight of the newest frame in the mean time that a frame takes.
const NEWEST: f64 = 0.125;

/// What is done with a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Effort {
    /// It is analysed and rectified; this share of the correction is applied.
    Full(f64),
    /// It goes out as it came.
    None,
}

/// What a report of lateness changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finding {
    /// Nothing.
    Fine,
    /// Work stops until there is time for it.
    Overload,
    /// Frames come late by about so much, steadily.
    Behind(u64),
}

/// The work that is done, from reports of lateness and measured work.
#[derive(Clone, Debug, Default)]
pub struct Load {
    /// Lateness of the last frames, the oldest first; negative: early.
    lateness: Vec<i64>,
    /// Running time of the frame reported last.
    reported: Option<u64>,
    /// Mean time that the work on a frame takes.
    work: f64,
    /// Nominal time from frame to frame.
    interval: u64,
    paused: Option<Pause>,
    /// When work was resumed last.
    resumed: Option<u64>,
    /// Length of the last pause.
    pause: u64,
    /// Frames of the fade that are over: 0 outside pauses, `FADE` once nothing is corrected.
    faded: u32,
}

/// A time without work.
#[derive(Clone, Copy, Debug)]
struct Pause {
    /// Running time of its first frame; not known until one comes.
    since: Option<u64>,
}

impl Load {
    /// Sets the nominal time from frame to frame.
    pub fn set_interval(&mut self, interval: u64) {
        self.interval = interval;
    }

    /// Takes in the time that the work on a frame took.
    pub fn count_work(&mut self, time: u64) {
        let time = time as f64;
        self.work = if self.work == 0.0 { time } else { self.work + NEWEST * (time - self.work) };
    }

    /// The mean time that the work on a frame takes.
    pub fn work(&self) -> u64 {
        self.work as u64
    }

    /// Lateness of the frame reported last; negative: early.
    pub fn lateness(&self) -> i64 {
        self.lateness.last().copied().unwrap_or(0)
    }

    /// Forgets what was reported: another segment begins, or the stream was flushed.
    pub fn interrupt(&mut self) {
        self.lateness.clear();
        self.reported = None;
        // Its end is counted in the running time of a stretch that is over.
        if let Some(pause) = &mut self.paused {
            pause.since = None;
        }
        self.resumed = None;
    }

    /// Takes in how late (negative: early) the sink got the frame of a running time.
    pub fn note(&mut self, running: u64, lateness: i64) -> Finding {
        // A frame may be reported more than once.
        if self.reported == Some(running) {
            return Finding::Fine;
        }
        self.reported = Some(running);
        if self.lateness.len() == HISTORY {
            self.lateness.remove(0);
        }
        self.lateness.push(lateness);
        if self.paused.is_some() || self.lateness.len() < HISTORY {
            return Finding::Fine;
        }
        let late = self.lateness[HISTORY / 2..].iter().all(|&late| late > TOLERATED);
        if !late {
            return Finding::Fine;
        }
        if self.is_growing() {
            self.stop(running);
            return Finding::Overload;
        }
        // The work is answerable for no more than it takes.
        let least = self.lateness.iter().copied().min().unwrap_or(0);
        match u64::try_from(least) {
            Ok(least) if least > TOLERATED as u64 && self.work() > TOLERATED as u64 => {
                self.lateness.clear();
                Finding::Behind(least.min(self.work()))
            }
            _ => Finding::Fine,
        }
    }

    /// What is to be done with the next frame.
    pub fn next(&mut self, running: Option<u64>) -> Effort {
        if self.ends_pause(running) {
            self.paused = None;
            self.resumed = running;
            self.lateness.clear();
        }
        self.faded = match self.paused {
            Some(_) => (self.faded + 1).min(FADE),
            None => self.faded.saturating_sub(1),
        };
        match self.faded {
            FADE => Effort::None,
            faded => Effort::Full(1.0 - f64::from(faded) / f64::from(FADE)),
        }
    }

    /// Whether the lateness grows from frame to frame, not by chance.
    fn is_growing(&self) -> bool {
        let steps = || self.lateness.windows(2).map(|pair| (pair[1] - pair[0]) as f64);
        let count = steps().count().max(2) as f64;
        let mean = steps().sum::<f64>() / count;
        let variance = steps().map(|step| (step - mean).powi(2)).sum::<f64>() / (count - 1.0);
        let is_significant = mean > SIGNIFICANT * (variance / count).sqrt();
        let backlog = (BACKLOG * self.interval) as i64;
        let is_far_behind = self.lateness.iter().all(|&late| late > backlog);
        mean > GROWTH * self.interval as f64 && (is_significant || is_far_behind)
    }

    /// Begins a pause; a longer one if the last try did not last longer than the pause before it.
    fn stop(&mut self, running: u64) {
        let lasted = self.resumed.map(|resumed| running.saturating_sub(resumed));
        self.pause = match lasted {
            Some(lasted) if lasted <= 2 * self.pause => (2 * self.pause).min(LONGEST_PAUSE),
            _ => FIRST_PAUSE,
        };
        self.paused = Some(Pause { since: None });
        self.lateness.clear();
    }

    /// Whether the pause has lasted long enough.
    fn ends_pause(&mut self, running: Option<u64>) -> bool {
        let (Some(pause), Some(running)) = (&mut self.paused, running) else { return false };
        let lasted = running.saturating_sub(*pause.since.get_or_insert(running));
        // A sink that no longer reports anything is no longer late.
        let is_silent = self.reported.is_none_or(|reported| reported + self.pause < running);
        let work = self.work as i64;
        let has_time = self.lateness.len() == HISTORY && self.lateness.iter().all(|&late| -late > work);
        lasted >= self.pause && (is_silent || has_time || lasted >= PATIENCE * self.pause)
    }
}

#[cfg(test)]
#[path = "load_tests.rs"]
mod tests;
