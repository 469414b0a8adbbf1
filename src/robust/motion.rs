// SPDX-License-Identifier: MIT OR Apache-2.0

//! The motion that most displacements share, by iteratively re-weighted least squares.
//!
//! Displacement = A·φ(p), where φ(p) are the N terms of a basis at the point p and A is 2 × N. Both
//! coordinates have terms and weights in common, so the system of normal equations is N × N and has two right
//! sides. (A twist is not among these motions, as its angular velocity is in both coordinates; `solve::sequential`
//! fits it with the same loss.)

use super::loss::Loss;
use super::median::variance_of;
use nalgebra::{RealField, SMatrix, SVector, Vector2};

/// The basis of affine motions.
#[inline(always)]
pub fn affine<T: RealField + Copy>(point: Vector2<T>) -> SVector<T, 3> {
    SVector::from([T::one(), point.x, point.y])
}

/// Terms of a quadratic: 1, x, y, x², xy, y².
pub const QUADRATIC_TERMS: usize = 6;

/// A motion quadratic in the point.
pub type Quadratic = Motion<f64, QUADRATIC_TERMS>;

/// The basis of motions quadratic in the point; the first three terms are the affine ones.
#[inline(always)]
pub fn quadratic<T: RealField + Copy>(point: Vector2<T>) -> SVector<T, QUADRATIC_TERMS> {
    let [x, y] = [point.x, point.y];
    SVector::from([T::one(), x, y, x * x, x * y, y * y])
}

/// A measured displacement.
#[derive(Clone, Copy, Debug)]
pub struct Sample<T, const N: usize> {
    /// φ at the point.
    pub terms: SVector<T, N>,
    /// In the unit of the motion.
    pub displacement: Vector2<T>,
    /// Its weight at a residual of 0.
    pub weight: T,
}

impl<T: RealField + Copy, const N: usize> Sample<T, N> {
    /// Of weight 1.
    #[inline(always)]
    pub fn new(terms: SVector<T, N>, displacement: Vector2<T>) -> Self {
        Self { terms, displacement, weight: T::one() }
    }
}

/// A, the coefficients of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion<T, const N: usize>(pub SMatrix<T, 2, N>);

/// σ² of a coordinate by which a round of the fit whitens the residuals of the motion before.
#[derive(Clone, Copy, Debug)]
pub enum Scale<T> {
    /// Given.
    Variance(T),
    /// Estimated from the median of these residuals' |r|².
    Median {
        /// The least variance.
        least: T,
    },
}

/// A round of the fit.
#[derive(Clone, Copy, Debug)]
pub struct Round<T, const N: usize> {
    /// For the weights of the round.
    pub scale: Scale<T>,
    /// Added to the diagonal of the normal equations: pulls the coefficients of a term towards zero.
    pub ridge: [f64; N],
}

impl<T, const N: usize> Round<T, N> {
    /// Without a ridge.
    pub fn new(scale: Scale<T>) -> Self {
        Self { scale, ridge: [0.0; N] }
    }
}

/// Rounds after which a motion hardly changes, if most samples share it and the scale follows from them.
pub const ROUNDS: usize = 4;

/// The motion after these rounds of re-weighting, the first by the residuals of `start`; `None` if the normal
/// equations of a round are singular or not finite.
///
/// Points and residuals have the precision of `T`, the normal equations that of `f64`.
pub fn fit<T: RealField + Copy + Into<f64>, const N: usize>(
    samples: impl Iterator<Item = Sample<T, N>> + Clone,
    start: Motion<T, N>,
    loss: impl Loss<T>,
    rounds: impl IntoIterator<Item = Round<T, N>>,
) -> Option<Motion<T, N>> {
    let mut squares = Vec::new();
    rounds.into_iter().try_fold(start, |motion, Round { scale, ridge }| {
        let variance = match scale {
            Scale::Variance(variance) => variance,
            Scale::Median { least } => {
                nalgebra::convert(motion.variance(samples.clone(), least.into(), &mut squares))
            }
        };
        let mut normal = SMatrix::<f64, N, N>::zeros();
        let mut right = SMatrix::<f64, 2, N>::zeros();
        for sample in samples.clone() {
            let weight = loss.weight_times(sample.weight, motion.square(&sample) / variance);
            let terms: SVector<f64, N> = sample.terms.map(Into::into);
            let weighted = terms.transpose() * weight.into();
            normal += terms * weighted;
            right += sample.displacement.map(Into::into) * weighted;
        }
        normal += SMatrix::from_diagonal(&ridge.into());
        let found = normal.cholesky()?.solve(&right.transpose()).transpose().map(nalgebra::convert::<f64, T>);
        found.iter().all(|value| value.is_finite()).then_some(Motion(found))
    })
}

impl<T: RealField + Copy + Into<f64>, const N: usize> Motion<T, N> {
    /// The displacement of a point.
    #[inline(always)]
    pub fn at(&self, terms: &SVector<T, N>) -> Vector2<T> {
        self.0 * terms
    }

