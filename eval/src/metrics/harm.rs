// SPDX-License-Identifier: MIT OR Apache-2.0

//! What a method does to footage that nothing is wrong with.

use baselines::methods::Correction;
use nalgebra::Vector2;
use render::footage::STEP;
use render::stats::{Stats, distances};
use render::truth::Sample;

/// The displacement that corrections add to frames of `[width, height]` without rolling shutter, in
/// pixels: |C(x) − x| at every [`STEP`]th pixel of every frame. All of it is harm.
pub fn added(size: [usize; 2], corrections: &[Box<dyn Correction>]) -> Stats {
    let undisplaced: Vec<Sample> =
        grid(size).into_iter().map(|pixel| Sample { seen: pixel, truth: pixel }).collect();
    let added = corrections.iter().flat_map(|correction| distances(&undisplaced, |x| correction.correct(x)));
    Stats::of(added.collect())
}

/// Every [`STEP`]th pixel of a frame in x and y, row by row.
pub(super) fn grid([width, height]: [usize; 2]) -> Vec<Vector2<f64>> {
    let places = |length: usize| (STEP / 2..length).step_by(STEP);
    places(height).flat_map(|y| places(width).map(move |x| Vector2::new(x as f64, y as f64))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use baselines::methods::Corrections;

    #[test]
    fn worked_by_hand() {
        let still = |pixel| pixel;
        let shift = |pixel: Vector2<f64>| pixel + Vector2::new(-3.0, 4.0);
        let corrections: Corrections = vec![Box::new(still), Box::new(shift)];
        let harm = added([64, 48], &corrections);
        assert_eq!((harm.count, harm.p95), (2 * 8 * 6, 5.0));
        assert!((harm.rms - 12.5f64.sqrt()).abs() < 1e-12);
        assert_eq!(added([64, 48], &corrections[..1]).rms, 0.0);
    }
}
