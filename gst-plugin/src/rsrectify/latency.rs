// SPDX-License-Identifier: MIT OR Apache-2.0

//! The latency that the element reports, and how long it may hold a frame.
//!
//! All times are in nanoseconds; nothing here depends on GStreamer.

use super::interval::FrameInterval;

/// A frame may stay this much longer than was reported before it is given out with what is known, so that
/// the frame that it waits for can be a little late itself. Video sinks tolerate as much.
const GRACE: u64 = 5_000_000;

/// A latency: frames that are waited for, and the work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Parts {
    wait: u64,
    work: u64,
}

impl Parts {
    fn sum(self) -> u64 {
        self.wait.saturating_add(self.work)
    }
}

/// What the pipeline was set to.
#[derive(Clone, Copy, Debug)]
struct Grant {
    /// What the element had asked for.
    asked: Parts,
    /// From the source to the sink, all elements together.
    total: u64,
}

/// The latency of a stream.
#[derive(Clone, Debug)]
pub struct Latency {
    /// Frames that are waited for.
    frames: u64,
    /// The frame rate of the caps, as a fraction.
    rate: Option<(u64, u64)>,
    interval: FrameInterval,
    /// Time reserved for the work on a frame.
    work: u64,
    /// Whether the source is live, and the least latency up to here.
    live: bool,
    upstream: u64,
    /// What was answered last, and what the pipeline was then set to.
    answered: Parts,
    granted: Option<Grant>,
}

impl Latency {
    /// The latency of waiting for `frames` frames at a rate, and of `work` nanoseconds of work.
    pub fn new(frames: u64, rate: Option<(u64, u64)>, work: u64) -> Self {
        let rate = rate.filter(|&(num, den)| num > 0 && den > 0);
        let nominal = rate.map(|(num, den)| {
            u64::try_from(u128::from(den) * 1_000_000_000 / u128::from(num)).unwrap_or(u64::MAX)
        });
        Self {
            frames,
            rate,
            interval: FrameInterval::new(nominal),
            work,
            live: false,
            upstream: 0,
            answered: Parts::default(),
            granted: None,
        }
    }

    /// The latency of another stream in the same pipeline.
    pub fn renewed(&self, frames: u64, rate: Option<(u64, u64)>, work: u64) -> Self {
        let Self { live, upstream, answered, granted, .. } = *self;
        Self { live, upstream, answered, granted, ..Self::new(frames, rate, work) }
    }

    /// The element's own latency.
    pub fn own(&self) -> u64 {
        self.parts().sum()
    }

    /// Time from frame to frame.
    pub fn interval(&self) -> u64 {
        self.interval.in_use()
    }

    /// Whether the source is live, as far as is known.
    pub fn is_live(&self) -> bool {
        self.live
    }

    /// Answers a query for the latency, given what upstream answered; the element's own.
    pub fn answer(&mut self, live: bool, upstream: u64) -> u64 {
        self.live = live;
        self.upstream = upstream;
        self.answered = self.parts();
        self.answered.sum()
    }

    /// The pipeline was set to a latency, from the source to the sink, after the last answer.
    pub fn grant(&mut self, total: u64) {
        self.granted = Some(Grant { asked: self.answered, total });
    }

    /// Takes in a frame's timestamp; whether the latency has grown.
    pub fn note_frame(&mut self, time: Option<u64>) -> bool {
        self.interval.note(time) && self.frames > 0
    }

    /// The next frame does not follow the last one.
    pub fn interrupt(&mut self) {
        self.interval.interrupt();
    }

    /// Reserves more time for the work; whether the latency has grown.
    pub fn add_work(&mut self, more: u64) -> bool {
        self.work = self.work.saturating_add(more);
        more > 0
    }

    /// Running time until which a frame may be held; `None` where nobody waits for it.
    pub fn deadline(&self, running: u64) -> Option<u64> {
        let asked = self.granted.map_or(self.answered, |grant| grant.asked);
        let held = self.upstream.saturating_add(asked.wait).saturating_add(GRACE);
        let held = self.shortened().map_or(held, |shortened| shortened.min(held));
        (self.live && self.frames > 0).then(|| running.saturating_add(held))
    }

