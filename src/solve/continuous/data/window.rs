// SPDX-License-Identifier: MIT OR Apache-2.0

//! The pairs that a path is fitted to.

use super::matches::ScanAxis;
use super::pair::FramePair;
use crate::robust::median::median;

/// Pairs needed to constrain a readout: a path fits fewer with any shutter.
const MIN_READOUT_PAIRS: usize = 4;

/// Successive pairs around a frame.
#[derive(Clone, Copy)]
pub struct PairWindow<'a> {
    pub pairs: &'a [&'a FramePair],
    /// Number of pairs before the frame.
    pub past: usize,
}

impl<'a> PairWindow<'a> {
    /// The part from `past` pairs before the frame on, or from earlier to have `least` pairs in all.
    pub fn recent(self, past: usize, least: usize) -> Self {
        let ahead = self.pairs.len().saturating_sub(self.past);
        let skipped = self.past.saturating_sub(past.max(least.saturating_sub(ahead)));
        let pairs = self.pairs.get(skipped..).unwrap_or_default();
        Self { pairs, past: self.past - skipped }
    }

    /// Indices of the pairs that contain the frame.
    pub fn beside(self) -> impl Iterator<Item = usize> + Clone {
        let count = self.pairs.len();
        [self.past.checked_sub(1), Some(self.past)].into_iter().flatten().filter(move |index| *index < count)
    }

    /// The pairs that contain the frame.
    pub fn own_pairs(self) -> impl Iterator<Item = &'a FramePair> {
        self.beside().filter_map(move |index| self.pairs.get(index).copied())
    }

    /// Whether it is too short to constrain a readout.
    pub fn is_short(self) -> bool {
        self.pairs.len() < MIN_READOUT_PAIRS
    }

    /// Mean squared displacement, in squared radii, in the pair with the frame where it is greater.
    pub fn moved(self) -> f64 {
        self.own_pairs().map(FramePair::moved).fold(0.0, f64::max)
    }

    /// Index of the pair that begins with the frame; without lookahead, of the one that ends with it.
    pub fn own(self) -> usize {
        self.past.min(self.pairs.len().saturating_sub(1))
    }

    /// Median interval of the pairs in frame periods, an upper bound of the readout time.
    pub fn usual_interval(self) -> f64 {
        let interval = |pair: &&FramePair| (pair.stamps[1] - pair.stamps[0]).abs();
        let mut intervals: Vec<f64> = self.pairs.iter().map(interval).collect();
        if intervals.is_empty() { 1.0 } else { median(&mut intervals) }
    }
}

/// Coverage of the scan axis by the matches of a pair: 0 up to a quarter of the lines, 1 from a half on. With
/// less, a shutter is not distinguished from a moving object.
pub fn breadth(pair: &FramePair, scan_axis: ScanAxis) -> f64 {
    let mut shown = [false; ScanAxis::LINE_BANDS];
    pair.matches.iter().for_each(|m| shown[scan_axis.line_band(m.from)] = true);
    let share = shown.iter().filter(|shown| **shown).count() as f64 / ScanAxis::LINE_BANDS as f64;
    (4.0 * share - 1.0).clamp(0.0, 1.0)
}