    /// |r|² of a sample.
    #[inline(always)]
    pub fn square(&self, sample: &Sample<T, N>) -> T {
        (sample.displacement - self.at(&sample.terms)).norm_squared()
    }

    /// Variance of a coordinate by the median of |r|², at least `least`; `squares` is a buffer.
    pub fn variance(
        &self,
        samples: impl Iterator<Item = Sample<T, N>>,
        least: f64,
        squares: &mut Vec<f64>,
    ) -> f64 {
        squares.clear();
        squares.extend(samples.map(|sample| self.square(&sample).into()));
        variance_of(squares, least)
    }
}

#[cfg(test)]
mod tests {
    use super::super::loss::{GemanMcClure, Squares};
    use super::*;

    /// Points of a 20 × 15 grid, displaced by `of`.
    fn samples<const N: usize>(
        basis: fn(Vector2<f64>) -> SVector<f64, N>,
        of: impl Fn(Vector2<f64>) -> Vector2<f64>,
    ) -> Vec<Sample<f64, N>> {
        let point = |i: u32| Vector2::new(f64::from(i % 20), f64::from(i / 20)) / 10.0;
        (0..300).map(point).map(|at| Sample::new(basis(at), of(at))).collect()
    }

    fn unweighted<const N: usize>() -> Round<f64, N> {
        Round::new(Scale::Variance(f64::INFINITY))
    }

    fn by_median<const N: usize>() -> impl Iterator<Item = Round<f64, N>> {
        let round = Round::new(Scale::Median { least: 1e-4 });
        std::iter::once(unweighted()).chain(std::iter::repeat_n(round, 8))
    }

    fn still<const N: usize>() -> Motion<f64, N> {
        Motion(SMatrix::zeros())
    }

    #[test]
    fn exact_displacements_give_their_motion() {
        let truth = SMatrix::<f64, 2, 6>::from_fn(|row, column| 1.0 + row as f64 - 0.3 * column as f64);
        let exact = samples(quadratic, |at| truth * quadratic(at));
        for loss in [1.0, 4.0] {
            let found = fit(exact.iter().copied(), still(), GemanMcClure(loss), by_median()).unwrap();
            assert!((found.0 - truth).amax() < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn the_mean_is_weighted() {
        let sample =
            |x, weight| Sample { terms: SVector::from([1.0]), displacement: Vector2::new(x, 0.0), weight };
        let two = [sample(0.0, 3.0), sample(4.0, 1.0)];
        let mean = |loss: f64, variance, ridge| {
            let round = Round { scale: Scale::Variance(variance), ridge: [ridge] };
            fit(two.into_iter(), still(), GemanMcClure(loss), [round]).unwrap().0.x
        };
        assert_eq!(mean(1.0, f64::INFINITY, 0.0), 1.0);
        // At s = 16/4 = c² a quarter counts: 1/(3 + 1/4), and with the ridge 1/(3 + 1/4 + 3/4).
        assert!((mean(4.0, 4.0, 0.0) - 1.0 / 3.25).abs() < 1e-12);
        assert_eq!(mean(4.0, 4.0, 0.75), 0.25);
    }

    #[test]
    fn a_quarter_of_outliers_has_no_influence() {
        let shared = |at: Vector2<f64>| Vector2::new(0.5 + 0.1 * at.x, 0.2 - 0.1 * at.y);
        let mut mixed = samples(affine, shared);
        mixed.iter_mut().step_by(4).for_each(|sample| sample.displacement = Vector2::new(-4.0, 3.0));
        let truth = SMatrix::<f64, 2, 3>::new(0.5, 0.1, 0.0, 0.2, 0.0, -0.1);
        let found = fit(mixed.iter().copied(), still(), GemanMcClure(4.0), by_median()).unwrap();
        assert!((found.0 - truth).amax() < 1e-3, "{found:?}");
        let least_squares = fit(mixed.iter().copied(), still(), Squares, by_median()).unwrap();
        assert!((least_squares.0 - truth).amax() > 0.5);
    }

    #[test]
    fn undetermined_motions_are_none() {
        let fit = |samples: &[Sample<f64, 3>], ridge| {
            let round = Round { ridge, ..unweighted() };
            fit(samples.iter().copied(), still(), Squares, [round])
        };
        assert_eq!(fit(&[], [0.0; 3]), None);
        let not_finite = samples(affine, |_| Vector2::new(f64::NAN, 0.0));
        assert_eq!(fit(&not_finite, [1.0; 3]), None);
        let column: Vec<_> = samples(affine, |_| Vector2::new(1.0, 2.0)).into_iter().step_by(20).collect();
        assert_eq!(fit(&column, [0.0; 3]), None);
        let found = fit(&column, [0.0, 1.0, 1.0]).unwrap();
        assert!((found.0.column(0) - Vector2::new(1.0, 2.0)).amax() < 1e-9);
    }
}
