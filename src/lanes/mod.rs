// SPDX-License-Identifier: MIT OR Apache-2.0

//! Vectors of eight floats, of sixteen 16-bit integers and of four doubles: one source of a kernel for all instruction sets.
//!
//! | file | instructions | floats or doubles | integers |
//! |---|---|---|---|
//! | `scalar` | plain Rust | 1 array, the reference | 1 array |
//! | `avx2` | x86-64 with AVX2 and FMA | 1 register | 1 register |
//! | `neon` | AArch64 with NEON | 2 registers | 2 registers |
//!
//! All levels add in the same order. AVX2 and NEON give the same results to the last digit. [`Cpu::fused`] rounds
//! once there, and twice in plain Rust, which would call a function for it on machines without that instruction.
//! What several kernels share is in `matrices`, `rows`, `sums`, `wholes` and `dispatch`. Lanes are created only through a [`Cpu`], whose value proves that the machine has the instructions. All
//! functions that compute with lanes are `inline(always)`, up to a function compiled for that CPU; so must be closures.
//!
//! No crate took this place. The products of the warp are [`WordCpu::scaled`], one instruction with AVX2 and with
//! NEON; `fearless_simd` 1.2 and `pulp` 0.22 have no such operation, and `fearless_simd` widens, shifts and narrows instead:
//! 12 instructions. [`Cpu::halves`] takes it 6 instructions in place of 3. `wide` 1.7 selects instructions when it is compiled.

#[cfg(target_arch = "x86_64")]
mod avx2;
pub(crate) mod dispatch;
pub(crate) mod matrices;
#[cfg(target_arch = "aarch64")]
mod neon;
pub(crate) mod rows;
pub(crate) mod scalar;
pub(crate) mod sums;
pub(crate) mod wholes;

use std::fmt::Debug;
use std::ops::{Add, Mul, Sub};

/// Floats in a vector.
pub(crate) const FLOATS: usize = 8;

/// 16-bit integers in a vector.
pub(crate) const WORDS: usize = 16;

/// Doubles in a vector.
pub(crate) const DOUBLES: usize = 4;

/// Vectors of eight floats; a value proves that the machine has the instructions.
pub(crate) trait Cpu: Copy {
    type Lanes: Copy
        + Debug
        + Add<Output = Self::Lanes>
        + Sub<Output = Self::Lanes>
        + Mul<Output = Self::Lanes>;

    /// Runs a function that is compiled for this CPU. It must be `inline(always)`, with all that it calls.
    fn vectorize<R>(self, work: impl FnOnce() -> R) -> R;

    /// Loads eight samples.
    fn load(self, samples: &[f32; FLOATS]) -> Self::Lanes;

    /// Stores all lanes to an array.
    fn store(self, lanes: Self::Lanes) -> [f32; FLOATS];

    /// The same value in all lanes.
    fn splat(self, value: f32) -> Self::Lanes;

    /// a·b + c, rounded once (AVX2, NEON) or twice (plain Rust).
    fn fused(self, a: Self::Lanes, b: Self::Lanes, c: Self::Lanes) -> Self::Lanes;

    /// c − a·b, rounded once (AVX2, NEON) or twice (plain Rust).
    fn fused_less(self, a: Self::Lanes, b: Self::Lanes, c: Self::Lanes) -> Self::Lanes;

    /// Sums of the first four lanes of each of eight vectors, and of the last four lanes of each.
    fn halves(self, eight: [Self::Lanes; 8]) -> [Self::Lanes; 2];

    /// Sums over the lanes of each of eight vectors.
    #[inline(always)]
    fn totals(self, eight: [Self::Lanes; 8]) -> Self::Lanes {
        let [low, high] = self.halves(eight);
        low + high
    }

    /// Eight vectors as the rows of a matrix, whose columns are the result.
    fn transposed(self, rows: [Self::Lanes; FLOATS]) -> [Self::Lanes; FLOATS];

    /// a/b.
    fn divided(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes;

    /// √a.
    fn root(self, a: Self::Lanes) -> Self::Lanes;

    /// |a|.
    fn magnitude(self, a: Self::Lanes) -> Self::Lanes;
}

/// Vectors of sixteen 16-bit integers besides, and what leads from them to floats and back.
pub(crate) trait WordCpu: Cpu {
    type Words: Copy + Debug + Add<Output = Self::Words> + Sub<Output = Self::Words>;

    /// Loads sixteen words.
    fn load_words(self, words: &[i16; WORDS]) -> Self::Words;

    /// Stores all lanes to an array.
    fn store_words(self, words: Self::Words) -> [i16; WORDS];

    /// Loads sixteen bytes, 0 to 255, times 2⁷.
    fn load_bytes(self, bytes: &[u8; WORDS]) -> Self::Words;

    /// The lanes limited to 0 to 255.
    fn store_bytes(self, words: Self::Words) -> [u8; WORDS];

    /// The same value in all lanes.
    fn splat_words(self, value: i16) -> Self::Words;

    /// (a·b + 2¹⁴) >> 15; not both may be −2¹⁵, for which instruction sets differ.
    fn scaled(self, a: Self::Words, b: Self::Words) -> Self::Words;

