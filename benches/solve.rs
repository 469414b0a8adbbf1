// SPDX-License-Identifier: MIT OR Apache-2.0

//! Time of the solver: one uniform rotation, one step, and all that a frame costs.

#![allow(missing_docs)]

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Matrix2, Vector2};
use rsrectify::correspond::Correspondence;
use rsrectify::motion::{Twist, image_centre};
use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};
use rsrectify::solve::sequential::link::{FitBuffers, KnownFrame};
use rsrectify::solve::{Link, Window};

const PERIOD: f64 = 1.0 / 30.0;

/// A grid of 32 × 24 points that move by `twist` and a little on their own; a fifth are wrong.
fn link(twist: Twist, seed: f64) -> Link {
    let readout = Readout::new(1920, 1080, ReadoutDirection::TopToBottom, ReadoutTime::WholePeriod, PERIOD)
        .expect("a readout");
    let centre = image_centre(1920, 1080);
    let correspondences: Vec<_> = (0..768)
        .map(|i| {
            let from = Vector2::new(60.0 * f64::from(i % 32) + 30.0, 45.0 * f64::from(i / 32) + 22.0);
            let phase = f64::from(i) * 12.9898 + seed;
            let size = if i % 5 == 0 { 15.0 } else { 0.2 };
            let stray = Vector2::new(phase.sin(), (phase * 1.7).cos()) * size;
            let to = twist.after(PERIOD).apply(from - centre) + centre + stray;
            Correspondence { from, to, texture: 100.0, residual: 1.0, covariance: Matrix2::zeros() }
        })
        .collect();
    Link::new(&correspondences, &readout, PERIOD, 0.2)
}

fn solve(criterion: &mut Criterion) {
    let twists =
        [Twist::new(0.2, 200.0, -90.0), Twist::new(0.3, 260.0, -30.0), Twist::new(0.1, 230.0, -70.0)];
    let links: Vec<_> = (0..32).map(|i| link(twists[i % 3], i as f64)).collect();
    let scratch = &mut FitBuffers::default();
    criterion.bench_function("solve/uniform", |b| b.iter(|| links[0].uniform(scratch)));
    criterion.bench_function("solve/step", |b| {
        b.iter(|| links[0].sequential_step(KnownFrame::First, twists[0], scratch))
    });
    for lookahead in [0, 4, 12] {
        let mut window = Window::default();
        let mut frames = (0..).map(|i| links[i % links.len()].clone());
        window.push(None);
        for link in frames.by_ref().take(lookahead) {
            window.push(Some(link));
        }
        criterion.bench_function(&format!("solve/frame, lookahead {lookahead}"), |b| {
            b.iter(|| {
                window.push(frames.next());
                window.settle()
            })
        });
    }
}

criterion_group!(benches, solve);
criterion_main!(benches);
