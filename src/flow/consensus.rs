// SPDX-License-Identifier: MIT OR Apache-2.0

//! The motion that most of a picture shares: an affine map, fitted robustly.

use super::estimate::PatchFlow;
use super::level::CELL;
use super::patch::SIDE;
use crate::robust::loss::GemanMcClure;
use crate::robust::median::median;
use crate::robust::motion::{Motion, Round, Sample, Scale, affine, fit};
use nalgebra::{Matrix2x3, Vector2};

/// Rounds of re-weighted least squares, by the loss of Geman and McClure. The scale of residuals is halved in each …
const ROUNDS: usize = 8;

/// … from this share of the level's width …
const FIRST_SCALE: f32 = 0.1;

/// … to this many pixels, at which a cell counts a quarter.
const LAST_SCALE: f32 = 1.5;

/// Every so many cells are enough for a few parameters; a prime, so that they do not lie in columns.
const EVERY: usize = 7;

/// Added to the normal equations of the slopes, it makes them nothing: more than the sum of squared coordinates of any
/// level.
const STIFF: f64 = 1e15;

/// Displacement = A·(1, x, y) in pixels of the level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Consensus {
    motion: Motion<f32, 3>,
}

impl Consensus {
    /// Of patches with `columns` in a row, where a pixel's noise has the variance `noise`. `None` where nothing is seen.
    ///
    /// They count by their texture, less where they fit badly.
    pub(super) fn of(patches: &[PatchFlow], columns: usize, noise: f32) -> Option<Self> {
        let weight = |patch: &PatchFlow| {
            let [xx, _, yy] = patch.mean.tensor();
            let texture = xx + yy;
            texture / (texture + 4.0 * noise + patch.mean.residual())
        };
        let place = |index: usize| {
            Vector2::new(middle(index % columns.max(1) * CELL), middle(index / columns.max(1) * CELL))
        };
        let median_shift = |axis: usize| {
            let seen = patches.iter().step_by(EVERY).filter(|patch| weight(patch) > 0.0);
            let mut shifts: Vec<f64> = seen.map(|patch| f64::from(patch.mean.shift()[axis])).collect();
            (!shifts.is_empty()).then(|| median(&mut shifts) as f32)
        };
        let start = Motion(Matrix2x3::new(median_shift(0)?, 0.0, 0.0, median_shift(1)?, 0.0, 0.0));
        let samples = patches.iter().enumerate().step_by(EVERY).map(|(index, patch)| Sample {
            terms: affine(place(index)),
            displacement: Vector2::from(patch.mean.shift()),
            weight: weight(patch),
        });
        let width = (columns * CELL) as f32;
        let rounds = (0..ROUNDS).map(|round| {
            let scale = LAST_SCALE.max(FIRST_SCALE * width * 0.5f32.powi(round as i32));
            // An affine map may fit two motions halfway: first of all, the one that is shared is to be chosen.
            let ridge = if round < ROUNDS / 2 { STIFF } else { 0.0 };
            Round { scale: Scale::Variance(scale * scale), ridge: [0.0, ridge, ridge] }
        });
        fit(samples, start, GemanMcClure(1.0), rounds).map(|motion| Self { motion })
    }

    /// For the patch whose top left pixel is (x, y).
    pub(super) fn of_patch(&self, x: usize, y: usize) -> [f32; 2] {
        self.at(middle(x), middle(y))
    }

    /// The displacement at a pixel of the level.
    fn at(&self, x: f32, y: f32) -> [f32; 2] {
        self.motion.at(&affine(Vector2::new(x, y))).into()
    }
}

/// The middle of the patch that begins at a pixel, along an axis.
fn middle(first: usize) -> f32 {
    first as f32 + 0.5 * (SIDE as f32 - 1.0)
}

#[cfg(test)]
mod tests {
    use super::super::estimate::Mean;
    use super::*;

    fn patches(shift: impl Fn(f32, f32) -> [f32; 2]) -> Vec<PatchFlow> {
        let patch = |index: usize| {
            let [x, y] = shift(middle(index % 60 * CELL), middle(index / 60 * CELL));
            PatchFlow { mean: Mean([x, y, 0.0, 100.0, 0.0, 100.0, 0.0, 1.0]), ..PatchFlow::default() }
        };
        (0..60 * 40).map(patch).collect()
    }

    #[test]
    fn what_forty_per_cent_do_changes_nothing() {
        let shared = |x: f32, y: f32| [5.0 + 0.01 * x - 0.02 * y, -3.0 + 0.015 * y];
        let patches = patches(|x, y| if x < 96.0 { [-20.0, 7.0] } else { shared(x, y) });
        let found = Consensus::of(&patches, 60, 0.5).unwrap();
        for (x, y) in [(0.0, 0.0), (200.0, 100.0), (120.0, 7.0)] {
            let (is, ought) = (found.at(x, y), shared(x, y));
            assert!((is[0] - ought[0]).hypot(is[1] - ought[1]) < 0.1, "{x} {y}: {is:?} {ought:?}");
        }
    }

    #[test]
    fn where_nothing_is_seen_nothing_is_shared() {
        assert_eq!(Consensus::of(&vec![PatchFlow::default(); 600], 60, 0.5), None);
        assert_eq!(Consensus::of(&[], 0, 0.5), None);
    }
}