    /// Frames that may be waited for; `None`: all that it takes.
    ///
    /// Where less was granted than was asked for, a frame goes out as soon as those have come that can come in time, not
    /// only when its time is over.
    pub fn frames_in_time(&self) -> Option<u64> {
        let held = self.shortened().filter(|_| self.live)?;
        Some(held.saturating_sub(self.upstream) / self.interval().max(1))
    }

    /// Time after its timestamp for which a frame may be held where less was granted than was asked for.
    ///
    /// An interval is kept for the work: that on the frame which has just come may take so long where the machine keeps up,
    /// and it is not interrupted.
    fn shortened(&self) -> Option<u64> {
        let grant = self.granted?;
        let reserve = self.interval().saturating_add(self.work);
        let is_less = grant.total < self.upstream.saturating_add(grant.asked.sum());
        is_less.then(|| grant.total.saturating_sub(reserve))
    }

    fn parts(&self) -> Parts {
        Parts { wait: self.interval.latency(self.frames, self.rate), work: self.work }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn latency_is_frames_times_interval_plus_work() {
        assert_eq!(Latency::new(3, Some((30_000, 1001)), 0).own(), 100_100_000);
        assert_eq!(Latency::new(4, Some((25, 1)), 7 * MS).own(), 167 * MS);
        assert_eq!(Latency::new(0, None, 7 * MS).own(), 7 * MS);
        assert_eq!(Latency::new(3, None, 0).own(), 100_000_002, "30 frames a second assumed");
        assert_eq!(Latency::new(3, Some((0, 1)), 0).own(), 100_000_002);
        assert_eq!(Latency::new(64, Some((1, u64::MAX)), 1).own(), u64::MAX);
    }

    #[test]
    fn a_frame_is_held_as_long_as_the_pipeline_was_told() {
        let mut latency = Latency::new(4, Some((25, 1)), 10 * MS);
        assert_eq!(latency.deadline(0), None, "not known to be live");
        assert_eq!(latency.answer(true, 30 * MS), 170 * MS);
        assert_eq!(
            latency.deadline(MS),
            Some((1 + 30 + 160 + 5) * MS),
            "the time for the work is not spent waiting"
        );
        latency.grant(200 * MS);
        // Frames come every 80 ms: more is asked for, but the pipeline is not set to it yet.
        let grown = (0..20).filter(|k| latency.note_frame(Some(80 * MS * k))).count();
        assert_eq!((grown, latency.own()), (1, 330 * MS));
        assert_eq!(latency.deadline(0), Some(195 * MS));
        assert_eq!(latency.answer(true, 30 * MS), 330 * MS);
        assert_eq!(latency.deadline(0), Some(195 * MS), "an answer alone changes nothing");
        latency.grant(360 * MS);
        assert_eq!(latency.deadline(0), Some(355 * MS));
        assert_eq!(latency.answer(false, 0), 330 * MS);
        assert_eq!(latency.deadline(0), None);
    }

    #[test]
    fn a_frame_is_held_for_no_longer_than_was_granted() {
        let mut latency = Latency::new(4, Some((25, 1)), 10 * MS);
        latency.answer(true, 30 * MS);
        latency.grant(200 * MS);
        assert_eq!((latency.deadline(0), latency.frames_in_time()), (Some(195 * MS), None), "all of it");
        // 10 ms and an interval are kept for the work.
        for (total, held, frames) in
            [(199, 149, 2), (150, 100, 1), (120, 70, 1), (119, 69, 0), (20, 0, 0), (0, 0, 0)]
        {
            latency.grant(total * MS);
            assert_eq!(latency.deadline(MS), Some((1 + held) * MS), "{total} ms");
            assert_eq!(latency.frames_in_time(), Some(frames), "{total} ms");
        }
        latency.add_work(20 * MS);
        latency.grant(150 * MS);
        assert_eq!((latency.deadline(0), latency.frames_in_time()), (Some(80 * MS), Some(1)));
        latency.answer(false, 0);
        assert_eq!((latency.deadline(0), latency.frames_in_time()), (None, None));
    }

    #[test]
    fn without_frames_to_wait_for_there_is_no_deadline() {
        let mut latency = Latency::new(0, None, 0);
        latency.answer(true, 0);
        assert_eq!(latency.deadline(0), None);
        assert!((0..20).all(|k| !latency.note_frame(Some(80 * MS * k))));
    }
}
