// SPDX-License-Identifier: MIT OR Apache-2.0

//! Borders that are to be hidden: none of their colour is seen, whatever is asked for.

use super::paths::field;
use super::*;
use crate::motion::FrameMotion;
use nalgebra::Matrix3;

#[test]
fn no_border_is_seen_with_any_settings() {
    const DIRECTIONS: [ReadoutDirection; 4] = [
        ReadoutDirection::TopToBottom,
        ReadoutDirection::BottomToTop,
        ReadoutDirection::LeftToRight,
        ReadoutDirection::RightToLeft,
    ];
    const KERNELS: [Interpolation; 4] =
        [Interpolation::Nearest, Interpolation::Linear, Interpolation::Cubic, Interpolation::Lanczos];
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let (mut warper, mut bent) = (Warper::new(), 0);
    for case in 0..200 {
        let [width, height] = [80 + random.below(240), 60 + random.below(180)];
        let readout = readout(width, height, DIRECTIONS[random.below(4)], 0.1 + 0.9 * random.signed().abs());
        // Up to a tenth of a turn and half of the frame in a readout.
        let motion = path(&readout, 0.6 * random.signed(), 160.0 * random.signed(), 120.0 * random.signed());
        let [a, b] = [random.signed(), random.signed()].map(|value| 8.0 * value);
        let velocity = |x: f64, y: f64| [a * (x / 30.0).sin(), b * (y / 20.0 + x / 50.0).cos()];
        let motion = if case % 3 == 0 {
            motion.with_residual(field([width as f64, height as f64], 16.0, velocity))
        } else {
            motion
        };
        let (sin, cos) = (0.1 * random.signed()).sin_cos();
        let [x, y] = [30.0 * random.signed(), 20.0 * random.signed()];
        let placement = Matrix3::new(cos, -sin, x, sin, cos, y, 2e-4 * random.signed(), 0.0, 1.0);
        let motion = FrameMotion::new(readout, motion)
            .with_placement((case % 2 == 0).then_some(placement))
            .with_weight(random.signed().abs() + 0.3);
        let settings = WarpSettings {
            interpolation: KERNELS[random.below(4)],
            border: BorderMode::Constant(Fill::default()),
            reference_row: random.signed().abs(),
            strength: random.signed().abs() + 0.3,
            zoom: 1.0 / (1.0 - 0.03 - 0.3 * random.signed().abs()),
            hide_borders: true,
        };
        bent += usize::from(least_zoom(&motion, &settings) > settings.zoom);
        let layout = PlaneLayout::packed(width, height, SampleFormat::U8);
        let white = vec![255; width * height];
        warper.solve(&motion, &settings);
        let shown = rectify(&warper, &white, layout, SampleGrid::FULL);
        let seen: Vec<_> = (0..shown.len()).filter(|index| shown[*index] < 255).collect();
        assert!(
            seen.is_empty(),
            "case {case}, {width} × {height}, {settings:?}: {} pixels, from ({}, {}) on",
            seen.len(),
            seen[0] % width,
            seen[0] / width
        );
    }
    assert!((40..160).contains(&bent), "{bent} of 200 were bent");
}
