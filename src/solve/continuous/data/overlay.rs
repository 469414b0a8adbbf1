// SPDX-License-Identifier: MIT OR Apache-2.0

//! Static overlays: a timestamp, a logo, the bonnet below a dashcam.
//!
//! An overlay is at rest in the same rows whatever the camera does, which looks like a shutter. So it is
//! detected cell by cell, and its matches are left out. Per pair, a cell's log odds change by the difference
//! of two Student-t log likelihoods (ν = 3) of a match: of its distance from rest, and of its distance from
//! the affine motion of all that moves. Either distance is in units of its own standard deviation, and the
//! normalising constants are left out, so that the difference is about 0 where that motion is at rest itself.

use crate::correspond::Correspondence;
use crate::robust::loss::{GemanMcClure, Loss, StudentT};
use crate::robust::motion::{Motion, ROUNDS, Round, Sample, Scale, affine, fit};
use nalgebra::{Matrix2x3, Vector2};

/// Cells across the frame.
const COLUMNS: usize = 32;
/// Rows of cells, at most, however narrow the frame.
const MAX_ROWS: usize = 8 * COLUMNS;
/// Standard deviation of an overlay's displacement over that of a match; the scene moves at its edges.
const OVERLAY_NOISE: f64 = 5.0;
/// A displacement beyond this many of these standard deviations is motion.
const MOTION_DEVIATIONS: f64 = 4.0;
/// Shares of the matches, and of the columns of cells, that must move for the camera to move: people who walk
/// past a camera at rest fill less of the width.
const MIN_MOVING: f64 = 1.0 / 3.0;
const MIN_MOVING_COLUMNS: f64 = 0.75;
/// Log odds of a cell at first, and their greatest magnitude.
const PRIOR_LOG_ODDS: f64 = -3.0;
const MAX_LOG_ODDS: f64 = 8.0;
/// Degrees of freedom of Student's t.
const FREEDOM: i32 = 3;
/// The loss of the fit of the motion: weight ¼ at two standard deviations.
const FIT_LOSS: GemanMcClure = GemanMcClure(4.0);

/// The cells of the frame that show a static overlay.
#[derive(Debug)]
pub struct StaticOverlay {
    /// Side of a cell in pixels.
    cell: f64,
    /// Log odds of each cell, row by row.
    log_odds: Vec<f64>,
    /// Standard deviation in pixels of an overlay's displacement.
    deviation: f64,
}

impl StaticOverlay {
    /// For frames of `width` × `height` pixels; `noise` is the standard deviation of a match in pixels.
    pub fn new(width: usize, height: usize, noise: f64) -> Self {
        let cell =
            (width as f64 / COLUMNS as f64).max(height as f64 / MAX_ROWS as f64).max(1.0 / COLUMNS as f64);
        let rows = (height as f64 / cell).ceil() as usize;
        Self { cell, log_odds: vec![PRIOR_LOG_ODDS; COLUMNS * rows], deviation: OVERLAY_NOISE * noise }
    }

    /// Updates the cells by a pair's matches, and writes those off overlays to `scene`; all, if few.
    pub fn remove(&mut self, found: &[Correspondence], scene: &mut Vec<Correspondence>) {
        self.update(found);
        let is_overlay = |m: &Correspondence| {
            self.index(m).and_then(|index| self.log_odds.get(index)).is_some_and(|odds| *odds > 0.0)
        };
        scene.clear();
        scene.extend(found.iter().filter(|m| !is_overlay(m)));
        if (scene.len() as f64) < MIN_MOVING * found.len() as f64 {
            scene.clear();
            scene.extend_from_slice(found);
        }
    }

    /// The cell of a match in the first frame.
    fn index(&self, m: &Correspondence) -> Option<usize> {
        let [column, row] = [m.from.x, m.from.y].map(|pixel| (pixel + 0.5) / self.cell);
        let is_inside = column >= 0.0 && column < COLUMNS as f64 && row >= 0.0 && row < MAX_ROWS as f64;
        is_inside.then(|| row as usize * COLUMNS + column as usize)
    }

