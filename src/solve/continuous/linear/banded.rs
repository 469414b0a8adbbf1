// SPDX-License-Identifier: MIT OR Apache-2.0

//! Symmetric positive definite matrices with a band, and their Cholesky factors.
//!
//! A pair of frames depends on the coefficients of few blocks, so the band of each row is as wide as its own
//! couplings need (*variable-band* or *skyline* storage: A. George, J. W. Liu, *Computer Solution of Large
//! Sparse Positive Definite Systems*, 1981, chapter 4): rows of the turns, with a support of one block, are
//! shorter than those of the other generators, with four. The factor has the band of its matrix. With bᵢ
//! entries in row i before the diagonal it takes Σ bᵢ²/2 multiply-adds, the inverse inside the band at most
//! four times as many.

use crate::cpu::{CpuLevel, for_each_cpu};

/// The lower band of a symmetric matrix, row by row.
#[derive(Clone, Debug, Default)]
pub struct Banded {
    /// Column of the first entry of each row.
    first: Vec<usize>,
    /// Index in `values` of each diagonal entry, the last of its row.
    diagonal: Vec<usize>,
    values: Vec<f64>,
}

impl Banded {
    /// Makes this a zero matrix whose rows begin at these columns, or at the diagonal if these lie beyond.
    pub fn reset(&mut self, first: impl IntoIterator<Item = usize>) {
        self.first.clear();
        self.diagonal.clear();
        let mut count = 0;
        for (i, first) in first.into_iter().enumerate() {
            self.first.push(first.min(i));
            count += i - first.min(i);
            self.diagonal.push(count);
            count += 1;
        }
        self.values.clear();
        self.values.resize(count, 0.0);
    }

    /// Number of rows.
    pub fn size(&self) -> usize {
        self.first.len()
    }

    /// Entries (i, first) to (i, i).
    fn row(&self, i: usize) -> &[f64] {
        &self.values[self.diagonal[i] - (i - self.first[i])..=self.diagonal[i]]
    }

    /// Adds to the entry (i, j) or (j, i), which must lie in the band.
    pub fn add(&mut self, i: usize, j: usize, value: f64) {
        let (i, j) = (i.max(j), i.min(j));
        self.values[self.diagonal[i] - (i - j)] += value;
    }

    pub fn at(&self, i: usize, j: usize) -> f64 {
        let (i, j) = (i.max(j), i.min(j));
        if j < self.first[i] { 0.0 } else { self.values[self.diagonal[i] - (i - j)] }
    }

    /// Replaces the matrix by its Cholesky factor L; false if it is not positive definite.
    pub fn factorise(&mut self, cpu: CpuLevel) -> bool {
        factorise(cpu, self)
    }

    #[inline(always)]
    fn replace_by_factor(&mut self) -> bool {
        for i in 0..self.size() {
            let first = self.first[i];
            let (before, rest) = self.values.split_at_mut(self.diagonal[i] - (i - first));
            let row = &mut rest[..=i - first];
            for j in first..i {
                let other = &before[self.diagonal[j] - (j - self.first[j])..=self.diagonal[j]];
                let start = first.max(self.first[j]);
                let (own, theirs) = (&row[start - first..j - first], &other[start - self.first[j]..]);
                let sum = row[j - first] - dot(own, &theirs[..own.len()]);
                row[j - first] = sum / theirs[own.len()];
            }
            let sum = row[i - first] - dot(&row[..i - first], &row[..i - first]);
            if !(sum > 0.0 && sum.is_finite()) {
                return false;
            }
            row[i - first] = sum.sqrt();
        }
        true
    }

    /// Half the logarithm of the determinant of L·Lᵀ, this being L.
    pub fn half_log_determinant(&self) -> f64 {
        self.diagonal.iter().map(|place| self.values[*place].ln()).sum()
    }

    /// Solves L·Lᵀ·x = b in place, this being L.
    pub fn solve(&self, b: &mut [f64]) {
        for i in 0..self.size() {
            let sum = dot(&self.row(i)[..i - self.first[i]], &b[self.first[i]..i]);
            b[i] = (b[i] - sum) / self.values[self.diagonal[i]];
        }
        for i in (0..self.size()).rev() {
            let x = b[i] / self.values[self.diagonal[i]];
            b[i] = x;
            for (value, factor) in b[self.first[i]..i].iter_mut().zip(self.row(i)) {
                *value -= factor * x;
            }
        }
    }