    /// a · 2ᴺ.
    fn shifted_left<const N: i32>(self, a: Self::Words) -> Self::Words;

    /// ⌊a / 2ᴺ⌋.
    fn shifted_right<const N: i32>(self, a: Self::Words) -> Self::Words;

    fn and(self, a: Self::Words, b: Self::Words) -> Self::Words;

    /// The lanes of `next` where `value` > `limit`, of `lanes` elsewhere.
    fn above(
        self,
        value: Self::Words,
        limit: Self::Words,
        next: Self::Words,
        lanes: Self::Words,
    ) -> Self::Words;

    /// The lanes whose low and high bytes are those of `bytes` at the given positions, 0 to 7.
    fn shuffled(self, bytes: &[u8; 8], positions: &[u8; 2 * WORDS]) -> Self::Words;

    /// Asks for what is in memory at an address, which may be any, to be brought near; nothing where the compiler has no such
    /// instruction.
    fn prefetch(self, address: *const u8);

    /// Of each half of eight lanes the first four, or (`LAST`) the last four, each twice.
    fn doubled<const LAST: bool>(self, words: Self::Words) -> Self::Words;

    /// The same of pairs: of each half the first two pairs of lanes, or the last two, each twice.
    fn doubled_pairs<const LAST: bool>(self, words: Self::Words) -> Self::Words;

    /// The first six columns of sixteen rows of numbers.
    ///
    /// # Safety
    /// Eight numbers must be readable at each pointer.
    unsafe fn columns(self, rows: &[*const i16; WORDS]) -> [Self::Words; 6];

    /// The words as floats.
    fn floats(self, words: Self::Words) -> [Self::Lanes; 2];

    /// As [`above`](Self::above), for floats.
    fn above_floats(
        self,
        value: Self::Lanes,
        limit: Self::Lanes,
        next: Self::Lanes,
        lanes: Self::Lanes,
    ) -> Self::Lanes;

    /// A bit for each lane, the lowest for the first, that is set where `value` > `limit`.
    #[inline(always)]
    fn bits_above(self, value: Self::Lanes, limit: Self::Lanes) -> u32 {
        let (value, limit) = (self.store(value), self.store(limit));
        let mut bits = 0;
        for lane in 0..FLOATS {
            bits |= u32::from(value[lane] > limit[lane]) << lane;
        }
        bits
    }

    /// The lanes of `a` where they are greater than those of `b`, which stay elsewhere.
    #[inline(always)]
    fn greater(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
        self.above_floats(a, b, a, b)
    }

    /// The lanes of `a` where they are less than those of `b`, which stay elsewhere.
    #[inline(always)]
    fn lesser(self, a: Self::Lanes, b: Self::Lanes) -> Self::Lanes {
        self.above_floats(b, a, a, b)
    }

    /// The lanes limited to a range.
    #[inline(always)]
    fn clamped(self, lanes: Self::Lanes, least: f32, most: f32) -> Self::Lanes {
        self.greater(self.splat(least), self.lesser(self.splat(most), lanes))
    }

    /// Eight samples of 16 bits, little-endian, shifted right by `shift` bits.
    fn load_samples(self, bytes: &[u8; 2 * FLOATS], shift: u32) -> Self::Lanes;

    /// The lanes limited to 0 to `max`, rounded to integers, ties to even, and shifted left by `shift` bits.
    fn store_samples(self, floats: [Self::Lanes; 2], max: u16, shift: u32) -> [u16; WORDS];

    /// The lanes limited to ± `limit`, at most 2³⁰, and rounded to integers, ties to even. Not for NaN.
    fn rounded(self, lanes: Self::Lanes, limit: f32) -> [i32; FLOATS];
}

/// Vectors of four doubles besides.
pub(crate) trait DoubleCpu: Cpu {
    type Doubles: Copy
        + Debug
        + Add<Output = Self::Doubles>
        + Sub<Output = Self::Doubles>
        + Mul<Output = Self::Doubles>;

    /// Loads four doubles.
    fn load_doubles(self, values: &[f64; DOUBLES]) -> Self::Doubles;

    /// Stores all lanes to an array.
    fn store_doubles(self, doubles: Self::Doubles) -> [f64; DOUBLES];

    /// The same value in all lanes.
    fn splat_double(self, value: f64) -> Self::Doubles;

    /// a·b + c, rounded as often as by [`fused`](Cpu::fused).
    fn fused_doubles(self, a: Self::Doubles, b: Self::Doubles, c: Self::Doubles) -> Self::Doubles;

    /// c − a·b, rounded as often.
    fn fused_less_doubles(self, a: Self::Doubles, b: Self::Doubles, c: Self::Doubles) -> Self::Doubles;

    /// Adds a·b to doubles in memory.
    #[inline(always)]
    fn add_product(self, a: Self::Doubles, b: Self::Doubles, to: &mut [f64; DOUBLES]) {
        *to = self.store_doubles(self.fused_doubles(a, b, self.load_doubles(to)));
    }
}
