// SPDX-License-Identifier: MIT OR Apache-2.0

use super::*;
use crate::cpu::CpuLevel;
use crate::lanes::Cpu;
use crate::lanes::dispatch::with_cpu;
use crate::lanes::scalar::Scalar;

/// Repeatable pseudo-random grey levels (xorshift).
fn level(seed: u64, width: usize, height: usize) -> Level {
    let state = std::cell::Cell::new(seed);
    Level::of(width, height, |_, _| {
        let mut next = state.get();
        next ^= next << 13;
        next ^= next >> 7;
        next ^= next << 17;
        state.set(next);
        (next >> 40) as f32 * (255.0 / (1 << 24) as f32)
    })
}

/// What is compared: energy, tensor, squares of the quarters, total, step, and the residual at whole pixels.
type Compared = (f32, [f32; 3], [f32; 4], f32, [f32; 2], f32);

/// Squared differences of a patch from its mean, summed.
fn spread(level: &Level, x: i32, y: i32) -> f32 {
    let pixels = (0..64).map(|i| f64::from(level.pixel(x + i % 8, y + i / 8)));
    let mean = pixels.clone().sum::<f64>() / 64.0;
    pixels.map(|pixel| (pixel - mean).powi(2)).sum::<f64>() as f32
}

/// With the patch in the last lane, beside seven others.
#[inline(always)]
fn compared<C: WordCpu>(cpu: C, [first, second]: [&Level; 2], noise: f32, corner: [f32; 2]) -> Compared {
    const LAST: usize = GROUP - 1;
    let mut group = PatchGroup::new(cpu);
    let mut corners = [[1, 2]; GROUP];
    corners[LAST] = [5, 3];
    group.take(first, noise, &corners).unwrap();
    let [x, y] = corner;
    let shift = [cpu.splat(x - 5.0), cpu.splat(y - 3.0)];
    let Difference { step: [a, b], squares: [p, q, r, s], total } =
        group.compare(second, shift, 1 << LAST).unwrap();
    let (x, y) = (x as i32, y as i32);
    let rows = SampleRows::new(second.from(x, y).unwrap(), second.stride()).unwrap();
    let [product, ..] = cpu.store(products(cpu, &group.centred(LAST).unwrap(), &rows));
    let last = |lanes: C::Lanes| cpu.store(lanes)[LAST];
    let [xx, xy, yy] = group.tensor;
    let (tensor, squares) = ([last(xx), last(xy), last(yy)], [last(p), last(q), last(r), last(s)]);
    let whole = last(group.energy) + spread(second, x, y) - 2.0 * product;
    (last(group.energy), tensor, squares, last(total), [last(a), last(b)], whole)
}

