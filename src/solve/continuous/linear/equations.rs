// SPDX-License-Identifier: MIT OR Apache-2.0

//! The normal equations of a pair over the coefficients of the path.
//!
//! A displacement is the difference of the path at two *ends*, each a sum of four coefficients of each
//! generator. So a band's sums, 8 × 8 numbers for two ends, are spread over 32 × 32 entries by the weights of
//! the splines. The coefficients of a pair are sorted: the turns' knot by knot, then the others', so that the
//! four knots of either in the support of an instant are contiguous.

use super::banded::Banded;
use super::bands::{Band, Row, SIDES};
use super::shared::Shared;
use crate::cpu::{CpuLevel, for_each_cpu};
use crate::motion::generators::{GENERATORS, NON_TURNS, TURNS};
use crate::solve::continuous::trajectory::{BLOCK, Splines, ratio, spline};

/// Coefficients with an instant in their support: four knots of the turns, then four of the others.
const SUPPORT: usize = 4 * GENERATORS;
/// Those of the turns.
const TURNS_SUPPORT: usize = 4 * TURNS;
/// Two ends of a band, 0 being the start of the pair before, and the factors of the sums `own`, `across` and
/// `before` in their part of the matrix. Diagonal parts are halved, as the transpose is added.
const END_PAIRS: [([usize; 2], [f64; 3]); 6] = [
    ([2, 2], [0.5, 0.0, 0.0]),
    ([2, 1], [-1.0, 1.0, 0.0]),
    ([2, 0], [0.0, -1.0, 0.0]),
    ([1, 1], [0.5, -1.0, 0.5]),
    ([1, 0], [0.0, 1.0, -1.0]),
    ([0, 0], [0.0, 0.0, 0.5]),
];
/// Factors of the sums of the own pair and of the pair before in the right side of each end.
const SIDE_FACTORS: [[f64; 2]; 3] = [[0.0, -1.0], [-1.0, 1.0], [1.0, 0.0]];

/// The entries of the matrix for the coefficients of two ends, row by row.
type EndsMatrix = [[f64; SUPPORT]; SUPPORT];

/// An end of a band.
#[derive(Clone, Copy, Debug)]
struct End {
    /// Index of its first coefficient of the turns, and of the others, among those of the pair.
    places: [usize; 2],
    /// Weights of the turns' knots and of the others'.
    turns: [f64; 4],
    others: [f64; 4],
}

impl End {
    /// A number for each generator, times the weights of its coefficients.
    #[inline(always)]
    fn spread(&self, values: &Row) -> [f64; SUPPORT] {
        let mut all = [0.0; SUPPORT];
        let (turns, others) = all.split_at_mut(TURNS_SUPPORT);
        for (cells, weight) in turns.as_chunks_mut::<TURNS>().0.iter_mut().zip(self.turns) {
            for (cell, value) in cells.iter_mut().zip(&values[..TURNS]) {
                *cell = weight * value;
            }
        }
        for (cells, weight) in others.as_chunks_mut::<NON_TURNS>().0.iter_mut().zip(self.others) {
            for (cell, value) in cells.iter_mut().zip(&values[TURNS..]) {
                *cell = weight * value;
            }
        }
        all
    }

    /// Adds to a row over the coefficients of the pair.
    #[inline(always)]
    fn add(&self, to: &mut [f64], values: &[f64; SUPPORT]) {
        let (turns, others) = values.split_at(TURNS_SUPPORT);
        for (place, values) in self.places.into_iter().zip([turns, others]) {
            for (sum, value) in to[place..].iter_mut().zip(values) {
                *sum += value;
            }
        }
    }
}

/// The normal equations of a pair.
#[derive(Clone, Debug, Default)]
pub struct Equations {
    /// Index in the path of each coefficient that the pair depends on: the turns', then the others'.
    pub places: Vec<usize>,
    /// Right side, and columns of the shared unknowns.
    pub sides: [Vec<f64>; SIDES],
    /// The symmetric matrix, row by row.
    matrix: Vec<f64>,
    /// The first knot of the turns, the first of the others.
    first: [i64; 2],
    /// Number of coefficients of the turns.
    turns: usize,
    ends: Vec<[Option<End>; 3]>,
}

