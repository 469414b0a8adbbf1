// SPDX-License-Identifier: MIT OR Apache-2.0

//! Sums over the matches of a band.
//!
//! The matches of a band are exposed at about the same time and share the splines' weights: their products
//! are summed by generator, and spread over the coefficients once (`equations`).
//!
//! With the weight of an innovation W = UᵀU, its Jacobians and right sides times U are rows of unit weight. All sums
//! are of products of such rows, two to a match. They are taken a few rows of sums at a time over all matches
//! of the band, so that these stay in vector registers: with a track some 450 instructions of AVX2 a match, and 200
//! without.

use super::shared::SHARED;
use crate::motion::generators::GENERATORS;
use nalgebra::Matrix2;

/// Right sides of a band: the innovation, and the columns of the shared unknowns.
pub const SIDES: usize = 1 + SHARED;
/// Generators whose sums are taken at a time: a vector of AVX2.
const HALF: usize = GENERATORS / 2;

/// A number for each generator.
pub type Row = [f64; GENERATORS];
/// Derivatives of x and of y by the paths of the generators.
pub type Jacobian = [Row; 2];
/// Sums of products, row by row.
pub type Square = [Row; GENERATORS];

/// An innovation of unit weight.
#[derive(Clone, Copy, Debug)]
pub struct Unit {
    /// Its Jacobians by the path over the own pair and over the pair before; the latter is 0 without a track.
    pub own: Jacobian,
    pub before: Jacobian,
    /// The innovation and its Jacobian by the shared unknowns.
    pub sides: [[f64; SIDES]; 2],
}

impl Unit {
    pub const ZERO: Self =
        Self { own: [[0.0; GENERATORS]; 2], before: [[0.0; GENERATORS]; 2], sides: [[0.0; SIDES]; 2] };
}

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
        for (value, (x, y)) in row.iter_mut().zip(x.iter().zip(y)) {
            *value = by_x * x + by_y * y;
        }
    }
    rows
}

/// U with UᵀU = W, a positive semidefinite matrix.
#[inline(always)]
pub fn root(weight: &Matrix2<f64>) -> Matrix2<f64> {
    let (xx, xy, yy) = (weight.m11, weight.m12, weight.m22);
    let first = xx.max(0.0).sqrt();
    let beside = if first > 0.0 { xy / first } else { 0.0 };
    Matrix2::new(first, beside, 0.0, (yy - beside * beside).max(0.0).sqrt())
}

/// Half a row.
#[inline(always)]
fn half(row: &Row, of: usize) -> &[f64; HALF] {
    &row.as_chunks::<HALF>().0[of]
}

/// Rows `rows` of Σ aᵀ·b, columns `columns`: both halves of the generators.
#[inline(always)]
fn products(
    all: &[Unit],
    a: impl Fn(&Unit) -> &Jacobian,
    b: impl Fn(&Unit) -> &Jacobian,
    [rows, columns]: [usize; 2],
) -> [[f64; HALF]; HALF] {
    let mut sums = [[0.0; HALF]; HALF];
    for one in all {
        for (a, b) in a(one).iter().zip(b(one)) {
            let (a, b) = (half(a, rows), half(b, columns));
            for (sums, factor) in sums.iter_mut().zip(a) {
                for (sum, value) in sums.iter_mut().zip(b) {
                    *sum += factor * value;
                }
            }
        }
    }
    sums
}

/// Writes a quarter of a square.
#[inline(always)]
fn put(square: &mut Square, [rows, columns]: [usize; 2], sums: &[[f64; HALF]; HALF]) {
    for (row, sums) in square[rows * HALF..].iter_mut().zip(sums) {
        row[columns * HALF..][..HALF].copy_from_slice(sums);
    }
}

/// Σ aᵀ·b.
#[inline(always)]
fn square(
    all: &[Unit],
    a: impl Fn(&Unit) -> &Jacobian + Copy,
    b: impl Fn(&Unit) -> &Jacobian + Copy,
    symmetric: bool,
    out: &mut Square,
) {
    for quarter in [[0, 0], [0, 1], [1, 1]] {
        put(out, quarter, &products(all, a, b, quarter));
    }
    if symmetric {
        let (above, below) = out.split_at_mut(HALF);
        for (row, below) in below.iter_mut().enumerate() {
            for (value, above) in below.iter_mut().zip(&*above) {
                *value = above[HALF + row];
            }
        }
    } else {
        put(out, [1, 0], &products(all, a, b, [1, 0]));
    }
}

/// Σ aᵀ·s for each right side s.
#[inline(always)]
fn sides(all: &[Unit], a: impl Fn(&Unit) -> &Jacobian) -> [Row; SIDES] {
    let mut sums = [[0.0; GENERATORS]; SIDES];
    for one in all {
        for (row, sides) in a(one).iter().zip(&one.sides) {
            for (sums, side) in sums.iter_mut().zip(sides) {
                for (sum, value) in sums.iter_mut().zip(row) {
                    *sum += side * value;
                }
            }
        }
    }
    sums
}

impl Band {
    /// Sums up all innovations of the band; `linked` has to be known.
    #[inline(always)]
    pub fn sum(&mut self, all: &[Unit]) {
        square(all, |one| &one.own, |one| &one.own, true, &mut self.own);
        self.sides[0] = sides(all, |one| &one.own);
        if self.linked > 0.0 {
            square(all, |one| &one.own, |one| &one.before, false, &mut self.across);
            square(all, |one| &one.before, |one| &one.before, true, &mut self.before);
            self.sides[1] = sides(all, |one| &one.before);
        }
    }
}
