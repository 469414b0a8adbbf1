// SPDX-License-Identifier: MIT OR Apache-2.0

//! Rectifying one 1080p frame: the inverse map alone, by kind of path; a luma plane, all planes of I420.
//!
//! `RAYON_NUM_THREADS` sets the threads.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::Translation2;
use rsrectify::motion::{FrameMotion, MotionPath, ResidualField, ResidualMesh, SampledPath, Twist};
use rsrectify::plane::{Plane, PlaneLayout, PlaneMut, SampleFormat};
use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};
use rsrectify::warp::{CpuLevel, Interpolation, PreparedFrame, SampleGrid, WarpSettings, Warper};
use std::hint::black_box;

/// A picture with detail everywhere.
fn samples(layout: &PlaneLayout) -> Vec<u8> {
    let bytes = layout.stride * layout.height;
    (0..bytes).map(|index| (index.wrapping_mul(2_654_435_761) >> 13) as u8).collect()
}

struct Image {
    layout: PlaneLayout,
    grid: SampleGrid,
    source: Vec<u8>,
    target: Vec<u8>,
}

impl Image {
    fn new(layout: PlaneLayout, grid: SampleGrid) -> Self {
        let source = samples(&layout);
        Self { layout, grid, target: vec![0; source.len()], source }
    }

    fn warp(&mut self, frame: &PreparedFrame<'_>) {
        let source = Plane::new(&self.source, self.layout).expect("a plane");
        let mut target = PlaneMut::new(&mut self.target, self.layout).expect("a plane");
        frame.warp(&source, &mut target, self.grid).expect("planes of one kind");
        black_box(&self.target);
    }
}

fn one_channel(scale: usize, format: SampleFormat) -> PlaneLayout {
    PlaneLayout::packed(1920 / scale, 1080 / scale, format)
}

fn formats() -> Vec<(&'static str, Vec<Image>)> {
    let planes = |format| {
        vec![
            Image::new(one_channel(1, format), SampleGrid::FULL),
            Image::new(one_channel(2, format), SampleGrid::CHROMA_420),
            Image::new(one_channel(2, format), SampleGrid::CHROMA_420),
        ]
    };
    let pairs = PlaneLayout { step: 2, channels: 2, stride: 1920, ..one_channel(2, SampleFormat::U8) };
    let rgbx = PlaneLayout { step: 4, channels: 4, stride: 7680, ..one_channel(1, SampleFormat::U8) };
    let nv12 = vec![
        Image::new(one_channel(1, SampleFormat::U8), SampleGrid::FULL),
        Image::new(pairs, SampleGrid::CHROMA_420),
    ];
    vec![
        ("y", vec![Image::new(one_channel(1, SampleFormat::U8), SampleGrid::FULL)]),
        ("i420", planes(SampleFormat::U8)),
        ("nv12", nv12),
        ("i420_10le", planes(SampleFormat::U10)),
        ("rgba", vec![Image::new(rgbx, SampleGrid::FULL)]),
    ]
}

fn warp(criterion: &mut Criterion) {
    let readout = Readout::new(1920, 1080, ReadoutDirection::TopToBottom, ReadoutTime::Seconds(1.0), 1.0)
        .expect("a readout");
    let motions = [("gentle", Twist::new(0.01, 12.0, -6.0)), ("strong", Twist::new(0.1, 80.0, 40.0))];
    let mut formats = formats();
    for (motion, twist) in motions {
        let motion_of_frame = FrameMotion::new(readout, MotionPath::uniform(twist, readout.time()));
        let mut group = criterion.benchmark_group(format!("warp/{motion}"));
        group.sample_size(30);
        for level in CpuLevel::supported() {
            for interpolation in [Interpolation::Linear, Interpolation::Cubic, Interpolation::Lanczos] {
                let mut settings = WarpSettings::default();
                settings.interpolation = interpolation;
                let mut warper = Warper::with_cpu(level);
                let frame = warper.prepare(&motion_of_frame, &settings);
                for (name, images) in &mut formats {
                    let samples: usize =
                        images.iter().map(|i| i.layout.width * i.layout.height * i.layout.channels).sum();
                    group.throughput(Throughput::Elements(samples as u64));
                    group.bench_function(format!("{name}/{interpolation:?}/{level}"), |bencher| {
                        bencher.iter(|| images.iter_mut().for_each(|image| image.warp(&frame)));
                    });
                }
            }
        }
        group.finish();
    }
}

/// Two cycles a frame, 5 px to each side, in 32 steps.
fn vibrating() -> MotionPath {
    let shift = |step: i32| 5.0 * (f64::from(step) / 32.0 * std::f64::consts::TAU * 2.0).sin();
    let motions: Vec<_> = (0..=32).map(|step| Translation2::new(shift(step), 0.0).to_homogeneous()).collect();
    SampledPath::new(&motions, 1.0).expect("translations can be undone").into()
}

/// Velocities on nodes 16 px apart.
fn residual() -> ResidualField {
    let mesh = ResidualMesh { columns: 121, rows: 69, origin: [-960.0, -540.0], spacing: [16.0; 2] };
    let velocity = |node: usize| [(node % 121) as f32 / 20.0, (node / 121) as f32 / 20.0];
    ResidualField::new(mesh, (0..121 * 69).map(velocity).collect()).expect("one velocity a node")
}

/// The inverse map: solved, then laid out for planes of one row each, so that nothing is sampled.
fn prepare(criterion: &mut Criterion) {
    let time = ReadoutTime::Seconds(1.0);
    let uniform = MotionPath::uniform(Twist::new(0.1, 80.0, 40.0), 1.0);
    let paths = [
        ("twist", uniform.clone()),
        ("sampled", vibrating()),
        ("twist and field", uniform.with_residual(residual())),
        ("sampled and field", vibrating().with_residual(residual())),
    ];
    for direction in [ReadoutDirection::TopToBottom, ReadoutDirection::LeftToRight] {
        let readout = Readout::new(1920, 1080, direction, time, 1.0).expect("a readout");
        let mut group = criterion.benchmark_group(format!("prepare/{direction:?}"));
        let mut rows = [(1, SampleGrid::FULL), (2, SampleGrid::CHROMA_420)].map(|(scale, grid)| {
            Image::new(PlaneLayout { height: 1, ..one_channel(scale, SampleFormat::U8) }, grid)
        });
        for (name, path) in &paths {
            let motion = FrameMotion::new(readout, path.clone());
            let mut warper = Warper::new();
            group.bench_function(format!("map/{name}"), |bencher| {
                bencher.iter(|| drop(warper.prepare(black_box(&motion), &WarpSettings::default())));
            });
            group.bench_function(format!("map and knots/{name}"), |bencher| {
                bencher.iter(|| {
                    let frame = warper.prepare(black_box(&motion), &WarpSettings::default());
                    rows.iter_mut().for_each(|row| row.warp(&frame));
                });
            });
        }
    }
}

criterion_group!(benches, prepare, warp);
criterion_main!(benches);
