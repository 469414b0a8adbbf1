//! What the matches of a band add up to.
//!
//! A band's matches are exposed at about the same time, so that they share the splines' weights: they are added up by
//! generator here, and spread over the coefficients once (`equations`).

use super::shared::SHARED;
use crate::motion::generators::GENERATORS;
use nalgebra::{Matrix2, SMatrix, Vector2};

/// Right sides of a band: what is new, and the columns of the shared unknowns.
pub const SIDES: usize = 1 + SHARED;

/// A number for each generator.
pub type Row = [f64; GENERATORS];
/// What the generators change of x and of y.
pub type Slopes = [Row; 2];
/// Sums of products, row by row.
pub type Square = [Row; GENERATORS];

/// The sums of a band, by leg: the pair's own, the one before.
#[derive(Clone, Debug, Default)]
pub struct Band {
    pub weight: f64,
    /// Weight of the matches that have a leg before.
    pub linked: f64,
    /// Weighted exposure times: of the first end of the leg before, of its second, which is the first of the
    /// pair's own, and of the last.
    pub times: [f64; 3],
    pub own: Square,
    pub before: Square,
    /// Rows of the own leg, columns of the one before.
    pub across: Square,
    pub sides: [[Row; SIDES]; 2],
}

/// `matrix` times the two rows.
#[inline(always)]
pub fn mixed(matrix: &Matrix2<f64>, [x, y]: &Slopes) -> Slopes {
    let mut rows = [*x, *y];
    for (end, row) in rows.iter_mut().enumerate() {
        let (by_x, by_y) = (matrix[(end, 0)], matrix[(end, 1)]);
        row.iter_mut().zip(x.iter().zip(y)).for_each(|(value, (x, y))| *value = by_x * x + by_y * y);
    }
    rows
}

/// Adds aᵀ·b.
#[inline(always)]
fn add_products(sums: &mut Square, a: &Slopes, b: &Slopes) {
    for (row, (x, y)) in sums.iter_mut().zip(a[0].iter().zip(&a[1])) {
        let columns = b[0].iter().zip(&b[1]);
        row.iter_mut().zip(columns).for_each(|(sum, (bx, by))| *sum += x * bx + y * by);
    }
}

/// Adds aᵀ·v for each v.
#[inline(always)]
fn add_sides(sums: &mut [Row; SIDES], a: &Slopes, sides: &[Vector2<f64>; SIDES]) {
    for (row, side) in sums.iter_mut().zip(sides) {
        let slopes = a[0].iter().zip(&a[1]);
        row.iter_mut().zip(slopes).for_each(|(sum, (x, y))| *sum += x * side.x + y * side.y);
    }
}

impl Band {
    /// Adds a match of this weight: its slopes, those by the leg before, what is new in it, and what the
    /// shared unknowns change of that.
    #[inline(always)]
    pub fn add(
        &mut self,
        weight: &Matrix2<f64>,
        own: &Slopes,
        before: Option<&Slopes>,
        error: Vector2<f64>,
        shared: &SMatrix<f64, 2, SHARED>,
    ) {
        let sides = [error, shared.column(0).into_owned(), shared.column(1).into_owned()];
        let weighted = mixed(weight, own);
        add_products(&mut self.own, own, &weighted);
        add_sides(&mut self.sides[0], &weighted, &sides);
        if let Some(before) = before {
            let weighted = mixed(weight, before);
            add_products(&mut self.across, own, &weighted);
            add_products(&mut self.before, before, &weighted);
            add_sides(&mut self.sides[1], &weighted, &sides);
        }
    }
}
