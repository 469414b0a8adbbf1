// SPDX-License-Identifier: MIT OR Apache-2.0

//! The inverse map in the format of the kernels: blocks of 16 pixels of one row.
//!
//! Displacements are linear between *knots* 8 plane pixels apart. The error is 8²/8 · f″ = 3e-3 px for
//! 0.2 rad in 1080 rows; positions are then rounded to 1/2048 px.
//!
//! Along a row the position is almost "pixel + constant": inside a block the integer part of the
//! displacement takes few values, mostly one. A block therefore stores the least integer part, the span
//! to the largest, and the remainders as 16-bit numbers; a kernel reads as many neighbouring vectors as
//! there are taps and integer parts, without gathers.
//!
//! With AVX2, a block takes 11 instructions in rows of 1920 pixels, eight blocks at a time, and its knots 6; 17 and 11 in rows of 640.

use super::weights::{FRACTION_BITS, ONE};

/// Pixels in a block.
pub(super) const BLOCK: usize = 16;
/// Pixels between knots.
pub(super) const KNOT: usize = 8;
/// Largest change of displacement between two knots, in 1/[`ONE`] px: the largest zoom needs 7 px (1/8 − 1
/// per pixel), and twice as much still fits into 16 bits.
const MAX_CHANGE: i32 = 7 * ONE;

/// Displacements of 16 pixels: four numbers of 32 bits, so that the compiler vectorises over blocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub(super) struct Block {
    /// Displacements at pixels 0 (the low 16 bits) and 8 less `first`, in 1/[`ONE`] px; not negative. The
    /// vector kernels read them and `change` as the first 8 bytes.
    start: u32,
    /// Changes of displacement from there over 8 pixels.
    change: u32,
    /// The least integer displacement.
    pub first: i32,
    /// The largest integer displacement less the least.
    pub span: i32,
}

/// Two numbers of 16 bits, the first in the low bits.
#[inline(always)]
const fn pair(low: i32, high: i32) -> u32 {
    (low as u32 & 0xffff) | (high as u32) << 16
}

impl Block {
    /// The block between three knots given in 1/[`ONE`] px.
    #[inline(always)]
    pub(super) fn new(knots: [i32; 3]) -> Self {
        let middle = knots[0] + (knots[1] - knots[0]).clamp(-MAX_CHANGE, MAX_CHANGE);
        let end = middle + (knots[2] - middle).clamp(-MAX_CHANGE, MAX_CHANGE);
        let first = knots[0].min(middle).min(end) >> FRACTION_BITS;
        let last = knots[0].max(middle).max(end) >> FRACTION_BITS;
        let base = first << FRACTION_BITS;
        Self {
            start: pair(knots[0] - base, middle - base),
            change: pair(middle - knots[0], end - middle),
            first,
            span: last - first,
        }
    }

    /// The bytes of the displacements at pixels 0 and 8 and of the two changes, 16 bits each.
    #[inline(always)]
    pub(super) fn halves(&self) -> &[u8; 8] {
        // SAFETY: `start` and `change` are the first 8 bytes.
        unsafe { &*std::ptr::from_ref(self).cast() }
    }

    /// Integer displacement and fraction of pixel 0 to 15.
    pub fn at(&self, pixel: usize) -> (isize, i16) {
        let half = |pair: u32| (pair >> (16 * ((pixel / KNOT) & 1))) as i16;
        let ramp = ((pixel % KNOT) << 12) as i16;
        let value = half(self.start) + super::weights::mulhrs(half(self.change), ramp);
        let whole = self.first + i32::from(value >> FRACTION_BITS);
        (whole as isize, value & (ONE as i16 - 1))
    }
}
