//! Symmetric positive definite matrices with a band, and their Cholesky factors.
//!
//! A pair of frames depends on the coefficients of a few blocks, so that the matrix of n unknowns has a
//! band of width b ≪ n: n·b²/2 multiply-adds to factorise, n·b² for the inverse inside the band.

/// The lower band of a symmetric matrix, row by row: entry (i, j), i − band ≤ j ≤ i, at
/// i·(band + 1) + j + band − i.
#[derive(Clone, Debug, Default)]
pub(super) struct Banded {
    size: usize,
    band: usize,
    values: Vec<f64>,
    /// Room for two columns.
    scratch: Vec<f64>,
}

impl Banded {
    /// Makes this a matrix of zeros.
    pub fn reset(&mut self, size: usize, band: usize) {
        self.size = size;
        self.band = band;
        self.values.clear();
        self.values.resize(size * (band + 1), 0.0);
    }

    /// Entries (i, i − band) to (i, i).
    fn row(&self, i: usize) -> &[f64] {
        &self.values[i * (self.band + 1)..(i + 1) * (self.band + 1)]
    }

    /// Adds to the entry (i, j), j ≤ i ≤ j + band.
    pub fn add(&mut self, i: usize, j: usize, value: f64) {
        self.values[i * (self.band + 1) + j + self.band - i] += value;
    }

    /// Adds a symmetric block, row by row, whose first entry lies at (first, first).
    pub fn add_block(&mut self, first: usize, size: usize, block: &[f64]) {
        for i in 0..size {
            let row = (first + i) * (self.band + 1) + self.band - i;
            let own = &mut self.values[row..=row + i];
            for (value, part) in own.iter_mut().zip(&block[i * size..=i * size + i]) {
                *value += part;
            }
        }
    }

    pub fn at(&self, i: usize, j: usize) -> f64 {
        let (i, j) = (i.max(j), i.min(j));
        if i - j > self.band { 0.0 } else { self.values[i * (self.band + 1) + j + self.band - i] }
    }

    /// Replaces the matrix by its Cholesky factor L; false where it is not positive definite.
    pub fn factorise(&mut self) -> bool {
        let (band, width) = (self.band, self.band + 1);
        for i in 0..self.size {
            let first = i.saturating_sub(band);
            let (before, rest) = self.values.split_at_mut(i * width);
            let row = &mut rest[..width];
            for j in first..=i {
                let start = first.max(j.saturating_sub(band));
                let count = j - start;
                let own = start + band - i;
                if j == i {
                    let sum = row[band] - dot(&row[own..own + count], &row[own..own + count]);
                    if !(sum > 0.0 && sum.is_finite()) {
                        return false;
                    }
                    row[band] = sum.sqrt();
                } else {
                    let other = &before[j * width..(j + 1) * width];
                    let theirs = start + band - j;
                    let sum = row[j + band - i] - dot(&row[own..own + count], &other[theirs..theirs + count]);
                    row[j + band - i] = sum / other[band];
                }
            }
        }
        true
    }

    /// Half the logarithm of the determinant of L·Lᵀ, this being L.
    pub fn half_log_determinant(&self) -> f64 {
        (0..self.size).map(|i| self.row(i)[self.band].ln()).sum()
    }

    /// Solves L·Lᵀ·x = b in place, this being L.
    pub fn solve(&self, b: &mut [f64]) {
        let band = self.band;
        for i in 0..self.size {
            let first = i.saturating_sub(band);
            let row = self.row(i);
            let sum = dot(&row[first + band - i..band], &b[first..i]);
            b[i] = (b[i] - sum) / row[band];
        }
        for i in (0..self.size).rev() {
            let first = i.saturating_sub(band);
            let row = self.row(i);
            b[i] /= row[band];
            let x = b[i];
            for (value, factor) in b[first..i].iter_mut().zip(&row[first + band - i..band]) {
                *value -= factor * x;
            }
        }
    }

