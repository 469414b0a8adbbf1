// SPDX-License-Identifier: MIT OR Apache-2.0

//! Vectors in plain Rust: the reference for floats; for integers what compilers make of them for a machine of which
//! nothing is known, several times as fast as one number after the other.

use super::{Cpu, DOUBLES, DoubleCpu, FLOATS, WORDS, WordCpu};
use std::array::from_fn;
use std::ops::{Add, Mul, Sub};

/// Plain Rust.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scalar;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Array([f32; FLOATS]);

impl Cpu for Scalar {
    type Lanes = Array;

    #[inline(always)]
    fn vectorize<R>(self, work: impl FnOnce() -> R) -> R {
        work()
    }

    #[inline(always)]
    fn load(self, samples: &[f32; FLOATS]) -> Array {
        Array(*samples)
    }

    #[inline(always)]
    fn store(self, Array(lanes): Array) -> [f32; FLOATS] {
        lanes
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Array {
        Array([value; FLOATS])
    }

    #[inline(always)]
    fn fused(self, a: Array, b: Array, c: Array) -> Array {
        a * b + c
    }

    #[inline(always)]
    fn fused_less(self, a: Array, b: Array, c: Array) -> Array {
        c - a * b
    }

    #[inline(always)]
    fn halves(self, eight: [Array; 8]) -> [Array; 2] {
        [0, 4].map(|from| {
            Array(
                eight.map(|Array(lanes)| {
                    (lanes[from] + lanes[from + 1]) + (lanes[from + 2] + lanes[from + 3])
                }),
            )
        })
    }

    #[inline(always)]
    fn transposed(self, rows: [Array; FLOATS]) -> [Array; FLOATS] {
        from_fn(|column| Array(rows.map(|Array(row)| row[column])))
    }

    #[inline(always)]
    fn divided(self, Array(a): Array, Array(b): Array) -> Array {
        Array(from_fn(|lane| a[lane] / b[lane]))
    }

    #[inline(always)]
    fn root(self, Array(a): Array) -> Array {
        Array(a.map(f32::sqrt))
    }

    #[inline(always)]
    fn magnitude(self, Array(a): Array) -> Array {
        Array(a.map(f32::abs))
    }
}

/// Sixteen words.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Words([i16; WORDS]);

impl Words {
    /// An operation on each lane of two vectors.
    #[inline(always)]
    fn zip(self, other: Self, operation: impl Fn(i16, i16) -> i16) -> Self {
        Self(from_fn(|lane| operation(self.0[lane], other.0[lane])))
    }
}

impl WordCpu for Scalar {
    type Words = Words;

    #[inline(always)]
    fn load_words(self, words: &[i16; WORDS]) -> Words {
        Words(*words)
    }

    #[inline(always)]
    fn store_words(self, Words(words): Words) -> [i16; WORDS] {
        words
    }

    #[inline(always)]
    fn load_bytes(self, bytes: &[u8; WORDS]) -> Words {
        Words(bytes.map(|byte| i16::from(byte) << 7))
    }

    #[inline(always)]
    fn store_bytes(self, Words(words): Words) -> [u8; WORDS] {
        words.map(|word| word.clamp(0, 255) as u8)
    }

    #[inline(always)]
    fn splat_words(self, value: i16) -> Words {
        Words([value; WORDS])
    }

    #[inline(always)]
    fn scaled(self, a: Words, b: Words) -> Words {
        a.zip(b, |a, b| ((i32::from(a) * i32::from(b) + (1 << 14)) >> 15) as i16)
    }

    #[inline(always)]
    fn shifted_left<const N: i32>(self, Words(a): Words) -> Words {
        Words(a.map(|word| word << N))
    }

    #[inline(always)]
    fn shifted_right<const N: i32>(self, Words(a): Words) -> Words {
        Words(a.map(|word| word >> N))
    }

    #[inline(always)]
    fn and(self, a: Words, b: Words) -> Words {
        a.zip(b, |a, b| a & b)
    }

    #[inline(always)]
    fn above(self, value: Words, limit: Words, next: Words, lanes: Words) -> Words {
        let is_above = value.zip(limit, |value, limit| -i16::from(value > limit));
        Words(from_fn(|lane| (next.0[lane] & is_above.0[lane]) | (lanes.0[lane] & !is_above.0[lane])))
    }

    #[inline(always)]
    fn shuffled(self, bytes: &[u8; 8], positions: &[u8; 2 * WORDS]) -> Words {
        let byte = |position: usize| bytes[usize::from(positions[position]) % bytes.len()];
        Words(from_fn(|lane| i16::from_le_bytes([byte(2 * lane), byte(2 * lane + 1)])))
    }

