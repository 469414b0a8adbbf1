// SPDX-License-Identifier: MIT OR Apache-2.0

//! Banded matrices against dense ones.

use super::*;
use crate::solve::random::Random;
use nalgebra::{DMatrix, DVector};

/// A random positive definite matrix B·Bᵀ + I/10, B lower triangular, in both storages. Rows have `band`
/// entries before the diagonal, or, if `ragged`, every third one a third as many.
fn random(size: usize, band: usize, ragged: bool, seed: u64) -> (Banded, DMatrix<f64>) {
    let mut random = Random(seed);
    let mut uniform = || random.uniform() - 0.5;
    let first = |i: usize| i.saturating_sub(if ragged && i % 3 == 1 { band / 3 } else { band });
    let lower = DMatrix::from_fn(size, size, |i, j| if j <= i && j >= first(i) { uniform() } else { 0.0 });
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
        banded.solve(CpuLevel::detect(), &mut x);
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
                let inside = i.min(j) >= banded.begin[i.max(j)];
                let value = if inside { expected[(i, j)] } else { 0.0 };
                assert!((inverse.at(i, j) - value).abs() < 1e-9 * expected.amax(), "{size} {band}: {i} {j}");
            }
        }
    }
}

#[test]
fn an_inverse_of_large_entries_is_exact_to_their_differences() {
    // Paths of eight generators over 40 knots: the differences of neighbours are measured, their second differences
    // are small, and the level is hardly known.
    const GENERATORS: usize = 8;
    let size = 40 * GENERATORS;
    let mut banded = Banded::default();
    banded.reset((0..size).map(|i: usize| i.saturating_sub(3 * GENERATORS - 1)));
    let mut random = Random(7);
    let mut add = |weight: f64, entries: &[(usize, f64)]| {
        for (i, (row, one)) in entries.iter().enumerate() {
            entries[..=i].iter().for_each(|(column, other)| banded.add(*row, *column, weight * one * other));
        }
    };
    for place in 0..size {
        add(1e-6, &[(place, 1.0)]);
        if place + 2 * GENERATORS < size {
            add(1e4, &[0, 1, 2].map(|k| (place + k * GENERATORS, [1.0, -2.0, 1.0][k])));
        }
    }
    for knot in 0..39 {
        for _ in 0..6 {
            let field: [f64; GENERATORS] = std::array::from_fn(|_| random.uniform() - 0.5);
            let at = |next: usize| {
                let sign = if next == 0 { -1.0 } else { 1.0 };
                field
                    .map(|value| sign * value)
                    .into_iter()
                    .enumerate()
                    .map(move |(j, value)| ((knot + next) * GENERATORS + j, value))
            };
            add(20.0, &at(0).chain(at(1)).collect::<Vec<_>>());
        }
    }
    let dense = DMatrix::from_fn(size, size, |i, j| banded.at(i, j));
    let expected = dense.cholesky().unwrap().inverse();
    assert!(banded.factorise(CpuLevel::detect()));
    let mut inverse = Banded::default();
    banded.inverse_band(CpuLevel::detect(), &mut inverse);
    for place in 0..size - 2 * GENERATORS {
        let variance = |entry: &dyn Fn(usize, usize) -> f64| -> f64 {
            let terms = [1.0, -2.0, 1.0].into_iter().enumerate();
            let products = terms.clone().flat_map(|one| terms.clone().map(move |other| (one, other)));
            let at = |k: usize| place + k * GENERATORS;
            products.map(|((p, one), (q, other))| one * other * entry(at(p), at(q))).sum()
        };
        let (found, expected) = (variance(&|i, j| inverse.at(i, j)), variance(&|i, j| expected[(i, j)]));
        assert!((found / expected - 1.0).abs() < 1e-3, "{place}: {found} {expected}");
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
            let mut x: Vec<f64> = (0..size).map(|k| (k as f64).sin()).collect();
            banded.solve(cpu, &mut x);
            let entries = |of: &Banded| {
                let places = (0..size * size).map(|k| (k / size, k % size));
                places.map(|(i, j)| of.at(i, j)).collect::<Vec<f64>>()
            };
            [entries(&banded), entries(&inverse), x]
        });
        let found: Vec<_> = found.collect();
        // Sums of products are rounded once or twice.
        for (a, b) in found.windows(2).flat_map(|two| two[0].iter().zip(&two[1])) {
            let largest = a.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-10 * largest), "{size} {band}");
        }
    }
}

#[test]
fn rows_reach_back_as_far_as_they_were_made_to() {
    let mut banded = Banded::default();
    // Rows 8 to 11 and 12 begin in the second and in the first tile.
    banded.reset((0..13).map(|i| if i < 8 { i / SIDE * SIDE } else { 9 * usize::from(i < 12) }));
    banded.add(1, 0, 2.0);
    banded.add(5, 12, 4.0);
    banded.add(12, 12, 5.0);
    banded.add(12, 12, 6.0);
    let value = |i: usize, j: usize| match (i.max(j), i.min(j)) {
        (1, 0) => 2.0,
        (12, 5) => 4.0,
        (12, 12) => 11.0,
        _ => 0.0,
    };
    for (i, j) in (0..13).flat_map(|i| (0..13).map(move |j| (i, j))) {
        assert_eq!(banded.at(i, j), value(i, j), "{i} {j}");
    }
    assert_eq!(banded.first, [0, 1, 2, 0]);
    assert_eq!(banded.tiles.len(), 1 + 1 + 1 + 4);
    assert_eq!(banded.last(), [3, 3, 3, 3]);
    // Beyond the matrix the last tile is the identity.
    let last = banded.tiles.last().unwrap();
    assert_eq!(([1, 2, 3].map(|k| last[k][k]), banded.size()), ([1.0; 3], 13));
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
