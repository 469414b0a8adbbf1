//! What the neighbours of a point say of its motion and its local distortion.

use nalgebra::{Matrix2, Vector2};

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

/// Motion as the neighbours have it, to first order.
#[derive(Clone, Copy, Debug)]
pub(super) struct Agreement {
    /// Motion at the point; `None` without neighbours.
    pub(super) shift: Option<Vector2<f32>>,
    /// I + ∂shift/∂x: how the picture around the point is distorted.
    pub(super) distortion: Matrix2<f32>,
}

/// Medians over the 5 × 5 cells around a cell of a grid with `columns` a row: first of the slopes
/// between adjacent cells, then of the motions carried to `at` along those slopes. Up to half of
/// the neighbours may be wrong or belong to something else that moves.
pub(super) fn agreement(
    motions: &[Option<Motion>],
    columns: usize,
    index: usize,
    at: Vector2<f32>,
) -> Agreement {
    let (column, row) = (index % columns, index / columns);
    let across = column.saturating_sub(REACH)..(column + REACH + 1).min(columns);
    let down = row.saturating_sub(REACH)..(row + REACH + 1).min(motions.len() / columns);
    let motion = |i: usize, j: usize| motions.get(j * columns + i).copied().flatten();
    let cells = || down.clone().flat_map(|j| across.clone().map(move |i| (i, j)));
    let right = cells().filter(|&(i, _)| i + 1 < across.end).map(|(i, j)| (motion(i, j), motion(i + 1, j)));
    let below = cells().filter(|&(_, j)| j + 1 < down.end).map(|(i, j)| (motion(i, j), motion(i, j + 1)));
    let slope = Matrix2::from_columns(&[slope(right, 0), slope(below, 1)]);
    let carried = cells().filter_map(|(i, j)| motion(i, j)).map(|m| m.shift + slope * (at - m.at));
    Agreement { shift: median(carried, 1), distortion: Matrix2::identity() + slope }
}

/// Median change of the motion per pixel along an axis.
fn slope(pairs: impl Iterator<Item = (Option<Motion>, Option<Motion>)>, axis: usize) -> Vector2<f32> {
    let slopes = pairs.filter_map(|(a, b)| {
        let (a, b) = (a?, b?);
        let distance = b.at[axis] - a.at[axis];
        (distance > 0.0).then(|| (b.shift - a.shift) / distance)
    });
    let slope = median(slopes, FEWEST_PAIRS).unwrap_or_default();
    if slope.amax() <= MOST_DISTORTION { slope } else { Vector2::zeros() }
}

/// Median of each component; `None` of fewer than `fewest`.
fn median(values: impl Iterator<Item = Vector2<f32>>, fewest: usize) -> Option<Vector2<f32>> {
    let mut x = [0.0; SIDE * SIDE];
    let mut y = [0.0; SIDE * SIDE];
    let mut count = 0;
    for ((x, y), value) in x.iter_mut().zip(&mut y).zip(values) {
        (*x, *y) = (value.x, value.y);
        count += 1;
    }
    if count < fewest.max(1) {
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
            let at = Vector2::new((index % 5) as f32 * 30.0, (index / 5) as f32 * 22.0);
            let found = agreement(&motions, 5, index, at);
            assert!((found.distortion - Matrix2::identity() - slope).amax() < 1e-5);
            assert!((found.shift.unwrap() - Vector2::new(7.0, -3.0) - slope * at).norm() < 1e-3);
        }
    }

    #[test]
    fn without_neighbours_there_is_no_opinion() {
        let found = agreement(&[None, None], 2, 0, Vector2::zeros());
        assert!(found.shift.is_none() && found.distortion == Matrix2::identity());
    }
}
