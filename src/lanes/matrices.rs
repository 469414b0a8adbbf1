// SPDX-License-Identifier: MIT OR Apache-2.0

//! Matrices of 3 × 3, whose columns are vectors of four doubles.

use super::{DOUBLES, DoubleCpu};
use nalgebra::Matrix3;

/// The columns of a 3 × 3 matrix, each a vector whose last number is 0.
pub(crate) type Columns = [[f64; DOUBLES]; 3];

pub(crate) fn columns(matrix: &Matrix3<f64>) -> Columns {
    std::array::from_fn(|c| [matrix[(0, c)], matrix[(1, c)], matrix[(2, c)], 0.0])
}

/// The product of a matrix, by its columns, and a point. It is not fused, so that it is the same on all machines.
#[inline(always)]
pub(crate) fn times<C: DoubleCpu>(cpu: C, [a, b, c]: [C::Doubles; 3], [x, y, z]: [f64; 3]) -> [f64; 3] {
    let sum = cpu.splat_double(x) * a + cpu.splat_double(y) * b + cpu.splat_double(z) * c;
    let [x, y, z, _] = cpu.store_doubles(sum);
    [x, y, z]
}
