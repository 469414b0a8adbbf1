//! The frames' times, put in order: missing ones filled in, gaps noticed, the period learnt.

/// Frames further apart than this many periods and this many seconds are not compared.
const GAP_PERIODS: f64 = 4.0;
const GAP_SECONDS: f64 = 0.5;
/// Nor are frames further apart than this many periods, however short: a path that goes on through
/// all of them would cost as much as the frames that are not there.
const LONGEST_PERIODS: f64 = 16.0;
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
}

impl Clock {
    /// A clock of frames that are nominally `nominal` seconds apart.
    pub fn new(nominal: Option<f64>) -> Self {
        let nominal = nominal.filter(|period| BELIEVED.contains(period));
        Self { nominal, last: None, stated: None, intervals: [0.0; MEMORY], seen: 0 }
    }

    /// Seconds from one frame to the next: the nominal ones, else the median of the last intervals.
    pub fn period(&self) -> f64 {
        if let Some(nominal) = self.nominal {
            return nominal;
        }
        let count = self.seen.min(MEMORY);
        let mut known = self.intervals;
        known[..count].sort_by(f64::total_cmp);
        if count == 0 { DEFAULT_PERIOD } else { known[count / 2] }
    }

    /// The next frame's time. One that is missing, or the same as the last, is a period later; so
    /// is each one of a stream whose timestamps stand still.
    pub fn tick(&mut self, time: Option<f64>) -> Tick {
        let given = time.filter(|time| time.is_finite());
        let stated = std::mem::replace(&mut self.stated, given);
        let Some(last) = self.last else {
            let time = given.unwrap_or(0.0);
            self.last = Some(time);
            return Tick { time, continues: false };
        };
        let is_new = |time: f64| [Some(last), stated].iter().flatten().all(|old| (time - old).abs() > SAME);
        let time = given.filter(|&time| is_new(time)).unwrap_or(last + self.period());
        let interval = (time - last).abs();
        let [few, most] = [GAP_PERIODS, LONGEST_PERIODS].map(|periods| periods * self.period());
        let continues = interval <= GAP_SECONDS.clamp(few, most);
        if continues {
            self.intervals[self.seen % MEMORY] = interval;
            self.seen += 1;
        }
        self.last = Some(time);
        Tick { time, continues }
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
        let mut clock = Clock::new(Some(0.004));
        clock.tick(Some(0.0));
        assert!(clock.tick(Some(0.060)).continues);
        assert!(!clock.tick(Some(0.130)).continues);
    }
}
