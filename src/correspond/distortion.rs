//! Local distortion at a point, from the displacements of its neighbours.

use nalgebra::{Matrix2, Vector2};
use std::ops::Range;

/// Cells on each side that are used as neighbours.
const REACH: usize = 2;

/// Cells of the neighbourhood along each axis.
const SIDE: usize = 2 * REACH + 1;

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
    pub(super) fn distortion(&self, index: usize) -> Matrix2<f32> {
        let (column, row) = (index % self.columns, index / self.columns);
        let around = |at: usize, count: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(count);
        let (across, along) = (around(column, self.columns), around(row, self.rows));
        let [last, bottom] = [&across, &along].map(|range| range.start..range.end.saturating_sub(1));
        let right = self.median(&self.right, last, along);
        let down = self.median(&self.down, across, bottom);
        Matrix2::identity() + Matrix2::from_columns(&[right, down])
    }

    /// Median of the gradients of some cells; zero if there are too few, or the median exceeds
    /// [`MAX_DISTORTION`].
    fn median(
        &self,
        gradients: &[Option<Vector2<f32>>],
        columns: Range<usize>,
        rows: Range<usize>,
    ) -> Vector2<f32> {
        let rows = rows.filter_map(|row| {
            let start = row * self.columns;
            gradients.get(start + columns.start..start + columns.end)
        });
        let gradient = median(rows.flatten().copied().flatten()).unwrap_or_default();
        if gradient.amax() <= MAX_DISTORTION { gradient } else { Vector2::zeros() }
    }
}

/// Median of each component; `None` for fewer than [`MIN_PAIRS`].
fn median(values: impl Iterator<Item = Vector2<f32>>) -> Option<Vector2<f32>> {
    let mut x = [0.0; SIDE * SIDE];
    let mut y = [0.0; SIDE * SIDE];
    let mut count = 0;
    for ((x, y), value) in x.iter_mut().zip(&mut y).zip(values) {
        (*x, *y) = (value.x, value.y);
        count += 1;
    }
    if count < MIN_PAIRS {
        return None;
    }
    let middle = |values: &mut [f32]| *values.select_nth_unstable_by(count / 2, f32::total_cmp).1;
    Some(Vector2::new(middle(&mut x[..count]), middle(&mut y[..count])))
}

#[cfg(test)]
mod tests {
    use super::*;

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
            let found = gradients(&displacements, 5).distortion(index);
            assert!((found - Matrix2::identity() - gradient).amax() < 1e-5);
        }
    }

    #[test]
    fn without_neighbours_the_distortion_is_the_identity() {
        assert_eq!(gradients(&[None, None], 2).distortion(0), Matrix2::identity());
    }
}
