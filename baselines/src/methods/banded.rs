// SPDX-License-Identifier: MIT OR Apache-2.0

//! Banded normal equations.

use std::iter::Sum;
use std::ops::{Div, Mul, Sub};

/// Added to the diagonal, relative to its mean: unknowns without data stay zero.
const RIDGE: f64 = 1e-12;

/// The lower half of a symmetric matrix that is zero further than `reach` from its diagonal.
pub struct Banded {
    size: usize,
    reach: usize,
    /// Row by row, `reach + 1` entries each; the last is the diagonal's.
    entries: Vec<f64>,
}

impl Banded {
    /// Of `size` rows.
    pub fn zeros(size: usize, reach: usize) -> Self {
        Self { size, reach, entries: vec![0.0; size * (reach + 1)] }
    }

    /// Entry with `column` ≤ `row` ≤ `column` + reach.
    pub fn at(&mut self, row: usize, column: usize) -> &mut f64 {
        &mut self.entries[row * (self.reach + 1) + self.reach + column - row]
    }

    /// Cholesky's decomposition in place and both substitutions; `None` where the matrix is not positive. The right side
    /// is one column of numbers, or several as vectors.
    pub fn solve<T>(mut self, mut right: Vec<T>) -> Option<Vec<T>>
    where
        T: Copy + Sub<Output = T> + Mul<f64, Output = T> + Div<f64, Output = T> + Sum,
    {
        let trace: f64 = (0..self.size).map(|i| *self.at(i, i)).sum();
        let ridge = RIDGE * trace / self.size.max(1) as f64;
        for row in 0..self.size {
            let first = row.saturating_sub(self.reach);
            *self.at(row, row) += ridge;
            for column in first..=row {
                let shared = first.max(column.saturating_sub(self.reach))..column;
                let sum: f64 = shared.map(|k| *self.at(row, k) * *self.at(column, k)).sum();
                let rest = *self.at(row, column) - sum;
                *self.at(row, column) = if column < row {
                    rest / *self.at(column, column)
                } else {
                    (rest > 0.0 && rest.is_finite()).then(|| rest.sqrt())?
                };
            }
            let sum: T = (first..row).map(|k| right[k] * *self.at(row, k)).sum();
            right[row] = (right[row] - sum) / *self.at(row, row);
        }
        for row in (0..self.size).rev() {
            let last = (row + self.reach).min(self.size - 1);
            let sum: T = (row + 1..=last).map(|k| right[k] * *self.at(k, row)).sum();
            right[row] = (right[row] - sum) / *self.at(row, row);
        }
        Some(right)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector, Vector2};

    #[test]
    fn a_banded_system_is_solved_as_a_dense_one() {
        let (size, reach) = (9, 2);
        let mut banded = Banded::zeros(size, reach);
        let mut dense = DMatrix::zeros(size, size);
        for row in 0..size {
            for column in row.saturating_sub(reach)..=row {
                let entry =
                    if row == column { 5.0 + row as f64 } else { (row * 3 + column) as f64 % 4.0 - 1.5 };
                *banded.at(row, column) = entry;
                dense[(row, column)] = entry;
                dense[(column, row)] = entry;
            }
        }
        let right: Vec<_> = (0..size).map(|i| Vector2::new(i as f64, 1.0 - i as f64 * 0.5)).collect();
        let found = banded.solve(right.clone()).unwrap();
        let lu = dense.lu();
        for axis in 0..2 {
            let expected = lu.solve(&DVector::from_iterator(size, right.iter().map(|r| r[axis]))).unwrap();
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found[axis] - expected).abs() < 1e-9);
            }
        }
    }
}
