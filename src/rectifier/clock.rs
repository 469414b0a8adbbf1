// SPDX-License-Identifier: MIT OR Apache-2.0

//! Times of the frames: fills in missing ones, detects gaps, estimates period and spacing.
//!
//! The *period* is the nominal interval between frames, if stated. The *spacing* is the actual interval, by
//! which the estimator places its knots: a stream whose frames are ten periods apart has a tenth of the
//! frames, and with knots by the period it would have ten times the unknowns per frame.

use crate::solve::pairs::MAX_INTERVAL;

/// Frames further apart than this many spacings and this many seconds are not compared, nor are those further apart than
/// [`MAX_INTERVAL`] spacings.
const GAP_SPACINGS: f64 = 4.0;
const GAP_SECONDS: f64 = 0.5;
/// Least number of frames between two intervals of more than `GAP_SPACINGS` that a path bridges: a single one
/// among evenly spaced frames costs little, frequent ones as much as the missing frames.
const FRAMES_BETWEEN_HOLES: usize = 18;
/// The spacing is raised if intervals are longer by this factor, and lowered again if they are shorter by it.
/// A path with fewer knots costs up to twice as much as one of the right spacing, and restarting it for a
/// smaller change would cost accuracy.
const SPACING_RATIO: f64 = 2.5;
/// Inverse of the share of the recent intervals that may disagree with a change of spacing: two in three must
/// agree, so that frames at alternating rates do not change the spacing back and forth.
const DISAGREEING: usize = 3;
/// Plausible nominal periods in seconds: containers without a frame rate state their clock ticks, 1000 per
/// second and more.
const PLAUSIBLE_PERIODS: std::ops::RangeInclusive<f64> = 0.001_01..=10.0;
/// Times closer than this count as equal, in seconds (1 µs).
const TIME_TOLERANCE: f64 = 1e-6;
/// Period without any information, in seconds.
const DEFAULT_PERIOD: f64 = 1.0 / 30.0;
/// Number of recent intervals from which the period is estimated.
const MEMORY: usize = 9;

/// The time of a frame and whether it continues the previous one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tick {
    /// Seconds.
    pub time: f64,
    /// Whether it follows the previous frame without a gap.
    pub continues: bool,
}

/// Times of one stream.
#[derive(Clone, Debug)]
pub(super) struct Clock {
    nominal: Option<f64>,
    last: Option<f64>,
    /// The timestamp of the last frame, which may differ from the time assigned to it.
    stated: Option<f64>,
    intervals: [f64; MEMORY],
    /// Number of intervals so far.
    count: usize,
    /// Frames since the path last bridged a hole.
    since_hole: usize,
    /// The spacing, and its initial value, the period.
    spacing: f64,
    initial: f64,
}

impl Clock {
    /// A clock of frames that are nominally `nominal` seconds apart.
    pub fn new(nominal: Option<f64>) -> Self {
        let nominal = nominal.filter(|period| PLAUSIBLE_PERIODS.contains(period));
        let period = nominal.unwrap_or(DEFAULT_PERIOD);
        Self {
            nominal,
            last: None,
            stated: None,
            intervals: [0.0; MEMORY],
            count: 0,
            since_hole: FRAMES_BETWEEN_HOLES,
            spacing: period,
            initial: period,
        }
    }

    /// Seconds from one frame to the next: the nominal period, else the median of the recent intervals.
    pub fn period(&self) -> f64 {
        if let Some(nominal) = self.nominal {
            return nominal;
        }
        let (sorted, count) = self.sorted();
        if count == 0 { DEFAULT_PERIOD } else { sorted[count / 2] }
    }

    /// Actual seconds from one frame to the next: the period, unless the intervals are much longer.
    pub fn spacing(&self) -> f64 {
        self.spacing
    }

    /// The recent intervals in ascending order, and their number.
    fn sorted(&self) -> ([f64; MEMORY], usize) {
        let count = self.count.min(MEMORY);
        let mut sorted = self.intervals;
        sorted[..count].sort_by(f64::total_cmp);
        (sorted, count)
    }

    /// The next frame's time. A missing or repeated timestamp counts as one period after the last time,
    /// also if the timestamps of a stream stop advancing.
    pub fn tick(&mut self, time: Option<f64>) -> Tick {
        let given = time.filter(|time| time.is_finite());
        let stated = std::mem::replace(&mut self.stated, given);
        let Some(last) = self.last else {
            let time = given.unwrap_or(0.0);
            self.last = Some(time);
            (self.spacing, self.initial) = (self.period(), self.period());
            self.since_hole = FRAMES_BETWEEN_HOLES;
            return Tick { time, continues: false };
        };
        let is_new =
            |time: f64| [Some(last), stated].iter().flatten().all(|old| (time - old).abs() > TIME_TOLERANCE);
        let time = given.filter(|&time| is_new(time)).unwrap_or(last + self.period());
        let continues = self.add_interval((time - last).abs());
        self.last = Some(time);
        Tick { time, continues }
    }

    /// Adds an interval; returns whether the path continues across it.
    fn add_interval(&mut self, interval: f64) -> bool {
        // A longer interval is a pause and not used for the spacing.
        if interval <= *PLAUSIBLE_PERIODS.end() {
            self.intervals[self.count % MEMORY] = interval;
            self.count += 1;
            self.update_spacing();
        }
        let [few, most] = [GAP_SPACINGS, MAX_INTERVAL].map(|spacings| spacings * self.spacing);
        let is_hole = interval > few;
        let continues =
            interval <= GAP_SECONDS.clamp(few, most) && !(is_hole && self.since_hole < FRAMES_BETWEEN_HOLES);
        self.since_hole = if is_hole && continues { 0 } else { self.since_hole.saturating_add(1) };
        continues
    }

