// SPDX-License-Identifier: MIT OR Apache-2.0

//! The measured points: a uniform grid over the whole frame.

use super::patch::{MARGIN, PATCH_SIDE};

/// Patches centred in the cells of a grid, in analysed pixels, row by row.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    pub(super) columns: usize,
    /// The top left pixel of each patch; `None` if no patch fits near its cell.
    corners: Vec<Option<(usize, usize)>>,
}

impl Grid {
    /// A grid of `columns` × `rows` cells over `size` analysed pixels.
    ///
    /// A patch that would extend beyond the frame is moved inwards by at most half a cell.
    pub(super) fn new(size: (usize, usize), columns: usize, rows: usize) -> Self {
        let across: Vec<_> = (0..columns).map(|i| place(i, columns, size.0)).collect();
        let down: Vec<_> = (0..rows).map(|j| place(j, rows, size.1)).collect();
        let corners = down.iter().flat_map(|&y| across.iter().map(move |&x| x.zip(y))).collect();
        Self { columns, corners }
    }

    /// Number of cells.
    pub(super) fn len(&self) -> usize {
        self.corners.len()
    }

    /// The top left pixel of the patch of cell `index`.
    pub(super) fn corner(&self, index: usize) -> Option<(usize, usize)> {
        self.corners.get(index).copied().flatten()
    }
}

/// The first pixel of the patch in cell `index` of `cells` over `length` pixels.
fn place(index: usize, cells: usize, length: usize) -> Option<usize> {
    let last = length.checked_sub(PATCH_SIDE + MARGIN)?;
    if last < MARGIN {
        return None;
    }
    let cell = length as f64 / cells as f64;
    let wanted = (index as f64 + 0.5) * cell - 0.5 * PATCH_SIDE as f64;
    let corner = wanted.round().clamp(MARGIN as f64, last as f64);
    ((corner - wanted).abs() <= (0.5 * cell).max(0.5)).then_some(corner as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_lie_in_the_middle_of_their_cells() {
        let grid = Grid::new((960, 540), 32, 24);
        assert_eq!(grid.len(), 768);
        for index in 0..grid.len() {
            let (x, y) = grid.corner(index).unwrap();
            let middle = ((index % 32) as f64 * 30.0 + 15.0, (index / 32) as f64 * 22.5 + 11.25);
            assert!((x as f64 + 8.0 - middle.0).abs() <= 0.5 && (y as f64 + 8.0 - middle.1).abs() <= 0.5);
        }
    }

    #[test]
    fn small_frames_have_fewer_points_and_tiny_ones_none() {
        let count = |w, h| (0..768).filter(|&i| Grid::new((w, h), 32, 24).corner(i).is_some()).count();
        assert!(count(64, 48) > 0 && count(64, 48) < 768);
        assert_eq!((count(1, 1), count(7, 5), count(33, 17)), (0, 0, 0));
    }
}
