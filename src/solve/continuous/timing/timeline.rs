// SPDX-License-Identifier: MIT OR Apache-2.0

//! When frames were exposed, where a conversion of the frame rate has repeated or dropped some.

use crate::solve::frame_timing::Timeline;

/// Frames of which a conversion keeps all but one: to 24 or 25 of 30, to 50 of 60, and what lies between.
const MISSING: std::ops::RangeInclusive<usize> = 2..=6;
/// A frame is shown at most this many frame periods from its time when frames are repeated.
const ROUNDING: f64 = 1.0;

impl Timeline {
    /// The timelines to be compared, given the stated intervals of successive pairs in frame periods.
    pub fn candidates(stated: &[f64]) -> impl Iterator<Item = Self> {
        let missing = MISSING.flat_map(|kept| (0..kept).map(move |longer| Self::Missing { kept, longer }));
        [Self::Stated, Self::Even { interval: slope(stated) }].into_iter().chain(missing)
    }

    /// The interval of a pair in frame periods, from its number and its stated interval.
    pub fn interval(self, index: usize, stated: f64) -> f64 {
        match self {
            Self::Stated | Self::Blended { .. } => stated,
            // Other intervals are gaps.
            Self::Even { interval } if (stated - interval).abs() <= ROUNDING => interval,
            Self::Even { .. } => stated,
            Self::Missing { kept, longer } => {
                let lasts = if index % kept == longer { 2.0 } else { 1.0 };
                stated * lasts * kept as f64 / (kept + 1) as f64
            }
        }
    }
}

/// Mean interval: the slope of the straight line through the stamps, which rounding to frame periods disturbs least.
fn slope(intervals: &[f64]) -> f64 {
    let middle = intervals.len() as f64 / 2.0;
    let stamps = intervals.iter().scan(0.0, |stamp, interval| {
        *stamp += interval;
        Some(*stamp)
    });
    let mut sums = [0.0; 2];
    for (index, stamp) in std::iter::once(0.0).chain(stamps).enumerate() {
        let late = index as f64 - middle;
        sums = [sums[0] + late * stamp, sums[1] + late * late];
    }
    sums[0] / sums[1]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_of_five_frames_last_as_long_as_stated_in_all() {
        let timeline = Timeline::Missing { kept: 4, longer: 1 };
        let intervals: Vec<f64> = (0..4).map(|index| timeline.interval(index, 1.0)).collect();
        assert_eq!(intervals, [0.8, 1.6, 0.8, 0.8]);
    }

    #[test]
    fn repeated_frames_are_even_and_gaps_stay() {
        let stated: Vec<f64> = (0..25).map(|index| if index % 5 == 3 { 2.0 } else { 1.0 }).collect();
        let even = Timeline::candidates(&stated).nth(1).unwrap();
        let Timeline::Even { interval } = even else { panic!("{even:?}") };
        assert!((interval - 1.2).abs() < 0.003, "{interval}");
        assert_eq!([1.0, 2.0, 7.0].map(|stated| even.interval(0, stated)), [interval, interval, 7.0]);
    }

    #[test]
    fn played_in_reverse_the_intervals_are_negative() {
        assert_eq!(Timeline::Missing { kept: 2, longer: 0 }.interval(0, -3.0), -4.0);
        assert!((slope(&[-1.0, -1.0, -1.0]) + 1.0).abs() < 1e-12);
    }
}