    #[inline(always)]
    fn prefetch(self, _: *const u8) {}

    #[inline(always)]
    fn doubled<const LAST: bool>(self, Words(words): Words) -> Words {
        Words(from_fn(|lane| words[lane / 8 * 8 + lane % 8 / 2 + if LAST { 4 } else { 0 }]))
    }

    #[inline(always)]
    fn doubled_pairs<const LAST: bool>(self, Words(words): Words) -> Words {
        Words(from_fn(|lane| words[lane / 8 * 8 + lane % 8 / 4 * 2 + lane % 2 + if LAST { 4 } else { 0 }]))
    }

    #[inline(always)]
    unsafe fn columns(self, rows: &[*const i16; WORDS]) -> [Words; 6] {
        // SAFETY: the caller's promise.
        from_fn(|column| Words(rows.map(|row| unsafe { *row.add(column) })))
    }

    #[inline(always)]
    fn floats(self, Words(words): Words) -> [Array; 2] {
        from_fn(|half| Array(from_fn(|lane| f32::from(words[FLOATS * half + lane]))))
    }

    #[inline(always)]
    fn above_floats(self, value: Array, limit: Array, next: Array, lanes: Array) -> Array {
        Array(from_fn(|lane| if value.0[lane] > limit.0[lane] { next.0[lane] } else { lanes.0[lane] }))
    }

    #[inline(always)]
    fn load_samples(self, bytes: &[u8; 2 * FLOATS], shift: u32) -> Array {
        let word = |lane: usize| u16::from_le_bytes([bytes[2 * lane], bytes[2 * lane + 1]]);
        Array(from_fn(|lane| f32::from(word(lane) >> shift)))
    }

    #[inline(always)]
    fn store_samples(self, [Array(low), Array(high)]: [Array; 2], max: u16, shift: u32) -> [u16; WORDS] {
        let max = f32::from(max);
        from_fn(|lane| {
            let float = if lane < FLOATS { low[lane] } else { high[lane - FLOATS] };
            (nearest(float.clamp(0.0, max)) as u16) << shift
        })
    }

    #[inline(always)]
    fn rounded(self, Array(lanes): Array, limit: f32) -> [i32; FLOATS] {
        lanes.map(|float| float.clamp(-limit, limit).round_ties_even() as i32)
    }
}

/// Rounds a number from 0 to 2²³ to an integer, ties to even, without the function that the standard library calls on
/// machines that have no instruction for it: numbers from 2²³ on have no fraction.
#[inline(always)]
fn nearest(float: f32) -> i32 {
    const ROUND: f32 = (1 << 23) as f32;
    (float + ROUND).to_bits().wrapping_sub(ROUND.to_bits()) as i32
}

/// A binary operator on lanes.
macro_rules! operation {
    ($name:ident, $function:ident, $vector:ident) => {
        impl $name for $vector {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                Self(from_fn(|lane| self.0[lane].$function(other.0[lane])))
            }
        }
    };
}

operation!(Add, add, Array);
operation!(Sub, sub, Array);
operation!(Mul, mul, Array);
operation!(Add, add, Doubles);
operation!(Sub, sub, Doubles);
operation!(Mul, mul, Doubles);

impl Add for Words {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, i16::wrapping_add)
    }
}

impl Sub for Words {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, i16::wrapping_sub)
    }
}

/// Four doubles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Doubles([f64; DOUBLES]);

impl DoubleCpu for Scalar {
    type Doubles = Doubles;

    #[inline(always)]
    fn load_doubles(self, values: &[f64; DOUBLES]) -> Doubles {
        Doubles(*values)
    }

    #[inline(always)]
    fn store_doubles(self, Doubles(doubles): Doubles) -> [f64; DOUBLES] {
        doubles
    }

    #[inline(always)]
    fn splat_double(self, value: f64) -> Doubles {
        Doubles([value; DOUBLES])
    }

    #[inline(always)]
    fn fused_doubles(self, Doubles(a): Doubles, Doubles(b): Doubles, Doubles(c): Doubles) -> Doubles {
        Doubles(from_fn(|lane| a[lane] * b[lane] + c[lane]))
    }

    #[inline(always)]
    fn fused_less_doubles(self, Doubles(a): Doubles, Doubles(b): Doubles, Doubles(c): Doubles) -> Doubles {
        Doubles(from_fn(|lane| c[lane] - a[lane] * b[lane]))
    }
}
