// SPDX-License-Identifier: MIT OR Apache-2.0

//! Symmetric positive definite matrices with a band, and their Cholesky factors.
//!
//! A pair of frames depends on the coefficients of few blocks, so the band of each row is as wide as its own
//! couplings need (*variable-band* or *skyline* storage: A. George, J. W. Liu, *Computer Solution of Large
//! Sparse Positive Definite Systems*, 1981, chapter 4). Rows and columns are taken four at a time, as tiles of
//! 4 × 4, whose products fill vector registers: each row of tiles begins where the first of its rows does. The
//! factor has the tiles of its matrix. With b entries in a row before the diagonal it takes Σ b²/2
//! multiply-adds, the inverse inside the band at most Σ b².

use crate::cpu::CpuLevel;
use crate::lanes::dispatch::with_cpu;
use crate::lanes::{Cpu, DOUBLES, DoubleCpu};

/// Rows and columns of a tile: a column is a vector.
const SIDE: usize = DOUBLES;

/// Entries of a tile, column by column.
type Tile = [[f64; SIDE]; SIDE];

const ZERO: Tile = [[0.0; SIDE]; SIDE];

/// The lower band of a symmetric matrix, one row of tiles after the other.
#[derive(Clone, Debug, Default)]
pub struct Banded {
    /// First column of the band in each row. The last tile may reach beyond the rows, and is the identity there.
    begin: Vec<usize>,
    /// The first tile of each row of tiles.
    first: Vec<usize>,
    /// Index in `tiles` of each diagonal tile, the last of its row. Above its diagonal it is not used.
    diagonal: Vec<usize>,
    tiles: Vec<Tile>,
}

impl Banded {
    /// Makes this a zero matrix whose rows begin at these columns, or at the diagonal if these lie beyond.
    pub fn reset(&mut self, first: impl IntoIterator<Item = usize>) {
        self.begin.clear();
        self.begin.extend(first.into_iter().enumerate().map(|(i, first)| first.min(i)));
        self.first.clear();
        let least = |rows: &[usize]| rows.iter().fold(usize::MAX, |least, first| least.min(*first)) / SIDE;
        self.first.extend(self.begin.chunks(SIDE).map(least));
        self.diagonal.clear();
        let mut count = 0;
        for (row, first) in self.first.iter().enumerate() {
            self.diagonal.push(count + row - first);
            count += row - first + 1;
        }
        self.tiles.clear();
        self.tiles.resize(count, ZERO);
        for i in self.size()..self.first.len() * SIDE {
            self.add(i, i, 1.0);
        }
    }

    /// Number of rows.
    pub fn size(&self) -> usize {
        self.begin.len()
    }

    /// Tiles (i, first) to (i, i).
    #[inline(always)]
    fn row(&self, i: usize) -> &[Tile] {
        &self.tiles[self.diagonal[i] - (i - self.first[i])..=self.diagonal[i]]
    }

    /// Index among all entries of (i, 0), where it would lie: entries of a row are a side apart.
    #[inline(always)]
    fn row_start(&self, i: usize) -> usize {
        SIDE * SIDE * (self.diagonal[i / SIDE] - i / SIDE) + i % SIDE
    }

    /// Adds to the entry (i, j) or (j, i), which must lie in the band.
    #[inline(always)]
    pub fn add(&mut self, i: usize, j: usize, value: f64) {
        self.add_row(i, &[j], &[value]);
    }

    /// Adds to the entries (i, j) or (j, i) of these columns j, which must lie in the band.
    #[inline(always)]
    pub fn add_row(&mut self, i: usize, columns: &[usize], values: &[f64]) {
        let start = self.row_start(i);
        for (j, value) in columns.iter().zip(values) {
            let place = if *j <= i { start + SIDE * j } else { self.row_start(*j) + SIDE * i };
            self.tiles.as_flattened_mut().as_flattened_mut()[place] += value;
        }
    }

    /// The entry (i, j) or (j, i); 0 outside the band.
    pub fn at(&self, i: usize, j: usize) -> f64 {
        let (i, j) = (i.max(j), i.min(j));
        if j < self.begin[i] {
            return 0.0;
        }
        self.tiles[self.diagonal[i / SIDE] - (i / SIDE - j / SIDE)][j % SIDE][i % SIDE]
    }

