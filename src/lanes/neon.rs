// SPDX-License-Identifier: MIT OR Apache-2.0

//! Vectors with NEON: two registers each, the first lanes in the first. A value of [`Neon`] proves that the CPU
//! has it, and so does a register, for it is created only through such a value: the reason of every `unsafe` here
//! that names none.

use super::{Cpu, DOUBLES, DoubleCpu, FLOATS, WORDS, WordCpu};
use crate::cpu::Neon;
use std::arch::aarch64::*;
use std::ops::{Add, Mul, Sub};

/// Eight floats.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Floats(float32x4_t, float32x4_t);

/// Sixteen words.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Words(int16x8_t, int16x8_t);

/// Four doubles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Doubles(float64x2_t, float64x2_t);

/// An expression of intrinsics.
macro_rules! neon {
    ($expression:expr) => {
        // SAFETY: the CPU has NEON, by the proof that the caller holds; what is read and written is borrowed, and
        // as long as two registers.
        unsafe { $expression }
    };
}

impl Cpu for Neon {
    type Lanes = Floats;

    #[inline(always)]
    fn vectorize<R>(self, work: impl FnOnce() -> R) -> R {
        // Every CPU of this architecture that Rust compiles for by default has NEON.
        work()
    }

    #[inline(always)]
    fn load(self, samples: &[f32; FLOATS]) -> Floats {
        neon!(Floats(vld1q_f32(samples.as_ptr()), vld1q_f32(samples.as_ptr().add(4))))
    }

    #[inline(always)]
    fn store(self, lanes: Floats) -> [f32; FLOATS] {
        let mut out = [0.0; FLOATS];
        neon!({
            vst1q_f32(out.as_mut_ptr(), lanes.0);
            vst1q_f32(out.as_mut_ptr().add(4), lanes.1);
        });
        out
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Floats {
        let lanes = neon!(vdupq_n_f32(value));
        Floats(lanes, lanes)
    }

    #[inline(always)]
    fn fused(self, a: Floats, b: Floats, c: Floats) -> Floats {
        neon!(Floats(vfmaq_f32(c.0, a.0, b.0), vfmaq_f32(c.1, a.1, b.1)))
    }

    #[inline(always)]
    fn fused_less(self, a: Floats, b: Floats, c: Floats) -> Floats {
        neon!(Floats(vfmsq_f32(c.0, a.0, b.0), vfmsq_f32(c.1, a.1, b.1)))
    }

    #[inline(always)]
    fn halves(self, [a, b, c, d, e, f, g, h]: [Floats; 8]) -> [Floats; 2] {
        neon!([
            Floats(
                vpaddq_f32(vpaddq_f32(a.0, b.0), vpaddq_f32(c.0, d.0)),
                vpaddq_f32(vpaddq_f32(e.0, f.0), vpaddq_f32(g.0, h.0)),
            ),
            Floats(
                vpaddq_f32(vpaddq_f32(a.1, b.1), vpaddq_f32(c.1, d.1)),
                vpaddq_f32(vpaddq_f32(e.1, f.1), vpaddq_f32(g.1, h.1)),
            ),
        ])
    }

    #[inline(always)]
    fn transposed(self, [a, b, c, d, e, f, g, h]: [Floats; FLOATS]) -> [Floats; FLOATS] {
        let [p, q, r, s] = columns_of_four(a.0, b.0, c.0, d.0);
        let [t, u, v, w] = columns_of_four(e.0, f.0, g.0, h.0);
        let [i, j, k, l] = columns_of_four(a.1, b.1, c.1, d.1);
        let [m, n, o, x] = columns_of_four(e.1, f.1, g.1, h.1);
        [
            Floats(p, t),
            Floats(q, u),
            Floats(r, v),
            Floats(s, w),
            Floats(i, m),
            Floats(j, n),
            Floats(k, o),
            Floats(l, x),
        ]
    }

    #[inline(always)]
    fn divided(self, a: Floats, b: Floats) -> Floats {
        neon!(Floats(vdivq_f32(a.0, b.0), vdivq_f32(a.1, b.1)))
    }

    #[inline(always)]
    fn root(self, a: Floats) -> Floats {
        neon!(Floats(vsqrtq_f32(a.0), vsqrtq_f32(a.1)))
    }

    #[inline(always)]
    fn magnitude(self, a: Floats) -> Floats {
        neon!(Floats(vabsq_f32(a.0), vabsq_f32(a.1)))
    }
}

/// The columns of 4 × 4 floats.
#[inline(always)]
fn columns_of_four(a: float32x4_t, b: float32x4_t, c: float32x4_t, d: float32x4_t) -> [float32x4_t; 4] {
    neon!({
        let ab = vreinterpretq_f64_f32(vzip1q_f32(a, b));
        let cd = vreinterpretq_f64_f32(vzip1q_f32(c, d));
        let ab_last = vreinterpretq_f64_f32(vzip2q_f32(a, b));
        let cd_last = vreinterpretq_f64_f32(vzip2q_f32(c, d));
        [
            vreinterpretq_f32_f64(vzip1q_f64(ab, cd)),
            vreinterpretq_f32_f64(vzip2q_f64(ab, cd)),
            vreinterpretq_f32_f64(vzip1q_f64(ab_last, cd_last)),
            vreinterpretq_f32_f64(vzip2q_f64(ab_last, cd_last)),
        ]
    })
}

impl WordCpu for Neon {
    type Words = Words;

