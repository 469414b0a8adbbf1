//! The normal equations of a pair over the coefficients of the path.
//!
//! Each leg of a band is the difference of the path at two *ends*, and the path at an end is a sum of four coefficients
//! of each generator. So a band's sums, 8 × 8 numbers for two ends, go to 32 × 32 cells, each times two splines'
//! weights. The coefficients are sorted into turns and others, knot by knot, for four knots of either to lie side by
//! side: 12 and 20 cells of a row in one go.

use super::banded::Banded;
use super::path::{BLOCK, SplinePath, ratio};
use super::spline;
use super::sums::{Band, Row, SHARED, SIDES};
use crate::motion::generators::{GENERATORS, TURNS};

/// The other generators.
const OTHERS: usize = GENERATORS - TURNS;
/// Two ends of a band, 0 the first end of the leg before, and by what the sums of the own leg, those across, and those of the
/// leg before count for them. Half of what an end has with itself, as the transposed is added in the end.
const ENDS: [([usize; 2], [f64; 3]); 6] = [
    ([2, 2], [0.5, 0.0, 0.0]),
    ([2, 1], [-1.0, 1.0, 0.0]),
    ([2, 0], [0.0, -1.0, 0.0]),
    ([1, 1], [0.5, -1.0, 0.5]),
    ([1, 0], [0.0, 1.0, -1.0]),
    ([0, 0], [0.0, 0.0, 0.5]),
];
/// How either leg counts for the right side of an end.
const LEGS: [[f64; 2]; 3] = [[0.0, -1.0], [-1.0, 1.0], [1.0, 0.0]];

/// The four knots of the turns, or of the others, that have a say at an end.
#[derive(Clone, Copy, Default)]
struct Knots {
    /// Of the first coefficient, among those of the pair.
    index: usize,
    weights: [f64; 4],
}

/// The coefficients that have a say at an end.
#[derive(Clone, Copy, Default)]
struct End {
    turns: Knots,
    others: Knots,
}

impl End {
    /// Rows of a generator's coefficients and their weights.
    fn rows(&self, generator: usize) -> [(usize, f64); 4] {
        let (knots, step, first) = if generator < TURNS {
            (self.turns, TURNS, generator)
        } else {
            (self.others, OTHERS, generator - TURNS)
        };
        std::array::from_fn(|k| (knots.index + k * step + first, knots.weights[k]))
    }
}

/// The normal equations of a pair.
#[derive(Clone, Debug, Default)]
pub(super) struct Equations {
    /// Place of each coefficient that the pair depends on among those of the path.
    pub places: Vec<usize>,
    /// Right side, and columns of the shared unknowns.
    pub sides: [Vec<f64>; SIDES],
    /// Rows of a matrix that is the one of the equations when its transposed is added.
    half: Vec<f64>,
    /// The first knot of the turns, the first of the others.
    first: [i64; 2],
    /// Coefficients of turns.
    turns: usize,
}

/// Adds `factor` times each value.
fn add<const N: usize>(cells: &mut [f64], values: &[f64; N], factor: f64) {
    if let Some(cells) = cells.first_chunk_mut::<N>() {
        cells.iter_mut().zip(values).for_each(|(cell, value)| *cell += factor * value);
    }
}

/// Blocks at which a band's ends are exposed, within what the path covers.
fn times<'a>(band: &'a Band, path: &SplinePath) -> impl Iterator<Item = (usize, f64)> + 'a {
    let blocks = (path.coefficients.len() / BLOCK) as i64;
    let (low, high) = (path.base as f64, (path.base + blocks - 3) as f64);
    let weights = [band.linked, band.weight, band.weight];
    let weights = weights.map(|weight| if blocks < 4 { 0.0 } else { weight });
    let ends = weights.into_iter().zip(band.times).enumerate().filter(|(_, (weight, _))| *weight > 0.0);
    ends.map(move |(end, (weight, sum))| (end, (sum / weight).min(high.next_down()).max(low)))
}