    /// The last row with each column in its band.
    fn last(&self) -> Vec<usize> {
        let mut last = vec![0; self.size()];
        self.first.iter().enumerate().for_each(|(i, first)| last[*first] = i);
        let mut most = 0;
        last.iter_mut().for_each(|last| {
            most = most.max(*last);
            *last = most;
        });
        last
    }

    /// The entries of (L·Lᵀ)⁻¹ inside the band, this being L: Takahashi's recursion.
    ///
    /// Column j of the inverse Z is Z_ij = (δ_ij / L_jj − Σ_{k > j} Z_ik L_kj) / L_jj for i ≥ j: a product of
    /// the part of Z that is known already with column j of L. Rows i with L_ij outside the band are skipped.
    /// Only the lower half of the symmetric known part is stored, and each row is used both as row and as
    /// column, so that it is read in order.
    pub fn inverse_band(&self, cpu: CpuLevel, out: &mut Banded) {
        inverse_band(cpu, self, out);
    }

    #[inline(always)]
    fn fill_inverse_band(&self, out: &mut Banded) {
        out.reset(self.first.iter().copied());
        let (mut column, mut sums) = (Vec::new(), Vec::new());
        for (j, last) in self.last().into_iter().enumerate().rev() {
            let diagonal = self.values[self.diagonal[j]];
            let below = j + 1..last + 1;
            column.clear();
            column.extend(below.clone().map(|i| self.at(i, j)));
            sums.clear();
            sums.resize(column.len(), 0.0);
            for i in below.clone().filter(|i| self.first[*i] <= j) {
                let k = i - below.start;
                let row = &out.values[out.diagonal[i] - k..=out.diagonal[i]];
                let sum = dot_and_add(&row[..k], &column[..k], &mut sums[..k], column[k]);
                sums[k] += sum + row[k] * column[k];
            }
            let above = dot(&column, &sums);
            for (i, sum) in below.zip(&sums).filter(|(i, _)| self.first[*i] <= j) {
                out.values[out.diagonal[i] - (i - j)] = -sum / diagonal;
            }
            out.values[out.diagonal[j]] = (1.0 + above) / (diagonal * diagonal);
        }
    }
}

for_each_cpu! {
    fn factorise(matrix: &mut Banded) -> bool {
        matrix.replace_by_factor()
    }
}

for_each_cpu! {
    fn inverse_band(factor: &Banded, out: &mut Banded) {
        factor.fill_inverse_band(out);
    }
}

/// Σ aᵢ·bᵢ, in eight partial sums for vector registers.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (a8, b8) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let rest: f64 = a8.1.iter().zip(b8.1).map(|(x, y)| x * y).sum();
    for (x, y) in a8.0.iter().zip(b8.0) {
        for k in 0..8 {
            sums[k] += x[k] * y[k];
        }
    }
    sums.iter().sum::<f64>() + rest
}

