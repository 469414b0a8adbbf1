// SPDX-License-Identifier: MIT OR Apache-2.0

use super::*;
use crate::cpu::CpuLevel;
use crate::lanes::Cpu;
use crate::lanes::dispatch::with_cpu;

/// Repeatable pseudo-random grey levels.
fn level(seed: u64) -> Level {
    let state = std::cell::Cell::new(seed);
    Level::of(40, 36, |_, _| {
        state.set(state.get().wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1));
        (state.get() >> 40) as f32 * (255.0 / (1 << 24) as f32)
    })
}

/// All sums of a patch and of its comparison: v, v², d, d·v, d·dᵀ; v·I, d·I, I, I².
type Found = ([f32; 9], [f32; 5]);

#[inline(always)]
fn found<C: WordCpu>(cpu: C, levels: [&Level; 2], corner: Vector2<f32>) -> Option<(f32, Found)> {
    let mut block = Block::new(cpu);
    // The patch at (5, 7), whose margin begins a pixel before.
    let mut distorted = DistortedPatch::new();
    let samples = distorted.sample(cpu, levels[0], Vector2::new(4.0, 6.0), &Matrix2::identity())?;
    let own = block.take(cpu, samples)?;
    let other = block.sample_sums(cpu, levels[1], corner, 100.0)?;
    let (d, p, t) = (own.gradients, own.products, own.tensor);
    let own = [own.values, own.squares, d.x, d.y, p.x, p.y, t.m11, t.m12, t.m22];
    let other = [other.values, other.slope.x, other.slope.y, other.sum, other.squares];
    Some((block.pivot, (own, other)))
}

/// The same by definition, in double precision.
fn defined([first, second]: [&Level; 2], corner: Vector2<f32>, pivot: f32) -> ([f64; 9], [f64; 5]) {
    let weights = |t: f32| {
        let t = f64::from(t);
        [-1.0, 0.0, 1.0, 2.0].map(|own| {
            let others = [-1.0, 0.0, 1.0, 2.0].into_iter().filter(|other| *other != own);
            others.map(|other| (t - other) / (own - other)).product::<f64>()
        })
    };
    let (across, down) = (weights(corner.x.fract()), weights(corner.y.fract()));
    let pixel = |level: &Level, x: i32, y: i32| f64::from(level.pixel(x, y));
    let (mut own, mut other) = ([0.0; 9], [0.0; 5]);
    for (c, r) in (0..256).map(|i| (i % 16, i / 16)) {
        let v = pixel(first, 5 + c, 7 + r) - f64::from(pivot);
        let x = pixel(first, 6 + c, 7 + r) - pixel(first, 4 + c, 7 + r);
        let y = pixel(first, 5 + c, 8 + r) - pixel(first, 5 + c, 6 + r);
        let mut grey = -100.0;
        for (i, j) in (0..16).map(|k| (k % 4, k / 4)) {
            let (left, top) = (corner.x as i32 + c - 1, corner.y as i32 + r - 1);
            grey += across[i as usize] * down[j as usize] * pixel(second, left + i, top + j);
        }
        let all = [v, v * v, x, y, x * v, y * v, x * x, x * y, y * y];
        own.iter_mut().zip(all).for_each(|(sum, value)| *sum += value);
        let all = [v * grey, x * grey, y * grey, grey, grey * grey];
        other.iter_mut().zip(all).for_each(|(sum, value)| *sum += value);
    }
    (own, other)
}

#[test]
fn sums_are_those_of_their_definition_on_all_levels() {
    for seed in 1..50 {
        let levels = [level(seed), level(seed + 1000)];
        let levels = levels.each_ref();
        let corner = Vector2::new(2.0 + (seed % 11) as f32 / 11.0, 4.0 + (seed % 13) as f32 / 13.0);
        for cpu in CpuLevel::supported() {
            let (pivot, found) = with_cpu!(
                cpu,
                cpu => cpu.vectorize(#[inline(always)] || found(cpu, levels, corner))
            )
            .unwrap();
            let expected = defined(levels, corner, pivot);
            // 256 products of up to 255².
            for (a, b) in found.0.iter().zip(&expected.0).chain(found.1.iter().zip(&expected.1)) {
                assert!((f64::from(*a) - b).abs() < 1.0, "{cpu}: {found:?} {expected:?}");
            }
        }
    }
}

/// Of a plane of grey all samples are exact, however they are distorted.
#[test]
fn distorted_patches_are_sampled_where_they_lie_on_all_levels() {
    let plane = |at: Vector2<f32>| 20.0 + 3.0 * at.x - 1.5 * at.y;
    let level = Level::of(80, 70, |x, y| plane(Vector2::new(x, y)));
    for (m11, m12, m21, m22) in [
        (1.0, 0.0, 0.0, 1.0),
        (1.02, -0.03, 0.04, 0.98),
        (0.97, 0.3, -0.3, 1.1),
        (0.5, 0.0, 0.2, 0.6),
        (2.0, -0.5, 0.5, 1.9),
    ] {
        let (first, distortion) = (Vector2::new(20.3, 17.8), Matrix2::new(m11, m12, m21, m22));
        for cpu in CpuLevel::supported() {
            let mut distorted = DistortedPatch::new();
            let samples = with_cpu!(
                cpu,
                cpu => cpu.vectorize(#[inline(always)] || distorted.sample(cpu, &level, first, &distortion))
            )
            .unwrap();
            for (c, r) in (0..WIDTH_WITH_MARGIN * WIDTH_WITH_MARGIN).map(|i| (i % 18, i / 18)) {
                let expected = plane(first + distortion * Vector2::new(c as f32, r as f32));
                assert!((samples[r][c] - expected).abs() < 1e-3, "{cpu}, {distortion}: {c}, {r}");
            }
        }
    }
}

/// Outside the level, and where no number is, patches are refused.
#[test]
fn corners_anywhere_are_safe() {
    let levels = [level(1), level(2)];
    let cpu = crate::lanes::scalar::Scalar;
    for at in [-1e30, -9.0, 0.0, 0.999, 23.0, 40.0, 1e30, f32::INFINITY, f32::NAN] {
        assert!(found(cpu, levels.each_ref(), Vector2::new(at, 5.0)).is_none(), "{at}");
        let mut distorted = DistortedPatch::new();
        let none = distorted.sample(cpu, &levels[0], Vector2::new(5.0, at), &Matrix2::identity()).is_none();
        assert!(none || (0.0..18.0).contains(&at), "{at}");
        assert!(distorted.sample(cpu, &levels[0], Vector2::new(4.0, 4.0), &Matrix2::repeat(at)).is_none());
    }
}