/// The same by definition, in double precision.
fn defined([first, second]: [&Level; 2], noise: f64, corner: [f32; 2]) -> Compared {
    let pixel = |level: &Level, x: i32, y: i32| f64::from(level.pixel(x, y));
    let [x, y] = corner.map(f64::from);
    let sampled = |c: i32, r: i32, across: f64, down: f64| {
        let (c, r) = (c + x.floor() as i32, r + y.floor() as i32);
        let row = |r: i32| pixel(second, c, r) * (1.0 - across) + pixel(second, c + 1, r) * across;
        row(r) * (1.0 - down) + row(r + 1) * down
    };
    let of = |grey: &dyn Fn(i32, i32) -> f64| -> Vec<f64> { (0..64).map(|i| grey(i % 8, i / 8)).collect() };
    let centred = |mut all: Vec<f64>| {
        let mean = all.iter().sum::<f64>() / 64.0;
        all.iter_mut().for_each(|value| *value -= mean);
        all
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let values = centred(of(&|c, r| pixel(first, c + 5, r + 3)));
    let energy = dot(&values, &values);
    let orthogonal = |gradient: Vec<f64>| {
        let gradient = centred(gradient);
        let share = dot(&gradient, &values) / energy;
        gradient.iter().zip(&values).map(|(g, v)| g - share * v).collect::<Vec<_>>()
    };
    let dx = orthogonal(of(&|c, r| 0.5 * (pixel(first, c + 6, r + 3) - pixel(first, c + 4, r + 3))));
    let dy = orthogonal(of(&|c, r| 0.5 * (pixel(first, c + 5, r + 4) - pixel(first, c + 5, r + 2))));
    let left = |across: f64, down: f64| {
        let samples = of(&|c, r| sampled(c, r, across, down));
        centred(samples.iter().zip(&values).map(|(s, v)| s - v).collect())
    };
    let difference = left(x - x.floor(), y - y.floor());
    let quarter = |k: usize| {
        let is_in = |i: usize| (i % 8 / 4, i / 32) == (k / 2, k % 2);
        (0..64).filter(|i| is_in(*i)).map(|i| difference[i].powi(2)).sum::<f64>() as f32
    };
    let (xx, xy, yy) = (dot(&dx, &dx), dot(&dx, &dy), dot(&dy, &dy));
    let matrix = nalgebra::Matrix2::new(xx + 32.0 * noise, xy, xy, yy + 32.0 * noise);
    let slope = nalgebra::Vector2::new(dot(&dx, &difference), dot(&dy, &difference));
    let step = -matrix.try_inverse().unwrap() * slope;
    let [total, whole] = [&difference, &left(0.0, 0.0)].map(|all| dot(all, all) as f32);
    let tensor = [xx, xy, yy].map(|sum| sum as f32);
    (energy as f32, tensor, std::array::from_fn(quarter), total, [step.x as f32, step.y as f32], whole)
}

#[test]
fn sums_are_those_of_their_definition_on_all_levels() {
    for seed in 1..100 {
        let levels = [level(seed, 20, 18), level(seed + 1000, 20 + (seed % 7) as usize, 18)];
        let levels = levels.each_ref();
        let corner = [2.0 + (seed % 11) as f32 / 11.0, 4.0 + (seed % 13) as f32 / 13.0];
        let expected = defined(levels, 0.5, corner);
        let check = |found: Compared| {
            let near =
                |a: f32, b: f32, unit: f32| assert!((a - b).abs() < 1e-5 * unit, "{found:?} {expected:?}");
            near(found.0, expected.0, expected.0);
            found.1.iter().zip(expected.1).for_each(|(a, b)| near(*a, b, expected.1[0]));
            found.2.iter().zip(expected.2).for_each(|(a, b)| near(*a, b, expected.3));
            near(found.3, expected.3, expected.3);
            found.4.iter().zip(expected.4).for_each(|(a, b)| near(*a, b, 1.0));
            near(found.5, expected.5, expected.5);
        };
        for cpu in CpuLevel::supported() {
            check(with_cpu!(
                cpu,
                cpu => cpu.vectorize(#[inline(always)] || compared(cpu, levels, 0.5, corner))
            ));
        }
    }
}

#[test]
fn a_position_is_split_into_whole_pixels_and_the_rest() {
    for at in [-8.0, -7.75, -0.25, 0.0, 0.5, 1.0, 479.998, 480.0, 1e6] {
        let (whole, rest) = split(Scalar, Scalar.splat(at), 2e6);
        let ([whole, ..], [rest, ..]) = (Scalar.store(whole), Scalar.store(rest));
        assert!(
            (0.0..=1.0).contains(&rest) && whole.fract() == 0.0 && whole + rest == at,
            "{at}: {whole} {rest}"
        );
    }
}

/// Far outside and without a number, comparisons stay within the level or are refused.
#[test]
fn corners_anywhere_are_safe() {
    let levels = [level(1, 20, 18), level(2, 20, 18)];
    let mut group = PatchGroup::new(Scalar);
    group.take(&levels[0], 0.5, &[[16, 14]]).unwrap();
    let mut compare =
        |x: f32, y: f32| group.compare(&levels[1], [x, y].map(|at| Scalar.splat(at)), 1).is_some();
    for at in [-1e30, -9.0, -8.0, 20.0, 1e30, f32::INFINITY] {
        assert!(compare(at, 3.0) && compare(3.0, at));
    }
    compare(f32::NAN, f32::NAN);
}
