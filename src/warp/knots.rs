// SPDX-License-Identifier: MIT OR Apache-2.0

//! The displacements of a plane at knots, and the blocks between them.

use super::blocks::{BLOCK, Block, KNOT};
use super::inverse::{MapField, cubic};
use super::kernels::{self, KnotColumn};
use super::sample_grid::SampleGrid;
use super::weights::ONE;
use crate::cpu::{CpuLevel, for_each_cpu};
use crate::lanes::FLOATS;

for_each_cpu! {
    /// The blocks between successive pairs of knots, at most as many as `blocks`.
    fn between(pairs: &[[i32; 2]], blocks: &mut [Block]) {
        let next = pairs.get(1..).unwrap_or_default();
        for ((block, from), to) in blocks.iter_mut().zip(pairs).zip(next) {
            *block = Block::new([from[0], from[1], to[0]]);
        }
    }
}

/// A displacement field resampled for one plane: knots of the plane's columns at the rows of the field's
/// nodes.
#[derive(Clone, Debug, Default)]
pub(super) struct KnotTable {
    /// Index of the first knot; knot k lies at plane column 8k.
    first: isize,
    /// The knots of a row, a multiple of [`FLOATS`].
    columns: Vec<KnotColumn>,
    /// Displacements in plane pixels, row by row.
    values: Vec<f32>,
    /// Plane row of node row 0.
    origin: f64,
    /// Plane rows between node rows.
    spacing: f64,
    /// A buffer.
    strip: Vec<[f32; FLOATS]>,
}

impl KnotTable {
    /// Resamples `field` at knots that cover plane columns `from` to `to`; `axis` is the one along
    /// which the field displaces.
    pub fn fill(
        &mut self,
        level: CpuLevel,
        field: &MapField,
        grid: &SampleGrid,
        axis: usize,
        [from, to]: [isize; 2],
    ) {
        let [scale_x, scale_y] = grid.scale;
        self.first = from.div_euclid(BLOCK as isize) * 2;
        self.origin = (field.y.first - grid.offset[1]) / scale_y;
        self.spacing = field.y.spacing / scale_y;
        let count = (to.div_euclid(BLOCK as isize) * 2 + 3 - self.first).max(3) as usize;
        self.columns.clear();
        self.columns.extend((0..count.next_multiple_of(FLOATS)).map(|index| {
            let column = ((self.first + index as isize) * KNOT as isize) as f64;
            let at = (scale_x * column + grid.offset[0] - field.x.first) / field.x.spacing;
            let (node, weights) = cubic(at, field.x.count);
            KnotColumn { node, weights: weights.map(|weight| weight as f32 / grid.scale[axis] as f32) }
        }));
        self.values.resize(self.columns.len() * field.y.count, 0.0);
        kernels::knots_along_x(level, &field.values, &self.columns, &mut self.strip, &mut self.values);
    }

    /// Displacements at all knots of plane row `row`, in 1/[`ONE`] px plus `round`; `knots` is a buffer.
    pub fn row<'a>(&self, level: CpuLevel, row: usize, round: i32, knots: &'a mut Vec<i32>) -> &'a [i32] {
        let columns = self.columns.len();
        let rows = self.values.len() / columns.max(1);
        let (node, weights) = cubic((row as f64 - self.origin) / self.spacing, rows);
        let nodes = &self.values[node * columns..(node + 4) * columns];
        if knots.len() < columns {
            knots.resize(columns, 0);
        }
        let knots = &mut knots[..columns];
        let weights = weights.map(|weight| weight as f32 * ONE as f32);
        kernels::knots_along_y(level, nodes, weights, round as f32, knots);
        knots
    }

    /// The blocks of plane columns `from` (a multiple of 16) to `to`, from the knots of a row; constant
    /// beyond the table.
    pub fn blocks(&self, level: CpuLevel, knots: &[i32], from: isize, to: isize, blocks: &mut Vec<Block>) {
        let (from, to) = (from.div_euclid(BLOCK as isize), to.div_euclid(BLOCK as isize));
        let last = knots.len() as isize - 1;
        let knot = |index: isize| knots[index.clamp(0, last) as usize];
        let first = from * 2 - self.first;
        let single = |index: isize| Block::new([knot(index), knot(index + 1), knot(index + 2)]);
        // Blocks before the table; those within it except the last, which has no second pair; all others.
        blocks.resize((to - from + 1) as usize, Block::default());
        let (before, inside) = blocks.split_at_mut((-first / 2).clamp(0, to - from + 1) as usize);
        let start = (first.max(0) / 2) as usize;
        let (pairs, _) = knots.as_chunks::<2>();
        let pairs = pairs.get(start..).unwrap_or_default();
        let count = pairs.len().saturating_sub(1).min(inside.len());
        let (inside, after) = inside.split_at_mut(count);
        between(level, pairs, inside);
        let behind = first + 2 * (before.len() + count) as isize;
        for (start, outside) in [(first, before), (behind, after)] {
            for (knot, block) in (start..).step_by(2).zip(outside) {
                *block = single(knot);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_those_of_single_knots_at_all_levels() {
        // Displacements that change slowly, too fast, and up to the largest.
        let wave = |knot: i32, size: i32| (knot * knot * 7919 % 4093 - 2046) * size;
        for size in [1, 13, 700, 480_000] {
            for columns in [3, 5, 17, 33, 245] {
                let knots: Vec<i32> = (0..columns).map(|knot| wave(knot, size)).collect();
                for (first, from, to) in
                    [(0, 0isize, 16 * columns as isize / 2), (-4, -96, 500), (6, -32, 20), (0, 320, 400)]
                {
                    let table = KnotTable { first, ..KnotTable::default() };
                    let known = |index: isize| knots[(index - first).clamp(0, columns as isize - 1) as usize];
                    let truth: Vec<Block> = (from.div_euclid(16)..=to.div_euclid(16))
                        .map(|block| Block::new([0, 1, 2].map(|knot| known(2 * block + knot))))
                        .collect();
                    for level in CpuLevel::supported() {
                        let mut blocks = Vec::new();
                        table.blocks(level, &knots, from, to, &mut blocks);
                        assert_eq!(blocks, truth, "{level} {size} {columns} {first} {from} {to}");
                    }
                }
            }
        }
    }
}