    #[inline(always)]
    fn load_words(self, words: &[i16; WORDS]) -> Words {
        neon!(Words(vld1q_s16(words.as_ptr()), vld1q_s16(words.as_ptr().add(8))))
    }

    #[inline(always)]
    fn store_words(self, words: Words) -> [i16; WORDS] {
        let mut out = [0; WORDS];
        neon!({
            vst1q_s16(out.as_mut_ptr(), words.0);
            vst1q_s16(out.as_mut_ptr().add(8), words.1);
        });
        out
    }

    #[inline(always)]
    fn load_bytes(self, bytes: &[u8; WORDS]) -> Words {
        neon!({
            // Widened and shifted by one instruction.
            let bytes = vld1q_u8(bytes.as_ptr());
            let (low, high) = (vshll_n_u8::<7>(vget_low_u8(bytes)), vshll_high_n_u8::<7>(bytes));
            Words(vreinterpretq_s16_u16(low), vreinterpretq_s16_u16(high))
        })
    }

    #[inline(always)]
    fn store_bytes(self, words: Words) -> [u8; WORDS] {
        let mut out = [0; WORDS];
        neon!(vst1q_u8(out.as_mut_ptr(), vqmovun_high_s16(vqmovun_s16(words.0), words.1)));
        out
    }

    #[inline(always)]
    fn splat_words(self, value: i16) -> Words {
        let words = neon!(vdupq_n_s16(value));
        Words(words, words)
    }

    #[inline(always)]
    fn scaled(self, a: Words, b: Words) -> Words {
        neon!(Words(vqrdmulhq_s16(a.0, b.0), vqrdmulhq_s16(a.1, b.1)))
    }

    #[inline(always)]
    fn shifted_left<const N: i32>(self, a: Words) -> Words {
        neon!(Words(vshlq_n_s16::<N>(a.0), vshlq_n_s16::<N>(a.1)))
    }

    #[inline(always)]
    fn shifted_right<const N: i32>(self, a: Words) -> Words {
        neon!(Words(vshrq_n_s16::<N>(a.0), vshrq_n_s16::<N>(a.1)))
    }

    #[inline(always)]
    fn and(self, a: Words, b: Words) -> Words {
        neon!(Words(vandq_s16(a.0, b.0), vandq_s16(a.1, b.1)))
    }

    #[inline(always)]
    fn above(self, value: Words, limit: Words, next: Words, lanes: Words) -> Words {
        neon!(Words(
            vbslq_s16(vcgtq_s16(value.0, limit.0), next.0, lanes.0),
            vbslq_s16(vcgtq_s16(value.1, limit.1), next.1, lanes.1),
        ))
    }

