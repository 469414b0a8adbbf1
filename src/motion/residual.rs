// SPDX-License-Identifier: MIT OR Apache-2.0

//! The residual field: local motion beside the global one, from parallax and moving objects.

use nalgebra::Vector2;
use thiserror::Error;

/// Where the nodes of a [`ResidualField`] lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualMesh {
    /// Nodes in a row.
    pub columns: usize,
    /// Rows of nodes.
    pub rows: usize,
    /// Node (0, 0) in centred pixels of the frame, x and y.
    pub origin: [f64; 2],
    /// Pixels from one node to the next, in x and y.
    pub spacing: [f64; 2],
}

/// Velocities added to a global path, at the positions *where the frame shows the points*: bilinear
/// between the nodes of a regular mesh, constant outside of it.
#[derive(Clone, Debug, PartialEq)]
pub struct ResidualField {
    mesh: ResidualMesh,
    /// Pixels per whole readout, x and y, row by row.
    velocities: Vec<[f32; 2]>,
}

/// Why velocities are not a valid field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum MeshError {
    /// Not one velocity per node, or no nodes.
    #[error("a mesh of {columns} × {rows} nodes with {velocities} velocities")]
    Size {
        /// Nodes in a row.
        columns: usize,
        /// Rows of nodes.
        rows: usize,
        /// Velocities given.
        velocities: usize,
    },
    /// An origin that is not finite or a spacing that is not positive.
    #[error("the nodes of a mesh must lie at finite places, apart from each other")]
    Place,
    /// A velocity that is not finite.
    #[error("the velocity of node {0} is not finite")]
    Velocity(usize),
}

impl ResidualField {
    /// A field of velocities in pixels per whole readout, one per node, row by row.
    pub fn new(mesh: ResidualMesh, velocities: Vec<[f32; 2]>) -> Result<Self, MeshError> {
        let ResidualMesh { columns, rows, origin, spacing } = mesh;
        if velocities.is_empty() || columns.checked_mul(rows) != Some(velocities.len()) {
            return Err(MeshError::Size { columns, rows, velocities: velocities.len() });
        }
        let is_valid = spacing.iter().all(|spacing| spacing.is_finite() && *spacing > 0.0);
        if !(is_valid && origin.iter().all(|origin| origin.is_finite())) {
            return Err(MeshError::Place);
        }
        match velocities.iter().position(|velocity| velocity.iter().any(|value| !value.is_finite())) {
            Some(node) => Err(MeshError::Velocity(node)),
            None => Ok(Self { mesh, velocities }),
        }
    }

    /// The mesh of the nodes.
    pub fn mesh(&self) -> &ResidualMesh {
        &self.mesh
    }

    /// The velocities of the nodes, row by row.
    pub(super) fn velocities(&self) -> &[[f32; 2]] {
        &self.velocities
    }

    /// The same field in pixels that are smaller by these factors along x and y.
    pub(super) fn scaled(&self, factors: [f64; 2]) -> Self {
        let by = |values: [f64; 2]| [values[0] * factors[0], values[1] * factors[1]];
        let ResidualMesh { columns, rows, origin, spacing } = self.mesh;
        let mesh = ResidualMesh { columns, rows, origin: by(origin), spacing: by(spacing) };
        let scaled = |velocity: &[f32; 2]| by(velocity.map(f64::from)).map(|value| value as f32);
        Self { mesh, velocities: self.velocities.iter().map(scaled).collect() }
    }

    /// The same field in a frame turned clockwise by a quarter: the nodes of a row, from the left, become those of a
    /// column, from the top, and the first row the last column.
    pub(super) fn turned(&self) -> Self {
        let ResidualMesh { columns, rows, origin: [x, y], spacing: [across, down] } = self.mesh;
        let last = y + down * (rows - 1) as f64;
        let mesh = ResidualMesh { columns: rows, rows: columns, origin: [-last, x], spacing: [down, across] };
        let old = |node: usize| (rows - 1 - node % rows) * columns + node / rows;
        let velocity = |[vx, vy]: [f32; 2]| [-vy, vx];
        Self {
            mesh,
            velocities: (0..columns * rows).map(|node| velocity(self.velocities[old(node)])).collect(),
        }
    }

    /// The velocity, in pixels per whole readout, at the position (centred pixels) where the frame shows a
    /// point.
    pub fn velocity(&self, point: Vector2<f64>) -> Vector2<f64> {
        let across = self.cell(0, point.x, self.mesh.columns);
        let (top, bottom, y) = self.cell(1, point.y, self.mesh.rows);
        self.in_row(top, across) * (1.0 - y) + self.in_row(bottom, across) * y
    }

