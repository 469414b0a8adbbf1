// SPDX-License-Identifier: MIT OR Apache-2.0

//! Interpolation kernels: the weights of the samples around a position.
//!
//! A position is an integer sample and a fraction t of [`FRACTION_BITS`] bits: the quantisation error is
//! at most 1/4096 px, which on the steepest edge of a picture (full range in one pixel) is 1/4096 of the
//! range: 0.06 grey levels of 255.
//!
//! Weights have two formats: 16-bit integers with [`WEIGHT_BITS`] fraction bits for 8-bit samples,
//! `f32` for all others. Integer weights sum to exactly one, and those of the linear and cubic
//! kernel have exactly t as their first moment, so that ramps are reproduced.

use super::settings::Interpolation;
use std::sync::LazyLock;

/// Bits of the fraction of a position.
pub(super) const FRACTION_BITS: u32 = 11;
/// Fraction steps in one pixel.
pub(super) const ONE: i32 = 1 << FRACTION_BITS;
/// Fraction bits of integer weights.
pub(super) const WEIGHT_BITS: u32 = 14;
const UNIT: i16 = 1 << WEIGHT_BITS;
/// Most taps of a kernel.
pub(super) const MAX_TAPS: usize = 6;

/// An interpolation kernel; `fraction` is in 0..[`ONE`]. Weights past `TAPS` are zero.
pub(super) trait Kernel {
    /// Number of taps.
    const TAPS: usize;
    /// Position of the first tap, relative to the integer sample.
    const FIRST: isize;
    /// Added to a position before its integer part is taken.
    const ROUND: i32 = 0;

    /// Integer weights.
    fn fixed(fraction: i16) -> [i16; MAX_TAPS];
    /// The same weights in `f32`.
    fn float(fraction: i16) -> [f32; MAX_TAPS];
}

/// The nearest sample.
pub(super) struct Nearest;
/// Linear between two samples.
pub(super) struct Linear;
/// Catmull–Rom: the cubic convolution of Keys with a = −½.
pub(super) struct Cubic;
/// sinc(x)·sinc(x/3) for |x| < 3, normalised to sum one.
pub(super) struct Lanczos;

/// (a · b + 2¹⁴) >> 15: the rounded product of 16-bit vector instructions.
pub(super) const fn mulhrs(a: i16, b: i16) -> i16 {
    ((a as i32 * b as i32 + (1 << 14)) >> 15) as i16
}

fn real(fraction: i16) -> f32 {
    f32::from(fraction) / ONE as f32
}

impl Kernel for Nearest {
    const TAPS: usize = 1;
    const FIRST: isize = 0;
    const ROUND: i32 = ONE / 2;

    fn fixed(_: i16) -> [i16; MAX_TAPS] {
        [UNIT, 0, 0, 0, 0, 0]
    }

    fn float(_: i16) -> [f32; MAX_TAPS] {
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    }
}

impl Kernel for Linear {
    const TAPS: usize = 2;
    const FIRST: isize = 0;

    fn fixed(fraction: i16) -> [i16; MAX_TAPS] {
        let t = fraction << (WEIGHT_BITS - FRACTION_BITS);
        [UNIT - t, t, 0, 0, 0, 0]
    }

    fn float(fraction: i16) -> [f32; MAX_TAPS] {
        let t = real(fraction);
        [1.0 - t, t, 0.0, 0.0, 0.0, 0.0]
    }
}

impl Kernel for Cubic {
    const TAPS: usize = 4;
    const FIRST: isize = -1;

    /// The outer weights are polynomials, (−t³ + 2t² − t)/2 and (t³ − t²)/2, with an error of at most
    /// 3/2¹⁴ each; the inner ones follow from the sum, 1, and the first moment, t.
    fn fixed(fraction: i16) -> [i16; MAX_TAPS] {
        let t15 = fraction << (15 - FRACTION_BITS);
        let t14 = fraction << (WEIGHT_BITS - FRACTION_BITS);
        let square = mulhrs(t15, t15);
        let rest = mulhrs(square, t15) - square;
        let first = (square - t15 - rest) >> 2;
        let last = rest >> 2;
        let third = t14 + first - 2 * last;
        let second = UNIT - t14 - 2 * first + last;
        [first, second, third, last, 0, 0]
    }

    fn float(fraction: i16) -> [f32; MAX_TAPS] {
        let t = real(fraction);
        let rest = t * t * t - t * t;
        let first = (t * t - t - rest) * 0.5;
        let last = rest * 0.5;
        let third = t + first - (last + last);
        let second = 1.0 - t - (first + first) + last;
        [first, second, third, last, 0.0, 0.0]
    }
}

/// The weights of all fractions: 2048 × 6 × 2 bytes = 24 KiB, and twice that in `f32`. The integers have one
/// extra row, so that 16 bytes can be read at each row.
struct LanczosTable {
    fixed: Vec<[i16; MAX_TAPS]>,
    float: Vec<[f32; MAX_TAPS]>,
}

