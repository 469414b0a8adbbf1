// SPDX-License-Identifier: MIT OR Apache-2.0

//! Innovations: residuals given those of the same points in the pair before.
//!
//! A point at another depth than the path's has the residual r = (λ − 1)·w + noise, λ its inverse depth over
//! the path's and w its displacement by the path's translations. One pair does not distinguish this from an
//! error of the path; over two pairs λ is the same. So a residual is compared with its prediction from the
//! pair before:
//!
//! e = rᵢ − B·rⱼ, B = Cᵢⱼ·Cⱼⱼ⁻¹, with covariance V = Cᵢᵢ − B·Cⱼᵢ,
//!
//! where Cᵢⱼ = τ²·wᵢ·wⱼᵀ (+ σ²·I for i = j), j the pair before: the density of a Markov chain of residuals.
//! Translations thus constrain path and shutter as well as turns, at any depths.

use super::pair_residuals::PairResiduals;
use super::residual::MatchResidual;
use crate::robust::median::weighted_variance_of;
use nalgebra::{Matrix2, Vector2};

/// Greatest standard deviation τ of λ: half the usual inverse depth of the scene.
const MAX_DEPTH_DEVIATION: f64 = 0.5;
/// Greatest λ.
const MAX_DEPTH: f64 = 3.0;
/// Rounds of the alternation between σ² and τ².
const ROUNDS: usize = 3;

/// Variances of a pair's residuals.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ResidualVariances {
    /// σ² in px².
    pub noise: f64,
    /// τ², the variance of λ; 0 if there is no parallax.
    pub depth: f64,
}

/// A residual less its prediction from the pair before.
#[derive(Clone, Copy, Debug)]
pub struct Innovation {
    /// e, in pixels.
    pub error: Vector2<f64>,
    /// B.
    pub gain: Matrix2<f64>,
    /// V⁻¹.
    pub weight: Matrix2<f64>,
    /// Mean of λ given both residuals.
    pub depth: f64,
}

/// Sums of wᵀr and |w|² over a residual, or over both that a track joins.
#[derive(Clone, Copy, Debug)]
struct Joint {
    product: f64,
    length: f64,
}

impl Joint {
    fn of(one: &MatchResidual) -> Self {
        Self { product: one.parallax.dot(&one.residual), length: one.parallax.norm_squared() }
    }

    /// |r|² − σ²·rᵀ·C⁻¹·r, C = τ²·w·wᵀ + σ²·I.
    fn explained(self, variances: &ResidualVariances) -> f64 {
        variances.depth * self.product * self.product / (variances.noise + variances.depth * self.length)
    }
}

/// A residual and that of the match it continues, as far as variances depend on them.
#[derive(Debug)]
struct Linked {
    prior: f64,
    /// |rᵢ − rⱼ|² and |rᵢ|².
    difference: f64,
    own: f64,
    known: Joint,
    both: Joint,
}

impl Linked {
    fn of(now: &MatchResidual, before: &MatchResidual) -> Self {
        let [alone, known] = [now, before].map(Joint::of);
        Self {
            prior: now.prior,
            difference: (now.residual - before.residual).norm_squared(),
            own: now.residual.norm_squared(),
            known,
            both: Joint { product: known.product + alone.product, length: known.length + alone.length },
        }
    }

    /// σ²·eᵀ·V⁻¹·e: rᵀ·C⁻¹·r of both residuals less that of the one before.
    fn square(&self, variances: &ResidualVariances) -> f64 {
        self.own - self.both.explained(variances) + self.known.explained(variances)
    }
}

/// Memory with which variances are estimated, used again for the next pair.
#[derive(Debug, Default)]
pub struct VarianceBuffers {
    linked: Vec<Linked>,
    squares: Vec<(f64, f64)>,
}

impl ResidualVariances {
    /// Estimates σ², at least `least` px², and τ²; without parallax all is noise.
    pub fn of(
        residuals: &PairResiduals,
        least: f64,
        VarianceBuffers { linked, squares }: &mut VarianceBuffers,
    ) -> Self {
        let all = residuals.sigma * residuals.sigma;
        let mut found = Self { noise: all, depth: 0.0 };
        let Some(parallax) = residuals.parallax else { return found };
        let both = residuals.matches.iter().zip(&residuals.before);
        linked.clear();
        linked.extend(both.filter_map(|(now, before)| Some(Linked::of(now, before.as_ref()?))));
        let mut noise = |square: &dyn Fn(&Linked) -> f64, factor: f64| {
            squares.clear();
            squares.extend(linked.iter().map(|one| (square(one), one.prior)));
            (weighted_variance_of(squares) / factor).min(all).max(least)
        };
        // If the residuals are the same in both pairs, their difference is twice the noise.
        found.noise = noise(&|one| one.difference, 2.0);
        for _ in 0..ROUNDS {
            found.depth = ((all - found.noise) / parallax).min(MAX_DEPTH_DEVIATION * MAX_DEPTH_DEVIATION);
            found.noise = noise(&|one| one.square(&found), 1.0);
        }
        found
    }

    /// (`depth`·w·wᵀ + σ²·I)⁻¹ by the Sherman–Morrison formula.
    #[inline(always)]
    fn inverse(&self, depth: f64, parallax: Vector2<f64>) -> Matrix2<f64> {
        let part = depth / (self.noise + depth * parallax.norm_squared());
        (Matrix2::identity() - parallax * parallax.transpose() * part) / self.noise
    }