    #[inline(always)]
    fn shuffled(self, bytes: &[u8; 8], positions: &[u8; 2 * WORDS]) -> Words {
        neon!({
            let bytes = vld1_u8(bytes.as_ptr());
            let bytes = vcombine_u8(bytes, bytes);
            let low = vqtbl1q_u8(bytes, vld1q_u8(positions.as_ptr()));
            let high = vqtbl1q_u8(bytes, vld1q_u8(positions.as_ptr().add(WORDS)));
            Words(vreinterpretq_s16_u8(low), vreinterpretq_s16_u8(high))
        })
    }

    #[inline(always)]
    fn prefetch(self, _: *const u8) {}

    #[inline(always)]
    fn doubled<const LAST: bool>(self, Words(low, high): Words) -> Words {
        if LAST {
            neon!(Words(vzip2q_s16(low, low), vzip2q_s16(high, high)))
        } else {
            neon!(Words(vzip1q_s16(low, low), vzip1q_s16(high, high)))
        }
    }

    #[inline(always)]
    fn doubled_pairs<const LAST: bool>(self, Words(low, high): Words) -> Words {
        neon!({
            let (low, high) = (vreinterpretq_s32_s16(low), vreinterpretq_s32_s16(high));
            let (low, high) = if LAST {
                (vzip2q_s32(low, low), vzip2q_s32(high, high))
            } else {
                (vzip1q_s32(low, low), vzip1q_s32(high, high))
            };
            Words(vreinterpretq_s16_s32(low), vreinterpretq_s16_s32(high))
        })
    }

    #[inline(always)]
    unsafe fn columns(self, rows: &[*const i16; WORDS]) -> [Words; 6] {
        // SAFETY: the caller's promise, and `self` is a proof of NEON.
        unsafe {
            let mut halves = [[vdupq_n_s16(0); 6]; 2];
            for (half, columns) in halves.iter_mut().enumerate() {
                // Columns 0 and 1, 2 and 3, 4 and 5 of rows 0 to 3 and of rows 4 to 7, in pairs of words.
                let mut four = [[vdupq_n_s32(0); 3]; 2];
                for (index, four) in four.iter_mut().enumerate() {
                    let first = 8 * half + 4 * index;
                    let (a, b) = (vld1q_s16(rows[first]), vld1q_s16(rows[first + 1]));
                    let (c, d) = (vld1q_s16(rows[first + 2]), vld1q_s16(rows[first + 3]));
                    let ab = vreinterpretq_s32_s16(vzip1q_s16(a, b));
                    let cd = vreinterpretq_s32_s16(vzip1q_s16(c, d));
                    let ab_last = vreinterpretq_s32_s16(vzip2q_s16(a, b));
                    let cd_last = vreinterpretq_s32_s16(vzip2q_s16(c, d));
                    *four = [vzip1q_s32(ab, cd), vzip2q_s32(ab, cd), vzip1q_s32(ab_last, cd_last)];
                }
                for (index, (low, high)) in four[0].into_iter().zip(four[1]).enumerate() {
                    let (low, high) = (vreinterpretq_s64_s32(low), vreinterpretq_s64_s32(high));
                    columns[2 * index] = vreinterpretq_s16_s64(vzip1q_s64(low, high));
                    columns[2 * index + 1] = vreinterpretq_s16_s64(vzip2q_s64(low, high));
                }
            }
            let mut columns = [Words(vdupq_n_s16(0), vdupq_n_s16(0)); 6];
            for (column, (low, high)) in columns.iter_mut().zip(halves[0].into_iter().zip(halves[1])) {
                *column = Words(low, high);
            }
            columns
        }
    }

    #[inline(always)]
    fn floats(self, words: Words) -> [Floats; 2] {
        neon!([
            Floats(vcvtq_f32_s32(vmovl_s16(vget_low_s16(words.0))), vcvtq_f32_s32(vmovl_high_s16(words.0)),),
            Floats(vcvtq_f32_s32(vmovl_s16(vget_low_s16(words.1))), vcvtq_f32_s32(vmovl_high_s16(words.1)),),
        ])
    }

    #[inline(always)]
    fn above_floats(self, value: Floats, limit: Floats, next: Floats, lanes: Floats) -> Floats {
        neon!(Floats(
            vbslq_f32(vcgtq_f32(value.0, limit.0), next.0, lanes.0),
            vbslq_f32(vcgtq_f32(value.1, limit.1), next.1, lanes.1),
        ))
    }

