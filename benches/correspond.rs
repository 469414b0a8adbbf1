// SPDX-License-Identifier: MIT OR Apache-2.0

//! Building a pyramid and measuring the correspondences of a pair of 1920×1080 frames, on all cores
//! and on one.

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Vector2;
use rayon::ThreadPoolBuilder;
use rsrectify::correspond::{Pyramid, Sampler};
use rsrectify::plane::{Luma, Plane, PlaneLayout, SampleFormat};
use std::hint::black_box;

/// Waves of several lengths, shifted: texture everywhere.
fn frame(width: usize, height: usize, shift: (f64, f64)) -> Vec<u8> {
    let grey = |x: f64, y: f64| {
        let waves: f64 = (0..12)
            .map(|i| {
                let i = f64::from(i);
                let (sin, cos) = (i * 2.4).sin_cos();
                let length = 14.0 * 1.5f64.powf(i);
                (8.0 + 0.5 * i) * (std::f64::consts::TAU * (cos * x + sin * y) / length + i).sin()
            })
            .sum();
        (128.0 + waves).clamp(0.0, 255.0) as u8
    };
    (0..width * height).map(|i| grey((i % width) as f64 - shift.0, (i / width) as f64 - shift.1)).collect()
}

fn luma(data: &[u8], width: usize, height: usize) -> Luma<'_> {
    let layout = PlaneLayout::packed(width, height, SampleFormat::U8);
    Plane::new(data, layout).expect("the frame is as large as its layout").into()
}

fn bench(criterion: &mut Criterion) {
    for threads in [1, 2] {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be started");
        let mut group = criterion.benchmark_group(format!("{threads} threads"));
        group.sample_size(50);
        for (width, height) in [(1920, 1080), (1280, 720)] {
            let (first, second) = (frame(width, height, (0.0, 0.0)), frame(width, height, (22.4, -9.3)));
            let mut sampler = Sampler::new(width, height, 32, 24);
            let (mut a, mut b) = (Pyramid::new(), Pyramid::new());
            sampler.build(&luma(&first, width, height), &mut a);
            group.bench_function(format!("build {width}×{height}"), |bencher| {
                bencher
                    .iter(|| pool.install(|| sampler.build(&luma(black_box(&second), width, height), &mut b)))
            });
            let mut out = Vec::new();
            group.bench_function(format!("correspond {width}×{height}"), |bencher| {
                bencher.iter(|| pool.install(|| sampler.correspond(&a, &b, |x: Vector2<f64>| x, &mut out)))
            });
            group.bench_function(format!("difference {width}×{height}"), |bencher| {
                bencher.iter(|| pool.install(|| sampler.difference(&a, black_box(&b))))
            });
            println!("{} of {} points", out.len(), 32 * 24);
        }
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
