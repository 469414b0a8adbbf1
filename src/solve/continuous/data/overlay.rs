//! What is fixed to the frame, whatever the camera does: a timestamp, a logo, the bonnet below a dashcam.
//!
//! It stands still to a fraction of a pixel where all around it moves, and a fit takes it for a part of the scene at
//! which the camera was at rest, always in the same rows: that looks like a shutter. Where the picture is fixed is
//! learnt cell by cell, pair by pair. A match is as likely as Student's t (ν = 3) says of its distance from rest if it is
//! fixed, and of its distance from the motion around if it is not; each in units of its own spread and without regard to
//! that spread, so that a motion that is at rest there, or may be, says nothing.

use crate::correspond::Correspondence;
use crate::robust::loss::{GemanMcClure, Loss, StudentT};
use crate::robust::motion::{Motion, Round, Sample, Scale, affine, fit};
use nalgebra::{Matrix2x3, Vector2};

/// Cells across the frame.
const COLUMNS: usize = 32;
/// Rows of cells, at most, however narrow the frame.
const MOST_ROWS: usize = 8 * COLUMNS;
/// What is fixed is found to move by so many times the noise of measurement, for it covers what moves behind it.
const UNSTEADY: f64 = 5.0;
/// What moves by more than so many times that, moves.
const MOVES: f64 = 4.0;
/// It takes so much of the matches, and of the columns of cells, for what moves to be the scene before a moving camera:
/// what walks by a camera at rest fills less of the width.
const QUORUM: f64 = 1.0 / 3.0;
const BREADTH: f64 = 0.75;
/// The logarithm of the odds that a cell is fixed before anything was seen of it, and how far they go.
const PRIOR: f64 = -3.0;
const FARTHEST: f64 = 8.0;
/// Degrees of freedom of Student's t.
const FREEDOM: i32 = 3;
/// Rounds in which the motion of what moves is fitted, all weights being equal in the first.
const ROUNDS: usize = 4;
/// The loss of these rounds: a match two deviations off counts a quarter.
const FIT_LOSS: GemanMcClure = GemanMcClure(4.0);

/// Where the picture is fixed to the frame.
#[derive(Debug)]
pub struct StaticOverlay {
    /// Pixels from cell to cell.
    cell: f64,
    /// Logarithms of the odds that a cell is fixed, row by row.
    odds: Vec<f64>,
    /// Spread in pixels of the displacements of what is fixed.
    spread: f64,
}

impl StaticOverlay {
    /// For frames of `width` × `height` pixels, whose points have this standard deviation in pixels.
    pub fn new(width: usize, height: usize, noise: f64) -> Self {
        let cell =
            (width as f64 / COLUMNS as f64).max(height as f64 / MOST_ROWS as f64).max(1.0 / COLUMNS as f64);
        let rows = (height as f64 / cell).ceil() as usize;
        Self { cell, odds: vec![PRIOR; COLUMNS * rows], spread: UNSTEADY * noise }
    }

    /// Learns from the matches of a pair and leaves those of the scene in `scene`: all, where too few would be left.
    pub fn part(&mut self, found: &[Correspondence], scene: &mut Vec<Correspondence>) {
        self.learn(found);
        scene.clear();
        scene.extend(found.iter().filter(|m| !self.is_fixed(m)));
        if (scene.len() as f64) < QUORUM * found.len() as f64 {
            scene.clear();
            scene.extend_from_slice(found);
        }
    }

    fn is_fixed(&self, m: &Correspondence) -> bool {
        self.index(m).and_then(|index| self.odds.get(index)).is_some_and(|odds| *odds > 0.0)
    }

    /// The cell that a match sets out from.
    fn index(&self, m: &Correspondence) -> Option<usize> {
        let [column, row] = [m.from.x, m.from.y].map(|pixel| (pixel + 0.5) / self.cell);
        let is_inside = column >= 0.0 && column < COLUMNS as f64 && row >= 0.0 && row < MOST_ROWS as f64;
        is_inside.then(|| row as usize * COLUMNS + column as usize)
    }

    /// Share of the columns that some matches set out from.
    fn columns_of(&self, matches: &[&Correspondence]) -> f64 {
        let mut seen = [false; COLUMNS];
        for index in matches.iter().filter_map(|m| self.index(m)) {
            seen[index % COLUMNS] = true;
        }
        seen.iter().filter(|seen| **seen).count() as f64 / COLUMNS as f64
    }

    fn learn(&mut self, found: &[Correspondence]) {
        let least = (MOVES * self.spread).powi(2);
        let moved: Vec<&Correspondence> =
            found.iter().filter(|m| displacement(m).norm_squared() > least).collect();
        if (moved.len() as f64) < QUORUM * found.len() as f64 || self.columns_of(&moved) < BREADTH {
            return;
        }
        let still = self.spread * self.spread;
        let Some(around) = Around::of(&moved, still) else { return };
        let loss = StudentT::<FREEDOM>;
        for m in found {
            let fixed = loss.log_likelihood(displacement(m).norm_squared() / still);
            let moves = loss.log_likelihood(around.motion.square(&sample(m)) / around.variance);
            if let Some(odds) = self.index(m).and_then(|index| self.odds.get_mut(index)) {
                *odds = (*odds + fixed - moves).clamp(-FARTHEST, FARTHEST);
            }
        }
    }
}

