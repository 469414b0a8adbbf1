// SPDX-License-Identifier: MIT OR Apache-2.0

//! Robust losses, with one convention. Which loss is used where: the table "Robust losses" of `CONTRIBUTING.md`.
//!
//! s = |r|²/σ² is the squared, whitened residual of a measurement of d coordinates: each of them has variance
//! 1 if the measurement belongs to the model, so that s is then about d. A fit minimises ½·Σ ρ(s), where ρ(0)
//! = 0. The logarithm of the likelihood is −½·ρ(s) and terms that do not depend on s, such as −d·ln σ. The
//! normal equations of the minimum are those of least squares in which a measurement has the weight ρ′(s), as
//! for squares ρ(s) = s. Points have d = 2.

use nalgebra::RealField;

/// A loss ρ(s) and its weight. `T` is the type of s: `f32` in the flow.
pub trait Loss<T: RealField + Copy = f64>: Copy {
    /// ρ(s): twice the cost.
    fn rho(self, s: T) -> T;

    /// The weight ρ′(s).
    #[inline(always)]
    fn weight(self, s: T) -> T {
        self.weight_times(T::one(), s)
    }

    /// `factor`·ρ′(s).
    fn weight_times(self, factor: T, s: T) -> T;

    /// −½·ρ(s): the log likelihood over that of s = 0. It does not compare different σ: see [`Density`].
    #[inline(always)]
    fn log_likelihood(self, s: T) -> T {
        -self.rho(s) / (T::one() + T::one())
    }
}

/// A loss that is the negative log density of a distribution, so that models of different σ can be compared by
/// their evidence.
pub trait Density: Loss {
    /// The log density with all that depends on σ. The factor 1/2π that densities of two coordinates have in
    /// common is left out.
    fn log_density(self, s: f64) -> f64;
}

/// ρ(s) = s: normal distribution.
#[cfg(test)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Squares;

#[cfg(test)]
impl<T: RealField + Copy> Loss<T> for Squares {
    #[inline(always)]
    fn rho(self, s: T) -> T {
        s
    }

    #[inline(always)]
    fn weight_times(self, factor: T, _: T) -> T {
        factor
    }
}

/// ρ(s) = c²·s/(c² + s), Geman & McClure, given c². The weight is a quarter at s = c². ρ is at most c²: no
/// distribution has this likelihood, and a measurement far off has no influence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GemanMcClure<T = f64>(pub T);

impl<T: RealField + Copy> Loss<T> for GemanMcClure<T> {
    #[inline(always)]
    fn rho(self, s: T) -> T {
        self.0 * s / (self.0 + s)
    }

    #[inline(always)]
    fn weight_times(self, factor: T, s: T) -> T {
        let share = self.0 / (self.0 + s);
        factor * share * share
    }
}

/// ρ(s) = (ν + 2)·ln(1 + s/ν): Student's t distribution of two coordinates with ν = `FREEDOM` degrees of
/// freedom, where σ² is its scale, not its variance. The weight at 0 is (ν + 2)/ν, and 1 at s = 2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StudentT<const FREEDOM: i32>;

impl<const FREEDOM: i32> StudentT<FREEDOM> {
    const NU: f64 = FREEDOM as f64;

    /// The density over that at 0, exp(−½·ρ(s)); at 0 it is 1/(2π·σ²) for any ν.
    #[inline(always)]
    pub fn relative_density(self, s: f64) -> f64 {
        let base = 1.0 + s / Self::NU;
        if FREEDOM % 2 == 0 { base.powi(-(FREEDOM + 2) / 2) } else { base.powf(-0.5 * (Self::NU + 2.0)) }
    }
}

impl<const FREEDOM: i32> Loss for StudentT<FREEDOM> {
    #[inline(always)]
    fn rho(self, s: f64) -> f64 {
        (Self::NU + 2.0) * (s / Self::NU).ln_1p()
    }

    #[inline(always)]
    fn weight_times(self, factor: f64, s: f64) -> f64 {
        factor * (Self::NU + 2.0) / (Self::NU + s)
    }
}

