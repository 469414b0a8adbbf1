// SPDX-License-Identifier: MIT OR Apache-2.0

//! The flow field: a grid of cells with a displacement each.

/// Displacement of one cell with its confidence and information.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cell {
    /// Displacement to the other frame, x and y, in full-frame pixels.
    pub flow: [f32; 2],
    /// Confidence of the displacement, 0 to 1: from the residual, the texture and forward–backward
    /// consistency.
    pub confidence: f32,
    /// The inverse covariance of the displacement (xx, xy, yy) in full-frame pixels, provided that it is an
    /// inlier: from the structure tensor and the residual. It is 0 along an edge (the aperture problem).
    pub information: [f32; 3],
}

/// A dense optical flow, row by row, in cells.
#[derive(Debug, Default, PartialEq)]
pub struct FlowField {
    pub(super) columns: usize,
    pub(super) rows: usize,
    pub(super) side: f64,
    pub(super) cells: Vec<Cell>,
}

impl Clone for FlowField {
    fn clone(&self) -> Self {
        let mut other = Self::default();
        other.clone_from(self);
        other
    }

    /// Reuses the memory of the cells.
    fn clone_from(&mut self, other: &Self) {
        (self.columns, self.rows, self.side) = (other.columns, other.rows, other.side);
        self.cells.clone_from(&other.cells);
    }
}

impl FlowField {
    /// A field of cells, row by row with `columns` in a row, each `side` full-frame pixels wide. `None` if
    /// the last row is incomplete or the side is not positive.
    #[cfg(feature = "unstable")]
    pub fn new(columns: usize, side: f64, cells: Vec<Cell>) -> Option<Self> {
        let rows = cells.len().checked_div(columns)?;
        let is_complete = rows * columns == cells.len() && side.is_finite() && side > 0.0;
        is_complete.then_some(Self { columns, rows, side, cells })
    }

    /// Removes all cells.
    pub(crate) fn clear(&mut self) {
        self.cells.clear();
        (self.columns, self.rows) = (0, 0);
    }

    /// Cells in a row.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Rows of cells.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Side of a cell in full-frame pixels; the first cell starts at the frame's corner.
    pub fn cell_side(&self) -> f64 {
        self.side
    }

    /// The cells, row by row; none if one of the frames was empty.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// The centre of the cell in `column` and `row`, in full-frame pixels (pixel centres at integers).
    pub fn centre(&self, column: usize, row: usize) -> [f64; 2] {
        [column, row].map(|index| (index as f64 + 0.5) * self.side - 0.5)
    }

    /// The four cells around a point (full-frame pixels), each with its bilinear weight; `None` for a field
    /// without cells or a NaN. Constant beyond the outermost centres.
    pub fn around(&self, x: f64, y: f64) -> Option<[(&Cell, f64); 4]> {
        let (column, across) = place(x, self.side, self.columns)?;
        let (row, down) = place(y, self.side, self.rows)?;
        let right = (column + 1).min(self.columns - 1);
        let below = (row + 1).min(self.rows - 1);
        let cell = |row: usize, column: usize| self.cells.get(row * self.columns + column);
        Some([
            (cell(row, column)?, (1.0 - across) * (1.0 - down)),
            (cell(row, right)?, across * (1.0 - down)),
            (cell(below, column)?, (1.0 - across) * down),
            (cell(below, right)?, across * down),
        ])
    }

    /// The displacement at a point (both in full-frame pixels) and its confidence, interpolated bilinearly;
    /// displacements are weighted by confidence.
    pub fn sample(&self, x: f64, y: f64) -> Option<([f64; 2], f64)> {
        /// Added to each confidence, so that four cells of confidence 0 still have a mean.
        const MIN_WEIGHT: f64 = 0.01;
        let (mut flow, mut sum, mut confidence) = ([0.0; 2], 0.0, 0.0);
        for (cell, share) in self.around(x, y)? {
            let own = f64::from(cell.confidence);
            let weight = share * (own + MIN_WEIGHT);
            flow[0] += weight * f64::from(cell.flow[0]);
            flow[1] += weight * f64::from(cell.flow[1]);
            confidence += share * own;
            sum += weight;
        }
        (sum > 0.0).then(|| (flow.map(|value| value / sum), confidence))
    }
}

/// The last cell whose centre is not beyond a position, and the fraction of the way to the next centre.
fn place(position: f64, side: f64, cells: usize) -> Option<(usize, f64)> {
    let last = cells.checked_sub(1)?;
    let at = ((position + 0.5) / side - 0.5).clamp(0.0, last as f64);
    // False for NaN.
    (at >= 0.0).then(|| (at as usize, at.fract()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> FlowField {
        let cell = |index: usize| Cell {
            flow: [(index % 4) as f32, (index / 4) as f32],
            confidence: 1.0,
            ..Cell::default()
        };
        FlowField::new(4, 8.0, (0..12).map(cell).collect()).unwrap()
    }

    #[test]
    fn cells_make_complete_rows() {
        let cells = vec![Cell::default(); 12];
        assert_eq!(FlowField::new(4, 8.0, cells.clone()).map(|field| field.rows()), Some(3));
        for (columns, side) in [(5, 8.0), (0, 8.0), (4, 0.0), (4, f64::NAN)] {
            assert!(FlowField::new(columns, side, cells.clone()).is_none(), "{columns} {side}");
        }
    }

    #[test]
    fn a_ramp_is_interpolated_and_ends_level() {
        let field = ramp();
        let [x, y] = field.centre(2, 1);
        assert_eq!([x, y], [19.5, 11.5]);
        let (flow, confidence) = field.sample(x + 2.0, y - 4.0).unwrap();
        assert!((flow[0] - 2.25).abs() < 1e-9 && (flow[1] - 0.5).abs() < 1e-9 && confidence == 1.0);
        assert_eq!(field.sample(-100.0, 1e9).unwrap().0, [0.0, 2.0]);
        assert!(field.sample(f64::NAN, 0.0).is_none() && FlowField::default().sample(0.0, 0.0).is_none());
    }
}