    /// The velocities at one x (centred pixels) in all rows of nodes, from the top: `velocities` is overwritten.
    #[inline(always)]
    pub(crate) fn column(&self, x: f64, velocities: &mut Vec<Vector2<f64>>) {
        let across = self.cell(0, x, self.mesh.columns);
        velocities.clear();
        velocities.extend((0..self.mesh.rows).map(|row| self.in_row(row, across)));
    }

    /// [`velocity`](Self::velocity) at `y` and the x of a [`column`](Self::column).
    #[inline(always)]
    pub(crate) fn velocity_in(&self, column: &[Vector2<f64>], y: f64) -> Vector2<f64> {
        let (top, bottom, y) = self.cell(1, y, self.mesh.rows);
        column[top] * (1.0 - y) + column[bottom] * y
    }

    /// The velocity in a row of nodes, between two of its columns.
    #[inline(always)]
    fn in_row(&self, row: usize, (left, right, x): (usize, usize, f64)) -> Vector2<f64> {
        let at =
            |column: usize| Vector2::from(self.velocities[row * self.mesh.columns + column].map(f64::from));
        at(left) * (1.0 - x) + at(right) * x
    }

    /// Whether all velocities are zero.
    pub fn is_zero(&self) -> bool {
        self.velocities.iter().all(|velocity| *velocity == [0.0; 2])
    }

    /// The nodes on both sides of a coordinate and its fraction of the way from the first to the second.
    #[inline(always)]
    fn cell(&self, axis: usize, at: f64, count: usize) -> (usize, usize, f64) {
        let last = count - 1;
        let at = ((at - self.mesh.origin[axis]) / self.mesh.spacing[axis]).clamp(0.0, last as f64);
        // NaN becomes node 0 here, at a fraction of 0.
        let node = at as usize;
        let fraction = (at - node as f64).max(0.0);
        (node, (node + 1).min(last), fraction)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MESH: ResidualMesh =
        ResidualMesh { columns: 3, rows: 2, origin: [-10.0, 4.0], spacing: [10.0, 20.0] };

    #[test]
    fn velocities_are_bilinear_within_and_clamped_outside() {
        let rows = [[0.0, 1.0], [4.0, 1.0], [6.0, 1.0], [10.0, 3.0], [14.0, 3.0], [16.0, 3.0]];
        let field = ResidualField::new(MESH, rows.to_vec()).unwrap();
        let cases = [
            ((-10.0, 4.0), (0.0, 1.0)),
            ((-5.0, 4.0), (2.0, 1.0)),
            ((5.0, 14.0), (10.0, 2.0)),
            ((10.0, 24.0), (16.0, 3.0)),
            ((-1e9, 9.0), (2.5, 1.5)),
            ((1e300, 1e300), (16.0, 3.0)),
            ((f64::NEG_INFINITY, f64::INFINITY), (10.0, 3.0)),
        ];
        for ((x, y), (vx, vy)) in cases {
            assert_eq!(field.velocity(Vector2::new(x, y)), Vector2::new(vx, vy), "{x} {y}");
        }
        assert!(field.velocity(Vector2::new(f64::NAN, 0.0)).x.is_finite());
        assert!(!field.is_zero());
    }

    #[test]
    fn one_node_is_enough() {
        let mesh = ResidualMesh { columns: 1, rows: 1, ..MESH };
        let field = ResidualField::new(mesh, vec![[2.0, -3.0]]).unwrap();
        assert_eq!(field.velocity(Vector2::new(77.0, -1.0)), Vector2::new(2.0, -3.0));
    }

    #[test]
    fn invalid_fields_are_refused() {
        let new = |mesh, nodes: usize| ResidualField::new(mesh, vec![[0.0; 2]; nodes]).map(|_| ());
        assert_eq!(new(MESH, 6), Ok(()));
        assert_eq!(new(MESH, 5), Err(MeshError::Size { columns: 3, rows: 2, velocities: 5 }));
        assert!(new(ResidualMesh { columns: 0, ..MESH }, 0).is_err());
        assert!(new(ResidualMesh { columns: usize::MAX, rows: 3, ..MESH }, 6).is_err());
        for spacing in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(new(ResidualMesh { spacing: [spacing, 1.0], ..MESH }, 6), Err(MeshError::Place));
        }
        assert_eq!(new(ResidualMesh { origin: [0.0, f64::NAN], ..MESH }, 6), Err(MeshError::Place));
        let velocities = vec![[0.0, 0.0], [0.0, f32::NAN], [0.0; 2], [0.0; 2], [0.0; 2], [0.0; 2]];
        assert_eq!(ResidualField::new(MESH, velocities), Err(MeshError::Velocity(1)));
    }
}
