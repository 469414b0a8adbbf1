// SPDX-License-Identifier: MIT OR Apache-2.0

//! Vectors with AVX2 and FMA: one register each. A value of [`Avx2`] proves that the CPU has them, and so does a
//! register, for it is created only through such a value: the reason of every `unsafe` here that names none.

use super::{Cpu, DOUBLES, DoubleCpu, FLOATS, WORDS, WordCpu};
use crate::cpu::Avx2;
use std::arch::x86_64::*;
use std::ops::{Add, Mul, Sub};

/// Eight floats.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Floats(__m256);

/// Sixteen words.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Words(__m256i);

/// Four doubles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Doubles(__m256d);

/// An expression of intrinsics.
macro_rules! avx2 {
    ($expression:expr) => {
        // SAFETY: the CPU has AVX2 and FMA, by the proof that the caller holds; what is read and written is
        // borrowed, and as long as a register.
        unsafe { $expression }
    };
}

impl Cpu for Avx2 {
    type Lanes = Floats;

    #[inline(always)]
    fn vectorize<R>(self, work: impl FnOnce() -> R) -> R {
        #[target_feature(enable = "avx2,fma")]
        fn compiled<R>(work: impl FnOnce() -> R) -> R {
            work()
        }
        avx2!(compiled(work))
    }

    #[inline(always)]
    fn load(self, samples: &[f32; FLOATS]) -> Floats {
        Floats(avx2!(_mm256_loadu_ps(samples.as_ptr())))
    }

    #[inline(always)]
    fn store(self, Floats(lanes): Floats) -> [f32; FLOATS] {
        let mut out = [0.0; FLOATS];
        avx2!(_mm256_storeu_ps(out.as_mut_ptr(), lanes));
        out
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Floats {
        Floats(avx2!(_mm256_set1_ps(value)))
    }

    #[inline(always)]
    fn fused(self, a: Floats, b: Floats, c: Floats) -> Floats {
        Floats(avx2!(_mm256_fmadd_ps(a.0, b.0, c.0)))
    }

    #[inline(always)]
    fn fused_less(self, a: Floats, b: Floats, c: Floats) -> Floats {
        Floats(avx2!(_mm256_fnmadd_ps(a.0, b.0, c.0)))
    }

    #[inline(always)]
    fn halves(self, [a, b, c, d, e, f, g, h]: [Floats; 8]) -> [Floats; 2] {
        avx2!({
            let four = _mm256_hadd_ps(_mm256_hadd_ps(a.0, b.0), _mm256_hadd_ps(c.0, d.0));
            let others = _mm256_hadd_ps(_mm256_hadd_ps(e.0, f.0), _mm256_hadd_ps(g.0, h.0));
            [
                Floats(_mm256_permute2f128_ps::<0x20>(four, others)),
                Floats(_mm256_permute2f128_ps::<0x31>(four, others)),
            ]
        })
    }

    #[inline(always)]
    fn transposed(self, rows: [Floats; FLOATS]) -> [Floats; FLOATS] {
        avx2!({
            // Rows k and k + 4 in the halves of a register: 4 x 4 twice.
            let [a, b, c, d, e, f, g, h] = rows;
            let (a, b, c, d, e, f, g, h) = (a.0, b.0, c.0, d.0, e.0, f.0, g.0, h.0);
            let [p, q, r, s] = columns_of_four([
                _mm256_permute2f128_ps::<0x20>(a, e),
                _mm256_permute2f128_ps::<0x20>(b, f),
                _mm256_permute2f128_ps::<0x20>(c, g),
                _mm256_permute2f128_ps::<0x20>(d, h),
            ]);
            let [t, u, v, w] = columns_of_four([
                _mm256_permute2f128_ps::<0x31>(a, e),
                _mm256_permute2f128_ps::<0x31>(b, f),
                _mm256_permute2f128_ps::<0x31>(c, g),
                _mm256_permute2f128_ps::<0x31>(d, h),
            ]);
            [p, q, r, s, t, u, v, w]
        })
    }

    #[inline(always)]
    fn divided(self, a: Floats, b: Floats) -> Floats {
        Floats(avx2!(_mm256_div_ps(a.0, b.0)))
    }

    #[inline(always)]
    fn root(self, a: Floats) -> Floats {
        Floats(avx2!(_mm256_sqrt_ps(a.0)))
    }

    #[inline(always)]
    fn magnitude(self, a: Floats) -> Floats {
        // All bits but the sign.
        Floats(avx2!(_mm256_andnot_ps(_mm256_set1_ps(-0.0), a.0)))
    }
}

/// The columns of the 4 × 4 floats in either half of four registers.
#[inline(always)]
fn columns_of_four([a, b, c, d]: [__m256; 4]) -> [Floats; 4] {
    avx2!({
        let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
        let (ab_last, cd_last) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
        [
            Floats(_mm256_shuffle_ps::<0x44>(ab, cd)),
            Floats(_mm256_shuffle_ps::<0xee>(ab, cd)),
            Floats(_mm256_shuffle_ps::<0x44>(ab_last, cd_last)),
            Floats(_mm256_shuffle_ps::<0xee>(ab_last, cd_last)),
        ]
    })
}

impl WordCpu for Avx2 {
    type Words = Words;