/// Mixture of inliers and outliers: [`StudentT`] with the prior probability p, else a uniform density
/// 1/(2π·v), that of a normal distribution of variance v at its centre.
///
/// With the tails of t alone a model that fits two thirds of the measurements well is as likely as one that
/// fits all of them badly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mixture<const FREEDOM: i32> {
    /// p.
    prior: f64,
    /// 1/σ²: 2π times the density of an inlier at s = 0.
    inverse_scale: f64,
    /// (1 − p)/v: 2π times the density of an outlier, times its probability.
    outlier: f64,
}

impl<const FREEDOM: i32> Mixture<FREEDOM> {
    /// Given p, 1/σ² and v, both variances in the same unit. (1/σ² is the root of the determinant of the
    /// inverse of the scale where that differs with the direction.)
    #[inline(always)]
    pub fn new(prior: f64, inverse_scale: f64, outlier_variance: f64) -> Self {
        Self { prior, inverse_scale, outlier: (1.0 - prior) / outlier_variance }
    }

    #[inline(always)]
    fn inlier_density(self, s: f64) -> f64 {
        self.prior * (StudentT::<FREEDOM>.relative_density(s) * self.inverse_scale)
    }

    /// Posterior probability of an inlier.
    #[cfg(test)]
    #[inline(always)]
    pub fn inlier_probability(self, s: f64) -> f64 {
        let inlier = self.inlier_density(s);
        inlier / (inlier + self.outlier)
    }
}

impl<const FREEDOM: i32> Loss for Mixture<FREEDOM> {
    #[inline(always)]
    fn rho(self, s: f64) -> f64 {
        2.0 * (self.log_density(0.0) - self.log_density(s))
    }

    /// The weight of [`StudentT`] times the posterior probability of an inlier.
    #[inline(always)]
    fn weight_times(self, factor: f64, s: f64) -> f64 {
        let inlier = self.inlier_density(s);
        StudentT::<FREEDOM>.weight_times(factor, s) * inlier / (inlier + self.outlier)
    }
}

impl<const FREEDOM: i32> Density for Mixture<FREEDOM> {
    #[inline(always)]
    fn log_density(self, s: f64) -> f64 {
        (self.inlier_density(s) + self.outlier).ln()
    }
}

/// The effective number of weights w, (Σw)²/Σw²: that of equal weights of the same variance of the mean (L.
/// Kish, *Survey Sampling*, 1965).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectiveNumber {
    sum: f64,
    squares: f64,
}

impl FromIterator<f64> for EffectiveNumber {
    fn from_iter<I: IntoIterator<Item = f64>>(weights: I) -> Self {
        let add = |[sum, squares]: [f64; 2], w| [sum + w, squares + w * w];
        let [sum, squares] = weights.into_iter().fold([0.0; 2], add);
        Self { sum, squares }
    }
}

