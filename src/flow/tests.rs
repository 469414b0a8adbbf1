// SPDX-License-Identifier: MIT OR Apache-2.0

use super::*;
use crate::plane::{Plane, PlaneLayout, SampleFormat};

const SIZE: (usize, usize) = (320, 240);

/// Waves of several lengths, the longest of a third of the frame, so that every level has texture.
fn wave(x: f64, y: f64) -> f64 {
    let waves = [
        (0.9, 0.31, 10.0),
        (0.35, -0.6, 14.0),
        (-0.17, 0.21, 18.0),
        (0.083, 0.11, 18.0),
        (0.051, -0.037, 20.0),
        (0.019, 0.027, 22.0),
    ];
    128.0 + waves.iter().map(|(a, b, c)| c * (a * x + b * y + c).sin()).sum::<f64>()
}

/// Squares of 4 and of 16 pixels, each of a random grey, so that nothing fits by chance.
fn grain(x: f64, y: f64) -> f64 {
    let squares = |side: f64| {
        let [column, row] = [x, y].map(|at| (at / side).floor() as i64 as u64);
        let mixed = column.wrapping_mul(73_856_093) ^ row.wrapping_mul(19_349_663);
        (mixed.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 56) as f64
    };
    0.5 * (squares(4.0) + squares(16.0))
}

fn frame(grey: impl Fn(f64, f64) -> f64) -> Vec<u8> {
    let at = |i: usize| grey((i % SIZE.0) as f64, (i / SIZE.0) as f64).round().clamp(0.0, 255.0) as u8;
    (0..SIZE.0 * SIZE.1).map(at).collect()
}

fn pyramid(reducer: &Reducer, bytes: &[u8]) -> Pyramid {
    let plane = Plane::new(bytes, PlaneLayout::packed(SIZE.0, SIZE.1, SampleFormat::U8)).unwrap();
    let mut pyramid = Pyramid::new();
    reducer.build(&plane.into(), &mut pyramid);
    pyramid
}

fn flow_of(cpu: CpuLevel, frames: [&[u8]; 2], predict: impl Fn(Vector2<f64>) -> Vector2<f64>) -> DenseFlow {
    let reducer = Reducer::new(SIZE.0, SIZE.1);
    let mut flow = DenseFlow::with_cpu(cpu, &reducer);
    let [first, second] = frames.map(|bytes| pyramid(&reducer, bytes));
    flow.estimate(&first, &second, predict);
    flow
}

