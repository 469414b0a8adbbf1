// SPDX-License-Identifier: MIT OR Apache-2.0

//! Local distortion at a point, from the displacements of its neighbours.
//!
//! It is I + ∂shift/∂x, by medians of the differences between adjacent cells of the 5 × 5 around a cell: robust to just
//! under half outliers or cells of another displacement. Eight cells of a row are done at a time, one in each lane: for
//! each of four medians of 20 some 1800 instructions, 900 a cell.

use crate::cpu::CpuLevel;
use crate::lanes::dispatch::with_cpu;
use crate::lanes::rows::SampleRows;
use crate::lanes::{Cpu, FLOATS, WordCpu};
use nalgebra::{Matrix2, Vector2};

/// Cells on each side that are used as neighbours.
const REACH: usize = 2;

/// Cells of the neighbourhood along each axis.
const SIDE: usize = 2 * REACH + 1;

/// Pairs of neighbours along one axis.
const PAIRS: usize = SIDE * (SIDE - 1);

/// Fewer pairs of neighbours than this give no estimate.
const MIN_NEIGHBOUR_PAIRS: f32 = 4.0;

/// Distortions with a matrix entry larger than this are rejected as outliers.
const MAX_DISTORTION: f32 = 0.5;

/// A measured displacement at a cell of the grid, in analysed pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct GridDisplacement {
    pub(super) at: Vector2<f32>,
    pub(super) shift: Vector2<f32>,
}

/// Local distortions at the cells of a grid.
#[derive(Clone, Debug, Default)]
pub(super) struct Distortions {
    matrices: Vec<Matrix2<f32>>,
    /// Scratch: differences of displacement per pixel of distance, to the cell on the right and to the cell below.
    gradients: [Gradients; 2],
}

/// Derivatives of the displacement along one axis, x and y, row by row with a margin of [`REACH`] cells; not a number
/// where either cell has no displacement.
#[derive(Clone, Debug, Default)]
struct Gradients {
    components: [Vec<f32>; 2],
    stride: usize,
}

impl Distortions {
    /// The distortion at a cell.
    pub(super) fn at(&self, index: usize) -> Matrix2<f32> {
        self.matrices.get(index).copied().unwrap_or_else(Matrix2::identity)
    }

    /// Computes the distortions from the displacements of a whole grid with `columns` in a row.
    pub(super) fn fill(&mut self, cpu: CpuLevel, displacements: &[Option<GridDisplacement>], columns: usize) {
        let columns = columns.max(1);
        for (axis, gradients) in self.gradients.iter_mut().enumerate() {
            gradients.fill(displacements, columns, axis);
        }
        self.matrices.clear();
        self.matrices.resize(displacements.len(), Matrix2::identity());
        let [right, down] = &self.gradients;
        for (row, out) in self.matrices.chunks_mut(columns).enumerate() {
            for (group, out) in out.chunks_mut(FLOATS).enumerate() {
                let at = [FLOATS * group, row];
                let medians = with_cpu!(cpu, cpu => cpu.vectorize(
                    #[inline(always)]
                    || Some([right.medians(cpu, at, [SIDE - 1, SIDE])?, down.medians(cpu, at, [SIDE, SIDE - 1])?])
                ));
                let Some(medians) = medians else { continue };
                for (k, out) in out.iter_mut().enumerate() {
                    let [right, down] = medians.map(|[x, y]| {
                        let gradient = Vector2::new(x[k], y[k]);
                        if gradient.amax() <= MAX_DISTORTION { gradient } else { Vector2::zeros() }
                    });
                    *out += Matrix2::from_columns(&[right, down]);
                }
            }
        }
    }
}

