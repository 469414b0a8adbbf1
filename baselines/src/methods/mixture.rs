// SPDX-License-Identifier: MIT OR Apache-2.0

//! Homography mixture: no calibration.
//!
//! M. Grundmann, V. Kwatra, D. Castro and I. Essa, *Calibration-free rolling shutter removal*, ICCP
//! 2012. Between two frames each line has a homography of its own, H(s) = Σₖ wₖ(s) Hₖ, where s is the
//! line's share of the readout, the Hₖ belong to blocks of lines and the weights wₖ are Gaussians
//! around the blocks' middles that add up to 1. With the last entry 1 the direct linear
//! transformation is linear in all others; it is solved in normalised coordinates by iteratively
//! reweighted least squares for an L1 norm, with a penalty on the difference of neighbouring blocks.
//! Here the two perspective entries are the same in all blocks, which a few lines cannot determine.
//!
//! # From the mixture to the correction of a line
//! The source removes the rolling shutter and stabilises at once. What is judged here is the motion
//! within a frame alone, which follows from the same mixtures. H(s) takes a point p from where it is
//! when line s of frame k is read to where frame k+1 sees it: to H(s) p, whose line is read after
//! t = P + T·(s(H(s) p) − s(p)), P being the frame period and T the readout time. The mean
//! velocity over that time is v = (H(s) p − p)/t. A mixture fitted from frame k to frame k−1 gives
//! the velocity over the time before, and the mean of the two is, to second order, the velocity when
//! line s is read. A pixel is carried from its own line to the middle of the readout along
//! dp = v(s, p)·T ds. Nothing is known of the lens; of the shutter only the readout's direction and
//! time, and told the whole period the method needs no calibration at all.

use super::homography::apply;
use super::{Correction, Corrections, Input, Method};
use anyhow::Result;
use nalgebra::{Cholesky, DMatrix, DVector, Matrix3, Vector2};
use rsrectify::readout::Readout;

/// Blocks of lines.
const BLOCKS: usize = 10;
/// Standard deviation of a block's weight, as a share of the readout.
const SIGMA: f64 = 0.1;
/// Weight of the penalty on neighbouring blocks' differences, for each correspondence of a block.
const SMOOTHNESS: f64 = 0.1;
/// Rounds of reweighting.
const ROUNDS: usize = 10;
/// Fewer correspondences than this tell nothing.
const FEWEST: usize = 50;
/// Residuals below this many pixels do not gain more weight.
const LEAST_RESIDUAL: f64 = 0.05;
/// Entries of a block: two rows of its homography.
const AFFINE: usize = 6;
/// Entries of a mixture: the blocks', and two of perspective.
const UNKNOWNS: usize = BLOCKS * AFFINE + 2;
/// Steps in which a pixel is carried to the middle of the readout.
const STEPS: usize = 8;

/// The homography mixture.
pub struct HomographyMixture;

impl Method for HomographyMixture {
    fn name(&self) -> String {
        "homography-mixture".into()
    }

    fn solve(&self, input: &Input) -> Result<Corrections> {
        let count = input.stamps.len();
        let motion = |from: usize, to: usize| {
            let sights: Vec<Sight> = input.pairs[from.min(to)]
                .iter()
                .map(|found| if from < to { (found.from, found.to) } else { (found.to, found.from) })
                .collect();
            let lines = Mixture::fit(input.readout, &sights)?.lines();
            Some(Neighbour { lines, interval: input.stamps[to] - input.stamps[from] })
        };
        let correction = |k: usize| -> Box<dyn Correction> {
            let before = (k > 0).then(|| motion(k, k - 1)).flatten();
            let after = (k + 1 < count).then(|| motion(k, k + 1)).flatten();
            let neighbours = before.into_iter().chain(after).collect();
            Box::new(Unrolled { readout: input.readout, neighbours })
        };
        Ok((0..count).map(correction).collect())
    }
}

/// A point in the frame whose lines the mixture is about, and in the other one, in pixels.
type Sight = (Vector2<f64>, Vector2<f64>);

/// wₖ(s).
fn weights(share: f64) -> [f64; BLOCKS] {
    let share = share.clamp(0.0, 1.0);
    let gaussian: [f64; BLOCKS] = std::array::from_fn(|k| {
        let middle = (k as f64 + 0.5) / BLOCKS as f64;
        (-0.5 * ((share - middle) / SIGMA).powi(2)).exp()
    });
    let sum: f64 = gaussian.iter().sum();
    gaussian.map(|weight| weight / sum)
}

/// A fitted mixture.
struct Mixture {
    readout: Readout,
    /// Takes pixels to the coordinates in which it was fitted.
    normal: Matrix3<f64>,
    /// Six entries for each block, row by row, and the two of perspective.
    entries: DVector<f64>,
}

