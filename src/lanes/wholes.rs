// SPDX-License-Identifier: MIT OR Apache-2.0

//! Whole numbers from floats much smaller than 2²²: half as many instructions as a conversion, which must be defined for
//! every number.

use super::WordCpu;

/// Numbers between 2²³ and 2²⁴ have no fraction, so that adding 1.5·2²³ rounds, and leaves the whole number
/// in the lowest bits.
pub(crate) const ROUND: f32 = 1.5 * (1 << 23) as f32;

/// The whole number to which [`ROUND`] was added.
#[inline(always)]
pub(crate) fn whole(rounded: f32) -> i32 {
    rounded.to_bits().wrapping_sub(ROUND.to_bits()) as i32
}

/// ⌊a⌋.
#[inline(always)]
pub(crate) fn floor<C: WordCpu>(cpu: C, a: C::Lanes) -> C::Lanes {
    let round = cpu.splat(ROUND);
    let rounded = (a + round) - round;
    rounded - cpu.above_floats(rounded, a, cpu.splat(1.0), cpu.splat(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Cpu;
    use crate::lanes::scalar::Scalar;

    #[test]
    fn floors_are_whole_numbers() {
        for at in [-4e6, -8.0, -7.75, -0.25, 0.0, 0.25, 0.5, 1.0, 1.5, 479.998, 480.0, 4e6] {
            let [found, ..] = Scalar.store(floor(Scalar, Scalar.splat(at)));
            assert_eq!((found, whole(found + ROUND)), (at.floor(), at.floor() as i32));
        }
    }
}