    #[inline(always)]
    fn load_samples(self, bytes: &[u8; 2 * FLOATS], shift: u32) -> Floats {
        neon!({
            // Detected only on little-endian machines.
            let words = vreinterpretq_u16_u8(vld1q_u8(bytes.as_ptr()));
            // A shift to the left by a negative number of bits is one to the right.
            let words = vshlq_u16(words, vdupq_n_s16(-(shift as i16)));
            Floats(vcvtq_f32_u32(vmovl_u16(vget_low_u16(words))), vcvtq_f32_u32(vmovl_high_u16(words)))
        })
    }

    #[inline(always)]
    fn store_samples(self, [low, high]: [Floats; 2], max: u16, shift: u32) -> [u16; WORDS] {
        let mut out = [0; WORDS];
        neon!({
            // Conversion limits to 0 and 2³² − 1, narrowing to 2¹⁶ − 1.
            let first = vqmovn_high_u32(vqmovn_u32(vcvtnq_u32_f32(low.0)), vcvtnq_u32_f32(low.1));
            let last = vqmovn_high_u32(vqmovn_u32(vcvtnq_u32_f32(high.0)), vcvtnq_u32_f32(high.1));
            let (max, shift) = (vdupq_n_u16(max), vdupq_n_s16(shift as i16));
            vst1q_u16(out.as_mut_ptr(), vshlq_u16(vminq_u16(first, max), shift));
            vst1q_u16(out.as_mut_ptr().add(8), vshlq_u16(vminq_u16(last, max), shift));
        });
        out
    }

    #[inline(always)]
    fn rounded(self, lanes: Floats, limit: f32) -> [i32; FLOATS] {
        let mut out = [0; FLOATS];
        neon!({
            let (least, most) = (vdupq_n_f32(-limit), vdupq_n_f32(limit));
            vst1q_s32(out.as_mut_ptr(), vcvtnq_s32_f32(vminq_f32(vmaxq_f32(lanes.0, least), most)));
            vst1q_s32(out.as_mut_ptr().add(4), vcvtnq_s32_f32(vminq_f32(vmaxq_f32(lanes.1, least), most)));
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
                neon!(Self($intrinsic(self.0, other.0), $intrinsic(self.1, other.1)))
            }
        }
    };
}

operation!(Add, add, Floats, vaddq_f32);
operation!(Sub, sub, Floats, vsubq_f32);
operation!(Mul, mul, Floats, vmulq_f32);
operation!(Add, add, Words, vaddq_s16);
operation!(Sub, sub, Words, vsubq_s16);
operation!(Add, add, Doubles, vaddq_f64);
operation!(Sub, sub, Doubles, vsubq_f64);
operation!(Mul, mul, Doubles, vmulq_f64);

impl DoubleCpu for Neon {
    type Doubles = Doubles;

    #[inline(always)]
    fn load_doubles(self, values: &[f64; DOUBLES]) -> Doubles {
        neon!(Doubles(vld1q_f64(values.as_ptr()), vld1q_f64(values.as_ptr().add(2))))
    }

    #[inline(always)]
    fn store_doubles(self, doubles: Doubles) -> [f64; DOUBLES] {
        let mut out = [0.0; DOUBLES];
        neon!({
            vst1q_f64(out.as_mut_ptr(), doubles.0);
            vst1q_f64(out.as_mut_ptr().add(2), doubles.1);
        });
        out
    }

    #[inline(always)]
    fn splat_double(self, value: f64) -> Doubles {
        let lanes = neon!(vdupq_n_f64(value));
        Doubles(lanes, lanes)
    }

    #[inline(always)]
    fn fused_doubles(self, a: Doubles, b: Doubles, c: Doubles) -> Doubles {
        neon!(Doubles(vfmaq_f64(c.0, a.0, b.0), vfmaq_f64(c.1, a.1, b.1)))
    }

    #[inline(always)]
    fn fused_less_doubles(self, a: Doubles, b: Doubles, c: Doubles) -> Doubles {
        neon!(Doubles(vfmsq_f64(c.0, a.0, b.0), vfmsq_f64(c.1, a.1, b.1)))
    }
}