/// Adds a band's sums, times their factors, to the matrix of two ends, or sets it to them for the `first` band.
#[inline(always)]
fn add_sums(
    part: &mut EndsMatrix,
    first: bool,
    band: &Band,
    [own, across, before]: [f64; 3],
    rows: &End,
    columns: &End,
) {
    for j in 0..GENERATORS {
        let mut sums = band.own[j];
        for (sum, (one, other)) in sums.iter_mut().zip(band.across[j].iter().zip(&band.before[j])) {
            *sum = own * *sum + across * one + before * other;
        }
        let wide = columns.spread(&sums);
        // The rows of the generator, one for each knot.
        let (place, step, weights) = if j < TURNS {
            (j, TURNS, rows.turns)
        } else {
            (TURNS_SUPPORT + j - TURNS, NON_TURNS, rows.others)
        };
        for (cells, weight) in part[place..].iter_mut().step_by(step).zip(weights) {
            if first {
                for (cell, value) in cells.iter_mut().zip(&wide) {
                    *cell = weight * value;
                }
            } else {
                for (cell, value) in cells.iter_mut().zip(&wide) {
                    *cell += weight * value;
                }
            }
        }
    }
}

/// Blocks of the path at which a band's ends are exposed, clamped to those that it covers.
fn end_blocks<'a>(band: &'a Band, path: &Splines) -> impl Iterator<Item = (usize, f64)> + 'a {
    let count = (path.coefficients.len() / BLOCK) as i64;
    let (low, high) = (path.base as f64, (path.base + count - 3) as f64);
    let weights = [band.linked, band.weight, band.weight];
    let weights = weights.map(|weight| if count < 4 { 0.0 } else { weight });
    let ends = weights.into_iter().zip(band.blocks).enumerate().filter(|(_, (weight, _))| *weight > 0.0);
    ends.map(move |(end, (weight, sum))| (end, (sum / weight).min(high.next_down()).max(low)))
}

