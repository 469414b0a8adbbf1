// SPDX-License-Identifier: MIT OR Apache-2.0

//! Local distortion at a point, from the displacements of its neighbours.

use crate::cpu::{CpuLevel, for_each_cpu};
use nalgebra::{Matrix2, Vector2};
use std::ops::Range;

/// Cells on each side that are used as neighbours.
const REACH: usize = 2;

/// Cells of the neighbourhood along each axis.
const SIDE: usize = 2 * REACH + 1;

/// Pairs of neighbours along one axis, at most, in whole vectors.
const MAX_PAIRS: usize = (SIDE * (SIDE - 1)).next_multiple_of(LANES);

/// Keys that are compared at once.
const LANES: usize = 8;

/// Fewer pairs of neighbours than this give no estimate.
const MIN_PAIRS: usize = 4;

/// Distortions with a matrix entry larger than this are rejected as outliers.
const MAX_DISTORTION: f32 = 0.5;

/// A measured displacement at a cell of the grid, in analysed pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct GridDisplacement {
    pub(super) at: Vector2<f32>,
    pub(super) shift: Vector2<f32>,
}

/// Differences of displacement between adjacent cells of a grid, per pixel of distance.
#[derive(Clone, Debug, Default)]
pub(super) struct DisplacementGradients {
    columns: usize,
    rows: usize,
    /// To the cell on the right; `None` without a displacement at either. Those of the last column are not
    /// used.
    right: Vec<Option<Vector2<f32>>>,
    /// To the cell below.
    down: Vec<Option<Vector2<f32>>>,
}

impl DisplacementGradients {
    /// Computes the gradients of `displacements`, those of a whole grid with `columns` in a row.
    pub(super) fn fill(&mut self, displacements: &[Option<GridDisplacement>], columns: usize) {
        self.columns = columns.max(1);
        self.rows = displacements.len() / self.columns;
        let between = |index: usize, step: usize, axis: usize| {
            let (a, b) = (
                displacements.get(index).copied().flatten()?,
                displacements.get(index + step).copied().flatten()?,
            );
            let distance = b.at[axis] - a.at[axis];
            (distance > 0.0).then(|| (b.shift - a.shift) / distance)
        };
        self.right.clear();
        self.right.extend((0..displacements.len()).map(|index| between(index, 1, 0)));
        self.down.clear();
        self.down.extend((0..displacements.len()).map(|index| between(index, self.columns, 1)));
    }

    /// The local distortion I + ∂shift/∂x at a cell: medians of the gradients between adjacent cells of the 5
    /// × 5 around it, robust to just under half outliers or cells of another displacement.
    pub(super) fn distortion(&self, cpu: CpuLevel, index: usize) -> Matrix2<f32> {
        let (column, row) = (index % self.columns, index / self.columns);
        let around = |at: usize, count: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(count);
        let (across, along) = (around(column, self.columns), around(row, self.rows));
        let [last, bottom] = [&across, &along].map(|range| range.start..range.end.saturating_sub(1));
        let right = self.median(cpu, &self.right, last, along);
        let down = self.median(cpu, &self.down, across, bottom);
        Matrix2::identity() + Matrix2::from_columns(&[right, down])
    }

    /// Median of the gradients of some cells; zero if there are too few, or the median exceeds
    /// [`MAX_DISTORTION`].
    fn median(
        &self,
        cpu: CpuLevel,
        gradients: &[Option<Vector2<f32>>],
        columns: Range<usize>,
        rows: Range<usize>,
    ) -> Vector2<f32> {
        let rows = rows.filter_map(|row| {
            let start = row * self.columns;
            gradients.get(start + columns.start..start + columns.end)
        });
        let gradient = median(cpu, rows.flatten().copied().flatten()).unwrap_or_default();
        if gradient.amax() <= MAX_DISTORTION { gradient } else { Vector2::zeros() }
    }
}

/// Median of each component; `None` for fewer than [`MIN_PAIRS`].
fn median(cpu: CpuLevel, values: impl Iterator<Item = Vector2<f32>>) -> Option<Vector2<f32>> {
    let mut keys = [[i32::MAX; MAX_PAIRS]; 2];
    let mut count = 0;
    for (index, value) in values.take(MAX_PAIRS).enumerate() {
        (keys[0][index], keys[1][index]) = (key(value.x), key(value.y));
        count = index + 1;
    }
    if count < MIN_PAIRS {
        return None;
    }
    let middle = |keys: &[i32; MAX_PAIRS]| value(ranked(cpu, keys, count / 2));
    Some(Vector2::new(middle(&keys[0]), middle(&keys[1])))
}

/// An integer that is less where a number is less, as `f32::total_cmp` has them.
fn key(value: f32) -> i32 {
    let bits = value.to_bits() as i32;
    bits ^ (((bits >> 31) as u32) >> 1) as i32
}

/// The number of a [`key`].
fn value(key: i32) -> f32 {
    f32::from_bits((key ^ (((key >> 31) as u32) >> 1) as i32) as u32)
}

for_each_cpu! {
    /// The element number `rank` of the keys in ascending order.
    ///
    /// It is the largest of those that are greater than `rank` keys or fewer. Some 7 instructions a key count these
    /// for all keys at once; a sort of 20 keys takes a thousand.
    fn ranked(keys: &[i32; MAX_PAIRS], rank: usize) -> i32 {
        let mut greater_than = [0i32; MAX_PAIRS];
        for other in keys {
            for (number, key) in greater_than.iter_mut().zip(keys) {
                *number += i32::from(key > other);
            }
        }
        let mut largest = [i32::MIN; LANES];
        for (numbers, keys) in greater_than.as_chunks::<LANES>().0.iter().zip(keys.as_chunks::<LANES>().0) {
            for lane in 0..LANES {
                let low = if numbers[lane] <= rank as i32 { keys[lane] } else { i32::MIN };
                largest[lane] = largest[lane].max(low);
            }
        }
        largest.into_iter().fold(i32::MIN, i32::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::CpuLevel;

    fn gradients(displacements: &[Option<GridDisplacement>], columns: usize) -> DisplacementGradients {
        let mut gradients = DisplacementGradients::default();
        gradients.fill(displacements, columns);
        gradients
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
        for index in [0, 6, 12, 24] {
            let found = gradients(&displacements, 5).distortion(CpuLevel::Scalar, index);
            assert!((found - Matrix2::identity() - gradient).amax() < 1e-5);
        }
    }

    #[test]
    fn without_neighbours_the_distortion_is_the_identity() {
        assert_eq!(gradients(&[None, None], 2).distortion(CpuLevel::Scalar, 0), Matrix2::identity());
    }

    #[test]
    fn medians_are_those_of_sorted_numbers_at_all_levels() {
        let mut state = 1u64;
        for round in 0..2000 {
            let numbers: Vec<f32> = (0..MIN_PAIRS + round % (SIDE * (SIDE - 1) + 1 - MIN_PAIRS))
                .map(|_| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    // Few values, so that many are equal; zeros of both signs.
                    ((state >> 33) % 9) as f32 * if state >> 63 == 0 { 0.25 } else { -0.25 }
                })
                .collect();
            let mut sorted = numbers.clone();
            sorted.sort_by(f32::total_cmp);
            for cpu in CpuLevel::supported() {
                let found =
                    median(cpu, numbers.iter().map(|number| Vector2::new(*number, -*number))).unwrap();
                assert_eq!(found.x.to_bits(), sorted[numbers.len() / 2].to_bits());
                assert_eq!(found.y, -sorted[(numbers.len() - 1) / 2]);
            }
        }
    }
}