impl Gradients {
    /// Computes those along an axis.
    fn fill(&mut self, displacements: &[Option<GridDisplacement>], columns: usize, axis: usize) {
        let rows = displacements.len() / columns;
        self.stride = columns.next_multiple_of(FLOATS) + 2 * REACH;
        for component in &mut self.components {
            component.clear();
            component.resize(self.stride * (rows + 2 * REACH), f32::NAN);
        }
        let [by_x, by_y] = &mut self.components;
        for (row, cells) in displacements.chunks_exact(columns).enumerate() {
            let next = if axis == 0 { cells.get(1..) } else { displacements.get((row + 1) * columns..) };
            let start = (row + REACH) * self.stride + REACH;
            let (Some(by_x), Some(by_y)) = (by_x.get_mut(start..), by_y.get_mut(start..)) else { continue };
            let outs = by_x.iter_mut().zip(by_y);
            for ((own, next), (x, y)) in cells.iter().zip(next.unwrap_or_default()).zip(outs) {
                let (Some(own), Some(next)) = (own, next) else { continue };
                let distance = next.at[axis] - own.at[axis];
                if distance > 0.0 {
                    let gradient = (next.shift - own.shift) / distance;
                    (*x, *y) = (gradient.x, gradient.y);
                }
            }
        }
    }

    /// For eight cells from (column, row) on the medians of x and of y of so many gradients across and down around each.
    #[inline(always)]
    fn medians<C: WordCpu>(
        &self,
        cpu: C,
        [column, row]: [usize; 2],
        [across, down]: [usize; 2],
    ) -> Option<[[f32; FLOATS]; 2]> {
        let mut medians = [[0.0; FLOATS]; 2];
        for (median, component) in medians.iter_mut().zip(&self.components) {
            // The margin is above and left of the first cell: its neighbourhood begins here.
            let samples = component.get(row * self.stride + column..)?;
            let rows = SampleRows::<SIDE, { SIDE - 1 + FLOATS }>::new(samples, self.stride)?;
            let mut values = [cpu.splat(f32::NAN); PAIRS];
            let mut next = values.iter_mut();
            for r in 0..down {
                for c in 0..across {
                    if let Some(value) = next.next() {
                        *value = cpu.load(rows.at(r, c));
                    }
                }
            }
            *median = cpu.store(median_of(cpu, values));
        }
        Some(medians)
    }
}

/// In each lane the median of those values that are numbers, of an even number the upper one of the middle two; 0 of fewer
/// than [`MIN_NEIGHBOUR_PAIRS`].
#[inline(always)]
fn median_of<C: WordCpu>(cpu: C, mut values: [C::Lanes; PAIRS]) -> C::Lanes {
    let (zero, one, least) = (cpu.splat(0.0), cpu.splat(1.0), cpu.splat(f32::MIN));
    // Every first missing value counts as less than all others and every second as greater, which leaves the median in
    // its place.
    let (mut missing, mut count) = (cpu.splat(f32::NEG_INFINITY), zero);
    for value in &mut values {
        let found = *value;
        *value = cpu.above_floats(found, least, found, missing);
        missing = cpu.above_floats(found, least, missing, zero - missing);
        count = count + cpu.above_floats(found, least, one, zero);
    }
    // Of 12 values neither the least nor the greatest is the upper median of 20. Without them another one is taken, and
    // so on until three are left.
    for first in 0..PAIRS / 2 {
        let last = PAIRS / 2 + 1;
        for k in first + 1..=last {
            order(cpu, &mut values, first, k);
        }
        for k in first + 1..last {
            order(cpu, &mut values, k, last);
        }
        if let Some(next) = values.get(last + 1 + first) {
            values[last] = *next;
        }
    }
    cpu.above_floats(count, cpu.splat(MIN_NEIGHBOUR_PAIRS - 0.5), values[PAIRS / 2], zero)
}

