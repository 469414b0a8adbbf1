//! What the neighbours of a point say of its local distortion.

use nalgebra::{Matrix2, Vector2};
use std::ops::Range;

/// Cells on each side that count as neighbours.
const REACH: usize = 2;

/// Cells of the neighbourhood along one axis.
const SIDE: usize = 2 * REACH + 1;

/// Pairs of neighbours without which no distortion is told.
const FEWEST_PAIRS: usize = 4;

/// A distortion by more than this (as a matrix entry) is taken for a mistake.
const MOST_DISTORTION: f32 = 0.5;

/// A measured motion at a cell of the grid, analysed pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub(super) at: Vector2<f32>,
    pub(super) shift: Vector2<f32>,
}

/// How the motions of a grid's cells change from one cell to the next, per pixel.
#[derive(Clone, Debug, Default)]
pub(super) struct Slopes {
    columns: usize,
    rows: usize,
    /// To the cell on the right; `None` where one of the two did not move. Those of the last column are not used.
    right: Vec<Option<Vector2<f32>>>,
    /// To the cell below.
    down: Vec<Option<Vector2<f32>>>,
}

impl Slopes {
    /// Makes these the slopes of `motions`, those of a whole grid with `columns` a row.
    pub(super) fn fill(&mut self, motions: &[Option<Motion>], columns: usize) {
        self.columns = columns.max(1);
        self.rows = motions.len() / self.columns;
        let between = |index: usize, step: usize, axis: usize| {
            let (a, b) =
                (motions.get(index).copied().flatten()?, motions.get(index + step).copied().flatten()?);
            let distance = b.at[axis] - a.at[axis];
            (distance > 0.0).then(|| (b.shift - a.shift) / distance)
        };
        self.right.clear();
        self.right.extend((0..motions.len()).map(|index| between(index, 1, 0)));
        self.down.clear();
        self.down.extend((0..motions.len()).map(|index| between(index, self.columns, 1)));
    }

    /// I + ∂shift/∂x, how the picture around a cell is distorted: medians of the slopes between adjacent ones of the 5 × 5
    /// cells around it. Up to half of them may be wrong or belong to something else that moves.
    pub(super) fn distortion(&self, index: usize) -> Matrix2<f32> {
        let (column, row) = (index % self.columns, index / self.columns);
        let around = |at: usize, count: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(count);
        let (across, along) = (around(column, self.columns), around(row, self.rows));
        let [last, bottom] = [&across, &along].map(|range| range.start..range.end.saturating_sub(1));
        let right = self.median(&self.right, last, along);
        let down = self.median(&self.down, across, bottom);
        Matrix2::identity() + Matrix2::from_columns(&[right, down])
    }

    /// Median of the slopes of some cells; none where it is none to be believed.
    fn median(
        &self,
        slopes: &[Option<Vector2<f32>>],
        columns: Range<usize>,
        rows: Range<usize>,
    ) -> Vector2<f32> {
        let rows = rows.filter_map(|row| {
            let start = row * self.columns;
            slopes.get(start + columns.start..start + columns.end)
        });
        let slope = median(rows.flatten().copied().flatten()).unwrap_or_default();
        if slope.amax() <= MOST_DISTORTION { slope } else { Vector2::zeros() }
    }
}

/// Median of each component; `None` of fewer than [`FEWEST_PAIRS`].
fn median(values: impl Iterator<Item = Vector2<f32>>) -> Option<Vector2<f32>> {
    let mut x = [0.0; SIDE * SIDE];
    let mut y = [0.0; SIDE * SIDE];
    let mut count = 0;
    for ((x, y), value) in x.iter_mut().zip(&mut y).zip(values) {
        (*x, *y) = (value.x, value.y);
        count += 1;
    }
    if count < FEWEST_PAIRS {
        return None;
    }
    let middle = |values: &mut [f32]| *values.select_nth_unstable_by(count / 2, f32::total_cmp).1;
    Some(Vector2::new(middle(&mut x[..count]), middle(&mut y[..count])))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slopes(motions: &[Option<Motion>], columns: usize) -> Slopes {
        let mut slopes = Slopes::default();
        slopes.fill(motions, columns);
        slopes
    }

    #[test]
    fn a_rotation_is_found_among_outliers() {
        let slope = Matrix2::new(-0.004, -0.087, 0.087, -0.004);
        let mut motions: Vec<_> = (0..25)
            .map(|i| Vector2::new((i % 5) as f32 * 30.0, (i / 5) as f32 * 22.0))
            .map(|at| Some(Motion { at, shift: Vector2::new(7.0, -3.0) + slope * at }))
            .collect();
        motions[6] = Some(Motion { at: Vector2::new(30.0, 22.0), shift: Vector2::new(90.0, 40.0) });
        motions[13] = None;
        for index in [0, 6, 12, 24] {
            let found = slopes(&motions, 5).distortion(index);
            assert!((found - Matrix2::identity() - slope).amax() < 1e-5);
        }
    }

    #[test]
    fn without_neighbours_nothing_is_distorted() {
        assert_eq!(slopes(&[None, None], 2).distortion(0), Matrix2::identity());
    }
}