/// Σ aᵢ·bᵢ; adds factor·aᵢ to cᵢ.
#[inline(always)]
fn dot_and_add(a: &[f64], b: &[f64], c: &mut [f64], factor: f64) -> f64 {
    let mut sums = [0.0; 4];
    let (a4, b4, c4) = (a.as_chunks::<4>(), b.as_chunks::<4>(), c.as_chunks_mut::<4>());
    for ((x, y), z) in a4.0.iter().zip(b4.0).zip(c4.0) {
        for k in 0..4 {
            sums[k] += x[k] * y[k];
            z[k] += factor * x[k];
        }
    }
    let mut rest = 0.0;
    for ((x, y), z) in a4.1.iter().zip(b4.1).zip(c4.1) {
        rest += x * y;
        *z += factor * x;
    }
    sums.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::random::Random;
    use nalgebra::{DMatrix, DVector};

    /// A random positive definite matrix B·Bᵀ + I/10, B lower triangular, in both storages. Rows have `band`
    /// entries before the diagonal, or, if `ragged`, every third one a third as many.
    fn random(size: usize, band: usize, ragged: bool, seed: u64) -> (Banded, DMatrix<f64>) {
        let mut random = Random(seed);
        let mut uniform = || random.uniform() - 0.5;
        let first = |i: usize| i.saturating_sub(if ragged && i % 3 == 1 { band / 3 } else { band });
        let lower =
            DMatrix::from_fn(size, size, |i, j| if j <= i && j >= first(i) { uniform() } else { 0.0 });
        let mut dense = &lower * lower.transpose() + DMatrix::identity(size, size) / 10.0;
        if ragged {
            // The product is wider than the band; the diagonal keeps it definite.
            dense = DMatrix::from_fn(size, size, |i, j| {
                let inside = i.min(j) >= first(i.max(j));
                if i == j { band as f64 } else { dense[(i, j)] * f64::from(u8::from(inside)) }
            });
        }
        let mut banded = Banded::default();
        banded.reset((0..size).map(first));
        for i in 0..size {
            (first(i)..=i).for_each(|j| banded.add(i, j, dense[(i, j)]));
        }
        (banded, dense)
    }

    const SHAPES: [(usize, usize, bool); 8] = [
        (1, 0, false),
        (5, 0, false),
        (6, 5, false),
        (40, 1, false),
        (61, 13, false),
        (90, 50, false),
        (61, 13, true),
        (90, 50, true),
    ];

    #[test]
    fn the_factor_solves_as_a_dense_one_does() {
        for (seed, (size, band, ragged)) in SHAPES.into_iter().enumerate() {
            let (mut banded, dense) = random(size, band, ragged, seed as u64);
            assert!(banded.factorise(CpuLevel::detect()));
            let b = DVector::from_fn(size, |i, _| (i as f64 * 1.3).sin());
            let expected = dense.cholesky().unwrap().solve(&b);
            let mut x = b.as_slice().to_vec();
            banded.solve(&mut x);
            let off = (DVector::from_vec(x) - &expected).amax();
            assert!(off < 1e-9 * expected.amax().max(1.0), "{size} {band}: {off}");
        }
    }

    #[test]
    fn the_inverse_is_the_dense_one_s_inside_the_band() {
        for (seed, (size, band, ragged)) in SHAPES.into_iter().enumerate() {
            let (mut banded, dense) = random(size, band, ragged, 100 + seed as u64);
            assert!(banded.factorise(CpuLevel::detect()));
            let expected = dense.try_inverse().unwrap();
            let mut inverse = Banded::default();
            banded.inverse_band(CpuLevel::detect(), &mut inverse);
            for i in 0..size {
                for j in 0..size {
                    let inside = i.min(j) >= banded.first[i.max(j)];
                    let value = if inside { expected[(i, j)] } else { 0.0 };
                    assert!(
                        (inverse.at(i, j) - value).abs() < 1e-9 * expected.amax(),
                        "{size} {band}: {i} {j}"
                    );
                }
            }
        }
    }

    #[test]
    fn all_instructions_find_the_same() {
        for (seed, (size, band, ragged)) in SHAPES.into_iter().enumerate() {
            let found = CpuLevel::supported().map(|cpu| {
                let (mut banded, _) = random(size, band, ragged, 200 + seed as u64);
                assert!(banded.factorise(cpu));
                let mut inverse = Banded::default();
                banded.inverse_band(cpu, &mut inverse);
                (banded.values, inverse.values)
            });
            let found: Vec<_> = found.collect();
            assert!(found.windows(2).all(|two| two[0] == two[1]), "{size} {band}");
        }
    }

    #[test]
    fn rows_reach_back_as_far_as_they_were_made_to() {
        let mut banded = Banded::default();
        banded.reset([0, 0, 2, 1]);
        banded.add(1, 0, 2.0);
        banded.add(1, 3, 4.0);
        banded.add(3, 3, 5.0);
        banded.add(3, 3, 6.0);
        let dense = DMatrix::from_fn(4, 4, |i, j| banded.at(i, j));
        let expected = DMatrix::from_row_slice(
            4,
            4,
            &[0.0, 2.0, 0.0, 0.0, 2.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0, 4.0, 0.0, 11.0],
        );
        assert_eq!(dense, expected);
        assert_eq!(banded.values.len(), 1 + 2 + 1 + 3);
        assert_eq!(banded.last(), [1, 3, 3, 3]);
    }

    #[test]
    fn indefinite_matrices_are_refused() {
        // Eigenvalues 3 and −1; a zero matrix; NaN.
        for [diagonal, beside] in [[1.0, 2.0], [0.0, 0.0], [f64::NAN, 0.0], [f64::INFINITY, 0.0]] {
            let mut banded = Banded::default();
            banded.reset([0, 0]);
            banded.add(0, 0, diagonal);
            banded.add(1, 1, diagonal);
            banded.add(1, 0, beside);
            assert!(!banded.factorise(CpuLevel::detect()), "{diagonal} {beside}");
        }
    }
}
