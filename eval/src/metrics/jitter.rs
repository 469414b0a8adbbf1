// SPDX-License-Identifier: MIT OR Apache-2.0

//! Jitter: how unsteady a correction is from frame to frame, and the content that it corrects.
//!
//! A viewer takes a displacement that stays, or grows steadily, as part of the picture; what shakes
//! is its second difference over time, at a fixed pixel:
//!
//! - [`added`], of the correction: d(k+1) − 2 d(k) + d(k−1) with d = C(x) − x;
//! - [`content`], of the picture as it arrives: m(k) − m(k−1) with m = H(x) − x, the motion from each
//!   frame to the next, taken as the homography H.
//!
//! Both in pixels, over a grid of pixels and all frames that have a frame before and one after. The
//! frames are to follow one another without a cut. A faithful correction is proportional to the
//! motion and so as unsteady as the content; its share of the content's jitter stays below about the
//! readout ratio, while a noisy one adds jitter where the content has none.

use super::harm::grid;
use super::homography::Homography;
use baselines::methods::Correction;
use nalgebra::Vector2;
use render::stats::Stats;

/// The jitter that the corrections of successive frames of `[width, height]` add; zero for
/// corrections that do not change, or change steadily.
pub fn added(size: [usize; 2], corrections: &[Box<dyn Correction>]) -> Stats {
    let second = |x: Vector2<f64>, of: &[Box<dyn Correction>]| {
        of[2].correct(x) - of[1].correct(x) * 2.0 + of[0].correct(x)
    };
    let grid = grid(size);
    let jitter = corrections.windows(3).flat_map(|of| grid.iter().map(move |x| second(*x, of).norm()));
    Stats::of(jitter.collect())
}

/// The jitter of the content, from the motions of each frame to the next; pairs of frames whose
/// motion is unknown are left out.
pub fn content(size: [usize; 2], motions: &[Option<Homography>]) -> Stats {
    let grid = grid(size);
    let known = motions.windows(2).filter_map(|pair| pair[0].zip(pair[1]));
    let jitter = known
        .flat_map(|(before, after)| grid.iter().map(move |x| (after.apply(*x) - before.apply(*x)).norm()));
    Stats::of(jitter.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use baselines::methods::Corrections;
    use nalgebra::Matrix3;

    const SIZE: [usize; 2] = [64, 48];

    fn shifts(by: impl Fn(f64) -> Vector2<f64>) -> Corrections {
        let shift = |k: usize| {
            let by = by(k as f64);
            Box::new(move |x: Vector2<f64>| x + by) as Box<dyn Correction>
        };
        (0..20).map(shift).collect()
    }

    fn moves(by: impl Fn(usize) -> f64) -> Vec<Option<Homography>> {
        let shift = |k| Homography(Matrix3::new(1.0, 0.0, by(k), 0.0, 1.0, 0.0, 0.0, 0.0, 1.0));
        (0..5).map(|k| Some(shift(k))).collect()
    }

    #[test]
    fn steady_corrections_add_none() {
        assert!(added(SIZE, &shifts(|_| Vector2::zeros())).rms == 0.0);
        let lean = |x: Vector2<f64>| x + Vector2::new(0.1 * (x.y - 24.0), 0.0);
        let leaning: Corrections = (0..4).map(|_| Box::new(lean) as Box<dyn Correction>).collect();
        assert!(added(SIZE, &leaning).rms < 1e-12);
        assert!(added(SIZE, &shifts(|k| Vector2::new(0.5 * k, -k))).rms < 1e-12);
    }

    #[test]
    fn an_oscillation_adds_its_second_difference() {
        // (−1)^k (3, 4): 4 times its length.
        let found = added(SIZE, &shifts(|k| Vector2::new(3.0, 4.0) * (1.0 - 2.0 * (k % 2.0))));
        assert!((found.rms - 20.0).abs() < 1e-12 && (found.p95 - 20.0).abs() < 1e-12);
        assert_eq!(found.count, 18 * 8 * 6);
        // A turning shift of radius 2: 2 · 2 (1 − cos ω).
        let turning = added(SIZE, &shifts(|k| 2.0 * Vector2::new((0.7 * k).cos(), (0.7 * k).sin())));
        assert!((turning.rms - 4.0 * (1.0 - 0.7f64.cos())).abs() < 1e-12);
    }

    #[test]
    fn content_that_moves_steadily_has_none() {
        assert_eq!(content(SIZE, &moves(|_| 7.0)).rms, 0.0);
        assert_eq!(content(SIZE, &moves(|k| 1.5 * k as f64)).rms, 1.5);
        let mut broken = moves(|k| k as f64);
        broken[2] = None;
        assert_eq!(content(SIZE, &broken).count, 2 * 8 * 6);
    }
}