    /// The innovation of a residual, given the one before.
    #[inline(always)]
    pub fn innovation(&self, now: &MatchResidual, before: Option<&MatchResidual>) -> Innovation {
        // C⁻¹·r by blocks: `new` of this residual, `old` of the one before.
        let (error, gain, weight, old) = match before.filter(|_| self.depth > 0.0) {
            None => (now.residual, Matrix2::zeros(), self.inverse(self.depth, now.parallax), 0.0),
            Some(before) => {
                // τ²·wⱼᵀ·Cⱼⱼ⁻¹ = part·wⱼᵀ, and V = τ²·(1 − part·|wⱼ|²)·wᵢ·wᵢᵀ + σ²·I.
                let part = self.depth / (self.noise + self.depth * before.parallax.norm_squared());
                let gain = now.parallax * before.parallax.transpose() * part;
                let weight = self.inverse(self.noise * part, now.parallax);
                let error = now.residual - gain * before.residual;
                let known = self.inverse(self.depth, before.parallax) * before.residual;
                let old = known - gain.transpose() * (weight * error);
                (error, gain, weight, before.parallax.dot(&old))
            }
        };
        let new = now.parallax.dot(&(weight * error));
        Innovation { error, gain, weight, depth: (1.0 + self.depth * (new + old)).clamp(0.0, MAX_DEPTH) }
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

    fn one(residual: [f64; 2], parallax: [f64; 2]) -> MatchResidual {
        let measured = Match { from: Vector2::zeros(), to: Vector2::zeros(), covariance: Matrix2::zeros() };
        MatchResidual {
            measured,
            prior: 1.0,
            blocks: [0.0, 1.0],
            residual: residual.into(),
            parallax: parallax.into(),
            by_gamma: [Vector2::zeros(); 2],
            by_kappa: Vector2::zeros(),
            whitening: Matrix2::identity(),
        }
    }

    #[test]
    fn innovations_sum_to_the_joint_density() {
        let (now, before) = (one([1.3, -0.4], [2.0, 1.0]), one([0.7, 0.2], [1.5, -0.5]));
        let variances = ResidualVariances { noise: 0.09, depth: 0.25 };
        // Both residuals at once: rᵀ·C⁻¹·r is the sum of the first and of the innovation.
        let w = Vector4::new(2.0, 1.0, 1.5, -0.5);
        let r = Vector4::new(1.3, -0.4, 0.7, 0.2);
        let inverse = (w * w.transpose() * 0.25 + Matrix4::identity() * 0.09).try_inverse().unwrap();
        let new = variances.innovation(&now, Some(&before));
        let first = variances.innovation(&before, None);
        assert!((new.square() + first.square() - r.dot(&(inverse * r))).abs() < 1e-9);
        // The mean of λ given both.
        assert!((new.depth - 1.0 - 0.25 * w.dot(&(inverse * r))).abs() < 1e-9);
    }

    #[test]
    fn a_point_at_another_depth_has_no_innovation() {
        let variances = ResidualVariances { noise: 1e-6, depth: 0.25 };
        // Half as deep, λ = 2, while the camera slows down and turns aside.
        let new = variances.innovation(&one([1.0, 2.0], [1.0, 2.0]), Some(&one([3.0, 1.0], [3.0, 1.0])));
        assert!(new.error.norm() < 1e-5 && (new.depth - 2.0).abs() < 1e-5, "{new:?}");
        let alone = variances.innovation(&one([1.0, 2.0], [1.0, 2.0]), None);
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
                one(moved.map(|moved| depth * moved + noise * random.normal()), parallax)
            };
            let before = see([0.9 * parallax, 0.2 * parallax], [3.6, 0.8]);
            let now = see([parallax, 0.0], [4.0, 0.0]);
            squares.push((now.residual.norm_squared(), 1.0));
            residuals.matches.push(now);
            residuals.before.push(Some(before));
        }
        residuals.sigma = weighted_variance_of(&mut squares).sqrt();
        residuals
    }

    /// Noise and parallax of a scene, of which at least 0.01 px are noise.
    fn estimated(mut residuals: PairResiduals) -> ResidualVariances {
        let both = residuals.matches.iter().zip(residuals.before.iter().map(Option::as_ref));
        residuals.parallax = parallax(both, residuals.sigma * residuals.sigma - 1e-4, &mut Vec::new());
        ResidualVariances::of(&residuals, 1e-4, &mut VarianceBuffers::default())
    }

    #[test]
    fn noise_is_separated_from_parallax() {
        let variances = estimated(scene(0.4, 0.1, 4.0));
        let noise = variances.noise.sqrt();
        assert!((0.08..0.12).contains(&noise) && variances.depth > 0.0, "{noise}");
    }

    #[test]
    fn residuals_beyond_parallax_are_noise() {
        // The path's translation explains a tenth of the displacements, and τ is a half at most.
        let residuals = scene(0.4, 0.1, 0.4);
        let all = residuals.sigma * residuals.sigma;
        let variances = estimated(residuals);
        assert!(
            variances.noise > 0.75 * all && variances.depth == MAX_DEPTH_DEVIATION * MAX_DEPTH_DEVIATION,
            "{variances:?} of {all}"
        );
        let mut lost = scene(0.4, 0.1, 4.0);
        lost.before.iter_mut().step_by(3).for_each(|before| *before = None);
        assert!(estimated(lost.clone()).depth > 0.0, "two thirds of the tracks are enough");
        lost.before.fill(None);
        assert_eq!(estimated(lost).depth, 0.0);
    }
}
