// SPDX-License-Identifier: MIT OR Apache-2.0

//! The normal equations of a pair over the coefficients of the path.
//!
//! A displacement is the difference of the path at two *ends*, each a sum of four coefficients of each
//! generator. So a band's sums, 8 × 8 numbers for two ends, are spread over 32 × 32 entries by the weights of
//! the splines. The coefficients of a pair are sorted by generator and knot, so that the four knots of a generator in
//! the support of an instant are contiguous and fill a vector: two generators share 4 × 4 entries, to which a band adds a
//! number times the products of the weights of both ends.

use super::banded::Banded;
use super::bands::{Band, Row, SIDES, Square};
use super::shared::Shared;
use crate::cpu::CpuLevel;
use crate::lanes::dispatch::with_cpu;
use crate::lanes::{Cpu, DOUBLES, DoubleCpu};
use crate::motion::generators::{GENERATORS, TURNS};
use crate::solve::continuous::trajectory::spline::{self, KNOTS};
use crate::solve::continuous::trajectory::{BLOCK, Splines, ratio};

/// Kinds of generators by their knots: the turns, and the others.
const KINDS: usize = 2;
/// Factors of the path at each end of a band in the displacement over the own pair, and in that over the pair before: the ends are the
/// start of the pair before, its end, which is the start of the own one, and the end of the own one.
const END_FACTORS: [[f64; 2]; 3] = [[0.0, -1.0], [-1.0, 1.0], [1.0, 0.0]];

/// A number for each knot of a generator in the support of an end: a vector.
type Knots = [f64; KNOTS];

const fn kind(generator: usize) -> usize {
    if generator < TURNS { 0 } else { 1 }
}

/// An end of a band, for the generators of either kind.
#[derive(Clone, Copy, Debug)]
struct End {
    /// First knot of its support among those of the pair.
    knots: [usize; KINDS],
    weights: [Knots; KINDS],
}

/// What a band adds to the matrix of two ends.
#[derive(Clone, Debug, Default)]
struct Term {
    sums: Square,
    /// Products of the weights of both ends, by the kinds of the generators of row and column.
    products: [[[Knots; KNOTS]; KINDS]; KINDS],
}

impl Term {
    /// Sets this to the sums of a band times their factors.
    #[inline(always)]
    fn set<C: DoubleCpu>(
        &mut self,
        cpu: C,
        band: &Band,
        [own, across, before]: [f64; 3],
        [rows, columns]: [&End; 2],
    ) {
        let factors = [own, across, before].map(
            #[inline(always)]
            |factor| cpu.splat_double(factor),
        );
        let sums = self.sums.as_flattened_mut().as_chunks_mut::<DOUBLES>().0.iter_mut();
        let [own, across, before] = [&band.own, &band.across, &band.before]
            .map(|square| square.as_flattened().as_chunks::<DOUBLES>().0);
        for (sum, (own, (across, before))) in sums.zip(own.iter().zip(across.iter().zip(before))) {
            let mut all = factors[0] * cpu.load_doubles(own);
            if band.linked > 0.0 {
                all = cpu.fused_doubles(factors[1], cpu.load_doubles(across), all);
                all = cpu.fused_doubles(factors[2], cpu.load_doubles(before), all);
            }
            *sum = cpu.store_doubles(all);
        }
        for (products, rows) in self.products.iter_mut().zip(&rows.weights) {
            for (products, columns) in products.iter_mut().zip(&columns.weights) {
                let columns = cpu.load_doubles(columns);
                for (products, row) in products.iter_mut().zip(rows) {
                    *products = cpu.store_doubles(cpu.splat_double(*row) * columns);
                }
            }
        }
    }
}

/// The entries of two generators: rows are knots of one of them, columns of the other.
#[inline(always)]
fn entries<C: DoubleCpu>(cpu: C, terms: &[Term], row: usize, column: usize) -> [C::Doubles; KNOTS] {
    let mut sums = [cpu.splat_double(0.0); KNOTS];
    for Term { sums: of, products } in terms {
        let factor = cpu.splat_double(of[row][column]);
        for (sum, products) in sums.iter_mut().zip(&products[kind(row)][kind(column)]) {
            *sum = cpu.fused_doubles(factor, cpu.load_doubles(products), *sum);
        }
    }
    sums
}