impl Equations {
    /// Sets all to zero, for the coefficients that these bands depend on.
    fn reset(&mut self, bands: &[Band], path: &Splines) {
        let blocks = bands.iter().flat_map(|band| end_blocks(band, path)).map(|(_, block)| block);
        let [low, high] =
            blocks.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], t| [low.min(t), high.max(t)]);
        self.places.clear();
        for (kind, generators) in [0..TURNS, TURNS..GENERATORS].into_iter().enumerate() {
            let [first, last] =
                [low, high].map(|block| spline::values(block * ratio(generators.start) as f64).first);
            self.first[kind] = first;
            self.turns = if kind == 0 { 0 } else { self.places.len() };
            let knots = first..last.saturating_add(4);
            let places = knots.flat_map(|knot| generators.clone().map(move |j| path.place(j, knot)));
            self.places.extend(places.filter_map(|place| usize::try_from(place).ok()));
        }
        let size = self.places.len();
        self.matrix.clear();
        self.matrix.resize(size * size, 0.0);
        for side in &mut self.sides {
            side.clear();
            side.resize(size, 0.0);
        }
    }

    /// Makes these the equations of bands.
    #[inline(always)]
    pub fn fill(&mut self, bands: &[Band], path: &Splines) {
        self.reset(bands, path);
        let mut ends = std::mem::take(&mut self.ends);
        ends.clear();
        ends.extend(bands.iter().map(|band| {
            let mut ends = [None; 3];
            end_blocks(band, path).for_each(|(end, block)| ends[end] = Some(self.end(block)));
            ends
        }));
        for (band, ends) in bands.iter().zip(&ends) {
            self.add_sides(band, ends);
        }
        let mut part = [[0.0; SUPPORT]; SUPPORT];
        for (pair, factors) in END_PAIRS {
            self.add_matrices(bands, &ends, pair, factors, &mut part);
        }
        self.ends = ends;
        self.add_transposed();
    }

    /// Adds the transpose to the matrix.
    #[inline(always)]
    fn add_transposed(&mut self) {
        let size = self.places.len();
        for i in 0..size {
            let (above, own) = self.matrix.split_at_mut(i * size);
            let own = &mut own[..size];
            for (value, row) in own.iter_mut().zip(above.chunks_exact_mut(size)) {
                *value += row[i];
                row[i] = *value;
            }
            own[i] *= 2.0;
        }
    }

    fn end(&self, block: f64) -> End {
        let [turns, others] = [0, TURNS].map(|generator| spline::values(block * ratio(generator) as f64));
        let knot =
            |first: i64, support: &spline::Support| usize::try_from(support.first - first).unwrap_or(0);
        End {
            places: [
                knot(self.first[0], &turns) * TURNS,
                self.turns + knot(self.first[1], &others) * NON_TURNS,
            ],
            turns: turns.weights,
            others: others.weights,
        }
    }

    /// Adds the right sides of a band.
    #[inline(always)]
    fn add_sides(&mut self, band: &Band, ends: &[Option<End>; 3]) {
        for (end, factors) in
            ends.iter().zip(SIDE_FACTORS).filter_map(|(end, factors)| Some((end.as_ref()?, factors)))
        {
            for (index, side) in self.sides.iter_mut().enumerate() {
                let [own, before]: [&Row; 2] = [0, 1].map(|pair| &band.sides[pair][index]);
                let sums: Row = std::array::from_fn(|j| factors[0] * own[j] + factors[1] * before[j]);
                end.add(side, &end.spread(&sums));
            }
        }
    }

    /// Adds the matrices of two ends of all bands. Successive bands with the same support are summed before.
    #[inline(always)]
    fn add_matrices(
        &mut self,
        bands: &[Band],
        ends: &[[Option<End>; 3]],
        [row, column]: [usize; 2],
        factors: [f64; 3],
        part: &mut EndsMatrix,
    ) {
        let mut last: Option<[&End; 2]> = None;
        for (band, ends) in bands.iter().zip(ends) {
            let (Some(rows), Some(columns)) = (&ends[row], &ends[column]) else { continue };
            let is_other = |last: &[&End; 2]| last.map(|end| end.places) != [rows.places, columns.places];
            if let Some(last) = last.take_if(|last| is_other(last)) {
                self.add_matrix(part, last);
            }
            add_sums(part, last.is_none(), band, factors, rows, columns);
            last = Some([rows, columns]);
        }
        last.into_iter().for_each(|last| self.add_matrix(part, last));
    }

    #[inline(always)]
    fn add_matrix(&mut self, part: &EndsMatrix, [rows, columns]: [&End; 2]) {
        let size = self.places.len();
        let (turns, others) = part.split_at(TURNS_SUPPORT);
        for (place, part) in rows.places.into_iter().zip([turns, others]) {
            let cells = self.matrix[place * size..].chunks_exact_mut(size);
            for (cells, values) in cells.zip(part) {
                columns.add(cells, values);
            }
        }
    }

    /// Adapts the indices to a path that begins so many blocks later; whether it has all the coefficients.
    pub fn shift(&mut self, blocks: i64, path: &Splines) -> bool {
        let by = blocks.saturating_mul(BLOCK as i64);
        let moved = |place: &usize| usize::try_from(*place as i64 - by).unwrap_or(usize::MAX);
        self.places.iter_mut().for_each(|place| *place = moved(place));
        self.places.iter().all(|place| *place < path.coefficients.len())
    }

    /// An entry of the symmetric matrix.
    #[cfg(test)]
    pub fn entry(&self, i: usize, j: usize) -> f64 {
        self.matrix[i * self.places.len() + j]
    }

    /// Extends the rows of a band, given by their first columns, to hold these equations.
    pub fn reach(&self, first: &mut [usize]) {
        let least = self.places.iter().copied().min().unwrap_or(0);
        self.places.iter().for_each(|place| first[*place] = first[*place].min(least));
    }

    /// Adds these equations, with another right side, to those of the path.
    pub fn add_to(
        &self,
        own_right: &[f64],
        matrix: &mut Banded,
        right: &mut [f64],
        border: &mut Shared<Vec<f64>>,
    ) {
        let mut border = border.as_mut().into_array();
        let rows = self.matrix.chunks_exact(self.places.len().max(1));
        for (i, ((row, own), values)) in self.places.iter().zip(own_right).zip(rows).enumerate() {
            matrix.add_row(*row, &self.places[..=i], values);
            right[*row] += own;
            border.iter_mut().zip(&self.sides[1..]).for_each(|(border, side)| border[*row] += side[i]);
        }
    }

    /// N·δ for a change of the pair's coefficients.
    pub fn product(&self, cpu: CpuLevel, change: &[f64], out: &mut Vec<f64>) {
        out.clear();
        out.resize(change.len(), 0.0);
        product(cpu, &self.matrix, change, out);
    }
}

for_each_cpu! {
    fn product(matrix: &[f64], by: &[f64], out: &mut [f64]) {
        let size = by.len().max(1);
        // The matrix is symmetric: sums of four of its rows at a time are those of columns, and fill vectors.
        let (fours, rest) = by.as_chunks::<4>();
        for (rows, [a, b, c, d]) in matrix.chunks_exact(4 * size).zip(fours) {
            let [first, second, third, fourth] = [0, 1, 2, 3].map(|row| &rows[row * size..][..size]);
            let rows = first.iter().zip(second).zip(third.iter().zip(fourth));
            for (sum, ((first, second), (third, fourth))) in out.iter_mut().zip(rows) {
                *sum += (a * first + b * second) + (c * third + d * fourth);
            }
        }
        for (row, factor) in matrix.chunks_exact(size).skip(4 * fours.len()).zip(rest) {
            out.iter_mut().zip(row).for_each(|(sum, value)| *sum += factor * value);
        }
    }
}