fn displacement(m: &Correspondence) -> Vector2<f64> {
    m.to - m.from
}

/// An affine motion that most of some matches share, and how far they are off.
#[derive(Debug)]
struct Around {
    motion: Motion<f64, 3>,
    /// Of a coordinate.
    variance: f64,
}

impl Around {
    /// The fit to some matches; the variance is at least `least`.
    fn of(matches: &[&Correspondence], least: f64) -> Option<Self> {
        let samples = matches.iter().map(|m| sample(m));
        let rounds = (0..ROUNDS).map(|round| {
            let scale = if round == 0 { Scale::Variance(f64::INFINITY) } else { Scale::Median { least } };
            Round { scale, ridge: [0.0; 3] }
        });
        let motion = fit(samples.clone(), Motion(Matrix2x3::zeros()), FIT_LOSS, rounds)?;
        let variance = motion.variance(samples, least, &mut Vec::new());
        variance.is_finite().then_some(Self { motion, variance })
    }
}

fn sample(m: &Correspondence) -> Sample<f64, 3> {
    Sample { terms: affine(m.from), displacement: displacement(m), weight: 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::random::Random;
    use nalgebra::Matrix2;

    const WIDTH: f64 = 800.0;
    const HEIGHT: f64 = 600.0;
    const NOISE: f64 = 0.03;

    fn fixed() -> StaticOverlay {
        StaticOverlay::new(WIDTH as usize, HEIGHT as usize, NOISE)
    }

    /// A pair of frames in which each point of a grid moves as `motion` says, and a little at random.
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

    /// How many matches of those that are at rest, and of the others, are taken for the scene's.
    fn kept(
        fixed: &mut StaticOverlay,
        found: &[Correspondence],
        at_rest: impl Fn(Vector2<f64>) -> bool,
    ) -> [usize; 2] {
        let mut scene = Vec::new();
        fixed.part(found, &mut scene);
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
    fn a_caption_is_told_from_the_scene_at_once_and_remembered() {
        let mut fixed = fixed();
        assert_eq!(kept(&mut fixed, &captioned(1, Vector2::new(4.0, -2.0)), is_caption), [0, 22 * 32]);
        // A camera at rest says nothing.
        let still = pair(2, |_| Vector2::zeros());
        assert_eq!(kept(&mut fixed, &still, is_caption), [0, 22 * 32]);
    }

    #[test]
    fn a_bonnet_over_more_than_half_of_the_picture_is_told() {
        let mut fixed = fixed();
        let is_bonnet = |point: Vector2<f64>| point.y > 275.0;
        let seen = pair(3, |point| Vector2::new(-4.0, 3.0) * if is_bonnet(point) { 0.0 } else { 1.0 });
        assert_eq!(kept(&mut fixed, &seen, is_bonnet), [0, 11 * 32]);
    }

    #[test]
    fn what_moves_again_is_the_scene() {
        let mut fixed = fixed();
        let all = 24 * 32;
        for seed in 0..10 {
            kept(&mut fixed, &captioned(seed, Vector2::new(4.0, -2.0)), is_caption);
        }
        for seed in 10..12 {
            kept(&mut fixed, &pair(seed, |_| Vector2::new(3.0, 3.0)), is_caption);
        }
        let kept = kept(&mut fixed, &pair(12, |_| Vector2::new(-3.0, 3.0)), is_caption);
        assert_eq!(kept.iter().sum::<usize>(), all);
    }

    #[test]
    fn the_middle_of_a_turn_is_no_caption() {
        let mut fixed = fixed();
        let centre = Vector2::new(412.0, 312.0);
        let turn = |point: Vector2<f64>| Vector2::new(centre.y - point.y, point.x - centre.x) * 0.03;
        for seed in 0..20 {
            assert_eq!(kept(&mut fixed, &pair(seed, turn), |_| false), [0, 24 * 32]);
        }
    }

    #[test]
    fn a_still_camera_sees_no_caption_where_something_moves() {
        let mut fixed = fixed();
        // A bus over nearly half of the picture, or water whose every point goes its own way, over most.
        let is_bus = |point: Vector2<f64>| point.x < 550.0 && (50.0..500.0).contains(&point.y);
        let bus = |point: Vector2<f64>| Vector2::new(if is_bus(point) { 5.0 } else { 0.0 }, 0.0);
        for seed in 0..20 {
            assert_eq!(kept(&mut fixed, &pair(seed, bus), |_| false), [0, 24 * 32]);
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
            assert_eq!(kept(&mut fixed, &water, |_| false), [0, 24 * 32]);
        }
    }

    #[test]
    fn points_outside_of_the_frame_are_the_scene() {
        let mut found = captioned(1, Vector2::new(4.0, -2.0));
        for (m, x) in found.iter_mut().zip([-50.0, f64::NAN, 1e300, f64::INFINITY]) {
            m.from.x = x;
        }
        let mut scene = Vec::new();
        fixed().part(&found, &mut scene);
        assert!(scene.len() >= 4);
        fixed().part(&[], &mut scene);
        assert!(scene.is_empty());
    }
}
