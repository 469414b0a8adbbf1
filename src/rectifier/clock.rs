//! The frames' times, put in order: missing ones filled in, gaps noticed, period and spacing learnt.
//!
//! The *period* is the nominal interval between frames where one is stated. The *spacing* is the interval at which frames
//! do come, and what the estimator places its knots by: a stream whose frames are ten periods apart has a tenth of the
//! frames, and would have ten times the unknowns for each of them.

/// Frames further apart than this many spacings and this many seconds are not compared.
const GAP_SPACINGS: f64 = 4.0;
const GAP_SECONDS: f64 = 0.5;
/// Nor are frames further apart than this many spacings, however short: a path that goes on through
/// all of them would cost as much as the frames that are not there.
const LONGEST_SPACINGS: f64 = 16.0;
/// Frames from one interval of more than `GAP_SPACINGS` that the path goes on through to the next: a hole among frames that
/// come evenly costs little, one after another as much as the frames that are not there.
const BETWEEN_HOLES: usize = 18;
/// The spacing is changed where frames come more slowly by this factor, or as much faster again. A path with fewer knots
/// costs up to twice as much as one of the right spacing, and restarting it for less would cost accuracy.
const STRETCH: f64 = 2.5;
/// Of the last intervals, two in three show that: frames that come now and then at one rate, now and then at another
/// do not change the spacing back and forth.
const SURE: usize = 3;
/// Nominal periods that are believed, in seconds: containers state the ticks of their clock, 1000 a
/// second and more, where they know no frame rate.
const BELIEVED: std::ops::RangeInclusive<f64> = 0.001_01..=10.0;
/// Times nearer than this are one and the same (1 µs).
const SAME: f64 = 1e-6;
/// Period where nothing is known, in seconds.
const DEFAULT_PERIOD: f64 = 1.0 / 30.0;
/// Intervals from which the period is taken.
const MEMORY: usize = 9;

/// The time of a frame and how it follows the frame before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tick {
    /// Seconds.
    pub time: f64,
    /// Whether it follows the frame before without a gap.
    pub continues: bool,
}

/// Times of one stream.
#[derive(Clone, Debug)]
pub(super) struct Clock {
    nominal: Option<f64>,
    last: Option<f64>,
    /// The time that the last frame came with, which need not be the one it was given.
    stated: Option<f64>,
    intervals: [f64; MEMORY],
    seen: usize,
    /// Frames since the path last went on through a hole.
    since_hole: usize,
    /// The spacing, and the period from which it started.
    spacing: f64,
    started: f64,
}

impl Clock {
    /// A clock of frames that are nominally `nominal` seconds apart.
    pub fn new(nominal: Option<f64>) -> Self {
        let nominal = nominal.filter(|period| BELIEVED.contains(period));
        let period = nominal.unwrap_or(DEFAULT_PERIOD);
        Self {
            nominal,
            last: None,
            stated: None,
            intervals: [0.0; MEMORY],
            seen: 0,
            since_hole: BETWEEN_HOLES,
            spacing: period,
            started: period,
        }
    }

    /// Seconds from one frame to the next: the nominal ones, else the median of the last intervals.
    pub fn period(&self) -> f64 {
        if let Some(nominal) = self.nominal {
            return nominal;
        }
        let (known, count) = self.sorted();
        if count == 0 { DEFAULT_PERIOD } else { known[count / 2] }
    }

    /// Seconds from one frame to the next as they come: the period, unless they come much more slowly.
    pub fn spacing(&self) -> f64 {
        self.spacing
    }

    /// The last intervals in ascending order, and how many there are.
    fn sorted(&self) -> ([f64; MEMORY], usize) {
        let count = self.seen.min(MEMORY);
        let mut known = self.intervals;
        known[..count].sort_by(f64::total_cmp);
        (known, count)
    }

    /// The next frame's time. One that is missing, or the same as the last, is a period later; so
    /// is each one of a stream whose timestamps stand still.
    pub fn tick(&mut self, time: Option<f64>) -> Tick {
        let given = time.filter(|time| time.is_finite());
        let stated = std::mem::replace(&mut self.stated, given);
        let Some(last) = self.last else {
            let time = given.unwrap_or(0.0);
            self.last = Some(time);
            (self.spacing, self.started) = (self.period(), self.period());
            self.since_hole = BETWEEN_HOLES;
            return Tick { time, continues: false };
        };
        let is_new = |time: f64| [Some(last), stated].iter().flatten().all(|old| (time - old).abs() > SAME);
        let time = given.filter(|&time| is_new(time)).unwrap_or(last + self.period());
        let continues = self.note((time - last).abs());
        self.last = Some(time);
        Tick { time, continues }
    }

    /// Takes in an interval; whether the path goes on through it.
    fn note(&mut self, interval: f64) -> bool {
        // A longer one is a pause, no rate.
        if interval <= *BELIEVED.end() {
            self.intervals[self.seen % MEMORY] = interval;
            self.seen += 1;
            self.follow();
        }
        let [few, most] = [GAP_SPACINGS, LONGEST_SPACINGS].map(|spacings| spacings * self.spacing);
        let is_hole = interval > few;
        let continues =
            interval <= GAP_SECONDS.clamp(few, most) && !(is_hole && self.since_hole < BETWEEN_HOLES);
        self.since_hole = if is_hole && continues { 0 } else { self.since_hole.saturating_add(1) };
        continues
    }

    /// Changes the spacing where nearly all of the last frames came at another one.
    fn follow(&mut self) {
        let (known, count) = self.sorted();
        // One alone may be a gap.
        if count < 2 {
            return;
        }
        let beyond = (count - 1) / SURE;
        let [short, middle, long] = [beyond, (count - 1) / 2, count - 1 - beyond].map(|index| known[index]);
        let is_slower = short > STRETCH * self.spacing;
        let is_faster = STRETCH * long < self.spacing && self.spacing > self.started;
        if is_slower || is_faster {
            self.spacing = if middle > STRETCH * self.started { middle } else { self.started };
        }
    }

    /// Starts anew, keeping the period that was learnt.
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
    fn time_goes_on_where_timestamps_stand_still() {
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
    fn the_period_is_learnt_where_it_is_not_given() {
        let mut clock = Clock::new(None);
        assert_eq!(clock.period(), 1.0 / 30.0);
        for k in [0.0, 1.0, 2.0, 4.0, 5.0, 6.0] {
            clock.tick(Some(0.02 * k));
        }
        assert!((clock.period() - 0.02).abs() < 1e-12);
        for nonsense in [0.0, -1.0, 1e-9, 1e-3, 1e9, f64::NAN, f64::INFINITY] {
            assert_eq!(Clock::new(Some(nonsense)).period(), 1.0 / 30.0, "{nonsense} is not believed");
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

    /// Spacings and whether the path went on, of frames with these intervals, under a claimed period.
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