    #[inline(always)]
    fn load_words(self, words: &[i16; WORDS]) -> Words {
        Words(avx2!(_mm256_loadu_si256(words.as_ptr().cast())))
    }

    #[inline(always)]
    fn store_words(self, Words(words): Words) -> [i16; WORDS] {
        let mut out = [0; WORDS];
        avx2!(_mm256_storeu_si256(out.as_mut_ptr().cast(), words));
        out
    }

    #[inline(always)]
    fn load_bytes(self, bytes: &[u8; WORDS]) -> Words {
        Words(avx2!(_mm256_slli_epi16::<7>(_mm256_cvtepu8_epi16(_mm_loadu_si128(bytes.as_ptr().cast())))))
    }

    #[inline(always)]
    fn store_bytes(self, Words(words): Words) -> [u8; WORDS] {
        let mut out = [0; WORDS];
        avx2!({
            let (low, high) = (_mm256_castsi256_si128(words), _mm256_extracti128_si256::<1>(words));
            _mm_storeu_si128(out.as_mut_ptr().cast(), _mm_packus_epi16(low, high));
        });
        out
    }

    #[inline(always)]
    fn splat_words(self, value: i16) -> Words {
        Words(avx2!(_mm256_set1_epi16(value)))
    }

    #[inline(always)]
    fn scaled(self, a: Words, b: Words) -> Words {
        Words(avx2!(_mm256_mulhrs_epi16(a.0, b.0)))
    }

    #[inline(always)]
    fn shifted_left<const N: i32>(self, a: Words) -> Words {
        Words(avx2!(_mm256_slli_epi16::<N>(a.0)))
    }

    #[inline(always)]
    fn shifted_right<const N: i32>(self, a: Words) -> Words {
        Words(avx2!(_mm256_srai_epi16::<N>(a.0)))
    }

    #[inline(always)]
    fn and(self, a: Words, b: Words) -> Words {
        Words(avx2!(_mm256_and_si256(a.0, b.0)))
    }

    #[inline(always)]
    fn above(self, value: Words, limit: Words, next: Words, lanes: Words) -> Words {
        Words(avx2!(_mm256_blendv_epi8(lanes.0, next.0, _mm256_cmpgt_epi16(value.0, limit.0))))
    }

    #[inline(always)]
    fn shuffled(self, bytes: &[u8; 8], positions: &[u8; 2 * WORDS]) -> Words {
        Words(avx2!({
            let bytes = _mm256_set1_epi64x(i64::from_ne_bytes(*bytes));
            _mm256_shuffle_epi8(bytes, _mm256_loadu_si256(positions.as_ptr().cast()))
        }))
    }

