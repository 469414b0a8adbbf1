// SPDX-License-Identifier: MIT OR Apache-2.0

//! Displacement over a set of samples.

use crate::truth::Sample;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// Displacement over the samples of a frame or a sequence, in pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Stats {
    /// Root mean square.
    pub rms: f64,
    /// The value that 95 % of the samples do not exceed.
    pub p95: f64,
    /// Number of samples.
    pub count: usize,
}

impl Stats {
    /// The statistics of a set of distances; all zero for none.
    pub fn of(mut distances: Vec<f64>) -> Self {
        let count = distances.len();
        if count == 0 {
            return Self::default();
        }
        let squares: f64 = distances.iter().map(|distance| distance * distance).sum();
        let rank = (0.95 * count as f64).ceil() as usize - 1;
        let (_, p95, _) = distances.select_nth_unstable_by(rank, f64::total_cmp);
        Self { rms: (squares / count as f64).sqrt(), p95: *p95, count }
    }

    /// This displacement as a share of the uncorrected one; `None` where nothing was displaced.
    pub fn share_of(&self, uncorrected: &Self) -> Option<f64> {
        (uncorrected.rms > 1e-9).then(|| self.rms / uncorrected.rms)
    }
}

/// How far each sample lies from its truth, |x_cor − x_true| in pixels, where `corrected` takes a pixel
/// of the frame as it arrived to its place at the reference instant.
pub fn distances<'a>(
    samples: &'a [Sample],
    corrected: impl Fn(Vector2<f64>) -> Vector2<f64> + 'a,
) -> impl Iterator<Item = f64> + 'a {
    samples.iter().map(move |sample| (corrected(sample.seen) - sample.truth).norm())
}

/// The displacement of samples as they arrive.
pub fn uncorrected(samples: impl IntoIterator<Item = Sample>) -> Stats {
    Stats::of(samples.into_iter().map(|sample| (sample.seen - sample.truth).norm()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn displacement_left(samples: &[Sample], corrected: impl Fn(Vector2<f64>) -> Vector2<f64>) -> Stats {
        Stats::of(distances(samples, corrected).collect())
    }

    fn sample(x: f64, y: f64, dx: f64, dy: f64) -> Sample {
        Sample { seen: Vector2::new(x, y), truth: Vector2::new(x + dx, y + dy) }
    }

    #[test]
    fn worked_by_hand() {
        let samples = [sample(0.0, 0.0, 3.0, 4.0), sample(8.0, 0.0, 0.0, 0.0)];
        let left = displacement_left(&samples, |x| x);
        assert_eq!((left.rms, left.p95, left.count), (12.5f64.sqrt(), 5.0, 2));
        let half = displacement_left(&samples[..1], |x| x + Vector2::new(1.5, 2.0));
        assert_eq!(half.share_of(&displacement_left(&samples[..1], |x| x)), Some(0.5));
    }

    #[test]
    fn the_95th_percentile_is_the_nearest_rank() {
        let stats = Stats::of((1..=100).rev().map(f64::from).collect());
        assert_eq!((stats.p95, stats.count), (95.0, 100));
    }

    #[test]
    fn nothing_displaced_has_no_share() {
        assert_eq!(Stats::of(Vec::new()), Stats::default());
        assert_eq!(Stats::default().share_of(&Stats::of(vec![0.0, 0.0])), None);
    }
}
