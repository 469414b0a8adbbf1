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

/// The 5 × 5 cells around a cell of a grid.
pub(super) struct Neighbourhood<'a> {
    motions: &'a [Option<Motion>],
    columns: usize,
    index: usize,
}

impl<'a> Neighbourhood<'a> {
    /// Around cell `index` of a grid with `columns` a row; `motions` are those of the whole grid.
    pub(super) fn new(motions: &'a [Option<Motion>], columns: usize, index: usize) -> Self {
        Self { motions, columns, index }
    }

    /// I + ∂shift/∂x, how the picture around the cell is distorted: medians of the slopes between adjacent cells. Up to
    /// half of them may be wrong or belong to something else that moves.
    pub(super) fn distortion(&self) -> Matrix2<f32> {
        Matrix2::identity() + Matrix2::from_columns(&[slope(self.pairs(1, 0), 0), slope(self.pairs(0, 1), 1)])
    }

    fn ranges(&self) -> (Range<usize>, Range<usize>) {
        let (column, row) = (self.index % self.columns, self.index / self.columns);
        let rows = self.motions.len() / self.columns;
        let around = |at: usize, count: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(count);
        (around(column, self.columns), around(row, rows))
    }

    fn motion(&self, column: usize, row: usize) -> Option<Motion> {
        self.motions.get(row * self.columns + column).copied().flatten()
    }

    /// Cells that moved, each with the one `right` and `down` of it.
    fn pairs(&self, right: usize, down: usize) -> impl Iterator<Item = (Motion, Motion)> {
        let (across, rows) = self.ranges();
        let (last, bottom) = (across.end - right, rows.end - down);
        let cells = (rows.start..bottom).flat_map(move |j| (across.start..last).map(move |i| (i, j)));
        cells.filter_map(move |(i, j)| Some((self.motion(i, j)?, self.motion(i + right, j + down)?)))
    }
}

/// Median change of the motion per pixel along an axis.
fn slope(pairs: impl Iterator<Item = (Motion, Motion)>, axis: usize) -> Vector2<f32> {
    let slopes = pairs.filter_map(|(a, b)| {
        let distance = b.at[axis] - a.at[axis];
        (distance > 0.0).then(|| (b.shift - a.shift) / distance)
    });
    let slope = median(slopes).unwrap_or_default();
    if slope.amax() <= MOST_DISTORTION { slope } else { Vector2::zeros() }
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
            let found = Neighbourhood::new(&motions, 5, index).distortion();
            assert!((found - Matrix2::identity() - slope).amax() < 1e-5);
        }
    }

    #[test]
    fn without_neighbours_nothing_is_distorted() {
        assert_eq!(Neighbourhood::new(&[None, None], 2, 0).distortion(), Matrix2::identity());
    }
}