    /// Share of the columns with a match.
    fn columns_of(&self, matches: &[&Correspondence]) -> f64 {
        let mut seen = [false; COLUMNS];
        matches.iter().filter_map(|m| self.index(m)).for_each(|index| seen[index % COLUMNS] = true);
        seen.iter().filter(|seen| **seen).count() as f64 / COLUMNS as f64
    }

    fn update(&mut self, found: &[Correspondence]) {
        let least = (MOTION_DEVIATIONS * self.deviation).powi(2);
        let moving: Vec<&Correspondence> =
            found.iter().filter(|m| displacement(m).norm_squared() > least).collect();
        if (moving.len() as f64) < MIN_MOVING * found.len() as f64
            || self.columns_of(&moving) < MIN_MOVING_COLUMNS
        {
            return;
        }
        let overlay_variance = self.deviation * self.deviation;
        let Some((motion, variance)) = fit_motion(&moving, overlay_variance) else { return };
        let loss = StudentT::<FREEDOM>;
        for m in found {
            let rests = loss.log_likelihood(displacement(m).norm_squared() / overlay_variance);
            let moves = loss.log_likelihood(motion.square(&sample(m)) / variance);
            if let Some(odds) = self.index(m).and_then(|index| self.log_odds.get_mut(index)) {
                *odds = (*odds + rests - moves).clamp(-MAX_LOG_ODDS, MAX_LOG_ODDS);
            }
        }
    }
}

fn displacement(m: &Correspondence) -> Vector2<f64> {
    m.to - m.from
}

/// The affine motion of matches, and the variance of a coordinate about it, at least `least`.
fn fit_motion(matches: &[&Correspondence], least: f64) -> Option<(Motion<f64, 3>, f64)> {
    let samples = matches.iter().map(|m| sample(m));
    // In the first round all weights are equal.
    let rounds = (0..ROUNDS).map(|round| {
        Round::new(if round == 0 { Scale::Variance(f64::INFINITY) } else { Scale::Median { least } })
    });
    let motion = fit(samples.clone(), Motion(Matrix2x3::zeros()), FIT_LOSS, rounds)?;
    let variance = motion.variance(samples, least, &mut Vec::new());
    variance.is_finite().then_some((motion, variance))
}

