// SPDX-License-Identifier: MIT OR Apache-2.0

//! The dominant motion of a pair, by least median of squares.
//!
//! A path describes one motion; fitted to two, it bends between them. So matches of the scene and of moving
//! objects are separated before any path is known: of affine motions through three matches, the one with the
//! least median of squared residuals (P. J. Rousseeuw, *Least median of squares regression*, JASA 79(388),
//! 1984), refined to a motion quadratic in the point, which approximates perspective, rotation and the
//! shutter between two frames.
//!
//! The weight of a match grows with its squared distance from the centre, as the background surrounds moving
//! objects. Matches that were outliers in the pair before are not eligible.

use super::matches::Match;
use crate::robust::loss::GemanMcClure;
use crate::robust::median::median;
use crate::robust::motion::{
    Motion, QUADRATIC_TERMS, Quadratic, ROUNDS, Round, Sample, Scale, fit, quadratic,
};
use nalgebra::{Matrix2x3, Matrix3, SMatrix};

/// Size of the sample that is drawn, with replacement, by weight.
const DRAWS: f64 = 128.0;
/// Weight of a match at the centre, in squared radii.
const CENTRE_WEIGHT: f64 = 0.2;
/// Affine motions that are tried. With half of the matches inliers, 1 of 8 is through inliers only.
const TRIALS: usize = 64;
/// How many of them, the best, are refined to quadratic motions.
const FINALISTS: usize = 6;
/// The loss by which they are refined: weight ¼ at two standard deviations.
const LOSS: GemanMcClure = GemanMcClure(4.0);
/// Least standard deviation of inliers, as a share of the median displacement: error of the quadratic model.
const MODEL_ERROR: f64 = 0.02;
/// Matches with residuals beyond this many standard deviations are outliers.
const OUTLIER_DEVIATIONS: f64 = 5.0;
/// If fewer than this share of the matches are eligible, all are.
const MIN_ELIGIBLE: f64 = 0.25;
/// Keeps the quadratic through collinear points finite.
const RIDGE: f64 = 1e-3;
/// Steps of a low-discrepancy sequence in the unit cube: powers of the root of x⁴ = x + 1 (M. Roberts, 2018).
const R3_STEPS: [f64; 3] = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_2];

type Draw = Sample<f64, QUADRATIC_TERMS>;

/// The displacement of the scene as a function of the point, in radii.
#[derive(Clone, Debug)]
pub struct DominantMotion {
    /// Displacement in radii.
    pub motion: Quadratic,
    /// The greatest squared residual of an inlier.
    max_square: f64,
}

fn sample(m: &Match) -> Draw {
    Sample::new(quadratic(m.from), m.displacement())
}

impl DominantMotion {
    /// The motion of the eligible matches.
    pub fn of(matches: &[Match], eligible: &[bool]) -> Self {
        let chosen: Vec<&Match> =
            matches.iter().zip(eligible).filter(|(_, is)| **is).map(|(m, _)| m).collect();
        let are_enough = chosen.len() as f64 >= MIN_ELIGIBLE * matches.len() as f64;
        let draws = if are_enough { draw(&chosen) } else { draw(&matches.iter().collect::<Vec<_>>()) };
        let mut squares: Vec<f64> = draws.iter().map(|draw| draw.displacement.norm_squared()).collect();
        let least = MODEL_ERROR * MODEL_ERROR * median(&mut squares);
        let mut variance = |motion: &Quadratic| motion.variance(draws.iter().copied(), least, &mut squares);
        let mut tried: Vec<(f64, Quadratic)> =
            (0..TRIALS).filter_map(|trial| affine(&draws, trial)).map(|m| (variance(&m), m)).collect();
        tried.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut best = (f64::INFINITY, Motion(SMatrix::zeros()));
        for (mut least, mut motion) in tried.into_iter().take(FINALISTS) {
            for _ in 0..ROUNDS {
                let round = Round { scale: Scale::Variance(least), ridge: [RIDGE; QUADRATIC_TERMS] };
                let Some(refined) = fit(draws.iter().copied(), motion, LOSS, [round]) else { break };
                let variance = variance(&refined);
                if variance >= least {
                    break;
                }
                (least, motion) = (variance, refined);
            }
            if least < best.0 {
                best = (least, motion);
            }
        }
        let (variance, motion) = best;
        Self { motion, max_square: 2.0 * OUTLIER_DEVIATIONS * OUTLIER_DEVIATIONS * variance }
    }

