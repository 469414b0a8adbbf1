// SPDX-License-Identifier: MIT OR Apache-2.0

//! The time from frame to frame, which the caps need not tell truly.

/// Assumed where neither caps nor timestamps tell, in nanoseconds: 30 frames a second.
const ASSUMED: u64 = 33_333_334;
/// The median of this many intervals is the measured one: a few dropped or doubled frames do not move it.
const MEMORY: usize = 9;
/// Longer intervals are pauses, not a frame rate, in nanoseconds.
const PAUSE: u64 = 2_000_000_000;
/// The interval in use grows once the measured one exceeds it by a sixteenth: less is jitter of the
/// timestamps, and each growth makes a live pipeline stop for a moment.
const MARGIN: u64 = 16;

/// The interval between frames on which the element's latency is based.
///
/// It starts at the nominal interval of the caps and only grows while a stream plays: a shorter latency
/// would make the frames on their way late.
#[derive(Clone, Debug)]
pub struct FrameInterval {
    nominal: Option<u64>,
    in_use: u64,
    last: Option<u64>,
    recent: [u64; MEMORY],
    seen: usize,
}

impl FrameInterval {
    /// For frames that are nominally `nominal` nanoseconds apart; `None` where the caps do not say.
    pub fn new(nominal: Option<u64>) -> Self {
        Self { nominal, in_use: nominal.unwrap_or(ASSUMED), last: None, recent: [0; MEMORY], seen: 0 }
    }

    /// The interval in nanoseconds.
    pub fn in_use(&self) -> u64 {
        self.in_use
    }

    /// The latency in nanoseconds of a filter that waits for `frames` frames, rounded up.
    ///
    /// `exact` is the nominal interval as a fraction of seconds, used as long as nothing longer was measured.
    pub fn latency(&self, frames: u64, exact: Option<(u64, u64)>) -> u64 {
        match exact {
            Some((num, den)) if num > 0 && self.nominal == Some(self.in_use) => {
                let time = u128::from(frames) * u128::from(den) * 1_000_000_000;
                u64::try_from(time.div_ceil(u128::from(num))).unwrap_or(u64::MAX)
            }
            _ => frames.saturating_mul(self.in_use),
        }
    }

    /// Takes in a frame's timestamp; whether the interval in use has grown.
    pub fn note(&mut self, time: Option<u64>) -> bool {
        let Some(time) = time else { return false };
        let Some(last) = self.last.replace(time) else { return false };
        let interval = time.abs_diff(last);
        if interval == 0 || interval > PAUSE {
            return false;
        }
        self.recent[self.seen % MEMORY] = interval;
        self.seen += 1;
        if self.seen < MEMORY {
            return false;
        }
        let mut sorted = self.recent;
        sorted.sort_unstable();
        let measured = sorted[MEMORY / 2];
        let grows = measured > self.in_use.saturating_add(self.in_use / MARGIN);
        if grows {
            self.in_use = measured;
        }
        grows
    }

    /// The next frame does not follow the last one: a cut, a seek, a gap.
    pub fn interrupt(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    /// Latencies of four frames in milliseconds, one each time the interval grows.
    fn growth(interval: &mut FrameInterval, times: impl Iterator<Item = u64>) -> Vec<u64> {
        let mut latencies = Vec::new();
        for time in times {
            if interval.note(Some(time)) {
                latencies.push(interval.latency(4, None) / MS);
            }
        }
        latencies
    }

    #[test]
    fn without_a_rate_one_is_assumed_and_a_slower_one_learnt() {
        let mut interval = FrameInterval::new(None);
        assert_eq!(interval.latency(3, None), 100_000_002);
        assert_eq!(growth(&mut interval, (0..30).map(|k| 100 * MS * k)), [400]);
        assert_eq!(interval.in_use(), 100 * MS);
    }

    #[test]
    fn a_rate_that_is_not_kept_is_corrected_once() {
        let mut interval = FrameInterval::new(Some(40 * MS));
        assert_eq!(interval.latency(4, Some((25, 1))), 160 * MS);
        // 12.5 frames a second with a jitter of 3 ms.
        let times = (0..60).map(|k| 80 * MS * k + (k * 7 % 4) * MS);
        let grown = growth(&mut interval, times);
        assert_eq!(grown.len(), 1, "{grown:?}");
        assert!((308..=332).contains(&grown[0]), "{grown:?}");
        assert_eq!(interval.latency(4, Some((25, 1))) / MS, grown[0]);
    }

    #[test]
    fn jitter_drops_pauses_and_faster_frames_change_nothing() {
        let mut interval = FrameInterval::new(Some(40 * MS));
        let mut time = 0;
        for k in 0..200 {
            time += match k % 20 {
                3 => 80 * MS,
                11 => 5000 * MS,
                _ => 39 * MS + k % 3 * MS,
            };
            assert!(!interval.note(Some(time)), "{k}");
        }
        (0..40).for_each(|k| assert!(!interval.note(Some(time + 10 * MS * k))));
        assert!(!interval.note(None));
        assert_eq!(interval.latency(3, Some((30_000, 1001))), 100_100_000);
    }

    #[test]
    fn an_interruption_is_no_interval() {
        let mut interval = FrameInterval::new(Some(40 * MS));
        for k in 0..50 {
            interval.interrupt();
            assert!(!interval.note(Some(k * 900 * MS)));
        }
    }
}
