// SPDX-License-Identifier: MIT OR Apache-2.0

//! Sums over a patch by which it is registered.

use super::Cpu;

/// Number of the sums: of v, x, y, x², x·y, y², v², x·v and y·v.
pub(crate) const SUMS: usize = 9;

/// Adds eight pixels of values v and differences x and y.
#[inline(always)]
pub(crate) fn add_products<C: Cpu>(cpu: C, sums: &mut [C::Lanes; SUMS], [v, x, y]: [C::Lanes; 3]) {
    sums[0] = sums[0] + v;
    sums[1] = sums[1] + x;
    sums[2] = sums[2] + y;
    sums[3] = cpu.fused(x, x, sums[3]);
    sums[4] = cpu.fused(x, y, sums[4]);
    sums[5] = cpu.fused(y, y, sums[5]);
    sums[6] = cpu.fused(v, v, sums[6]);
    sums[7] = cpu.fused(x, v, sums[7]);
    sums[8] = cpu.fused(y, v, sums[8]);
}
