// SPDX-License-Identifier: MIT OR Apache-2.0

//! The two passes of the warp: in plain Rust, and in the vectors of [`lanes`](crate::lanes).
//!
//! Output row Y is the image of a curve y = Y + down(x, Y) through the frame. The *vertical* pass
//! samples each column where the curve crosses it; the *horizontal* pass samples the resulting row
//! at x = X + across(X, Y). This is two-pass resampling after Catmull and Smith: 2·T taps per sample
//! instead of T², memory read in order, no gathers. It is exact for linear ramps, and its error is of
//! the order of the 2D kernel's for the slopes due to a rolling shutter (up to some 0.3).
//!
//! 8-bit samples: values times 2⁷, weights times 2¹⁴, products rounded to 16 bits (`mulhrs`); there are
//! 6 fraction bits between the passes and 5 in the sum, so the rounding error is at most 4/2⁷ + 4/2⁶ =
//! 0.1 grey levels before the last rounding. All other samples: `f32`.
//!
//! Cubic, 8 bits, AVX2, a block of 16 samples with a constant integer displacement: 5 instructions for
//! the positions, 14 for the weights, 4 × 4 (vertical) or 4 × 3 (horizontal) for the taps, some 4 for
//! rounding and storing: 75 to 80 for both passes, 5 per sample; at three per cycle, 1.6 cycles. Counted,
//! with addressing and varying integer displacements: 77 (vertical) and 57 (horizontal), 8 per sample.
//! Lanczos: 54 for the weights, which are rows of a table, and 6 taps; counted, 146 and 111, 16 per sample.
//! Memory: one byte read and one written per sample, everything else is in the L1 cache (a source row is
//! read four times from there, two bytes per sample between the passes): 2 × 3.1 MB for 1080p I420, 0.4 ms
//! at 15 GB/s. The lower bound is the arithmetic: 3.1 M × 1.6 cycles = 5 M cycles, 1.6 ms on one core of
//! 3.1 GHz.

mod bytes;
mod knots;
mod passes;
mod scalar;
mod task;
mod window;
mod words;

use super::settings::Interpolation;
use super::weights::{Cubic, Kernel, Lanczos, Linear, Nearest};
use crate::cpu::CpuLevel;
use crate::lanes::dispatch::with_cpu;
use crate::lanes::{Cpu, FLOATS};
pub(super) use passes::Passes;
use passes::with_kernel;
pub(super) use scalar::{Fixed, Float};
pub(super) use task::{Horizontal, KnotColumn, OutputFormat, Vertical};

/// First and last tap, relative to the integer position, and the rounding of positions.
pub(super) fn reach(interpolation: Interpolation) -> (isize, isize, i32) {
    with_kernel!(interpolation, K => (K::FIRST, K::FIRST + K::TAPS as isize - 1, K::ROUND))
}

/// Σ weight · node for each column of knots, in each row of `nodes`; finite. The number of columns is a multiple of eight, and
/// `strip` is a buffer.
pub(super) fn knots_along_x(
    level: CpuLevel,
    nodes: &[f32],
    columns: &[KnotColumn],
    strip: &mut Vec<[f32; FLOATS]>,
    knots: &mut [f32],
) {
    with_cpu!(
        level,
        cpu => cpu.vectorize(#[inline(always)] || knots::along_x(cpu, nodes, columns, strip, knots)),
        _ => scalar::along_x(nodes, columns, knots)
    );
}

/// Σ weight · node + round, rounded to integers, for four rows of `nodes` as long as `knots`: a multiple of eight.
pub(super) fn knots_along_y(
    level: CpuLevel,
    nodes: &[f32],
    weights: [f32; 4],
    round: f32,
    knots: &mut [i32],
) {
    with_cpu!(
        level,
        cpu => cpu.vectorize(#[inline(always)] || knots::along_y(cpu, nodes, weights, round, knots)),
        _ => scalar::along_y(nodes, weights, round, knots)
    );
}

/// Vertical pass of a row; `middle` is resized as needed.
pub(super) fn vertical<A: Passes>(
    level: CpuLevel,
    interpolation: Interpolation,
    task: &Vertical<'_>,
    patch: &mut Vec<u8>,
    middle: &mut Vec<A::Number>,
) {
    if with_cpu!(level, cpu => A::vertical(cpu, interpolation, task, patch, middle), _ => false) {
        return;
    }
    with_kernel!(interpolation, K => scalar::vertical::<A, K>(task, patch, middle));
}

/// Horizontal pass of a row.
pub(super) fn horizontal<A: Passes>(
    level: CpuLevel,
    interpolation: Interpolation,
    task: &Horizontal<'_, A::Number>,
    row: &mut [u8],
) {
    if with_cpu!(level, cpu => A::horizontal(cpu, interpolation, task, row), _ => false) {
        return;
    }
    with_kernel!(interpolation, K => scalar::horizontal::<A, K>(task, row));
}