static LANCZOS: LazyLock<LanczosTable> = LazyLock::new(|| {
    let float: Vec<_> = (0..ONE).map(|fraction| lanczos(f64::from(fraction) / f64::from(ONE))).collect();
    LanczosTable {
        fixed: float.iter().map(quantise).chain([[0; MAX_TAPS]]).collect(),
        float: float.iter().map(|weights| weights.map(|weight| weight as f32)).collect(),
    }
});

fn lanczos(t: f64) -> [f64; MAX_TAPS] {
    let sinc =
        |x: f64| if x == 0.0 { 1.0 } else { (std::f64::consts::PI * x).sin() / (std::f64::consts::PI * x) };
    let weights: [f64; MAX_TAPS] = std::array::from_fn(|tap| {
        let x = tap as f64 - 2.0 - t;
        if x.abs() < 3.0 { sinc(x) * sinc(x / 3.0) } else { 0.0 }
    });
    let sum: f64 = weights.iter().sum();
    weights.map(|weight| weight / sum)
}

/// Rounds weights and adds the rounding error to the largest, so that they sum to one.
fn quantise(weights: &[f64; MAX_TAPS]) -> [i16; MAX_TAPS] {
    let mut fixed = weights.map(|weight| (weight * f64::from(UNIT)).round() as i16);
    let missing = UNIT - fixed.iter().sum::<i16>();
    let largest = if weights[2] >= weights[3] { 2 } else { 3 };
    fixed[largest] += missing;
    fixed
}

impl Lanczos {
    /// The integer weights of all fractions, [`MAX_TAPS`] each, and one extra row.
    pub fn table() -> &'static [i16] {
        LANCZOS.fixed.as_flattened()
    }
}

impl Kernel for Lanczos {
    const TAPS: usize = 6;
    const FIRST: isize = -2;

    fn fixed(fraction: i16) -> [i16; MAX_TAPS] {
        LANCZOS.fixed[(fraction as usize) & (ONE as usize - 1)]
    }

    fn float(fraction: i16) -> [f32; MAX_TAPS] {
        LANCZOS.float[(fraction as usize) & (ONE as usize - 1)]
    }
}

impl Interpolation {
    /// Samples along one axis per output sample.
    pub const fn taps(self) -> usize {
        match self {
            Self::Nearest => Nearest::TAPS,
            Self::Linear => Linear::TAPS,
            Self::Cubic => Cubic::TAPS,
            Self::Lanczos => Lanczos::TAPS,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check<K: Kernel>(truth: impl Fn(f64) -> f64, tolerance: f64) {
        for fraction in 0..ONE as i16 {
            let (fixed, float) = (K::fixed(fraction), K::float(fraction));
            assert_eq!(fixed.iter().map(|&w| i32::from(w)).sum::<i32>(), i32::from(UNIT));
            for tap in 0..MAX_TAPS {
                let x = tap as f64 + K::FIRST as f64 - f64::from(fraction) / f64::from(ONE);
                let truth = if tap < K::TAPS { truth(x) } else { 0.0 };
                assert!((f64::from(float[tap]) - truth).abs() < 1e-6, "{fraction} {tap}");
                let fixed = f64::from(fixed[tap]) / f64::from(UNIT);
                assert!((fixed - truth).abs() < tolerance, "{fraction} {tap}: {fixed} for {truth}");
            }
        }
    }

    /// Keys' cubic convolution with a = −½, in its usual form.
    fn keys(x: f64) -> f64 {
        let (x, a) = (x.abs(), -0.5);
        if x <= 1.0 {
            (a + 2.0) * x.powi(3) - (a + 3.0) * x.powi(2) + 1.0
        } else if x < 2.0 {
            a * x.powi(3) - 5.0 * a * x.powi(2) + 8.0 * a * x - 4.0 * a
        } else {
            0.0
        }
    }

    #[test]
    fn weights_are_those_of_the_kernels() {
        check::<Linear>(|x| (1.0 - x.abs()).max(0.0), 1e-9);
        check::<Cubic>(keys, 5.0 / 16384.0);
    }

    #[test]
    fn linear_and_cubic_keep_ramps() {
        for fraction in 0..ONE as i16 {
            for (weights, first) in [(Linear::fixed(fraction), 0), (Cubic::fixed(fraction), -1)] {
                let moment: i32 = (first..).zip(weights).map(|(x, w): (i32, i16)| x * i32::from(w)).sum();
                assert_eq!(moment, i32::from(fraction) << (WEIGHT_BITS - FRACTION_BITS));
            }
        }
    }

    #[test]
    fn lanczos_is_one_at_its_sample_and_sums_to_one() {
        assert_eq!(Lanczos::fixed(0), [0, 0, UNIT, 0, 0, 0]);
        for fraction in 0..ONE as i16 {
            assert_eq!(Lanczos::fixed(fraction).iter().map(|&w| i32::from(w)).sum::<i32>(), 16384);
            assert!((Lanczos::float(fraction).iter().sum::<f32>() - 1.0).abs() < 1e-6);
        }
        let half = Lanczos::float(ONE as i16 / 2);
        assert!((half[2] - half[3]).abs() < 1e-6 && (half[0] - half[5]).abs() < 1e-6);
        assert!(half[1] < 0.0 && half[0] > 0.0);
    }
}
