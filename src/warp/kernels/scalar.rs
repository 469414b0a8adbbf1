// SPDX-License-Identifier: MIT OR Apache-2.0

//! Both passes in plain Rust, for every format and interpolation.

use super::task::{Horizontal, KnotColumn, MAX_DISPLACEMENT, Vertical};
use crate::warp::blocks::BLOCK;
use crate::warp::weights::{Kernel, MAX_TAPS, mulhrs};

/// How samples are multiplied and summed.
pub(in crate::warp) trait Arithmetic {
    /// A weight, and a sample between the passes.
    type Number: Copy + Default;

    fn weights<K: Kernel>(fraction: i16) -> [Self::Number; MAX_TAPS];
    /// A stored sample, without its shift, as a factor of the vertical pass.
    fn load(bytes: &[u8], at: usize, shift: u32) -> Self::Number;
    /// `sum + sample · weight`.
    fn add(sum: Self::Number, sample: Self::Number, weight: Self::Number) -> Self::Number;
    /// The sum of the horizontal pass as a sample from 0 to `max`.
    fn finish(sum: Self::Number, max: u16) -> u16;
}

/// 16-bit integers, for samples of 8 bits.
pub(in crate::warp) struct Fixed;
/// `f32`, for 16-bit words.
pub(in crate::warp) struct Float;

impl Arithmetic for Fixed {
    type Number = i16;

    fn weights<K: Kernel>(fraction: i16) -> [i16; MAX_TAPS] {
        K::fixed(fraction)
    }

    fn load(bytes: &[u8], at: usize, _: u32) -> i16 {
        i16::from(bytes[at]) << 7
    }

    fn add(sum: i16, sample: i16, weight: i16) -> i16 {
        sum.wrapping_add(mulhrs(sample, weight))
    }

    fn finish(sum: i16, _: u16) -> u16 {
        (sum.wrapping_add(16) >> 5).clamp(0, 255) as u16
    }
}

impl Arithmetic for Float {
    type Number = f32;

    fn weights<K: Kernel>(fraction: i16) -> [f32; MAX_TAPS] {
        K::float(fraction)
    }

    fn load(bytes: &[u8], at: usize, shift: u32) -> f32 {
        f32::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]) >> shift)
    }

    fn add(sum: f32, sample: f32, weight: f32) -> f32 {
        sum + sample * weight
    }

    fn finish(sum: f32, max: u16) -> u16 {
        sum.clamp(0.0, f32::from(max)).round_ties_even() as u16
    }
}

/// Samples each column at its own y.
pub(super) fn vertical<A: Arithmetic, K: Kernel>(
    task: &Vertical<'_>,
    patch: &mut Vec<u8>,
    middle: &mut Vec<A::Number>,
) {
    let layout = *task.plane.layout();
    let (step, bytes, shift) = (layout.step, layout.format.bytes(), layout.format.shift());
    middle.resize(task.blocks.len() * BLOCK * step, A::Number::default());
    let windows = task.windows::<K>();
    let blocks = task.blocks.iter().enumerate();
    for ((index, block), out) in blocks.zip(middle.chunks_exact_mut(BLOCK * step)) {
        let window = windows.of(index, block, patch);
        for (pixel, out) in out.chunks_exact_mut(step).enumerate() {
            let (whole, fraction) = block.at(pixel);
            let weights = A::weights::<K>(fraction);
            let tap = (whole - block.first as isize) as usize;
            let at = tap * window.stride + pixel * step * bytes;
            for (channel, out) in out[..layout.channels].iter_mut().enumerate() {
                *out = (0..K::TAPS).fold(A::Number::default(), |sum, tap| {
                    let at = at + tap * window.stride + channel * bytes;
                    A::add(sum, A::load(window.bytes, at, shift), weights[tap])
                });
            }
        }
    }
}

/// Samples the row between the passes at each pixel's own x.
pub(super) fn horizontal<A: Arithmetic, K: Kernel>(task: &Horizontal<'_, A::Number>, row: &mut [u8]) {
    let output = task.output;
    for pixel in 0..task.width {
        let (whole, fraction) = task.blocks[pixel / BLOCK].at(pixel % BLOCK);
        let weights = A::weights::<K>(fraction);
        let at = (pixel as isize + whole + K::FIRST - task.column) as usize * task.step;
        for channel in 0..output.channels {
            let sum = (0..K::TAPS).fold(A::Number::default(), |sum, tap| {
                A::add(sum, task.middle[at + tap * task.step + channel], weights[tap])
            });
            let stored = (A::finish(sum, output.max) << output.shift).to_le_bytes();
            let at = (pixel * output.step + channel) * output.bytes;
            row[at..at + output.bytes].copy_from_slice(&stored[..output.bytes]);
        }
    }
}

/// The knots of all rows of nodes, columns of four of which are weighted; zero in place of NaN.
pub(super) fn along_x(nodes: &[f32], columns: &[KnotColumn], knots: &mut [f32]) {
    let rows = knots.len() / columns.len().max(1);
    let width = nodes.len() / rows.max(1);
    for (nodes, knots) in nodes.chunks_exact(width.max(1)).zip(knots.chunks_exact_mut(columns.len().max(1))) {
        for (KnotColumn { node, weights }, knot) in columns.iter().zip(knots) {
            let value: f32 = nodes[*node..].iter().zip(weights).map(|(node, weight)| node * weight).sum();
            *knot = if value.is_nan() { 0.0 } else { value.clamp(-MAX_DISPLACEMENT, MAX_DISPLACEMENT) };
        }
    }
}

/// Knots of a row from four rows of nodes.
pub(super) fn along_y(nodes: &[f32], weights: [f32; 4], round: f32, knots: &mut [i32]) {
    let (a, rest) = nodes.split_at(knots.len());
    let (b, rest) = rest.split_at(knots.len());
    let (c, d) = rest.split_at(knots.len());
    let nodes = a.iter().zip(b).zip(c.iter().zip(d));
    for (((a, b), (c, d)), knot) in nodes.zip(knots) {
        let value = weights[0] * a + weights[1] * b + weights[2] * c + weights[3] * d + round;
        // 2³⁰ units are half a million pixels.
        *knot = value.clamp(-1.0e9, 1.0e9).round_ties_even() as i32;
    }
}