    #[inline(always)]
    fn prefetch(self, address: *const u8) {
        // Any address is allowed.
        avx2!(_mm_prefetch::<_MM_HINT_T0>(address.cast()));
    }

    #[inline(always)]
    fn doubled<const LAST: bool>(self, Words(words): Words) -> Words {
        if LAST {
            Words(avx2!(_mm256_unpackhi_epi16(words, words)))
        } else {
            Words(avx2!(_mm256_unpacklo_epi16(words, words)))
        }
    }

    #[inline(always)]
    fn doubled_pairs<const LAST: bool>(self, Words(words): Words) -> Words {
        if LAST {
            Words(avx2!(_mm256_unpackhi_epi32(words, words)))
        } else {
            Words(avx2!(_mm256_unpacklo_epi32(words, words)))
        }
    }

    #[inline(always)]
    unsafe fn columns(self, rows: &[*const i16; WORDS]) -> [Words; 6] {
        // SAFETY: the caller's promise, and `self` is a proof of AVX2.
        unsafe {
            // No closures: they would be compiled for any CPU.
            let mut lanes = [_mm256_setzero_si256(); 8];
            for (index, lanes) in lanes.iter_mut().enumerate() {
                let low = _mm256_castsi128_si256(_mm_loadu_si128(rows[index].cast()));
                *lanes = _mm256_inserti128_si256::<1>(low, _mm_loadu_si128(rows[index + 8].cast()));
            }
            // In both halves alike: columns 0 and 1, 2 and 3, 4 and 5 of rows 0 to 3 and of rows 4 to 7.
            let mut four = [[_mm256_setzero_si256(); 3]; 2];
            for (index, four) in four.iter_mut().enumerate() {
                let (a, b) = (lanes[4 * index], lanes[4 * index + 1]);
                let (c, d) = (lanes[4 * index + 2], lanes[4 * index + 3]);
                let (ab, cd) = (_mm256_unpacklo_epi16(a, b), _mm256_unpacklo_epi16(c, d));
                let last = _mm256_unpacklo_epi32(_mm256_unpackhi_epi16(a, b), _mm256_unpackhi_epi16(c, d));
                *four = [_mm256_unpacklo_epi32(ab, cd), _mm256_unpackhi_epi32(ab, cd), last];
            }
            let mut columns = [Words(_mm256_setzero_si256()); 6];
            for (index, (low, high)) in four[0].into_iter().zip(four[1]).enumerate() {
                columns[2 * index] = Words(_mm256_unpacklo_epi64(low, high));
                columns[2 * index + 1] = Words(_mm256_unpackhi_epi64(low, high));
            }
            columns
        }
    }

    #[inline(always)]
    fn floats(self, Words(words): Words) -> [Floats; 2] {
        avx2!({
            let (low, high) = (_mm256_castsi256_si128(words), _mm256_extracti128_si256::<1>(words));
            [
                Floats(_mm256_cvtepi32_ps(_mm256_cvtepi16_epi32(low))),
                Floats(_mm256_cvtepi32_ps(_mm256_cvtepi16_epi32(high))),
            ]
        })
    }

    #[inline(always)]
    fn above_floats(self, value: Floats, limit: Floats, next: Floats, lanes: Floats) -> Floats {
        Floats(avx2!(_mm256_blendv_ps(lanes.0, next.0, _mm256_cmp_ps::<_CMP_GT_OQ>(value.0, limit.0))))
    }

    #[inline(always)]
    fn bits_above(self, value: Floats, limit: Floats) -> u32 {
        avx2!(_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(value.0, limit.0))) as u32
    }

    // Both instructions give the second number where either is none, or both are zero: as `above_floats` does.
    #[inline(always)]
    fn greater(self, a: Floats, b: Floats) -> Floats {
        Floats(avx2!(_mm256_max_ps(a.0, b.0)))
    }

