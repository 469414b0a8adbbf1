// SPDX-License-Identifier: MIT OR Apache-2.0

//! Knots from the nodes of a map, along x once a frame and along y in each row, in vectors; bit-exact with `scalar`.
//!
//! With AVX2, counted: 5 instructions a knot along x, 2 along y; before, one number after the other, 28 along x.

use super::scalar;
use super::task::{KnotColumn, MAX_DISPLACEMENT};
use crate::lanes::{FLOATS, WordCpu};

/// As [`scalar::along_x`], eight rows at a time: each column of knots is a sum of vectors of nodes. The number of columns is a
/// multiple of eight. `strip` is a buffer.
#[inline(always)]
pub(super) fn along_x<C: WordCpu>(
    cpu: C,
    nodes: &[f32],
    columns: &[KnotColumn],
    strip: &mut Vec<[f32; FLOATS]>,
    knots: &mut [f32],
) {
    let rows = knots.len() / columns.len().max(1);
    if rows < FLOATS {
        return scalar::along_x(nodes, columns, knots);
    }
    let width = nodes.len() / rows;
    strip.resize(width, [0.0; FLOATS]);
    let (eights, _) = columns.as_chunks::<FLOATS>();
    // The last eight rows overlap those before.
    for first in (0..rows).step_by(FLOATS).map(|row| row.min(rows - FLOATS)) {
        let nodes = &nodes[first * width..][..FLOATS * width];
        for (lane, row) in nodes.chunks_exact(width).enumerate() {
            strip.iter_mut().zip(row).for_each(|(column, node)| column[lane] = *node);
        }
        let knots = &mut knots[first * columns.len()..][..FLOATS * columns.len()];
        for (index, eight) in eights.iter().enumerate() {
            let mut sums = [cpu.splat(0.0); FLOATS];
            for (sum, KnotColumn { node, weights }) in sums.iter_mut().zip(eight) {
                let [a, b, c, d] = weights.map(
                    #[inline(always)]
                    |weight| cpu.splat(weight),
                );
                let nodes = &strip[*node..node + 4];
                let all = cpu.load(&nodes[0]) * a + cpu.load(&nodes[1]) * b;
                let all = all + cpu.load(&nodes[2]) * c + cpu.load(&nodes[3]) * d;
                let limited = cpu.clamped(all, -MAX_DISPLACEMENT, MAX_DISPLACEMENT);
                // Zero in place of NaN.
                *sum = cpu.above_floats(cpu.magnitude(all), cpu.splat(-1.0), limited, cpu.splat(0.0));
            }
            for (row, eight) in knots.chunks_exact_mut(columns.len()).zip(cpu.transposed(sums)) {
                row.as_chunks_mut().0[index] = cpu.store(eight);
            }
        }
    }
}

/// As [`scalar::along_y`], eight knots at a time; their number is a multiple of eight.
#[inline(always)]
pub(super) fn along_y<C: WordCpu>(cpu: C, nodes: &[f32], weights: [f32; 4], round: f32, knots: &mut [i32]) {
    let (knots, _) = knots.as_chunks_mut::<FLOATS>();
    let (nodes, _) = nodes.as_chunks::<FLOATS>();
    let (a, rest) = nodes.split_at(knots.len());
    let (b, rest) = rest.split_at(knots.len());
    let (c, d) = rest.split_at(knots.len());
    let [wa, wb, wc, wd] = weights.map(
        #[inline(always)]
        |weight| cpu.splat(weight),
    );
    let nodes = a.iter().zip(b).zip(c.iter().zip(d));
    for (((a, b), (c, d)), knots) in nodes.zip(knots) {
        let sum = wa * cpu.load(a) + wb * cpu.load(b) + wc * cpu.load(c) + wd * cpu.load(d);
        // 2³⁰ units are half a million pixels.
        *knots = cpu.rounded(sum + cpu.splat(round), 1.0e9);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::CpuLevel;
    use crate::lanes::Cpu;
    use crate::lanes::dispatch::with_cpu;

    /// Numbers of all sizes, a few of them infinite or none.
    fn number(index: usize) -> f32 {
        match index * 7919 % 97 {
            0 => f32::NAN,
            1 => f32::INFINITY,
            2 => f32::NEG_INFINITY,
            residue => (residue as f32 - 48.0) * if residue % 5 == 0 { 3e4 } else { 0.37 },
        }
    }

    #[test]
    fn knots_along_x_are_those_of_plain_rust_at_all_levels() {
        for (width, rows, count) in [(4, 4, 8), (4, 8, 8), (9, 11, 16), (40, 17, 88)] {
            let nodes: Vec<f32> = (0..width * rows).map(number).collect();
            let column = |index: usize| KnotColumn {
                node: index * 13 % (width - 3),
                weights: [0, 1, 2, 3].map(|tap| ((index * 4 + tap) * 31 % 17) as f32 / 8.0 - 1.0),
            };
            let columns: Vec<KnotColumn> = (0..count).map(column).collect();
            let mut truth = vec![0.0; rows * count];
            scalar::along_x(&nodes, &columns, &mut truth);
            for level in CpuLevel::supported() {
                let (mut strip, mut found) = (Vec::new(), vec![7.0; rows * count]);
                with_cpu!(level, cpu => cpu.vectorize(
                    #[inline(always)]
                    || along_x(cpu, &nodes, &columns, &mut strip, &mut found)
                ));
                assert_eq!(found, truth, "{level}");
            }
        }
    }

    #[test]
    fn knots_along_y_are_those_of_plain_rust_at_all_levels() {
        for columns in [8, 24, 88] {
            let nodes: Vec<f32> = (0..4 * columns).map(|k| (k * k * 7919 % 4093) as f32 - 2046.0).collect();
            for (weights, round) in [([-0.05, 0.6, 0.5, -0.05], 0.0), ([1e6, 1e6, -1e6, 3.0], 1024.0)] {
                let mut truth = vec![0; columns];
                scalar::along_y(&nodes, weights, round, &mut truth);
                for level in CpuLevel::supported() {
                    let mut found = vec![7; columns];
                    with_cpu!(level, cpu => cpu.vectorize(
                        #[inline(always)]
                        || along_y(cpu, &nodes, weights, round, &mut found)
                    ));
                    assert_eq!(found, truth, "{level}");
                }
            }
        }
    }
}
