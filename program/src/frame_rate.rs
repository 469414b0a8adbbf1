// SPDX-License-Identifier: MIT OR Apache-2.0

//! Times of frames → the time from one frame to the next, which a file need not state truly.

/// Intervals count that differ from the median by no more than this share of it, which is jitter of timestamps, or by the
/// coarsest clock's tick, a millisecond: longer ones hold frames that were dropped, or were exposed for longer in the dark.
const JITTER: f64 = 1.0 / 16.0;
const TICK: f64 = 1.01e-3;
/// The stated interval is exact where it differs from the timestamps' by less than this share of it: containers round these.
const SAME: f64 = 0.02;
/// Stated intervals that are believed where timestamps are missing, in seconds: containers state the ticks of their clock,
/// 1000 a second and more, where they know no frame rate.
const BELIEVED: std::ops::RangeInclusive<f64> = 0.001_01..=10.0;

/// The time from frame to frame of a clip.
#[derive(Clone, Debug, Default)]
pub struct FrameInterval {
    /// In seconds, by the file.
    stated: Option<f64>,
    /// Of the frames that were seen, in seconds.
    seen: Vec<f64>,
    last: Option<f64>,
}

impl FrameInterval {
    /// Of frames that are so many seconds apart by the file; `None` where it does not state it.
    pub fn new(stated: Option<f64>) -> Self {
        Self { stated, ..Self::default() }
    }

    /// Adds a frame at a time in seconds.
    pub fn add(&mut self, time: Option<f64>) {
        let last = std::mem::replace(&mut self.last, time);
        let interval = time.zip(last).map(|(time, last)| time - last);
        self.seen.extend(interval.filter(|interval| *interval > 0.0));
    }

    /// The next frame does not follow the last one.
    pub fn interrupt(&mut self) {
        self.last = None;
    }

    /// In seconds; `None` where neither timestamps nor file tell.
    pub fn seconds(&self) -> Option<f64> {
        let stated = self.stated.filter(|stated| BELIEVED.contains(stated));
        let Some(seen) = self.of_timestamps() else { return stated };
        Some(stated.filter(|stated| (seen / stated - 1.0).abs() < SAME).unwrap_or(seen))
    }

    /// The mean of the intervals that are about as long as most.
    fn of_timestamps(&self) -> Option<f64> {
        let mut sorted = self.seen.clone();
        sorted.sort_by(f64::total_cmp);
        let median = *sorted.get(sorted.len() / 2)?;
        let reach = TICK.max(JITTER * median);
        let usual = sorted.iter().filter(|interval| (*interval - median).abs() <= reach);
        let (sum, count) = usual.fold((0.0, 0u32), |(sum, count), interval| (sum + interval, count + 1));
        (count > 0).then(|| sum / f64::from(count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn interval(stated: Option<f64>, times: impl IntoIterator<Item = f64>) -> Option<f64> {
        let mut interval = FrameInterval::new(stated);
        times.into_iter().for_each(|time| interval.add(Some(time)));
        interval.seconds()
    }

    #[test]
    fn timestamps_overrule_a_rate_that_is_not_kept() {
        let times = (0..20).map(|k| 0.04 * f64::from(k));
        for stated in [None, Some(1.0 / 90_000.0), Some(1.0 / 30.0), Some(0.0), Some(0.5)] {
            let found = interval(stated, times.clone()).unwrap();
            assert!((found - 0.04).abs() < 1e-12, "{stated:?} {found}");
        }
    }

    #[test]
    fn a_rate_that_is_kept_is_exact() {
        // Milliseconds, as Matroska rounds them.
        let rounded = (0..10).map(|k| (1e3 * f64::from(k) * 1001.0 / 30_000.0).round() * 1e-3);
        assert_eq!(interval(Some(1001.0 / 30_000.0), rounded.clone()), Some(1001.0 / 30_000.0));
        // Without it, the mean is nearer than any one of them.
        assert!((interval(None, rounded).unwrap() - 1001.0 / 30_000.0).abs() < 2e-4);
    }

    #[test]
    fn a_coarse_clock_does_not_shift_a_fast_rate() {
        let rounded = (0..100).map(|k| (1e3 * f64::from(k) / 240.0).round() * 1e-3);
        assert!((interval(None, rounded).unwrap() * 240.0 - 1.0).abs() < 0.01);
    }

    #[test]
    fn longer_exposures_now_and_then_do_not_count() {
        // A phone in the dark: every fourth frame takes 41.7 ms.
        let times = (0..60).map(|k: u32| f64::from(k) / 30.0 + f64::from(k / 4) * 0.008_4);
        assert!((interval(None, times).unwrap() * 30.0 - 1.0).abs() < 1e-9);
    }

    #[test]
    fn dropped_frames_and_pauses_are_no_frame_rate() {
        // Four of five frames, and a pause.
        let times =
            (0..40).filter(|k| k % 5 != 4).map(|k| f64::from(k) * 0.02 + if k > 20 { 7.0 } else { 0.0 });
        let found = interval(None, times).unwrap();
        assert!((found - 0.02).abs() < 1e-9, "{found}");
    }

    #[test]
    fn what_is_stated_counts_without_timestamps() {
        assert_eq!(interval(Some(0.04), [3.0]), Some(0.04));
        assert_eq!(interval(Some(1e-5), [3.0]), None);
        let mut still = FrameInterval::new(None);
        still.add(Some(1.0));
        still.add(None);
        still.add(Some(1.0));
        still.add(Some(1.0));
        assert_eq!(still.seconds(), None);
        still.interrupt();
        still.add(Some(9.0));
        assert_eq!(still.seconds(), None);
        still.add(Some(9.5));
        assert_eq!(still.seconds(), Some(0.5));
    }
}