    #[inline(always)]
    fn lesser(self, a: Floats, b: Floats) -> Floats {
        Floats(avx2!(_mm256_min_ps(a.0, b.0)))
    }

    #[inline(always)]
    fn load_samples(self, bytes: &[u8; 2 * FLOATS], shift: u32) -> Floats {
        Floats(avx2!({
            let words = _mm_loadu_si128(bytes.as_ptr().cast());
            let words = _mm_srl_epi16(words, _mm_cvtsi32_si128(shift as i32));
            _mm256_cvtepi32_ps(_mm256_cvtepu16_epi32(words))
        }))
    }

    #[inline(always)]
    fn store_samples(self, [low, high]: [Floats; 2], max: u16, shift: u32) -> [u16; WORDS] {
        let mut out = [0; WORDS];
        avx2!({
            let (zero, max) = (_mm256_setzero_ps(), _mm256_set1_ps(f32::from(max)));
            let low = _mm256_cvtps_epi32(_mm256_min_ps(_mm256_max_ps(low.0, zero), max));
            let high = _mm256_cvtps_epi32(_mm256_min_ps(_mm256_max_ps(high.0, zero), max));
            let ordered = _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_packus_epi32(low, high));
            let words = _mm256_sll_epi16(ordered, _mm_cvtsi32_si128(shift as i32));
            _mm256_storeu_si256(out.as_mut_ptr().cast(), words);
        });
        out
    }

    #[inline(always)]
    fn rounded(self, Floats(lanes): Floats, limit: f32) -> [i32; FLOATS] {
        let mut out = [0; FLOATS];
        avx2!({
            let limited = _mm256_min_ps(_mm256_max_ps(lanes, _mm256_set1_ps(-limit)), _mm256_set1_ps(limit));
            _mm256_storeu_si256(out.as_mut_ptr().cast(), _mm256_cvtps_epi32(limited));
        });
        out
    }
}

/// A binary operator on lanes.
macro_rules! operation {
    ($name:ident, $function:ident, $vector:ident, $intrinsic:ident) => {
        impl $name for $vector {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                Self(avx2!($intrinsic(self.0, other.0)))
            }
        }
    };
}

operation!(Add, add, Floats, _mm256_add_ps);
operation!(Sub, sub, Floats, _mm256_sub_ps);
operation!(Mul, mul, Floats, _mm256_mul_ps);
operation!(Add, add, Words, _mm256_add_epi16);
operation!(Sub, sub, Words, _mm256_sub_epi16);
operation!(Add, add, Doubles, _mm256_add_pd);
operation!(Sub, sub, Doubles, _mm256_sub_pd);
operation!(Mul, mul, Doubles, _mm256_mul_pd);

impl DoubleCpu for Avx2 {
    type Doubles = Doubles;

    #[inline(always)]
    fn load_doubles(self, values: &[f64; DOUBLES]) -> Doubles {
        Doubles(avx2!(_mm256_loadu_pd(values.as_ptr())))
    }

    #[inline(always)]
    fn store_doubles(self, Doubles(doubles): Doubles) -> [f64; DOUBLES] {
        let mut out = [0.0; DOUBLES];
        avx2!(_mm256_storeu_pd(out.as_mut_ptr(), doubles));
        out
    }

    #[inline(always)]
    fn splat_double(self, value: f64) -> Doubles {
        Doubles(avx2!(_mm256_set1_pd(value)))
    }

    #[inline(always)]
    fn fused_doubles(self, a: Doubles, b: Doubles, c: Doubles) -> Doubles {
        Doubles(avx2!(_mm256_fmadd_pd(a.0, b.0, c.0)))
    }

    #[inline(always)]
    fn fused_less_doubles(self, a: Doubles, b: Doubles, c: Doubles) -> Doubles {
        Doubles(avx2!(_mm256_fnmadd_pd(a.0, b.0, c.0)))
    }
}
