//! What the neighbours of a point say of its motion and its local distortion.

use nalgebra::{Matrix2, Vector2};
use std::ops::Range;

/// Motions closer than this, in pixels, are one to try.
const SAME_START: f32 = 0.7;

/// Cells on each side that count as neighbours.
const REACH: usize = 2;

/// Cells of the neighbourhood along one axis.
const SIDE: usize = 2 * REACH + 1;

/// A neighbour's motion, carried to a point, within this many pixels of the point's speaks for it.
const SAME_MOTION: f32 = 3.0;

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

impl Motion {
    /// The motion at another point, given how the motion changes from pixel to pixel.
    pub(super) fn carried(&self, at: Vector2<f32>, slope: &Matrix2<f32>) -> Vector2<f32> {
        self.shift + slope * (at - self.at)
    }
}

/// Motion as the neighbours have it, to first order.
#[derive(Clone, Copy, Debug)]
pub(super) struct Agreement {
    /// Motion at the point; `None` without neighbours.
    pub(super) shift: Option<Vector2<f32>>,
    /// I + ∂shift/∂x: how the picture around the point is distorted.
    pub(super) distortion: Matrix2<f32>,
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

    /// Medians: first of the slopes between adjacent cells, then of the motions carried to `at`
    /// along those slopes. Up to half of the neighbours may be wrong or belong to something else
    /// that moves.
    pub(super) fn agreement(&self, at: Vector2<f32>) -> Agreement {
        let slope = Matrix2::from_columns(&[slope(self.pairs(1, 0), 0), slope(self.pairs(0, 1), 1)]);
        let carried = self.all().map(|(_, motion)| motion.carried(at, &slope));
        Agreement { shift: median(carried, 1), distortion: Matrix2::identity() + slope }
    }

    /// Cells of the neighbourhood, whether they moved or not; itself counted.
    pub(super) fn cells(&self) -> usize {
        let (across, down) = self.ranges();
        across.len() * down.len()
    }

    /// How many neighbours move as `motion` does; itself not counted.
    pub(super) fn support(&self, motion: Motion, distortion: &Matrix2<f32>) -> usize {
        let slope = distortion - Matrix2::identity();
        let others = self.all().filter(|(index, _)| *index != self.index);
        others
            .filter(|(_, other)| (other.carried(motion.at, &slope) - motion.shift).norm() <= SAME_MOTION)
            .count()
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

    /// The cells that moved, by index.
    fn all(&self) -> impl Iterator<Item = (usize, Motion)> {
        let (across, down) = self.ranges();
        let cells = down.flat_map(move |j| across.clone().map(move |i| (i, j)));
        cells.filter_map(|(i, j)| Some((j * self.columns + i, self.motion(i, j)?)))
    }

    /// Cells that moved, each with the one `right` and `down` of it.
    fn pairs(&self, right: usize, down: usize) -> impl Iterator<Item = (Motion, Motion)> {
        let (across, rows) = self.ranges();
        let (last, bottom) = (across.end - right, rows.end - down);
        let cells = (rows.start..bottom).flat_map(move |j| (across.start..last).map(move |i| (i, j)));
        cells.filter_map(move |(i, j)| Some((self.motion(i, j)?, self.motion(i + right, j + down)?)))
    }
}

/// At most `N` distinct motions to try, in the order in which they came.
pub(super) struct Starts<const N: usize> {
    shifts: [Vector2<f32>; N],
    count: usize,
}

impl<const N: usize> Default for Starts<N> {
    fn default() -> Self {
        Self { shifts: [Vector2::zeros(); N], count: 0 }
    }
}

impl<const N: usize> Starts<N> {
    pub(super) fn list(&self) -> &[Vector2<f32>] {
        &self.shifts[..self.count]
    }

    /// Adds a motion that is unlike the others, as long as there is room.
    pub(super) fn add(&mut self, shift: Vector2<f32>) {
        if self.count < N && self.list().iter().all(|other| (other - shift).norm() > SAME_START) {
            self.shifts[self.count] = shift;
            self.count += 1;
        }
    }
}

/// Median change of the motion per pixel along an axis.
fn slope(pairs: impl Iterator<Item = (Motion, Motion)>, axis: usize) -> Vector2<f32> {
    let slopes = pairs.filter_map(|(a, b)| {
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
            let found = Neighbourhood::new(&motions, 5, index).agreement(at);
            assert!((found.distortion - Matrix2::identity() - slope).amax() < 1e-5);
            assert!((found.shift.unwrap() - Vector2::new(7.0, -3.0) - slope * at).norm() < 1e-3);
        }
    }

    #[test]
    fn a_point_alone_in_its_motion_has_no_support() {
        let at = |i: usize| Vector2::new((i % 5) as f32 * 30.0, (i / 5) as f32 * 22.0);
        let motions: Vec<_> =
            (0..25).map(|i| Some(Motion { at: at(i), shift: Vector2::new(7.0, -3.0) })).collect();
        let around = Neighbourhood::new(&motions, 5, 12);
        let support =
            |x| around.support(Motion { at: at(12), shift: Vector2::new(x, -3.0) }, &Matrix2::identity());
        assert_eq!((support(7.5), support(60.0)), (24, 0));
    }

    #[test]
    fn without_neighbours_there_is_no_opinion() {
        let found = Neighbourhood::new(&[None, None], 2, 0).agreement(Vector2::zeros());
        assert!(found.shift.is_none() && found.distortion == Matrix2::identity());
    }
}
