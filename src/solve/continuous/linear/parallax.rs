//! What a point does in one pair of frames and again in the next.
//!
//! A point off the depth for which the path stands is left over by it, and in the next pair again:
//! r = (λ − 1)·w + noise, λ its inverse depth over that of the path, w what the path's translations move it by.
//! Over one pair nothing tells that from an error of the path; over two, λ is the same. So a residual is
//! compared with its prediction from the pair before:
//!
//! e = rᵢ − B·rⱼ, B = Cᵢⱼ·Cⱼⱼ⁻¹, with covariance V = Cᵢᵢ − B·Cⱼᵢ,
//!
//! where Cᵢⱼ = τ²·wᵢ·wⱼᵀ, and the noise σ²·I on top for i = j, j the pair before. It is the density of a
//! chain of residuals, each given the one before. A camera that moves before a scene of any depth thus says
//! as much of its path and its shutter as one that turns.

use super::pair_residuals::PairResiduals;
use super::residual::Leg;
use crate::robust::median::{MEDIAN_TO_VARIANCE, weighted_median};
use nalgebra::{Matrix2, Vector2};

/// Standard deviation τ of λ at most: inverse depths spread by half of what is usual in the scene.
const DEPTHS: f64 = 0.5;
/// What λ may be.
const NEAREST: f64 = 3.0;
/// Rounds in which the noise is told from the parallax.
const ROUNDS: usize = 3;

/// Variances of a pair's residuals.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scatter {
    /// σ² in px².
    pub noise: f64,
    /// τ²; 0 where the residuals are no parallax.
    pub depths: f64,
}

/// What is new in a residual.
#[derive(Clone, Copy, Debug)]
pub struct Innovation {
    pub error: Vector2<f64>,
    /// What is expected for each pixel of the residual before: B.
    pub share: Matrix2<f64>,
    /// V⁻¹.
    pub weight: Matrix2<f64>,
    /// λ, as both residuals have it.
    pub depth: f64,
}

/// What (wᵀr)² and |w|² are, r and w being residual and parallax of a match, or of both that a track joins.
#[derive(Clone, Copy)]
struct Joint {
    product: f64,
    length: f64,
}

impl Joint {
    fn of(leg: &Leg) -> Self {
        Self { product: leg.parallax.dot(&leg.residual), length: leg.parallax.norm_squared() }
    }

    fn with(self, other: Self) -> Self {
        Self { product: self.product + other.product, length: self.length + other.length }
    }

    /// By how much parallax makes rᵀ·C⁻¹·r less than |r|²/σ², times σ²; C = τ²·w·wᵀ + σ²·I.
    fn explained(self, scatter: &Scatter) -> f64 {
        scatter.depths * self.product * self.product / (scatter.noise + scatter.depths * self.length)
    }
}

impl Scatter {
    /// Tells the noise of a pair, at least `least` px², from its parallax; all is noise where that has no say.
    pub fn of(residuals: &PairResiduals, least: f64, squares: &mut Vec<(f64, f64)>) -> Self {
        let all = residuals.sigma * residuals.sigma;
        let mut scatter = Self { noise: all, depths: 0.0 };
        let Some(parallax) = residuals.parallax else { return scatter };
        let both = || {
            residuals
                .legs
                .iter()
                .zip(&residuals.before)
                .filter_map(|(now, before)| Some((now, before.as_ref()?)))
        };
        // Were the residuals the same from pair to pair, their difference would be noise, twice.
        squares.clear();
        squares
            .extend(both().map(|(now, before)| ((now.residual - before.residual).norm_squared(), now.prior)));
        scatter.noise = (weighted_median(squares) * MEDIAN_TO_VARIANCE / 2.0).min(all).max(least);
        for _ in 0..ROUNDS {
            scatter.depths = ((all - scatter.noise) / parallax).min(DEPTHS * DEPTHS);
            squares.clear();
            squares.extend(both().map(|(now, before)| (scatter.square(now, before), now.prior)));
            scatter.noise = (weighted_median(squares) * MEDIAN_TO_VARIANCE).min(all).max(least);
        }
        scatter
    }

    /// σ²·eᵀ·V⁻¹·e of what is new in a residual: what both take of rᵀ·C⁻¹·r, less what the one before does.
    fn square(&self, now: &Leg, before: &Leg) -> f64 {
        let known = Joint::of(before);
        let both = known.with(Joint::of(now));
        now.residual.norm_squared() - both.explained(self) + known.explained(self)
    }

    /// (τ²·w·wᵀ + σ²·I)⁻¹ by Sherman and Morrison's formula.
    #[inline(always)]
    fn inverse(&self, depths: f64, parallax: Vector2<f64>) -> Matrix2<f64> {
        let part = depths / (self.noise + depths * parallax.norm_squared());
        (Matrix2::identity() - parallax * parallax.transpose() * part) / self.noise
    }

    /// What is new in a residual, given the one before.
    #[inline(always)]
    pub fn innovation(&self, now: &Leg, before: Option<&Leg>) -> Innovation {
        // C⁻¹·r by blocks: `new` the part of this residual, `old` that of the one before.
        let (error, share, weight, old) = match before.filter(|_| self.depths > 0.0) {
            None => (now.residual, Matrix2::zeros(), self.inverse(self.depths, now.parallax), 0.0),
            Some(before) => {
                // τ²·wⱼᵀ·Cⱼⱼ⁻¹ = part·wⱼᵀ, and V = τ²·(1 − part·|wⱼ|²)·wᵢ·wᵢᵀ + σ²·I.
                let part = self.depths / (self.noise + self.depths * before.parallax.norm_squared());
                let share = now.parallax * before.parallax.transpose() * part;
                let weight = self.inverse(self.noise * part, now.parallax);
                let error = now.residual - share * before.residual;
                let known = self.inverse(self.depths, before.parallax) * before.residual;
                let old = known - share.transpose() * (weight * error);
                (error, share, weight, before.parallax.dot(&old))
            }
        };
        let new = now.parallax.dot(&(weight * error));
        Innovation { error, share, weight, depth: (1.0 + self.depths * (new + old)).clamp(0.0, NEAREST) }
    }
}