impl Equations {
    /// Makes these the equations of a path that nothing is known of.
    fn reset(&mut self, bands: &[Band], path: &SplinePath) {
        let times = bands.iter().flat_map(|band| times(band, path)).map(|(_, time)| time);
        let [low, high] =
            times.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], t| [low.min(t), high.max(t)]);
        self.places.clear();
        for (kind, generators) in [0..TURNS, TURNS..GENERATORS].into_iter().enumerate() {
            let [first, last] = [low, high].map(|time| spline::values(time * ratio(generators.start) as f64).first);
            self.first[kind] = first;
            self.turns = if kind == 0 { 0 } else { self.places.len() };
            let knots = first..last.saturating_add(4);
            let places = knots.flat_map(|knot| generators.clone().map(move |j| path.place(j, knot)));
            self.places.extend(places.filter_map(|place| usize::try_from(place).ok()));
        }
        let size = self.places.len();
        for (values, len) in self.sides.iter_mut().map(|side| (side, size)).chain([(&mut self.half, size * size)]) {
            values.clear();
            values.resize(len, 0.0);
        }
    }

    /// Makes these the equations of bands.
    pub fn fill(&mut self, bands: &[Band], path: &SplinePath) {
        self.reset(bands, path);
        bands.iter().for_each(|band| self.spread(band, path));
    }

    fn end(&self, time: f64) -> End {
        let [turns, others] = [(0, TURNS, 0), (TURNS, OTHERS, self.turns)].map(|(generator, step, start)| {
            let support = spline::values(time * ratio(generator) as f64);
            let knot = support.first - self.first[usize::from(generator > 0)];
            Knots { index: start + usize::try_from(knot).unwrap_or(0) * step, weights: support.weights }
        });
        End { turns, others }
    }

    /// Spreads a band's sums over the coefficients.
    fn spread(&mut self, band: &Band, path: &SplinePath) {
        let size = self.places.len();
        let mut ends = [None; 3];
        times(band, path).for_each(|(end, time)| ends[end] = Some(self.end(time)));
        for ([row, column], factors) in ENDS {
            let (Some(row), Some(column)) = (ends[row], ends[column]) else { continue };
            for j in 0..GENERATORS {
                let [own, across, before] = factors;
                let sums: Row = std::array::from_fn(|k| {
                    own * band.own[j][k] + across * band.across[j][k] + before * band.before[j][k]
                });
                let turns: [f64; 4 * TURNS] =
                    std::array::from_fn(|k| column.turns.weights[k / TURNS] * sums[k % TURNS]);
                let others: [f64; 4 * OTHERS] =
                    std::array::from_fn(|k| column.others.weights[k / OTHERS] * sums[TURNS + k % OTHERS]);
                for (row, weight) in row.rows(j) {
                    let cells = &mut self.half[row * size..(row + 1) * size];
                    add(&mut cells[column.turns.index..], &turns, weight);
                    add(&mut cells[column.others.index..], &others, weight);
                }
            }
        }
        for (end, [own, before]) in ends.iter().zip(LEGS) {
            let Some(end) = end else { continue };
            for (side, sums) in self.sides.iter_mut().zip(0..) {
                let sums: [&Row; 2] = [0, 1].map(|leg| &band.sides[leg][sums]);
                for j in 0..GENERATORS {
                    let sum = own * sums[0][j] + before * sums[1][j];
                    end.rows(j).into_iter().for_each(|(row, weight)| side[row] += weight * sum);
                }
            }
        }
    }

    /// An entry of the symmetric matrix.
    pub fn entry(&self, i: usize, j: usize) -> f64 {
        let size = self.places.len();
        self.half[i * size + j] + self.half[j * size + i]
    }

    /// Moves the columns at which the rows of a matrix begin back to where these equations need them.
    pub fn reach(&self, first: &mut [usize]) {
        let least = self.places.iter().copied().min().unwrap_or(0);
        self.places.iter().for_each(|place| first[*place] = first[*place].min(least));
    }

    /// Adds them to those of the path.
    pub fn add_to(&self, matrix: &mut Banded, right: &mut [f64], border: &mut [Vec<f64>; SHARED]) {
        for (i, row) in self.places.iter().enumerate() {
            for (j, column) in self.places[..=i].iter().enumerate() {
                matrix.add(*row, *column, self.entry(i, j));
            }
            right[*row] += self.sides[0][i];
            border.iter_mut().zip(&self.sides[1..]).for_each(|(border, side)| border[*row] += side[i]);
        }
    }

    /// The square of a step of all coefficients of the path, weighed by the matrix.
    pub fn square(&self, step: &[f64]) -> f64 {
        let step: Vec<f64> = self.places.iter().map(|place| step[*place]).collect();
        let rows = self.half.chunks_exact(step.len().max(1)).zip(&step);
        let half: f64 =
            rows.map(|(row, own)| own * row.iter().zip(&step).map(|(a, b)| a * b).sum::<f64>()).sum();
        2.0 * half
    }
}
