// SPDX-License-Identifier: MIT OR Apache-2.0

//! Sums over the matches of a band.
//!
//! The matches of a band are exposed at about the same time and share the splines' weights: their products
//! are summed by generator, and spread over the coefficients once (`equations`).

use super::shared::SHARED;
use crate::motion::generators::GENERATORS;
use nalgebra::{Matrix2, SMatrix, Vector2};

/// Right sides of a band: the innovation, and the columns of the shared unknowns.
pub const SIDES: usize = 1 + SHARED;

/// A number for each generator.
pub type Row = [f64; GENERATORS];
/// Derivatives of x and of y by the paths of the generators.
pub type Jacobian = [Row; 2];
/// Sums of products, row by row.
pub type Square = [Row; GENERATORS];

/// The sums of a band. Innovations depend on the path over their own pair and over the pair before.
#[derive(Clone, Debug, Default)]
pub struct Band {
    pub weight: f64,
    /// Weight of the matches with a residual before.
    pub linked: f64,
    /// Weighted exposure times in blocks: start and end of the pair before, the latter also the start of the
    /// own one, and end of the own one.
    pub blocks: [f64; 3],
    pub own: Square,
    pub before: Square,
    /// Rows of the own pair, columns of the one before.
    pub across: Square,
    /// By own pair and pair before.
    pub sides: [[Row; SIDES]; 2],
}

/// `matrix` times a Jacobian.
#[inline(always)]
pub fn product(matrix: &Matrix2<f64>, [x, y]: &Jacobian) -> Jacobian {
    let mut rows = [*x, *y];
    for (end, row) in rows.iter_mut().enumerate() {
        let (by_x, by_y) = (matrix[(end, 0)], matrix[(end, 1)]);
        row.iter_mut().zip(x.iter().zip(y)).for_each(|(value, (x, y))| *value = by_x * x + by_y * y);
    }
    rows
}

/// Adds aᵀ·b.
#[inline(always)]
fn add_products(sums: &mut Square, a: &Jacobian, b: &Jacobian) {
    for (row, (x, y)) in sums.iter_mut().zip(a[0].iter().zip(&a[1])) {
        let columns = b[0].iter().zip(&b[1]);
        row.iter_mut().zip(columns).for_each(|(sum, (bx, by))| *sum += x * bx + y * by);
    }
}

/// Adds aᵀ·v for each v.
#[inline(always)]
fn add_sides(sums: &mut [Row; SIDES], a: &Jacobian, sides: &[Vector2<f64>; SIDES]) {
    for (row, side) in sums.iter_mut().zip(sides) {
        let columns = a[0].iter().zip(&a[1]);
        row.iter_mut().zip(columns).for_each(|(sum, (x, y))| *sum += x * side.x + y * side.y);
    }
}

impl Band {
    /// Adds an innovation with its Jacobians by the path over either pair and by the shared unknowns.
    #[inline(always)]
    pub fn add(
        &mut self,
        weight: &Matrix2<f64>,
        own: &Jacobian,
        before: Option<&Jacobian>,
        error: Vector2<f64>,
        shared: &SMatrix<f64, 2, SHARED>,
    ) {
        let sides = [error, shared.column(0).into_owned(), shared.column(1).into_owned()];
        let weighted = product(weight, own);
        add_products(&mut self.own, own, &weighted);
        add_sides(&mut self.sides[0], &weighted, &sides);
        if let Some(before) = before {
            let weighted = product(weight, before);
            add_products(&mut self.across, own, &weighted);
            add_products(&mut self.before, before, &weighted);
            add_sides(&mut self.sides[1], &weighted, &sides);
        }
    }
}