/// Exchanges two values in the lanes where the first is greater.
#[inline(always)]
fn order<C: WordCpu>(cpu: C, values: &mut [C::Lanes; PAIRS], first: usize, second: usize) {
    let (a, b) = (values[first], values[second]);
    values[first] = cpu.lesser(b, a);
    values[second] = cpu.greater(a, b);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn distortions(
        cpu: CpuLevel,
        displacements: &[Option<GridDisplacement>],
        columns: usize,
    ) -> Vec<Matrix2<f32>> {
        let mut distortions = Distortions::default();
        distortions.fill(cpu, displacements, columns);
        (0..displacements.len()).map(|index| distortions.at(index)).collect()
    }

    #[test]
    fn a_rotation_is_found_among_outliers() {
        let gradient = Matrix2::new(-0.004, -0.087, 0.087, -0.004);
        let mut displacements: Vec<_> = (0..25)
            .map(|i| Vector2::new((i % 5) as f32 * 30.0, (i / 5) as f32 * 22.0))
            .map(|at| Some(GridDisplacement { at, shift: Vector2::new(7.0, -3.0) + gradient * at }))
            .collect();
        displacements[6] =
            Some(GridDisplacement { at: Vector2::new(30.0, 22.0), shift: Vector2::new(90.0, 40.0) });
        displacements[13] = None;
        for found in distortions(CpuLevel::Scalar, &displacements, 5) {
            assert!((found - Matrix2::identity() - gradient).amax() < 1e-5);
        }
    }

    #[test]
    fn without_neighbours_the_distortion_is_the_identity() {
        assert_eq!(distortions(CpuLevel::Scalar, &[None, None], 2), [Matrix2::identity(); 2]);
        assert!(distortions(CpuLevel::Scalar, &[], 0).is_empty());
    }

    /// The same by sorting, of random displacements on a grid with gaps and steps.
    #[test]
    fn medians_are_those_of_sorted_numbers_at_all_levels() {
        const COLUMNS: usize = 13;
        const ROWS: usize = 9;
        let mut state = 1u64;
        let mut random = |count: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 33) % count
        };
        for round in 0..50 {
            let displacements: Vec<Option<GridDisplacement>> = (0..COLUMNS * ROWS)
                .map(|index| {
                    let at = Vector2::new((index % COLUMNS) as f32, (index / COLUMNS) as f32);
                    // Few values, so that many are equal.
                    let shift = Vector2::new(random(9) as f32 / 16.0, random(5) as f32 / 16.0);
                    (random(50) >= round).then_some(GridDisplacement { at, shift })
                })
                .collect();
            let shift = |column: usize, row: usize| {
                let is_inside = column < COLUMNS && row < ROWS;
                displacements.get(row * COLUMNS + column).filter(|_| is_inside)?.map(|found| found.shift)
            };
            let median = |mut all: Vec<f32>| {
                all.sort_by(f32::total_cmp);
                if all.len() < 4 { 0.0 } else { all[all.len() / 2] }
            };
            let expected = |index: usize, axis: usize| {
                let (column, row) = (index % COLUMNS, index / COLUMNS);
                let mut all = Vec::new();
                for r in row.saturating_sub(REACH)..=row + REACH - axis {
                    for c in column.saturating_sub(REACH)..=column + REACH - (1 - axis) {
                        let next = if axis == 0 { shift(c + 1, r) } else { shift(c, r + 1) };
                        all.extend(shift(c, r).zip(next).map(|(own, next)| next - own));
                    }
                }
                let [x, y] = [0, 1].map(|part| median(all.iter().map(|found| found[part]).collect()));
                if x.abs().max(y.abs()) <= MAX_DISTORTION { Vector2::new(x, y) } else { Vector2::zeros() }
            };
            for cpu in CpuLevel::supported() {
                for (index, found) in distortions(cpu, &displacements, COLUMNS).into_iter().enumerate() {
                    let axes = [expected(index, 0), expected(index, 1)];
                    assert_eq!(found, Matrix2::identity() + Matrix2::from_columns(&axes), "{cpu}, {index}");
                }
            }
        }
    }
}