    /// Changes the spacing if most of the recent intervals differ from it.
    fn update_spacing(&mut self) {
        let (sorted, count) = self.sorted();
        // A single interval may be a gap.
        if count < 2 {
            return;
        }
        let beyond = (count - 1) / DISAGREEING;
        let [short, middle, long] = [beyond, (count - 1) / 2, count - 1 - beyond].map(|index| sorted[index]);
        let is_slower = short > SPACING_RATIO * self.spacing;
        let is_faster = SPACING_RATIO * long < self.spacing && self.spacing > self.initial;
        if is_slower || is_faster {
            self.spacing = if middle > SPACING_RATIO * self.initial { middle } else { self.initial };
        }
    }

    /// Starts a new segment; the recent intervals are kept.
    pub fn restart(&mut self) {
        self.last = None;
        self.stated = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_and_repeated_times_are_filled_in() {
        let mut clock = Clock::new(Some(0.04));
        assert_eq!(clock.tick(None), Tick { time: 0.0, continues: false });
        assert_eq!(clock.tick(None), Tick { time: 0.04, continues: true });
        assert_eq!(clock.tick(Some(0.04)), Tick { time: 0.08, continues: true });
        assert_eq!(clock.tick(Some(f64::NAN)).time, 0.12);
    }

    #[test]
    fn time_advances_if_timestamps_do_not() {
        let mut clock = Clock::new(Some(0.04));
        let times: Vec<f64> = [5.0, 5.0, 5.0, 5.0, 5.16].map(|time| clock.tick(Some(time)).time).into();
        let expected = [5.0, 5.04, 5.08, 5.12, 5.16];
        assert!(times.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{times:?}");
    }

    #[test]
    fn a_gap_breaks_and_a_dropped_frame_does_not() {
        let mut clock = Clock::new(Some(0.04));
        clock.tick(Some(1.0));
        assert!(clock.tick(Some(1.12)).continues);
        assert!(!clock.tick(Some(9.0)).continues);
        assert!(clock.tick(Some(8.96)).continues, "reverse playback");
        let mut slow = Clock::new(Some(2.0));
        slow.tick(Some(0.0));
        assert!(slow.tick(Some(2.0)).continues, "one frame every two seconds");
    }

    #[test]
    fn the_period_is_estimated_if_it_is_not_given() {
        let mut clock = Clock::new(None);
        assert_eq!(clock.period(), 1.0 / 30.0);
        for k in [0.0, 1.0, 2.0, 4.0, 5.0, 6.0] {
            clock.tick(Some(0.02 * k));
        }
        assert!((clock.period() - 0.02).abs() < 1e-12);
        for nonsense in [0.0, -1.0, 1e-9, 1e-3, 1e9, f64::NAN, f64::INFINITY] {
            assert_eq!(Clock::new(Some(nonsense)).period(), 1.0 / 30.0, "{nonsense} is implausible");
        }
    }

    #[test]
    fn a_step_of_very_many_periods_is_a_gap() {
        for (step, continues) in [(0.060, true), (0.070, false)] {
            let mut clock = Clock::new(Some(0.004));
            (0..4).for_each(|k| _ = clock.tick(Some(0.004 * f64::from(k))));
            assert_eq!(clock.tick(Some(0.012 + step)).continues, continues, "{step} s");
        }
    }

    /// Spacing and continuity after each of these intervals, with a nominal period.
    fn ticks(period: f64, intervals: impl IntoIterator<Item = f64>) -> Vec<(f64, bool)> {
        let mut clock = Clock::new(Some(period));
        let mut time = 0.0;
        clock.tick(Some(time));
        let mut tick = |interval| {
            time += interval;
            let continues = clock.tick(Some(time)).continues;
            (clock.spacing(), continues)
        };
        intervals.into_iter().map(&mut tick).collect()
    }

    #[test]
    fn frames_that_come_slowly_set_the_spacing_and_fast_ones_set_it_back() {
        let found = ticks(0.04, [1.0; 4].into_iter().chain([0.04; 9]));
        assert_eq!(found[0], (0.04, false), "it may be a gap");
        assert!(found[1..4].iter().all(|&(spacing, continues)| (spacing - 1.0).abs() < 1e-9 && continues));
        assert!((found[5].0 - 1.0).abs() < 1e-9);
        assert_eq!(found[12], (0.04, true));
    }

    #[test]
    fn the_spacing_does_not_go_back_and_forth() {
        let alternating = (0..40).map(|k| [0.04, 0.5][k % 2]);
        assert!(ticks(0.04, alternating).iter().all(|&(spacing, _)| spacing == 0.04));
        let dropped = (0..40).map(|k| [0.04, 0.08, 0.12][k % 3]);
        assert!(ticks(0.04, dropped).iter().all(|&found| found == (0.04, true)));
    }

    #[test]
    fn one_hole_is_bridged_and_one_after_another_is_not() {
        let holes = (0..40).filter(|k| ticks(0.04, (0..40).map(|k| [0.04, 0.4][k % 2]))[*k] == (0.04, true));
        let long = holes.filter(|k| k % 2 == 1).count();
        assert_eq!(long, 2, "of twenty");
    }
}