    pub fn is_inlier(&self, m: &Match) -> bool {
        self.motion.square(&sample(m)) <= self.max_square
    }
}

/// Systematic sampling by weight.
fn draw(matches: &[&Match]) -> Vec<Draw> {
    let weight = |m: &Match| CENTRE_WEIGHT + m.from.norm_squared();
    let total: f64 = matches.iter().map(|m| weight(m)).sum();
    let mut sum = 0.5;
    let mut draws = Vec::new();
    for m in matches {
        let before = f64::floor(sum);
        sum += DRAWS * weight(m) / total;
        draws.extend(std::iter::repeat_n(sample(m), (sum.floor() - before) as usize));
    }
    draws
}

/// The affine motion through three draws.
fn affine(draws: &[Draw], trial: usize) -> Option<Quadratic> {
    let at = |step: f64| draws.get(((0.5 + step * trial as f64).fract() * draws.len() as f64) as usize);
    let [a, b, c] = R3_STEPS.map(at);
    let three = [*a?, *b?, *c?];
    let points = Matrix3::from_columns(&three.map(|draw| draw.terms.fixed_resize(0.0)));
    let affine = Matrix2x3::from_columns(&three.map(|draw| draw.displacement)) * points.try_inverse()?;
    Some(Motion(affine.fixed_resize(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::random::Random;
    use nalgebra::{Matrix2, Vector2};

    /// Matches that rotate and accelerate with the row; those within `side` of the centre along both axes are
    /// displaced by `own` more.
    fn scene(side: f64, own: Vector2<f64>) -> Vec<Match> {
        let mut random = Random(7);
        let mut point = || {
            let [x, y] = [1.0, 0.75].map(|size| size * (2.0 * random.uniform() - 1.0));
            let from = Vector2::new(x, y);
            let scene = Vector2::new(0.1 - 0.02 * y + 0.01 * y * y, 0.03 + 0.02 * x);
            let error = Vector2::new(random.normal(), random.normal()) * 3e-4;
            let is_inside = x.abs() < side && y.abs() < side;
            Match {
                from,
                to: from + scene + error + if is_inside { own } else { Vector2::zeros() },
                covariance: Matrix2::zeros(),
            }
        };
        (0..300).map(|_| point()).collect()
    }

    fn inliers(matches: &[Match], eligible: &[bool]) -> impl Iterator<Item = bool> {
        let dominant = DominantMotion::of(matches, eligible);
        matches.iter().map(move |m| dominant.is_inlier(m))
    }

    fn is_inside(m: &Match, side: f64) -> bool {
        m.from.x.abs() < side && m.from.y.abs() < side
    }

    #[test]
    fn a_moving_object_is_separated_from_the_scene() {
        // A square of 1.2 × 1.2 of a picture of 2 × 1.5: nearly half of it.
        let matches = scene(0.6, Vector2::new(0.04, -0.02));
        let inside = matches.iter().map(|m| is_inside(m, 0.6));
        let wrong =
            inliers(&matches, &[true; 300]).zip(inside).filter(|(holds, inside)| holds == inside).count();
        assert!(wrong <= 3, "{wrong}");
    }

    #[test]
    fn outliers_of_the_pair_before_are_not_eligible() {
        // 1.46 × 1.5 of 2 × 1.5: most of the picture, by weight, too.
        let matches = scene(0.73, Vector2::new(0.04, -0.02));
        let inside = matches.iter().map(|m| is_inside(m, 0.73));
        for (of_inside, eligible) in
            [(true, vec![true; 300]), (false, inside.clone().map(|inside| !inside).collect())]
        {
            let wrong = inliers(&matches, &eligible)
                .zip(inside.clone())
                .filter(|(holds, inside)| *holds != (*inside == of_inside));
            assert!(wrong.count() <= 6, "{of_inside}");
        }
    }

    #[test]
    fn a_single_motion_has_no_outliers() {
        let matches = scene(0.0, Vector2::zeros());
        assert!(inliers(&matches, &[true; 300]).all(|holds| holds));
        let still: Vec<Match> = matches.iter().map(|m| Match { to: m.from, ..*m }).collect();
        assert!(inliers(&still, &[true; 300]).all(|holds| holds));
        // Points on a line do not determine a quadratic.
        let line: Vec<Match> =
            matches.iter().map(|m| Match { from: m.from.component_mul(&Vector2::x()), ..*m }).collect();
        assert_eq!(inliers(&line, &[true; 300]).count(), 300);
    }
}
