//! The pairs that a path is fitted to.

use super::matches::ScanAxis;
use super::pair::FramePair;
use crate::robust::median::median;

/// Pairs that tell one readout from another.
const FEWEST_PAIRS: usize = 4;
/// Bands of lines in which matches are looked for.
const LINES: usize = 16;

/// Pairs that follow one another, around a frame.
#[derive(Clone, Copy)]
pub struct PairWindow<'a> {
    pub pairs: &'a [&'a FramePair],
    /// Number of those before the frame.
    pub past: usize,
}

impl<'a> PairWindow<'a> {
    /// The part of it from `past` pairs before the frame on, or from more where it would have fewer than `least` pairs.
    pub fn recent(self, past: usize, least: usize) -> Self {
        let ahead = self.pairs.len().saturating_sub(self.past);
        let skipped = self.past.saturating_sub(past.max(least.saturating_sub(ahead)));
        let pairs = self.pairs.get(skipped..).unwrap_or_default();
        Self { pairs, past: self.past - skipped }
    }

    /// Indices of the pairs that the frame is in.
    pub fn beside(self) -> impl Iterator<Item = usize> + Clone {
        let count = self.pairs.len();
        [self.past.checked_sub(1), Some(self.past)].into_iter().flatten().filter(move |index| *index < count)
    }

    /// The pairs that the frame is in.
    pub fn own_pairs(self) -> impl Iterator<Item = &'a FramePair> {
        self.beside().filter_map(move |index| self.pairs.get(index).copied())
    }

    /// Whether it is too short to say anything of a readout: some path fits a pair or two with any shutter, and
    /// whatever it stands for.
    pub fn is_short(self) -> bool {
        self.pairs.len() < FEWEST_PAIRS
    }

    /// Mean square distance by which points moved in the pairs that the frame is in, in squared units of the radius.
    pub fn moved(self) -> f64 {
        self.own_pairs().map(FramePair::moved).fold(0.0, f64::max)
    }

    /// Index of the pair that the frame begins; without lookahead, of the one that it ends.
    pub fn own(self) -> usize {
        self.past.min(self.pairs.len().saturating_sub(1))
    }

    /// The middle one of the intervals between the pairs' frames, in frame periods; a readout takes no longer.
    pub fn usual_interval(self) -> f64 {
        let mut intervals: Vec<f64> =
            self.pairs.iter().map(|pair| (pair.stamps[1] - pair.stamps[0]).abs()).collect();
        if intervals.is_empty() { 1.0 } else { median(&mut intervals) }
    }
}

/// Whether a pair shows enough of the picture's lines to tell a shutter from a thing that moves on its own: 0 up to a
/// quarter of them, 1 from a half on.
pub fn breadth(pair: &FramePair, scan_axis: ScanAxis) -> f64 {
    let mut shown = [false; LINES];
    for one in &pair.matches {
        let line = scan_axis.place(one.from) * LINES as f64;
        shown[line.clamp(0.0, LINES as f64 - 1.0) as usize] = true;
    }
    let share = shown.iter().filter(|shown| **shown).count() as f64 / LINES as f64;
    (4.0 * share - 1.0).clamp(0.0, 1.0)
}
