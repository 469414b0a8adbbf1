// SPDX-License-Identifier: MIT OR Apache-2.0

//! Symmetric equations of blocks, with two diagonals of blocks beside the main one.

use nalgebra::SMatrix;

/// A row of blocks of the lower half: the equations of N unknowns of a frame, with M right sides. Blocks beside the diagonal are
/// multiples of the identity.
#[derive(Clone, Copy, Debug)]
pub struct Row<const N: usize, const M: usize> {
    /// Elements with the row two before, and one before.
    pub beside: [f64; 2],
    pub diagonal: SMatrix<f64, N, N>,
    pub right: SMatrix<f64, N, M>,
    /// Seconds that the row's frame stands for.
    pub interval: f64,
    /// Of a row that is done: the inverse of the diagonal, and the factors beside it with the row two before and one before.
    inverse: SMatrix<f64, N, N>,
    to_two: SMatrix<f64, N, N>,
    to_one: SMatrix<f64, N, N>,
}

impl<const N: usize, const M: usize> Default for Row<N, M> {
    fn default() -> Self {
        let zeros = SMatrix::zeros();
        Self {
            beside: [0.0; 2],
            diagonal: zeros,
            right: SMatrix::zeros(),
            interval: 0.0,
            inverse: zeros,
            to_two: zeros,
            to_one: zeros,
        }
    }
}

impl<const N: usize, const M: usize> Row<N, M> {
    /// With the right side 0.
    pub fn new(beside: [f64; 2], diagonal: SMatrix<f64, N, N>, interval: f64) -> Self {
        Self { beside, diagonal, interval, ..Self::default() }
    }
}

/// Solves by the Cholesky factor L·D·Lᵀ inside the band. The elements stay; the right sides become those by L⁻¹.
pub fn solve<const N: usize, const M: usize>(rows: &mut [Row<N, M>], found: &mut Vec<SMatrix<f64, N, M>>) {
    for index in 0..rows.len() {
        let (done, rest) = rows.split_at_mut(index);
        let Some(row) = rest.first_mut() else { break };
        let one = done.last().copied().unwrap_or_default();
        let two = index.checked_sub(2).and_then(|two| done.get(two)).copied().unwrap_or_default();
        let [far, near] = row.beside;
        let near = SMatrix::from_diagonal_element(near) - one.to_one.transpose() * far;
        row.to_two = two.inverse * far;
        row.to_one = near * one.inverse;
        row.right -= row.to_two * two.right + row.to_one * one.right;
        let diagonal = row.diagonal - row.to_two * far - row.to_one * near.transpose();
        row.inverse = diagonal.cholesky().map_or_else(SMatrix::zeros, |factor| factor.inverse());
    }
    found.resize(rows.len(), SMatrix::zeros());
    for index in (0..rows.len()).rev() {
        let Some(row) = rows.get(index) else { continue };
        let mut value = row.inverse * row.right;
        if let (Some(row), Some(after)) = (rows.get(index + 1), found.get(index + 1)) {
            value -= row.to_one.tr_mul(after);
        }
        if let (Some(row), Some(after)) = (rows.get(index + 2), found.get(index + 2)) {
            value -= row.to_two.tr_mul(after);
        }
        if let Some(slot) = found.get_mut(index) {
            *slot = value;
        }
    }
}
