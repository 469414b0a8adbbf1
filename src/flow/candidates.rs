// SPDX-License-Identifier: MIT OR Apache-2.0

//! Candidate displacements of eight patches, and those among them that differ.

use super::estimate::Mean;
use super::patch::GROUP;
use crate::lanes::WordCpu;

/// Candidates that differ by less than this along both axes, in pixels, converge to the same displacement.
const SAME_CANDIDATE: f32 = 0.5;

/// Of up to eight patches, one in each lane, the candidate displacements (pixels; x, y) that differ.
pub(super) struct Candidates<C: WordCpu, const N: usize> {
    pub(super) shifts: [[C::Lanes; 2]; N],
    /// A bit for each patch that has a candidate of this number; what the lanes of others hold is of no meaning.
    pub(super) active: [u32; N],
}

impl<C: WordCpu, const N: usize> Candidates<C, N> {
    /// Of `count` patches, from the candidates of each.
    #[inline(always)]
    pub(super) fn distinct(cpu: C, count: usize, candidates: impl Fn(usize) -> [[f32; 2]; N]) -> Self {
        let mut all = [[[0.0; GROUP]; 2]; N];
        for k in (0..GROUP).take(count) {
            for (out, [x, y]) in all.iter_mut().zip(candidates(k)) {
                (out[0][k], out[1][k]) = (x, y);
            }
        }
        let mut out = Self { shifts: [[cpu.splat(0.0); 2]; N], active: [u32::MAX; N] };
        for (out, [x, y]) in out.shifts.iter_mut().zip(&all) {
            *out = [cpu.load(x), cpu.load(y)];
        }
        for number in 1..N {
            let mut nearest = cpu.splat(f32::INFINITY);
            for earlier in 0..number {
                nearest = cpu.lesser(separation(cpu, out.shifts[number], out.shifts[earlier]), nearest);
            }
            out.active[number] = others(cpu, nearest);
        }
        out
    }
}

/// The cells of the next coarser level, in its pixels.
#[derive(Clone, Copy)]
pub(super) struct CoarserCells<'a> {
    pub(super) means: &'a [Mean],
    pub(super) columns: usize,
    pub(super) rows: usize,
}

/// Displacements of some cells in a row, in pixels of the finer level: x, y.
type Line = [[f32; GROUP]; 2];

impl CoarserCells<'_> {
    #[inline(always)]
    fn at(&self, row: usize, column: usize) -> [f32; 2] {
        let index =
            row.min(self.rows.wrapping_sub(1)) * self.columns + column.min(self.columns.wrapping_sub(1));
        twice(self.means.get(index).map(Mean::shift).unwrap_or_default())
    }

    /// The displacement at a patch, and those of the four diagonal cells around it.
    ///
    /// In coarser cells the centre of a patch lies at half its index: on a cell, or between two.
    #[inline(always)]
    pub(super) fn around(&self, column: usize, row: usize) -> ([f32; 2], [[f32; 2]; 4]) {
        let around = |from: usize, to: usize, above: usize, below: usize| {
            [self.at(above, from), self.at(above, to), self.at(below, from), self.at(below, to)]
        };
        let [a, b, c, d] = around(column / 2, column.div_ceil(2), row / 2, row.div_ceil(2));
        let interpolated = [0, 1].map(|axis| 0.25 * ((a[axis] + b[axis]) + (c[axis] + d[axis])));
        (interpolated, around(before(column), column / 2 + 1, before(row), row / 2 + 1))
    }

    /// Cells of a row: that before the cell of a patch, its own, and four more.
    #[inline(always)]
    fn line(&self, row: usize, first: usize) -> Line {
        let mut line = [[0.0; GROUP]; 2];
        let [across, down] = &mut line;
        for (k, (x, y)) in across.iter_mut().zip(down).enumerate().take(6) {
            [*x, *y] = self.at(row, (first / 2 + k).saturating_sub(1));
        }
        line
    }

    /// Two candidates for eight patches from column `first`, a multiple of 8, on: the displacement there, and of the
    /// surrounding cells that which differs most.
    #[inline(always)]
    pub(super) fn finest<C: WordCpu>(&self, cpu: C, first: usize, row: usize) -> Candidates<C, 2> {
        let [above, below] = [row / 2, row.div_ceil(2)].map(|row| self.line(row, first));
        // Between two rows the cells around are those that are interpolated.
        let (before, after) = if row.is_multiple_of(2) {
            (self.line(before(row), first), self.line(row / 2 + 1, first))
        } else {
            (above, below)
        };
        let mut interpolated = [cpu.splat(0.0); 2];
        for (axis, out) in interpolated.iter_mut().enumerate() {
            *out = cpu.splat(0.25) * (between(cpu, &above[axis]) + between(cpu, &below[axis]));
        }
        let (mut furthest, mut distance) = (interpolated, cpu.splat(0.0));
        for line in [&before, &after] {
            for places in [[0, 1, 1, 2, 2, 3, 3, 4], [2, 2, 3, 3, 4, 4, 5, 5]] {
                let (x, y) = (cpu.load(&spread(&line[0], places)), cpu.load(&spread(&line[1], places)));
                let (dx, dy) = (x - interpolated[0], y - interpolated[1]);
                let other = dx * dx + dy * dy;
                furthest = [
                    cpu.above_floats(other, distance, x, furthest[0]),
                    cpu.above_floats(other, distance, y, furthest[1]),
                ];
                distance = cpu.greater(other, distance);
            }
        }
        let others = others(cpu, separation(cpu, furthest, interpolated));
        Candidates { shifts: [interpolated, furthest], active: [u32::MAX, others] }
    }
}

/// How far displacements are apart along the axis on which it is greater.
#[inline(always)]
fn separation<C: WordCpu>(cpu: C, [x, y]: [C::Lanes; 2], [other_x, other_y]: [C::Lanes; 2]) -> C::Lanes {
    cpu.greater(cpu.magnitude(x - other_x), cpu.magnitude(y - other_y))
}

/// A bit for each candidate that is so far from another one that it is not the same.
#[inline(always)]
fn others<C: WordCpu>(cpu: C, separation: C::Lanes) -> u32 {
    !cpu.bits_above(cpu.splat(SAME_CANDIDATE), separation)
}

/// The index of the coarser cell before that of a patch, or its own where there is none.
#[inline(always)]
fn before(index: usize) -> usize {
    index.saturating_sub(1) / 2
}

#[inline(always)]
fn spread(line: &[f32; GROUP], places: [usize; GROUP]) -> [f32; GROUP] {
    places.map(|place| line[place])
}

/// Sums of the cells to the left and right of the centres of eight patches.
#[inline(always)]
fn between<C: WordCpu>(cpu: C, line: &[f32; GROUP]) -> C::Lanes {
    let [left, right] = [spread(line, [1, 1, 2, 2, 3, 3, 4, 4]), spread(line, [1, 2, 2, 3, 3, 4, 4, 5])];
    cpu.load(&left) + cpu.load(&right)
}

#[inline(always)]
pub(super) fn twice(shift: [f32; 2]) -> [f32; 2] {
    shift.map(|value| 2.0 * value)
}