impl Mixture {
    /// Fits a mixture; `None` for too few points or points that do not determine it.
    fn fit(readout: Readout, sights: &[Sight]) -> Option<Self> {
        if sights.len() < FEWEST {
            return None;
        }
        let (normal, scale) = normalisation(sights);
        let normalised = |x| apply(&normal, x);
        let lines: Vec<_> = sights
            .iter()
            .map(|(x, y)| (weights(readout.share(x.x, x.y)), normalised(*x), normalised(*y)))
            .collect();
        let penalty = penalty(SMOOTHNESS * sights.len() as f64 / BLOCKS as f64);
        let mut importance = vec![1.0; sights.len()];
        let mut entries = DVector::zeros(UNKNOWNS);
        for _ in 0..ROUNDS {
            let mean = importance.iter().sum::<f64>() / importance.len() as f64;
            let (mut matrix, mut right) = (penalty.clone(), DVector::zeros(UNKNOWNS));
            for ((blocks, x, y), importance) in lines.iter().zip(&importance) {
                accumulate(&mut matrix, &mut right, blocks, *x, *y, importance / mean);
            }
            entries = Cholesky::new(matrix)?.solve(&right);
            for ((blocks, x, y), importance) in lines.iter().zip(&mut importance) {
                let residual = (apply(&homography(&entries, blocks), *x) - y).lp_norm(1);
                *importance = 1.0 / residual.max(LEAST_RESIDUAL * scale);
            }
        }
        Some(Self { readout, normal, entries })
    }

    /// The homography of each line in pixels, by the line's place in the readout.
    fn lines(&self) -> Vec<Matrix3<f64>> {
        let readout = &self.readout;
        let count = if readout.direction().is_by_rows() { readout.height() } else { readout.width() };
        let back = self.normal.try_inverse().unwrap_or_else(Matrix3::identity);
        let line = |i: usize| {
            let share = (i as f64 + 0.5) / count as f64;
            back * homography(&self.entries, &weights(share)) * self.normal
        };
        (0..count).map(line).collect()
    }
}

/// The homography of a line whose blocks weigh so much, in the coordinates of the fit.
fn homography(entries: &DVector<f64>, blocks: &[f64; BLOCKS]) -> Matrix3<f64> {
    let mixed = |entry: usize| -> f64 {
        blocks.iter().enumerate().map(|(k, weight)| weight * entries[k * AFFINE + entry]).sum()
    };
    let perspective = [entries[UNKNOWNS - 2], entries[UNKNOWNS - 1]];
    Matrix3::new(
        mixed(0),
        mixed(1),
        mixed(2), //
        mixed(3),
        mixed(4),
        mixed(5), //
        perspective[0],
        perspective[1],
        1.0,
    )
}

/// Hartley's normalisation, the same for both frames: the points' mean is 0, their mean distance
/// from it √2. With it, how many such units a pixel is.
fn normalisation(sights: &[Sight]) -> (Matrix3<f64>, f64) {
    let points = || sights.iter().flat_map(|(x, y)| [*x, *y]);
    let count = 2.0 * sights.len() as f64;
    let mean = points().sum::<Vector2<f64>>() / count;
    let spread = points().map(|point| (point - mean).norm()).sum::<f64>() / count;
    let scale = std::f64::consts::SQRT_2 / spread.max(1.0);
    let normal = Matrix3::new(scale, 0.0, -scale * mean.x, 0.0, scale, -scale * mean.y, 0.0, 0.0, 1.0);
    (normal, scale)
}

/// The normal matrix of the penalty `weight`·Σ ‖Hₖ₊₁ − Hₖ‖².
fn penalty(weight: f64) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(UNKNOWNS, UNKNOWNS);
    for i in 0..(BLOCKS - 1) * AFFINE {
        let j = i + AFFINE;
        matrix[(i, i)] += weight;
        matrix[(j, j)] += weight;
        matrix[(j, i)] -= weight;
    }
    matrix
}

/// Adds the two equations of a correspondence to the normal equations, of which the lower half is
/// kept: Σₖ wₖ·(row of Hₖ)·(x, 1) − y·(perspective · x) = y, for each coordinate of y.
fn accumulate(
    matrix: &mut DMatrix<f64>,
    right: &mut DVector<f64>,
    blocks: &[f64; BLOCKS],
    x: Vector2<f64>,
    y: Vector2<f64>,
    importance: f64,
) {
    for (row, y) in y.iter().enumerate() {
        let mut equation = [(0, 0.0); BLOCKS * 3 + 2];
        for (k, weight) in blocks.iter().enumerate() {
            let at = k * AFFINE + row * 3;
            for (entry, factor) in [x.x, x.y, 1.0].into_iter().enumerate() {
                equation[3 * k + entry] = (at + entry, weight * factor);
            }
        }
        equation[BLOCKS * 3] = (UNKNOWNS - 2, -y * x.x);
        equation[BLOCKS * 3 + 1] = (UNKNOWNS - 1, -y * x.y);
        for (column, (j, factor)) in equation.iter().enumerate() {
            let factor = importance * factor;
            right[*j] += factor * y;
            for (i, other) in &equation[column..] {
                matrix[(*i, *j)] += factor * other;
            }
        }
    }
}