/// The median distance from `truth` over the cells that stay inside the frame, in pixels.
fn median_error(field: &FlowField, truth: impl Fn(f64, f64) -> [f64; 2]) -> f64 {
    let mut errors = Vec::new();
    for (index, cell) in field.cells().iter().enumerate() {
        let [x, y] = field.centre(index % field.columns(), index / field.columns());
        let [u, v] = truth(x, y);
        let is_inside = |at: f64, length: usize| (8.0..length as f64 - 8.0).contains(&at);
        if is_inside(x + u, SIZE.0) && is_inside(y + v, SIZE.1) {
            errors.push((f64::from(cell.flow[0]) - u).hypot(f64::from(cell.flow[1]) - v));
        }
    }
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

#[test]
fn a_translation_is_found_both_ways() {
    for shift in [[3.3, -1.6], [-40.0, 12.5], [70.0, 30.0]] {
        let (first, second) = (frame(wave), frame(|x, y| wave(x - shift[0], y - shift[1])));
        let flow = flow_of(CpuLevel::detect(), [&first, &second], |p| p);
        let there = median_error(flow.forward(), |_, _| shift);
        let back = median_error(flow.backward(), |_, _| shift.map(|value| -value));
        assert!(there < 0.1 && back < 0.1, "{shift:?}: {there} {back}");
    }
}

#[test]
fn a_wrong_prediction_hides_nothing() {
    let (first, second) = (frame(wave), frame(|x, y| wave(x - 21.0, y + 9.0)));
    let flow = flow_of(CpuLevel::detect(), [&first, &second], |p| p + Vector2::new(-35.0, 28.0));
    assert!(median_error(flow.forward(), |_, _| [21.0, -9.0]) < 0.1);
}

#[test]
fn brightness_may_change() {
    let (first, second) = (frame(wave), frame(|x, y| 0.9 * wave(x - 6.0, y - 4.0) + 20.0));
    let flow = flow_of(CpuLevel::detect(), [&first, &second], |p| p);
    let error = median_error(flow.forward(), |_, _| [6.0, 4.0]);
    assert!(error < 0.15, "{error}");
}

#[test]
fn inconsistent_flow_has_low_confidence() {
    // The right half of the second frame shows something else.
    let other = |x: f64, y: f64| wave(1.7 * y + 400.0, 1.3 * x - 900.0);
    let (first, second) = (frame(wave), frame(|x, y| if x < 160.0 { wave(x - 4.0, y) } else { other(x, y) }));
    let flow = flow_of(CpuLevel::detect(), [&first, &second], |p| p);
    let field = flow.forward();
    let mean_confidence = |columns: std::ops::Range<usize>| {
        let cells = field.cells().iter().enumerate();
        let of = cells.filter(|(index, _)| columns.contains(&(index % field.columns())));
        let all: Vec<f32> = of.map(|(_, cell)| cell.confidence).collect();
        all.iter().sum::<f32>() / all.len() as f32
    };
    let (left, right) = (mean_confidence(2..16), mean_confidence(24..40));
    assert!(left > 0.9 && right < 0.3, "{left} {right}");
}

#[test]
fn occluded_cells_take_the_background_motion() {
    // To the right of a still foreground the background is occluded in the second frame.
    let moved = -64.0;
    let is_still = |x: f64, y: f64| (120.0..256.0).contains(&x) && (60.0..180.0).contains(&y);
    let seen = |x: f64, y: f64, moved: f64| {
        if is_still(x, y) { grain(x + 900.0, y + 700.0) } else { grain(x - moved, y) }
    };
    let (first, second) = (frame(|x, y| seen(x, y, 0.0)), frame(|x, y| seen(x, y, moved)));
    let flow = flow_of(CpuLevel::detect(), [&first, &second], |p| p);
    let field = flow.forward();
    let (mut right, mut occluded) = (0, 0);
    for (index, cell) in field.cells().iter().enumerate() {
        let [x, y] = field.centre(index % field.columns(), index / field.columns());
        // Without the cells across a depth edge.
        if x > 264.0 && (72.0..168.0).contains(&y) {
            let error = (f64::from(cell.flow[0]) - moved).hypot(f64::from(cell.flow[1]));
            (right, occluded) = (right + usize::from(error < 4.0), occluded + 1);
        }
    }
    assert!(occluded > 50 && 4 * right > 3 * occluded, "{right} of {occluded}");
}

/// Fused multiplications round differently, which decides between candidates of equal residual.
#[test]
fn all_levels_find_the_same() {
    let (first, second) = (frame(wave), frame(|x, y| wave(1.01 * x - 5.0, y + 0.01 * x)));
    let scalar = flow_of(CpuLevel::Scalar, [&first, &second], |p| p);
    for cpu in CpuLevel::supported() {
        let flow = flow_of(cpu, [&first, &second], |p| p);
        for (found, expected) in [(flow.forward(), scalar.forward()), (flow.backward(), scalar.backward())] {
            let is_same = |(a, b): &(&Cell, &Cell)| {
                let apart = (a.flow[0] - b.flow[0]).hypot(a.flow[1] - b.flow[1]);
                apart < 1e-3 && (a.confidence - b.confidence).abs() < 1e-3
            };
            let cells = found.cells().len();
            let same = found.cells().iter().zip(expected.cells()).filter(is_same).count();
            assert!(cells > 0 && same as f64 > 0.99 * cells as f64, "{cpu}: {same} of {cells}");
        }
    }
}

#[test]
fn frames_of_any_size_do() {
    for (width, height) in [(1, 1), (7, 300), (16, 16), (17, 23), (33, 16), (961, 20)] {
        let reducer = Reducer::new(width, height);
        let mut flow = DenseFlow::new(&reducer);
        let bytes: Vec<u8> = (0..width * height).map(|i| (i * 37 % 251) as u8).collect();
        let plane = Plane::new(&bytes, PlaneLayout::packed(width, height, SampleFormat::U8)).unwrap();
        let mut pyramid = Pyramid::new();
        flow.estimate(&pyramid, &pyramid, |p| p);
        assert!(flow.forward().cells().is_empty());
        reducer.build(&plane.into(), &mut pyramid);
        flow.estimate(&pyramid, &pyramid, |_| Vector2::new(f64::NAN, 1e300));
        let cells = flow.forward().cells();
        assert!(cells.iter().all(|cell| cell.flow.iter().all(|v| v.abs() < 1e-3)), "{width}×{height}");
    }
}