    /// The entries of (L·Lᵀ)⁻¹ inside the band, this being L: Takahashi's recursion.
    ///
    /// Column j of the inverse Z is Z_ij = (δ_ij / L_jj − Σ_{k > j} Z_ik L_kj) / L_jj for i ≥ j: a product of the
    /// part of Z that is known already with column j of L. That part is symmetric and only its lower half is
    /// kept, so that each row of it serves twice, as a row and as a column, and is read in order.
    pub fn inverse_band(&self, out: &mut Banded) {
        out.reset(self.size, self.band);
        let (n, band, width) = (self.size, self.band, self.band + 1);
        let mut scratch = std::mem::take(&mut out.scratch);
        scratch.resize(2 * band, 0.0);
        let (column, sums) = scratch.split_at_mut(band);
        for j in (0..n).rev() {
            let count = band.min(n - 1 - j);
            let diagonal = self.values[j * width + band];
            let (column, sums) = (&mut column[..count], &mut sums[..count]);
            for (k, value) in column.iter_mut().enumerate() {
                *value = self.values[(j + 1 + k) * width + band - 1 - k];
            }
            sums.fill(0.0);
            for i in 0..count {
                let row = &out.values[(j + 1 + i) * width + band - i..][..=i];
                let (below, above) = (&column[..i], &mut sums[..i]);
                let sum = dot_and_add(&row[..i], below, above, column[i]);
                sums[i] += sum + row[i] * column[i];
            }
            let above = dot(column, sums);
            for (i, sum) in sums.iter().enumerate() {
                out.values[(j + 1 + i) * width + band - 1 - i] = -sum / diagonal;
            }
            out.values[j * width + band] = (1.0 + above) / (diagonal * diagonal);
        }
        out.scratch = scratch;
    }
}

/// Σ aᵢ·bᵢ, in eight sums so that it runs on vectors.
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

/// Σ aᵢ·bᵢ; adds factor·aᵢ to cᵢ on the way.
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

    /// A random positive definite matrix with this band, as both see it: B·Bᵀ + 1/10 with B lower
    /// triangular of the same band.
    fn random(size: usize, band: usize, seed: u64) -> (Banded, DMatrix<f64>) {
        let mut random = Random(seed);
        let mut uniform = || random.uniform() - 0.5;
        let lower =
            DMatrix::from_fn(size, size, |i, j| if j <= i && i - j <= band { uniform() } else { 0.0 });
        let dense = &lower * lower.transpose() + DMatrix::identity(size, size) / 10.0;
        let mut banded = Banded::default();
        banded.reset(size, band);
        for i in 0..size {
            (i.saturating_sub(band)..=i).for_each(|j| banded.add(i, j, dense[(i, j)]));
        }
        (banded, dense)
    }

    const SHAPES: [(usize, usize); 6] = [(1, 0), (5, 0), (6, 5), (40, 1), (61, 13), (90, 50)];

    #[test]
    fn the_factor_solves_as_a_dense_one_does() {
        for (seed, (size, band)) in SHAPES.into_iter().enumerate() {
            let (mut banded, dense) = random(size, band, seed as u64);
            assert!(banded.factorise());
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
        for (seed, (size, band)) in SHAPES.into_iter().enumerate() {
            let (mut banded, dense) = random(size, band, 100 + seed as u64);
            assert!(banded.factorise());
            let expected = dense.try_inverse().unwrap();
            let mut inverse = Banded::default();
            banded.inverse_band(&mut inverse);
            for i in 0..size {
                for j in 0..size {
                    let value = if i.abs_diff(j) <= band { expected[(i, j)] } else { 0.0 };
                    assert!(
                        (inverse.at(i, j) - value).abs() < 1e-9 * expected.amax(),
                        "{size} {band}: {i} {j}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_block_is_added_entry_by_entry() {
        let mut banded = Banded::default();
        banded.reset(5, 2);
        banded.add_block(1, 3, &[1.0, 2.0, 3.0, 2.0, 4.0, 5.0, 3.0, 5.0, 6.0]);
        banded.add(3, 3, 10.0);
        let dense = DMatrix::from_fn(5, 5, |i, j| banded.at(i, j));
        let expected = DMatrix::from_row_slice(
            5,
            5,
            &[
                0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 0.0, 0.0, 2.0, 4.0, 5.0, 0.0, 0.0, 3.0, 5.0,
                16.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
            ],
        );
        assert_eq!(dense, expected);
    }

    #[test]
    fn what_is_not_positive_definite_is_refused() {
        // Eigenvalues 3 and −1; a zero matrix; what is not a number.
        for [diagonal, beside] in [[1.0, 2.0], [0.0, 0.0], [f64::NAN, 0.0], [f64::INFINITY, 0.0]] {
            let mut banded = Banded::default();
            banded.reset(2, 1);
            banded.add(0, 0, diagonal);
            banded.add(1, 1, diagonal);
            banded.add(1, 0, beside);
            assert!(!banded.factorise(), "{diagonal} {beside}");
        }
    }
}