/// The motion from a frame to one beside it.
struct Neighbour {
    /// The homography of each line, in pixels.
    lines: Vec<Matrix3<f64>>,
    /// The other frame's timestamp less this one's, in seconds.
    interval: f64,
}

impl Neighbour {
    /// Mean velocity in pixels a second of a point between the instant at which `share` of the
    /// readout has passed and when the other frame sees it.
    fn velocity(&self, readout: &Readout, share: f64, point: Vector2<f64>) -> Vector2<f64> {
        let line = (share * self.lines.len() as f64).clamp(0.0, self.lines.len() as f64 - 1.0) as usize;
        let there = apply(&self.lines[line], point);
        let later = readout.offset(there.x, there.y) - readout.offset(point.x, point.y);
        (there - point) / (self.interval + later)
    }
}

/// Carries a pixel from its line to the middle of the readout.
struct Unrolled {
    readout: Readout,
    /// None where nothing could be fitted.
    neighbours: Vec<Neighbour>,
}

impl Correction for Unrolled {
    fn correct(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        if self.neighbours.is_empty() {
            return pixel;
        }
        let velocity = |share, point| -> Vector2<f64> {
            let velocities = self.neighbours.iter().map(|n| n.velocity(&self.readout, share, point));
            velocities.sum::<Vector2<f64>>() / self.neighbours.len() as f64
        };
        let from = self.readout.share(pixel.x, pixel.y);
        let step = (0.5 - from) / STEPS as f64;
        let time = step * self.readout.time();
        (0..STEPS).fold(pixel, |point, i| {
            let share = from + step * i as f64;
            let half = point + velocity(share, point) * (time / 2.0);
            point + velocity(share + step / 2.0, half) * time
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::wall::Wall;
    use nalgebra::Vector3;
    use render::scene::FirstEdge;

    #[test]
    fn a_constant_move_past_a_wall_is_undone() {
        let moves = [
            (FirstEdge::Top, 1.0, Vector3::new(1.5, 0.0, 0.0)),
            (FirstEdge::Bottom, 0.7, Vector3::new(0.7, -1.0, 0.0)),
            (FirstEdge::Left, 0.7, Vector3::new(-0.8, 0.6, 0.0)),
        ];
        for (first, ratio, velocity) in moves {
            let left = Wall::moving(first, ratio, velocity).most_left(&HomographyMixture, 3);
            assert!(left < 0.01, "{first:?}: {left} px");
        }
    }

    #[test]
    fn a_fifth_of_wild_correspondences_does_no_harm() {
        let wall = Wall::moving(FirstEdge::Top, 1.0, Vector3::new(1.0, 0.8, 0.0));
        let mut pairs = wall.pairs(3);
        for found in pairs.iter_mut().flat_map(|pair| pair.iter_mut().step_by(5)) {
            found.to += Vector2::new(30.0, -20.0);
        }
        let (left, _) = wall.left(&HomographyMixture, &pairs);
        assert!(left.iter().all(|left| *left < 0.3), "{left:?}");
    }

    #[test]
    fn a_turn_about_a_tilted_axis_is_undone_but_for_its_curvature() {
        // The velocity of a constant turn is the same field at all times: the mean of what is
        // measured before and after differs from it by the third order of the turn only.
        let wall = Wall::turning(FirstEdge::Top, 1.0, Vector3::new(0.5, -0.4, 0.6));
        let (left, uncorrected) = wall.left(&HomographyMixture, &wall.pairs(3));
        assert!(uncorrected > 5.0 && left[1] < 0.1, "{left:?} of {uncorrected}");
    }

    #[test]
    fn weights_add_up_to_one_and_are_greatest_near_by() {
        for share in [-0.2, 0.0, 0.33, 0.5, 1.0] {
            let weights = weights(share);
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
        let weights = weights(0.45);
        // The middle of block 4; its neighbours are one standard deviation away.
        assert!((weights[3] / weights[4] - (-0.5f64).exp()).abs() < 1e-9);
        assert!((weights[5] / weights[4] - (-0.5f64).exp()).abs() < 1e-9);
    }

    #[test]
    fn without_correspondences_a_frame_is_left_as_it_is() {
        let wall = Wall::moving(FirstEdge::Top, 1.0, Vector3::new(1.0, 0.0, 0.0));
        let (left, uncorrected) = wall.left(&HomographyMixture, &[Vec::new(), Vec::new()]);
        assert!(left.iter().all(|left| (left - uncorrected).abs() < 1e-9));
    }
}
