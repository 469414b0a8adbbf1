// SPDX-License-Identifier: MIT OR Apache-2.0

//! Sums over the matches of a band.
//!
//! The matches of a band are exposed at about the same time and share the splines' weights: their products
//! are summed by generator, and spread over the coefficients once (`equations`).
//!
//! With the weight of an innovation W = UᵀU, its Jacobians and right sides times U are rows of unit weight. All sums
//! are of products of such rows, two to a match. They are taken a few rows of sums at a time over all matches
//! of the band, so that these stay in vector registers: with a track some 220 instructions of AVX2 a match, and 80
//! without.

use super::shared::SHARED;
use crate::lanes::{DOUBLES, DoubleCpu};
use crate::motion::generators::GENERATORS;
use nalgebra::Matrix2;

/// Right sides of a band: the innovation, and the columns of the shared unknowns.
pub const SIDES: usize = 1 + SHARED;
/// Generators whose sums are taken at a time: a vector of AVX2.
const HALF: usize = GENERATORS / 2;
const _: () =
    assert!(GENERATORS == 2 * DOUBLES, "a row is two vectors: another generator would not be summed");

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
    /// Of the pair before; these are set only if `linked` > 0, as those across and the second right sides.
    pub before: Square,
    /// Rows of the own pair, columns of the one before.
    pub across: Square,
    /// By own pair and pair before.
    pub sides: [[Row; SIDES]; 2],
}

/// `matrix` times a Jacobian.
#[inline(always)]
pub fn product<C: DoubleCpu>(cpu: C, matrix: &Matrix2<f64>, [x, y]: &Jacobian) -> Jacobian {
    let mut rows = [[0.0; GENERATORS]; 2];
    for (end, row) in rows.iter_mut().enumerate() {
        let (by_x, by_y) = (cpu.splat_double(matrix[(end, 0)]), cpu.splat_double(matrix[(end, 1)]));
        for (of, values) in row.as_chunks_mut::<HALF>().0.iter_mut().enumerate() {
            let [x, y] = [x, y].map(|row| cpu.load_doubles(half(row, of)));
            *values = cpu.store_doubles(cpu.fused_doubles(by_x, x, by_y * y));
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

/// Half `rows` of the rows of Σ aᵀ·b, in the last `HALVES` halves of the columns.
#[inline(always)]
fn products<C: DoubleCpu, const HALVES: usize>(
    cpu: C,
    all: &[Unit],
    a: impl Fn(&Unit) -> &Jacobian,
    b: impl Fn(&Unit) -> &Jacobian,
    rows: usize,
) -> [[C::Doubles; HALVES]; HALF] {
    let mut sums = [[cpu.splat_double(0.0); HALVES]; HALF];
    for one in all {
        for (a, b) in a(one).iter().zip(b(one)) {
            let mut columns = [cpu.splat_double(0.0); HALVES];
            for (of, column) in columns.iter_mut().enumerate() {
                *column = cpu.load_doubles(half(b, 2 - HALVES + of));
            }
            for (sums, factor) in sums.iter_mut().zip(half(a, rows)) {
                let factor = cpu.splat_double(*factor);
                for (sum, column) in sums.iter_mut().zip(columns) {
                    *sum = cpu.fused_doubles(factor, column, *sum);
                }
            }
        }
    }
    sums
}

/// Writes sums to the last of the columns.
#[inline(always)]
fn put<C: DoubleCpu, const HALVES: usize>(
    cpu: C,
    sums: impl IntoIterator<Item = [C::Doubles; HALVES]>,
    to: &mut [Row],
) {
    for (row, sums) in to.iter_mut().zip(sums) {
        for (values, sum) in row.as_chunks_mut::<HALF>().0[2 - HALVES..].iter_mut().zip(sums) {
            *values = cpu.store_doubles(sum);
        }
    }
}

/// Σ aᵀ·b.
#[inline(always)]
fn square<C: DoubleCpu>(
    cpu: C,
    all: &[Unit],
    a: impl Fn(&Unit) -> &Jacobian + Copy,
    b: impl Fn(&Unit) -> &Jacobian + Copy,
    out: &mut Square,
) {
    let (above, below) = out.split_at_mut(HALF);
    put::<C, 2>(cpu, products(cpu, all, a, b, 0), above);
    put::<C, 2>(cpu, products(cpu, all, a, b, 1), below);
}

/// Σ aᵀ·a.
#[inline(always)]
fn symmetric<C: DoubleCpu>(cpu: C, all: &[Unit], a: impl Fn(&Unit) -> &Jacobian + Copy, out: &mut Square) {
    let (above, below) = out.split_at_mut(HALF);
    put::<C, 2>(cpu, products(cpu, all, a, a, 0), above);
    put::<C, 1>(cpu, products(cpu, all, a, a, 1), below);
    for (row, below) in below.iter_mut().enumerate() {
        for (value, above) in below.iter_mut().zip(&*above) {
            *value = above[HALF + row];
        }
    }
}

/// Σ aᵀ·s for each right side s.
#[inline(always)]
fn sides<C: DoubleCpu>(cpu: C, all: &[Unit], a: impl Fn(&Unit) -> &Jacobian, out: &mut [Row; SIDES]) {
    let mut sums = [[cpu.splat_double(0.0); 2]; SIDES];
    for one in all {
        for (row, sides) in a(one).iter().zip(&one.sides) {
            let row = [0, 1].map(
                #[inline(always)]
                |of| cpu.load_doubles(half(row, of)),
            );
            for (sums, side) in sums.iter_mut().zip(sides) {
                let side = cpu.splat_double(*side);
                for (sum, values) in sums.iter_mut().zip(row) {
                    *sum = cpu.fused_doubles(side, values, *sum);
                }
            }
        }
    }
    put(cpu, sums, out);
}

impl Band {
    /// Makes this a band without innovations; sums are not used before they are taken anew.
    pub fn clear(&mut self) {
        (self.weight, self.linked, self.blocks) = (0.0, 0.0, [0.0; 3]);
    }

    /// Sums up all innovations of the band; `linked` has to be known.
    #[inline(always)]
    pub fn sum<C: DoubleCpu>(&mut self, cpu: C, all: &[Unit]) {
        let [own, before] = &mut self.sides;
        symmetric(cpu, all, |one| &one.own, &mut self.own);
        sides(cpu, all, |one| &one.own, own);
        if self.linked > 0.0 {
            square(cpu, all, |one| &one.own, |one| &one.before, &mut self.across);
            symmetric(cpu, all, |one| &one.before, &mut self.before);
            sides(cpu, all, |one| &one.before, before);
        }
    }
}