impl EffectiveNumber {
    /// The factor on all weights by which they count as at most `most` independent measurements: `most` over
    /// the effective number, at most 1; 0 if all weights are 0.
    pub fn independent_share(self, most: f64) -> f64 {
        if self.sum > 0.0 { (most * self.squares / (self.sum * self.sum)).min(1.0) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-9 * (1.0 + b.abs())
    }

    /// The convention, whatever the loss.
    fn check(loss: impl Loss) {
        assert_eq!(loss.rho(0.0), 0.0);
        for s in [0.01, 0.7, 2.0, 9.0, 300.0] {
            let step = 1e-4 * s;
            let slope = (loss.rho(s + step) - loss.rho(s - step)) / (2.0 * step);
            assert!((slope - loss.weight(s)).abs() < 1e-6 * loss.weight(s) + 1e-9, "{s}: {slope}");
            assert!(close(-loss.log_likelihood(s), 0.5 * loss.rho(s)));
            assert!(close(loss.weight_times(3.0, s), 3.0 * loss.weight(s)));
            assert!(loss.weight(s) >= loss.weight(2.0 * s));
        }
    }

    #[test]
    fn every_loss_keeps_the_convention() {
        check(Squares);
        check(GemanMcClure(4.0));
        check(StudentT::<3>);
        check(StudentT::<4>);
        check(Mixture::<4>::new(0.9, 4.0, 100.0));
        check(Mixture::<3>::new(0.2, 1.0, 30.0));
    }

    #[test]
    fn worked_by_hand() {
        assert_eq!((Squares.rho(7.0), Squares.weight(7.0), Squares.log_likelihood(7.0)), (7.0, 1.0, -3.5));
        let loss = GemanMcClure(4.0);
        assert_eq!((loss.rho(4.0), loss.weight(0.0), loss.weight(4.0)), (2.0, 1.0, 0.25));
        assert_eq!(GemanMcClure(1.0f32).weight_times(8.0, 1.0), 2.0);
        let loss = StudentT::<4>;
        assert!(close(loss.rho(4.0), 6.0 * 2f64.ln()));
        assert_eq!((loss.weight(0.0), loss.weight(2.0), loss.relative_density(4.0)), (1.5, 1.0, 0.125));
        // 2^(−5/2).
        assert!(close(StudentT::<3>.relative_density(3.0), 0.125 * 2f64.sqrt()));
        // σ = 1/2 px, outliers spread by 10 px, half of each: 0.5·4/8 = 1/4 against 1/200 at s = 4.
        let loss = Mixture::<4>::new(0.5, 4.0, 100.0);
        assert!(close(loss.inlier_probability(4.0), 50.0 / 51.0));
        assert!(close(loss.weight(4.0), 0.75 * 50.0 / 51.0));
        assert!(close(loss.log_density(4.0), 0.255f64.ln()));
    }

    #[test]
    fn far_off_each_loss_has_its_limit() {
        assert!(close(GemanMcClure(4.0).rho(1e12), 4.0));
        assert_eq!(GemanMcClure(4.0).weight(f64::INFINITY), 0.0);
        assert!((StudentT::<4>.weight(1e12) * 1e12 - 6.0).abs() < 1e-9);
        // An outlier is as likely wherever it is.
        let loss = Mixture::<4>::new(0.5, 4.0, 100.0);
        assert!(close(loss.log_density(1e9), 0.005f64.ln()));
        assert_eq!(loss.inlier_probability(f64::INFINITY), 0.0);
        // Without outliers it is Student's t.
        let loss = Mixture::<4>::new(1.0, 4.0, 100.0);
        assert!(
            close(loss.rho(5.0), StudentT::<4>.rho(5.0))
                && close(loss.weight(5.0), StudentT::<4>.weight(5.0))
        );
    }

    #[test]
    fn densities_integrate_to_one() {
        // Over the plane: ∫ density(s)/(2π)·2π·r dr = ½·∫ density(s) ds, here with s = u/(1 − u).
        let integral = |density: fn(f64) -> f64| {
            let steps = 100_000;
            let at = |i: i32| (f64::from(i) + 0.5) / f64::from(steps);
            let sum: f64 = (0..steps).map(|i| density(at(i) / (1.0 - at(i))) / (1.0 - at(i)).powi(2)).sum();
            0.5 * sum / f64::from(steps)
        };
        for whole in [
            integral(|s| StudentT::<4>.relative_density(s)),
            integral(|s| StudentT::<3>.relative_density(s)),
            integral(|s| Squares.log_likelihood(s).exp()),
        ] {
            assert!((whole - 1.0).abs() < 1e-3, "{whole}");
        }
    }

    #[test]
    fn the_effective_number_of_unequal_weights_is_smaller() {
        let of = |weights: &[f64]| weights.iter().copied().collect::<EffectiveNumber>();
        assert_eq!((of(&[]).independent_share(1.0), of(&[0.0; 3]).independent_share(1.0)), (0.0, 0.0));
        // Effective numbers of 4 and 1.6.
        assert_eq!(
            (of(&[0.25; 4]).independent_share(2.0), of(&[3.0, 1.0]).independent_share(0.8)),
            (0.5, 0.5)
        );
        // Four with an effective number of one and a half.
        assert_eq!(of(&[2.0; 4]).independent_share(1.5), 0.375);
        assert_eq!((of(&[2.0; 4]).independent_share(5.0), of(&[]).independent_share(5.0)), (1.0, 0.0));
    }
}