impl Innovation {
    /// eᵀ·V⁻¹·e.
    #[inline(always)]
    pub fn square(&self) -> f64 {
        self.error.dot(&(self.weight * self.error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::continuous::data::Match;
    use crate::solve::continuous::linear::pair_residuals::parallax;
    use crate::solve::random::Random;
    use nalgebra::{Matrix4, Vector4};

    fn leg(residual: [f64; 2], parallax: [f64; 2]) -> Leg {
        let m = Match { from: Vector2::zeros(), to: Vector2::zeros(), covariance: Matrix2::zeros() };
        Leg {
            m,
            prior: 1.0,
            times: [0.0, 1.0],
            residual: residual.into(),
            parallax: parallax.into(),
            by_readout: [Vector2::zeros(); 2],
            by_kappa: Vector2::zeros(),
            whitening: Matrix2::identity(),
        }
    }

    #[test]
    fn what_is_new_completes_what_the_residual_before_said() {
        let (now, before) = (leg([1.3, -0.4], [2.0, 1.0]), leg([0.7, 0.2], [1.5, -0.5]));
        let scatter = Scatter { noise: 0.09, depths: 0.25 };
        // Both residuals at once: rᵀ·C⁻¹·r is the sum of what the first says and of what is new.
        let w = Vector4::new(2.0, 1.0, 1.5, -0.5);
        let r = Vector4::new(1.3, -0.4, 0.7, 0.2);
        let inverse = (w * w.transpose() * 0.25 + Matrix4::identity() * 0.09).try_inverse().unwrap();
        let new = scatter.innovation(&now, Some(&before));
        let first = scatter.innovation(&before, None);
        assert!((new.square() + first.square() - r.dot(&(inverse * r))).abs() < 1e-9);
        // The mean of λ given both.
        assert!((new.depth - 1.0 - 0.25 * w.dot(&(inverse * r))).abs() < 1e-9);
    }

    #[test]
    fn a_point_at_another_depth_is_nothing_new() {
        let scatter = Scatter { noise: 1e-6, depths: 0.25 };
        // Half as deep, λ = 2, while the camera slows down and turns aside.
        let new = scatter.innovation(&leg([1.0, 2.0], [1.0, 2.0]), Some(&leg([3.0, 1.0], [3.0, 1.0])));
        assert!(new.error.norm() < 1e-5 && (new.depth - 2.0).abs() < 1e-5, "{new:?}");
        let alone = scatter.innovation(&leg([1.0, 2.0], [1.0, 2.0]), None);
        assert_eq!(alone.error, Vector2::new(1.0, 2.0));
    }

    /// Points whose residuals are (λ − 1)·w and noise.
    fn scene(spread: f64, noise: f64, parallax: f64) -> PairResiduals {
        let mut random = Random(5);
        let mut residuals = PairResiduals::default();
        let mut squares = Vec::new();
        for _ in 0..400 {
            let depth = spread * random.normal();
            let mut see = |parallax: [f64; 2], moved: [f64; 2]| {
                leg(moved.map(|moved| depth * moved + noise * random.normal()), parallax)
            };
            let before = see([0.9 * parallax, 0.2 * parallax], [3.6, 0.8]);
            let now = see([parallax, 0.0], [4.0, 0.0]);
            squares.push((now.residual.norm_squared(), 1.0));
            residuals.legs.push(now);
            residuals.before.push(Some(before));
        }
        residuals.sigma = (weighted_median(&mut squares) * MEDIAN_TO_VARIANCE).sqrt();
        residuals
    }

    /// Noise and parallax of a scene, of which at least 0.01 px are noise.
    fn told(mut residuals: PairResiduals) -> Scatter {
        let both = residuals.legs.iter().zip(residuals.before.iter().map(Option::as_ref));
        residuals.parallax = parallax(both, residuals.sigma * residuals.sigma - 1e-4, &mut Vec::new());
        Scatter::of(&residuals, 1e-4, &mut Vec::new())
    }

    #[test]
    fn noise_is_told_from_parallax() {
        let scatter = told(scene(0.4, 0.1, 4.0));
        let noise = scatter.noise.sqrt();
        assert!((0.08..0.12).contains(&noise) && scatter.depths > 0.0, "{noise}");
    }

    #[test]
    fn what_cannot_be_parallax_is_noise() {
        // The path's translation explains a tenth of what the points do, and depths spread by half at most.
        let residuals = scene(0.4, 0.1, 0.4);
        let all = residuals.sigma * residuals.sigma;
        let scatter = told(residuals);
        assert!(scatter.noise > 0.75 * all && scatter.depths == DEPTHS * DEPTHS, "{scatter:?} of {all}");
        let mut lost = scene(0.4, 0.1, 4.0);
        lost.before.iter_mut().step_by(3).for_each(|before| *before = None);
        assert!(told(lost.clone()).depths > 0.0, "two thirds of the tracks are enough");
        lost.before.fill(None);
        assert_eq!(told(lost).depths, 0.0);
    }
}
