//! Vectors of eight samples, one implementation per CPU level. Nearly all of the flow's time is spent here.
//!
//! All levels add in the same order; AVX2 fuses multiplication and addition without intermediate rounding,
//! for which plain Rust would call a function on machines without that instruction. Lanes are created only
//! through a [`Cpu`]; all functions that compute with them are `inline(always)`, up to a function compiled
//! for that CPU.

#[cfg(target_arch = "x86_64")]
use crate::cpu::Avx2;
use std::fmt::Debug;
use std::ops::{Add, Mul, Sub};

/// Lanes in a vector, and samples in a row of a patch.
pub(super) const SIDE: usize = 8;

/// A set of instructions; a value proves that the machine has them.
pub(super) trait Cpu: Copy {
    type Lanes: Copy
        + Debug
        + Add<Output = Self::Lanes>
        + Sub<Output = Self::Lanes>
        + Mul<Output = Self::Lanes>;

    /// Loads eight samples.
    fn load(self, samples: &[f32; SIDE]) -> Self::Lanes;

    /// Stores all lanes to an array.
    fn store(self, lanes: Self::Lanes) -> [f32; SIDE];

    /// The same value in all lanes.
    fn splat(self, value: f32) -> Self::Lanes;

    /// a·b + c, rounded once (AVX2) or twice (plain Rust).
    fn fused(self, a: Self::Lanes, b: Self::Lanes, c: Self::Lanes) -> Self::Lanes;

    /// Sums of the first four lanes of each of four vectors, then of the last four lanes of each.
    fn halves(self, four: [Self::Lanes; 4]) -> [f32; SIDE];

    /// Sums of all lanes of each of four vectors.
    #[inline(always)]
    fn totals(self, four: [Self::Lanes; 4]) -> [f32; 4] {
        let [a, b, c, d, e, f, g, h] = self.halves(four);
        [a + e, b + f, c + g, d + h]
    }
}

/// Plain Rust: the reference.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scalar;

#[derive(Clone, Copy, Debug)]
pub(super) struct Array([f32; SIDE]);

impl Cpu for Scalar {
    type Lanes = Array;

    #[inline(always)]
    fn load(self, samples: &[f32; SIDE]) -> Array {
        Array(*samples)
    }

    #[inline(always)]
    fn store(self, Array(lanes): Array) -> [f32; SIDE] {
        lanes
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Array {
        Array([value; SIDE])
    }

    #[inline(always)]
    fn fused(self, a: Array, b: Array, c: Array) -> Array {
        a * b + c
    }

    #[inline(always)]
    fn halves(self, four: [Array; 4]) -> [f32; SIDE] {
        std::array::from_fn(|k| {
            let (Array(lanes), from) = (four[k % 4], k / 4 * 4);
            (lanes[from] + lanes[from + 1]) + (lanes[from + 2] + lanes[from + 3])
        })
    }
}

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{
    __m256, _mm256_add_ps, _mm256_fmadd_ps, _mm256_hadd_ps, _mm256_loadu_ps, _mm256_mul_ps, _mm256_set1_ps,
    _mm256_storeu_ps, _mm256_sub_ps,
};

/// Created only through [`Avx2`], so a value is also a proof of AVX2.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub(super) struct Register(__m256);

#[cfg(target_arch = "x86_64")]
impl Cpu for Avx2 {
    type Lanes = Register;

    #[inline(always)]
    fn load(self, samples: &[f32; SIDE]) -> Register {
        // SAFETY: eight samples are borrowed, and `self` is a proof of AVX2.
        Register(unsafe { _mm256_loadu_ps(samples.as_ptr()) })
    }

    #[inline(always)]
    fn store(self, Register(lanes): Register) -> [f32; SIDE] {
        let mut out = [0.0; SIDE];
        // SAFETY: eight samples are borrowed, exclusively, and `self` is a proof of AVX2.
        unsafe { _mm256_storeu_ps(out.as_mut_ptr(), lanes) };
        out
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Register {
        // SAFETY: `self` is a proof of AVX2.
        Register(unsafe { _mm256_set1_ps(value) })
    }

    #[inline(always)]
    fn fused(self, a: Register, b: Register, c: Register) -> Register {
        // SAFETY: `self` is a proof of AVX2 and FMA.
        Register(unsafe { _mm256_fmadd_ps(a.0, b.0, c.0) })
    }

    #[inline(always)]
    fn halves(self, [a, b, c, d]: [Register; 4]) -> [f32; SIDE] {
        // SAFETY: `self` is a proof of AVX2.
        self.store(Register(unsafe { _mm256_hadd_ps(_mm256_hadd_ps(a.0, b.0), _mm256_hadd_ps(c.0, d.0)) }))
    }
}

/// A binary operator on lanes.
macro_rules! operation {
    ($name:ident, $function:ident, $intrinsic:ident) => {
        impl $name for Array {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                Self(std::array::from_fn(|lane| self.0[lane].$function(other.0[lane])))
            }
        }

        #[cfg(target_arch = "x86_64")]
        impl $name for Register {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                // SAFETY: a register is a proof of AVX2.
                Self(unsafe { $intrinsic(self.0, other.0) })
            }
        }
    };
}

operation!(Add, add, _mm256_add_ps);
operation!(Sub, sub, _mm256_sub_ps);
operation!(Mul, mul, _mm256_mul_ps);

/// `COUNT` rows of at least `WIDTH` samples, all within one slice.
#[derive(Clone, Copy)]
pub(super) struct SampleRows<'a, const COUNT: usize, const WIDTH: usize> {
    samples: &'a [f32],
    stride: usize,
}

impl<'a, const COUNT: usize, const WIDTH: usize> SampleRows<'a, COUNT, WIDTH> {
    /// Rows `stride` samples apart, starting at the first sample; `None` if the slice is too short.
    #[inline(always)]
    pub(super) fn new(samples: &'a [f32], stride: usize) -> Option<Self> {
        let reach = (COUNT - 1).checked_mul(stride)?.checked_add(WIDTH)?;
        (reach <= samples.len()).then_some(Self { samples, stride })
    }

    /// Eight samples of row `r` from column `c` on.
    #[inline(always)]
    pub(super) fn at(self, r: usize, c: usize) -> &'a [f32; SIDE] {
        // Compiled away where the indices are constants.
        assert!(r < COUNT && c + SIDE <= WIDTH);
        // SAFETY: r·stride + c + 8 ≤ (COUNT − 1)·stride + WIDTH ≤ the slice's length, by `new` and the line
        // above.
        unsafe { &*self.samples.as_ptr().add(r * self.stride + c).cast() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A slice without a sample to spare does; a shorter one is refused, and no stride is too large to be
    /// multiplied.
    #[test]
    fn rows_lie_within_their_slice() {
        let samples: Vec<f32> = (0..29).map(|i| i as f32).collect();
        let rows = SampleRows::<3, 9>::new(&samples, 10).unwrap();
        assert_eq!((rows.at(0, 0)[0], rows.at(2, 1)[7]), (0.0, 28.0));
        assert!(SampleRows::<3, 9>::new(&samples[1..], 10).is_none());
        assert!(SampleRows::<3, 9>::new(&samples, usize::MAX / 2).is_none());
    }

    #[test]
    #[should_panic]
    fn a_row_too_many_is_no_row() {
        SampleRows::<3, 9>::new(&[0.0; 100], 10).unwrap().at(3, 0);
    }
}