/// The normal equations of a pair.
#[derive(Clone, Debug, Default)]
pub struct Equations {
    /// Index in the path of each coefficient that the pair depends on, by generator and knot.
    pub places: Vec<usize>,
    /// Right side, and columns of the shared unknowns.
    pub sides: [Vec<f64>; SIDES],
    /// The symmetric matrix, row by row.
    matrix: Vec<f64>,
    /// First knot, and number of knots.
    first: [i64; KINDS],
    count: [usize; KINDS],
}

/// Memory with which bands are spread, used again for the next pair.
#[derive(Debug, Default)]
pub struct Spreading {
    ends: Vec<[Option<End>; 3]>,
    terms: Vec<Term>,
}

/// Blocks of the path at which a band's ends are exposed, clamped to those that it covers.
fn end_blocks<'a>(band: &'a Band, path: &Splines) -> impl Iterator<Item = (usize, f64)> + 'a {
    let count = path.coefficients.len() / BLOCK;
    let low = path.base as f64;
    let high = low + count as f64 - (KNOTS - 1) as f64;
    let weights = [band.linked, band.weight, band.weight];
    let weights = weights.map(|weight| if count < KNOTS { 0.0 } else { weight });
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
            let knots = first..last.saturating_add(KNOTS as i64);
            let before = self.places.len();
            let places = generators.clone().flat_map(|j| knots.clone().map(move |knot| path.place(j, knot)));
            self.places.extend(places.filter_map(|place| usize::try_from(place).ok()));
            self.first[kind] = first;
            self.count[kind] = (self.places.len() - before) / generators.len();
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
    pub fn fill<C: DoubleCpu>(
        &mut self,
        cpu: C,
        bands: &[Band],
        path: &Splines,
        Spreading { ends, terms }: &mut Spreading,
    ) {
        self.reset(bands, path);
        ends.clear();
        ends.extend(bands.iter().map(|band| {
            let mut ends = [None; 3];
            end_blocks(band, path).for_each(|(end, block)| ends[end] = Some(self.end(block)));
            ends
        }));
        terms.resize_with(bands.len(), Term::default);
        for (band, ends) in bands.iter().zip(&*ends) {
            self.add_sides(cpu, band, ends);
        }
        for row in (0..END_FACTORS.len()).rev() {
            for column in (0..=row).rev() {
                let ([own, before], [own_too, before_too]) = (END_FACTORS[row], END_FACTORS[column]);
                // Symmetric parts are halved, as the transpose is added. No later end is one of the pair before with an earlier one
                // of the own pair.
                let half = if row == column { 0.5 } else { 1.0 };
                let factors = [half * own * own_too, own * before_too, half * before * before_too];
                self.add_matrices(cpu, bands, ends, [row, column], factors, terms);
            }
        }
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
        let supports = [0, TURNS].map(|generator| spline::values(block * ratio(generator) as f64));
        let knot = |kind: usize| usize::try_from(supports[kind].first - self.first[kind]).unwrap_or(0);
        End { knots: [0, 1].map(knot), weights: supports.map(|support| support.weights) }
    }

    /// Index of a generator's first coefficient at an end.
    #[inline(always)]
    fn index(&self, generator: usize, end: &End) -> usize {
        let [turns, others] = self.count;
        let before = generator.min(TURNS) * turns + generator.saturating_sub(TURNS) * others;
        before + end.knots[kind(generator)]
    }

    /// Adds the right sides of a band.
    #[inline(always)]
    fn add_sides<C: DoubleCpu>(&mut self, cpu: C, band: &Band, ends: &[Option<End>; 3]) {
        let [own, before] = &band.sides;
        for (end, factors) in ends.iter().zip(END_FACTORS) {
            let Some(end) = end else { continue };
            for index in 0..SIDES {
                let mut sums: Row = own[index].map(|value| factors[0] * value);
                if band.linked > 0.0 {
                    let before = sums.iter_mut().zip(&before[index]);
                    before.for_each(|(sum, value)| *sum += factors[1] * value);
                }
                for (j, value) in sums.into_iter().enumerate() {
                    let first = self.index(j, end);
                    let cells = self.sides[index].get_mut(first..).and_then(<[f64]>::first_chunk_mut);
                    if let Some(cells) = cells {
                        let weights = cpu.load_doubles(&end.weights[kind(j)]);
                        cpu.add_product(cpu.splat_double(value), weights, cells);
                    }
                }
            }
        }
    }

    /// Adds the matrices of two ends of all bands. Successive bands with the same support are summed before.
    #[inline(always)]
    fn add_matrices<C: DoubleCpu>(
        &mut self,
        cpu: C,
        bands: &[Band],
        ends: &[[Option<End>; 3]],
        pair: [usize; 2],
        factors: [f64; 3],
        terms: &mut [Term],
    ) {
        let is_symmetric = pair[0] == pair[1] && factors[1] == 0.0;
        let (mut last, mut count): (Option<[&End; 2]>, usize) = (None, 0);
        for (band, ends) in bands.iter().zip(ends) {
            let [Some(rows), Some(columns)] = pair.map(|end| ends[end].as_ref()) else { continue };
            let is_other = |last: &[&End; 2]| last.map(|end| end.knots) != [rows.knots, columns.knots];
            if let Some(last) = last.take_if(|last| is_other(last)) {
                self.add_terms(cpu, &terms[..count], last, is_symmetric);
                count = 0;
            }
            terms[count].set(cpu, band, factors, [rows, columns]);
            count += 1;
            last = Some([rows, columns]);
        }
        last.into_iter().for_each(|last| self.add_terms(cpu, &terms[..count], last, is_symmetric));
    }

    /// Adds terms of the same support. Of those with symmetric sums, what is below the diagonal is counted above it.
    #[inline(always)]
    fn add_terms<C: DoubleCpu>(
        &mut self,
        cpu: C,
        terms: &[Term],
        [rows, columns]: [&End; 2],
        is_symmetric: bool,
    ) {
        let size = self.places.len();
        let starts: [usize; GENERATORS] = std::array::from_fn(|column| self.index(column, columns));
        for row in 0..GENERATORS {
            let first = self.index(row, rows) * size;
            for (column, start) in starts.iter().enumerate().skip(if is_symmetric { row } else { 0 }) {
                let factor = cpu.splat_double(if is_symmetric && column > row { 2.0 } else { 1.0 });
                let start = first + start;
                let entries = entries(cpu, terms, row, column);
                // All rows at once, so that one check of the bounds is enough.
                let Some(cells) = self.matrix.get_mut(start..start + (KNOTS - 1) * size + KNOTS) else {
                    continue;
                };
                for (knot, entries) in entries.into_iter().enumerate() {
                    if let Some(cells) = cells[knot * size..].first_chunk_mut() {
                        cpu.add_product(factor, entries, cells);
                    }
                }
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
        with_cpu!(cpu, cpu => cpu.vectorize(#[inline(always)] || product(cpu, &self.matrix, change, out)));
    }
}

/// Adds the product of a symmetric matrix, row by row.
#[inline(always)]
fn product<C: DoubleCpu>(cpu: C, matrix: &[f64], by: &[f64], out: &mut [f64]) {
    // The matrix is symmetric: sums of its rows are those of columns, and fill vectors.
    let (sums, last) = out.as_chunks_mut::<DOUBLES>();
    for (row, factor) in matrix.chunks_exact(by.len().max(1)).zip(by) {
        let (row, rest) = row.as_chunks::<DOUBLES>();
        let vector = cpu.splat_double(*factor);
        sums.iter_mut().zip(row).for_each(
            #[inline(always)]
            |(sum, values)| cpu.add_product(vector, cpu.load_doubles(values), sum),
        );
        last.iter_mut().zip(rest).for_each(|(sum, value)| *sum += factor * value);
    }
}
