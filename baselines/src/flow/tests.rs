// SPDX-License-Identifier: MIT OR Apache-2.0

use super::image::Image;
use super::*;
use nalgebra::Vector2;
use render::scene::SceneKind;
use render::scene::procedural::bake_all;
use render::sequence::{Sequence, Settings, Strength, named};
use std::sync::Arc;

/// A smooth picture with detail in all directions and no period in sight.
fn smooth(x: f32, y: f32) -> f32 {
    let wave = |kx: f32, ky: f32, phase: f32| (kx * x + ky * y + phase).sin();
    let wide = wave(0.11, 0.05, 0.3) + wave(-0.06, 0.13, 1.1);
    let narrow = wave(0.45, 0.31, 2.0) + wave(-0.29, 0.52, 0.7) + wave(0.61, -0.17, 4.0);
    128.0 + 25.0 * wide + 12.0 * narrow
}

/// The flow from the smooth picture to the one in which `back` tells where each point was.
fn found(back: impl Fn(f32, f32) -> [f32; 2] + Sync) -> Flow {
    let picture = |of: &(dyn Fn(f32, f32) -> f32 + Sync)| {
        Prepared::new(Image::from_fn(120, 90, |x, y| of(x as f32, y as f32)))
    };
    let moved = |x: f32, y: f32| {
        let [x, y] = back(x, y);
        smooth(x, y)
    };
    Flow::between(&picture(&smooth), &picture(&moved))
}

/// Asserts that away from the border the flow is `exact` to less than `tolerance` pixels.
fn assert_flow(found: &Flow, tolerance: f32, exact: impl Fn(f32, f32) -> [f32; 2]) {
    for y in (15..75).step_by(3) {
        for x in (15..105).step_by(3) {
            let [u, v] = exact(x as f32, y as f32);
            let error = (found.u.at(x, y) - u).hypot(found.v.at(x, y) - v);
            assert!(error < tolerance, "{error} px at {x}, {y}");
        }
    }
}

#[test]
fn a_shift_is_recovered() {
    for shift in [[0.3, -0.45], [6.7, 3.2]] {
        assert_flow(&found(|x, y| [x - shift[0], y - shift[1]]), 0.1, |_, _| shift);
    }
}

#[test]
fn a_rotation_is_recovered() {
    let turned = |x: f32, y: f32, angle: f32| {
        let (sin, cos) = angle.sin_cos();
        let (x, y) = (x - 60.0, y - 45.0);
        [60.0 + cos * x - sin * y, 45.0 + sin * x + cos * y]
    };
    let exact = |x: f32, y: f32| {
        let [x_to, y_to] = turned(x, y, 0.06);
        [x_to - x, y_to - y]
    };
    assert_flow(&found(|x, y| turned(x, y, -0.06)), 0.1, exact);
}

/// What the texture decomposition is for: light that is added, more of it on one side. Without it
/// the flow is wrong by more than a pixel.
#[test]
fn a_change_of_light_is_no_motion() {
    let frame =
        |of: fn(f32, f32) -> f32| Prepared::new(Image::from_fn(120, 90, |x, y| of(x as f32, y as f32)));
    let brighter = |x: f32, y: f32| smooth(x - 1.25, y + 0.5) + 10.0 + 0.2 * x;
    assert_flow(&Flow::between(&frame(smooth), &frame(brighter)), 0.2, |_, _| [1.25, -0.5]);
}

#[test]
fn identical_pictures_do_not_move() {
    let flow = found(|x, y| [x, y]);
    assert!(flow.u.data.iter().chain(&flow.v.data).all(|part| part.abs() < 1e-6));
}

#[test]
fn a_rendered_pair_against_the_truth() {
    let settings = Settings {
        width: 320,
        height: 240,
        frames: 6,
        strength: Strength::Displacement(2.0),
        ..named("rot2_B40").unwrap()
    };
    let sequence = Sequence::in_scene(settings, Arc::new(SceneKind::Room.covered(1, bake_all(1))));
    let [first, second] = [4, 5].map(|k| {
        let luma = sequence.frame(k).luma().iter().map(|grey| f32::from(*grey)).collect();
        Prepared::new(Image::new(320, 240, luma))
    });
    let found = points::correspondences(&first, &second, [32, 24]);
    assert!(found.len() > 600, "{} points", found.len());
    let exact = sequence.capture(4).exact_matches(&sequence.capture(5), 32, 24);
    let truth = |from: Vector2<f64>| exact.iter().find(|exact| (exact.from - from).norm() < 1e-9);
    let errors = found.iter().filter_map(|found| Some((found.to - truth(found.from)?.to).norm()));
    let mut errors: Vec<f64> = errors.collect();
    errors.sort_by(f64::total_cmp);
    assert!(errors.len() > 550);
    let (median, worst) = (errors[errors.len() / 2], errors[errors.len() * 19 / 20]);
    assert!(median < 0.2 && worst < 1.0, "median {median} px, 95 % {worst} px");
}