    /// Replaces the matrix by its Cholesky factor L; false if it is not positive definite.
    pub fn factorise(&mut self, cpu: CpuLevel) -> bool {
        with_cpu!(cpu, cpu => cpu.vectorize(#[inline(always)] || self.replace_by_factor(cpu)))
    }

    #[inline(always)]
    fn replace_by_factor<C: DoubleCpu>(&mut self, cpu: C) -> bool {
        for i in 0..self.first.len() {
            let first = self.first[i];
            let (before, rest) = self.tiles.split_at_mut(self.diagonal[i] - (i - first));
            let row = &mut rest[..=i - first];
            for j in first..i {
                let other = &before[self.diagonal[j] - (j - self.first[j])..=self.diagonal[j]];
                let start = first.max(self.first[j]);
                let [known, theirs] = [&row[start - first..j - first], &other[start - self.first[j]..]];
                let mut tile = row[j - first];
                for (own, their) in known.iter().zip(theirs) {
                    tile = less_product(cpu, &tile, own, &transposed(their));
                }
                row[j - first] = divided_by_transposed(&tile, &theirs[known.len()]);
            }
            let (known, own) = row.split_at_mut(i - first);
            for tile in known {
                own[0] = less_product(cpu, &own[0], tile, &transposed(tile));
            }
            match factor_of(&own[0]) {
                Some(factor) => own[0] = factor,
                None => return false,
            }
        }
        true
    }

    /// Half the logarithm of the determinant of L·Lᵀ, this being L.
    pub fn half_log_determinant(&self) -> f64 {
        let tiles = self.diagonal.iter().map(|place| &self.tiles[*place]);
        tiles.flat_map(|tile| (0..SIDE).map(|k| tile[k][k].ln())).sum()
    }

    /// Solves L·Lᵀ·x = b in place, this being L.
    pub fn solve(&self, cpu: CpuLevel, b: &mut [f64]) {
        with_cpu!(cpu, cpu => cpu.vectorize(#[inline(always)] || self.substitute(cpu, b)));
    }

    #[inline(always)]
    fn substitute<C: DoubleCpu>(&self, cpu: C, b: &mut [f64]) {
        let mut x = vec![[0.0; SIDE]; self.first.len()];
        x.as_flattened_mut().iter_mut().zip(&*b).for_each(|(x, b)| *x = *b);
        for i in 0..self.first.len() {
            let (known, rest) = x.split_at_mut(i);
            let (tiles, diagonal) = self.row(i).split_at(i - self.first[i]);
            for (tile, known) in tiles.iter().zip(&known[self.first[i]..]) {
                rest[0] = less_column(cpu, &rest[0], tile, known);
            }
            for k in 0..SIDE {
                rest[0][k] /= diagonal[0][k][k];
                let solved = rest[0][k];
                (k + 1..SIDE).for_each(|r| rest[0][r] -= diagonal[0][k][r] * solved);
            }
        }
        for i in (0..self.first.len()).rev() {
            let (before, rest) = x.split_at_mut(i);
            let (tiles, diagonal) = self.row(i).split_at(i - self.first[i]);
            for k in (0..SIDE).rev() {
                let sum: f64 = (k + 1..SIDE).map(|r| diagonal[0][k][r] * rest[0][r]).sum();
                rest[0][k] = (rest[0][k] - sum) / diagonal[0][k][k];
            }
            for (tile, before) in tiles.iter().zip(&mut before[self.first[i]..]) {
                *before = less_column(cpu, before, &transposed(tile), &rest[0]);
            }
        }
        b.iter_mut().zip(x.as_flattened()).for_each(|(b, x)| *b = *x);
    }

    /// The last row of tiles with each column of tiles in its band.
    fn last(&self) -> Vec<usize> {
        let mut last = vec![0; self.first.len()];
        self.first.iter().enumerate().for_each(|(i, first)| last[*first] = i);
        let mut most = 0;
        last.iter_mut().for_each(|last| {
            most = most.max(*last);
            *last = most;
        });
        last
    }

    /// The entries of Z = (L·Lᵀ)⁻¹ inside the band, this being L: Takahashi's recursion, by tiles.
    ///
    /// From Z·L = L⁻ᵀ, with S_ij = Σ_{k > j} Z_ik·L_kj: Z_ij = −S_ij·L_jj⁻¹ for i > j, and Z_jj = (L_jj⁻ᵀ −
    /// S_jj)·L_jj⁻¹. Rows i with L_ij outside the band are skipped. Only the lower half of the symmetric known
    /// part is stored, and each tile is used both as row and as column, so that it is read in order.
    pub fn inverse_band(&self, cpu: CpuLevel, out: &mut Banded) {
        with_cpu!(cpu, cpu => cpu.vectorize(#[inline(always)] || self.fill_inverse_band(cpu, out)));
    }

    #[inline(always)]
    fn fill_inverse_band<C: DoubleCpu>(&self, cpu: C, out: &mut Banded) {
        out.begin.clone_from(&self.begin);
        out.first.clone_from(&self.first);
        out.diagonal.clone_from(&self.diagonal);
        // All are set below.
        out.tiles.resize(self.tiles.len(), ZERO);
        let mut column: Vec<Entry> = Vec::new();
        for (j, last) in self.last().into_iter().enumerate().rev() {
            let below = (j + 1..last + 1).filter(|i| self.first[*i] <= j);
            column.clear();
            column.extend(below.map(|row| {
                let tile = self.tiles[self.diagonal[row] - (row - j)];
                Entry { row, tile, transposed: transposed(&tile), sum: ZERO, transposed_sum: ZERO }
            }));
            for k in 0..column.len() {
                let (before, rest) = column.split_at_mut(k);
                let own = &mut rest[0];
                let mut sum = own.sum;
                let diagonal = out.diagonal[own.row];
                for other in before {
                    let known = &out.tiles[diagonal - (own.row - other.row)];
                    sum = plus_product(cpu, &sum, known, &other.tile);
                    other.transposed_sum = plus_product(cpu, &other.transposed_sum, &own.transposed, known);
                }
                own.sum = plus_product(cpu, &sum, &out.tiles[diagonal], &own.tile);
            }
            let diagonal = &self.tiles[self.diagonal[j]];
            let inverse = inverse_of(diagonal);
            let mut rest = inverse;
            for Entry { row, transposed: own, sum, transposed_sum, .. } in &column {
                let mut sum = *sum;
                add(&mut sum, &transposed(transposed_sum));
                let found = less_product(cpu, &ZERO, &sum, &inverse);
                // S_jj = Σ Z_kjᵀ·L_kj; its transpose is subtracted, as the result is symmetric.
                rest = less_product(cpu, &rest, own, &found);
                out.tiles[out.diagonal[*row] - (row - j)] = found;
            }
            let mut found = plus_product(cpu, &ZERO, &transposed(&rest), &inverse);
            // Rounding errors that are not symmetric would grow from tile to tile.
            for (c, r) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
                found[r][c] = found[c][r];
            }
            out.tiles[out.diagonal[j]] = found;
        }
    }
}

/// A tile of a column of L, and the sums for the same tile of the inverse.
struct Entry {
    row: usize,
    tile: Tile,
    transposed: Tile,
    sum: Tile,
    /// What is to be added transposed.
    transposed_sum: Tile,
}

#[inline(always)]
fn transposed(tile: &Tile) -> Tile {
    std::array::from_fn(|c| std::array::from_fn(|r| tile[r][c]))
}

#[inline(always)]
fn add(to: &mut Tile, tile: &Tile) {
    to.as_flattened_mut().iter_mut().zip(tile.as_flattened()).for_each(|(sum, value)| *sum += value);
}

/// c + a·b.
#[inline(always)]
fn plus_product<C: DoubleCpu>(cpu: C, c: &Tile, a: &Tile, b: &Tile) -> Tile {
    let mut sum = *c;
    for (sum, b) in sum.iter_mut().zip(b) {
        let mut column = cpu.load_doubles(sum);
        for (a, factor) in a.iter().zip(b) {
            column = cpu.fused_doubles(cpu.load_doubles(a), cpu.splat_double(*factor), column);
        }
        *sum = cpu.store_doubles(column);
    }
    sum
}

/// c − a·b.
#[inline(always)]
fn less_product<C: DoubleCpu>(cpu: C, c: &Tile, a: &Tile, b: &Tile) -> Tile {
    let mut rest = *c;
    for (rest, b) in rest.iter_mut().zip(b) {
        *rest = less_column(cpu, rest, a, b);
    }
    rest
}

/// c − a·b, b and c being columns.
#[inline(always)]
fn less_column<C: DoubleCpu>(cpu: C, c: &[f64; SIDE], a: &Tile, b: &[f64; SIDE]) -> [f64; SIDE] {
    let mut rest = cpu.load_doubles(c);
    for (a, factor) in a.iter().zip(b) {
        rest = cpu.fused_less_doubles(cpu.load_doubles(a), cpu.splat_double(*factor), rest);
    }
    cpu.store_doubles(rest)
}

/// X with X·Lᵀ = a, L being lower triangular.
#[inline(always)]
fn divided_by_transposed(a: &Tile, factor: &Tile) -> Tile {
    let mut x = *a;
    for (c, own) in factor.iter().enumerate() {
        let (known, rest) = x.split_at_mut(c);
        for (known, by) in known.iter().zip(factor) {
            rest[0].iter_mut().zip(known).for_each(|(rest, value)| *rest -= value * by[c]);
        }
        rest[0].iter_mut().for_each(|value| *value /= own[c]);
    }
    x
}

/// The Cholesky factor of a tile, of which the lower half is used; `None` if it is not positive definite.
#[inline(always)]
fn factor_of(tile: &Tile) -> Option<Tile> {
    let mut factor = ZERO;
    for c in 0..SIDE {
        for r in c..SIDE {
            let sum = (0..c).fold(tile[c][r], |sum, k| sum - factor[k][r] * factor[k][c]);
            if r > c {
                factor[c][r] = sum / factor[c][c];
            } else if sum > 0.0 && sum.is_finite() {
                factor[c][c] = sum.sqrt();
            } else {
                return None;
            }
        }
    }
    Some(factor)
}

/// The inverse of a lower triangular tile.
#[inline(always)]
fn inverse_of(factor: &Tile) -> Tile {
    let mut inverse = ZERO;
    for (c, column) in inverse.iter_mut().enumerate() {
        for r in c..SIDE {
            let one = f64::from(u8::from(r == c));
            let sum = (c..r).fold(one, |sum, k| sum - factor[k][r] * column[k]);
            column[r] = sum / factor[r][r];
        }
    }
    inverse
}

#[cfg(test)]
#[path = "banded_tests.rs"]
mod tests;