fn sample(m: &Correspondence) -> Sample<f64, 3> {
    Sample::new(affine(m.from), displacement(m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::random::Random;
    use nalgebra::Matrix2;

    const WIDTH: f64 = 800.0;
    const HEIGHT: f64 = 600.0;
    const NOISE: f64 = 0.03;

    fn overlay() -> StaticOverlay {
        StaticOverlay::new(WIDTH as usize, HEIGHT as usize, NOISE)
    }

    /// A pair of frames in which each point of a grid is displaced by `motion` and noise.
    fn pair(seed: u64, motion: impl Fn(Vector2<f64>) -> Vector2<f64>) -> Vec<Correspondence> {
        let mut random = Random(seed);
        let mut at = |index: usize| {
            let place = Vector2::new((index % 32) as f64 + 0.5, (index / 32) as f64 + 0.5) * 25.0;
            let error = Vector2::new(random.normal(), random.normal()) * NOISE;
            Correspondence {
                from: place,
                to: place + motion(place) + error,
                texture: 100.0,
                residual: 1.0,
                covariance: Matrix2::zeros(),
            }
        };
        (0..32 * 24).map(&mut at).collect()
    }

    /// Matches at rest, and others, that are taken for the scene.
    fn kept(
        overlay: &mut StaticOverlay,
        found: &[Correspondence],
        at_rest: impl Fn(Vector2<f64>) -> bool,
    ) -> [usize; 2] {
        let mut scene = Vec::new();
        overlay.remove(found, &mut scene);
        let still = scene.iter().filter(|m| at_rest(m.from)).count();
        [still, scene.len() - still]
    }

    fn is_caption(point: Vector2<f64>) -> bool {
        (500.0..550.0).contains(&point.y)
    }

    fn captioned(seed: u64, motion: Vector2<f64>) -> Vec<Correspondence> {
        pair(seed, |point| if is_caption(point) { Vector2::zeros() } else { motion + 0.004 * (point.yx()) })
    }

    #[test]
    fn a_caption_is_removed_at_once_and_remembered() {
        let mut overlay = overlay();
        assert_eq!(kept(&mut overlay, &captioned(1, Vector2::new(4.0, -2.0)), is_caption), [0, 22 * 32]);
        // A camera at rest changes no odds.
        let still = pair(2, |_| Vector2::zeros());
        assert_eq!(kept(&mut overlay, &still, is_caption), [0, 22 * 32]);
    }

    #[test]
    fn a_bonnet_over_more_than_half_of_the_picture_is_removed() {
        let mut overlay = overlay();
        let is_bonnet = |point: Vector2<f64>| point.y > 275.0;
        let seen = pair(3, |point| Vector2::new(-4.0, 3.0) * if is_bonnet(point) { 0.0 } else { 1.0 });
        assert_eq!(kept(&mut overlay, &seen, is_bonnet), [0, 11 * 32]);
    }

    #[test]
    fn a_cell_that_moves_again_is_scene() {
        let mut overlay = overlay();
        let all = 24 * 32;
        for seed in 0..10 {
            kept(&mut overlay, &captioned(seed, Vector2::new(4.0, -2.0)), is_caption);
        }
        for seed in 10..12 {
            kept(&mut overlay, &pair(seed, |_| Vector2::new(3.0, 3.0)), is_caption);
        }
        let kept = kept(&mut overlay, &pair(12, |_| Vector2::new(-3.0, 3.0)), is_caption);
        assert_eq!(kept.iter().sum::<usize>(), all);
    }

    #[test]
    fn the_middle_of_a_turn_is_no_caption() {
        let mut overlay = overlay();
        let centre = Vector2::new(412.0, 312.0);
        let turn = |point: Vector2<f64>| Vector2::new(centre.y - point.y, point.x - centre.x) * 0.03;
        for seed in 0..20 {
            assert_eq!(kept(&mut overlay, &pair(seed, turn), |_| false), [0, 24 * 32]);
        }
    }

    #[test]
    fn motion_before_a_still_camera_makes_no_caption() {
        let mut overlay = overlay();
        // A bus over nearly half of the picture, or water with a random displacement of each point, over most.
        let is_bus = |point: Vector2<f64>| point.x < 550.0 && (50.0..500.0).contains(&point.y);
        let bus = |point: Vector2<f64>| Vector2::new(if is_bus(point) { 5.0 } else { 0.0 }, 0.0);
        for seed in 0..20 {
            assert_eq!(kept(&mut overlay, &pair(seed, bus), |_| false), [0, 24 * 32]);
        }
        for seed in 0..20 {
            let mut random = Random(100 + seed);
            let water: Vec<Correspondence> = pair(seed, |_| Vector2::zeros())
                .into_iter()
                .map(|mut m| {
                    if m.from.y < 400.0 {
                        m.to += Vector2::new(random.normal(), random.normal()) * 3.0;
                    }
                    m
                })
                .collect();
            assert_eq!(kept(&mut overlay, &water, |_| false), [0, 24 * 32]);
        }
    }

    #[test]
    fn points_outside_of_the_frame_are_the_scene() {
        let mut found = captioned(1, Vector2::new(4.0, -2.0));
        for (m, x) in found.iter_mut().zip([-50.0, f64::NAN, 1e300, f64::INFINITY]) {
            m.from.x = x;
        }
        let mut scene = Vec::new();
        overlay().remove(&found, &mut scene);
        assert!(scene.len() >= 4);
        overlay().remove(&[], &mut scene);
        assert!(scene.is_empty());
    }
}
