// SPDX-License-Identifier: MIT OR Apache-2.0

//! The paths of the generators over a window as uniform cubic B-splines.
//!
//! Time is in *blocks* (see [`KnotDensity`](super::KnotDensity)). The turns have four knots to a block, the
//! other generators one: a rotation has little inertia and changes faster than a translation.

use super::spline::{self, KNOTS, Support};
use crate::motion::generators::{GENERATORS, TURNS};

/// Knots of a turn to a block.
const RATIO: i64 = 4;
/// Coefficients to a block.
pub const BLOCK: usize = RATIO as usize * TURNS + (GENERATORS - TURNS);

/// Paths of the generators over successive blocks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Splines {
    /// Number of the first block.
    pub base: i64,
    /// Coefficients in pixels, block by block: the turns' knot by knot, then one of each other generator.
    pub coefficients: Vec<f64>,
    /// A copy of the posterior's κ at the last [`Trajectory::cover`](super::Trajectory::cover).
    pub kappa: f64,
}

/// Knots of a generator to a block.
pub const fn ratio(generator: usize) -> i64 {
    if generator < TURNS { RATIO } else { 1 }
}

/// Index within its block of a generator's coefficient, at this one of the block's knots.
const fn place_in_block(generator: usize, knot: usize) -> usize {
    generator + TURNS * if generator < TURNS { knot } else { RATIO as usize - 1 }
}

impl Splines {
    /// Paths that do not move, over the `blocks` blocks from `base` on.
    pub fn still(base: i64, blocks: usize, kappa: f64) -> Self {
        Self { base, coefficients: vec![0.0; blocks * BLOCK], kappa }
    }

    /// Index of a coefficient, negative or past the end outside the path.
    #[inline(always)]
    pub fn place(&self, generator: usize, knot: i64) -> i64 {
        let ratio = ratio(generator);
        let block = knot.div_euclid(ratio) - self.base;
        block * BLOCK as i64 + place_in_block(generator, knot.rem_euclid(ratio) as usize) as i64
    }

    /// Indices of a generator's coefficients, in the order of their knots.
    pub fn places(&self, generator: usize) -> Places {
        let blocks = self.coefficients.len() / BLOCK;
        Places { generator, count: blocks * ratio(generator) as usize }
    }

    /// The coefficient of a generator at a knot; 0 outside.
    fn coefficient(&self, generator: usize, knot: i64) -> f64 {
        let place = usize::try_from(self.place(generator, knot)).ok();
        place.and_then(|place| self.coefficients.get(place)).copied().unwrap_or(0.0)
    }

    /// Indices of the coefficients of all generators on which the path between two blocks depends.
    pub fn supporting(&self, [from, to]: [f64; 2]) -> impl Iterator<Item = usize> + Clone {
        (0..GENERATORS).flat_map(move |j| {
            let [first, last] = [from, to].map(|block| spline::values(block * ratio(j) as f64).first);
            let places = (first..last + KNOTS as i64).map(move |knot| self.place(j, knot));
            places
                .filter_map(|place| usize::try_from(place).ok())
                .filter(|place| *place < self.coefficients.len())
        })
    }

    /// Knots of a generator.
    pub fn knots(&self, generator: usize) -> std::ops::Range<i64> {
        let blocks = (self.coefficients.len() / BLOCK) as i64;
        self.base * ratio(generator)..(self.base + blocks) * ratio(generator)
    }

    /// Weighted sums of the coefficients of all generators.
    fn sums(&self, turns: Support, others: Support) -> [f64; GENERATORS] {
        let [a, b, c] = self.sums_of(0, turns);
        let [d, e, f, g, h] = self.sums_of(TURNS, others);
        [a, b, c, d, e, f, g, h]
    }

    /// Weighted sums of the coefficients of all generators of a kind, from the `first` on.
    #[inline(always)]
    fn sums_of<const COUNT: usize>(&self, first: usize, support: Support) -> [f64; COUNT] {
        let mut sums = [0.0; COUNT];
        for (knot, weight) in (support.first..).zip(support.weights) {
            // The generators of either kind lie side by side; outside the path there are none.
            let place = usize::try_from(self.place(first, knot)).unwrap_or(usize::MAX);
            if let Some(coefficients) = self.coefficients.get(place..).and_then(<[f64]>::first_chunk::<COUNT>)
            {
                sums.iter_mut().zip(coefficients).for_each(|(sum, c)| *sum += c * weight);
            }
        }
        sums
    }

    /// Paths of all generators in pixels. Their levels are a gauge: only differences between two instants have a
    /// meaning.
    pub fn values(&self, block: f64) -> [f64; GENERATORS] {
        self.sums(spline::values(block * RATIO as f64), spline::values(block))
    }

    /// Rates of all generators in pixels a block.
    pub fn rates(&self, block: f64) -> [f64; GENERATORS] {
        let mut turns = spline::slopes(block * RATIO as f64);
        turns.weights = turns.weights.map(|weight| RATIO as f64 * weight);
        self.sums(turns, spline::slopes(block))
    }

    /// Moves to the `blocks` blocks from `base` on. New coefficients continue at the last rate.
    pub fn shift(&mut self, base: i64, blocks: usize) {
        let mut moved = Self::still(base, blocks, self.kappa);
        for j in 0..GENERATORS {
            let known = self.knots(j);
            let places = moved.places(j);
            let (mut last, mut rate) = (0.0, 0.0);
            for (index, knot) in moved.knots(j).enumerate() {
                if known.contains(&knot) {
                    last = self.coefficient(j, knot);
                    let has_before = known.contains(&(knot - 1));
                    rate = if has_before { last - self.coefficient(j, knot - 1) } else { 0.0 };
                } else {
                    last += rate;
                }
                moved.coefficients[places.at(index)] = last;
            }
        }
        *self = moved;
    }
}

/// Indices of a generator's coefficients.
#[derive(Clone, Copy, Debug)]
pub struct Places {
    generator: usize,
    /// Number of coefficients.
    pub count: usize,
}

impl Places {
    /// Index of the coefficient at a knot, counted from the first.
    pub fn at(self, knot: usize) -> usize {
        let ratio = ratio(self.generator) as usize;
        knot / ratio * BLOCK + place_in_block(self.generator, knot % ratio)
    }

    /// All runs of `length` successive coefficients.
    pub fn runs(self, length: usize) -> impl Iterator<Item = impl Fn(usize) -> usize> {
        let starts = 0..(self.count + 1).saturating_sub(length);
        starts.map(move |start| move |index| self.at(start + index))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_coefficient_has_a_place_of_its_own() {
        let path = Splines::still(-3, 5, 0.0);
        let mut places: Vec<i64> = (0..GENERATORS)
            .flat_map(|j| path.knots(j).map(|knot| path.place(j, knot)).collect::<Vec<_>>())
            .collect();
        places.sort_unstable();
        assert_eq!(places, (0..5 * BLOCK as i64).collect::<Vec<_>>());
        for j in 0..GENERATORS {
            let expected: Vec<usize> = path.knots(j).map(|knot| path.place(j, knot) as usize).collect();
            let places = path.places(j);
            assert_eq!((0..places.count).map(|knot| places.at(knot)).collect::<Vec<_>>(), expected);
            let runs: Vec<[usize; 2]> = places.runs(3).map(|at| [at(0), at(2)]).collect();
            assert!(runs.iter().copied().eq(expected.windows(3).map(|run| [run[0], run[2]])));
            assert_eq!(places.runs(places.count + 1).count(), 0);
        }
    }

    #[test]
    fn a_shift_keeps_coefficients_and_extrapolates_linearly() {
        let mut path = Splines::still(10, 4, 0.2);
        for j in 0..GENERATORS {
            for knot in path.knots(j) {
                let place = path.place(j, knot) as usize;
                // A line in time, steeper for each generator.
                path.coefficients[place] = (j + 1) as f64 * knot as f64 / ratio(j) as f64;
            }
        }
        // At block 10 the splines depend on blocks 10 to 13: all there are.
        let before = path.rates(10.0);
        path.shift(12, 6);
        assert_eq!((path.base, path.coefficients.len()), (12, 6 * BLOCK));
        for time in [12.0, 13.5, 14.9] {
            for (j, (rate, old)) in path.rates(time).into_iter().zip(before).enumerate() {
                assert!(
                    (rate - old).abs() < 1e-9 && (rate - (j + 1) as f64).abs() < 1e-9,
                    "{j} {time}: {rate}"
                );
            }
        }
    }
}
