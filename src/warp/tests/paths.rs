// SPDX-License-Identifier: MIT OR Apache-2.0

//! Positions under vibrating paths and residual fields, against closed forms.

use super::accuracy::{DIRECTIONS, Truth, for_each_sample};
use super::*;
use crate::motion::{ResidualField, ResidualMesh, SampledPath};
use nalgebra::{Matrix3, matrix};
use std::f64::consts::TAU;

/// A camera vibration: the picture rotates about its centre and shifts, both at 2.3 cycles a frame.
#[derive(Clone, Copy)]
struct Vibration {
    gamma: f64,
    angle: f64,
    shift: [f64; 2],
}

impl Vibration {
    /// Angle and shift at a share of the readout.
    fn at(&self, share: f64) -> (f64, [f64; 2]) {
        let phase = TAU * 2.3 * self.gamma * share;
        (self.angle * (phase + 1.0).sin(), [self.shift[0] * phase.sin(), self.shift[1] * (phase + 2.0).cos()])
    }

    fn carry(&self, point: [f64; 2], from: f64, to: f64) -> [f64; 2] {
        let ((before, [bx, by]), (after, [ax, ay])) = (self.at(from), self.at(to));
        let (sin, cos) = (after - before).sin_cos();
        let (x, y) = (point[0] - bx, point[1] - by);
        [cos * x - sin * y + ax, sin * x + cos * y + ay]
    }

    fn path(&self) -> MotionPath {
        let back = |share: f64| {
            let (angle, [x, y]) = self.at(share);
            let (sin, cos) = angle.sin_cos();
            matrix![cos, sin, 0.0; -sin, cos, 0.0; 0.0, 0.0, 1.0]
                * matrix![1.0, 0.0, -x; 0.0, 1.0, -y; 0.0, 0.0, 1.0]
        };
        sampled(back)
    }
}

fn sampled(to_common: impl Fn(f64) -> Matrix3<f64>) -> MotionPath {
    let motions: Vec<_> = (0..=32).map(|index| to_common(f64::from(index) / 32.0)).collect();
    SampledPath::new(&motions, 1.0).unwrap().into()
}

/// A field whose nodes lie `spacing` apart over a frame and a node beyond.
pub(super) fn field(size: [f64; 2], spacing: f64, velocity: impl Fn(f64, f64) -> [f64; 2]) -> ResidualField {
    let [columns, rows] = size.map(|size| (size / spacing) as usize + 3);
    let origin = size.map(|size| -(size - 1.0) / 2.0 - spacing);
    let mesh = ResidualMesh { columns, rows, origin, spacing: [spacing; 2] };
    let at = |axis: usize, index: usize| origin[axis] + spacing * index as f64;
    let node = |node: usize| velocity(at(0, node % columns), at(1, node / columns)).map(|v| v as f32);
    ResidualField::new(mesh, (0..columns * rows).map(node).collect()).unwrap()
}

/// The largest error in pixels inside the frame: outside of it, before and after the readout, a sampled
/// path is extrapolated.
fn largest_error(truth: &Truth, path: &MotionPath) -> f64 {
    let mut worst: f64 = 0.0;
    let within = |at: f64, axis: usize| (0.0..=truth.size[axis] - 1.0).contains(&at);
    for_each_sample(truth, path, SampleGrid::FULL, |shown, [x, y]| {
        if within(x, 0) && within(y, 1) {
            let [u, v] = truth.inverse(shown[0], shown[1]);
            worst = worst.max((x - u).hypot(y - v));
        }
    });
    worst
}

#[test]
fn vibrations_are_followed() {
    let shapes = [(0.3, 0.0, [9.0, 5.0]), (0.6, 0.004, [4.0, 2.0]), (1.0, 0.004, [3.0, -3.0])];
    let mut worst: f64 = 0.0;
    for direction in DIRECTIONS {
        for (gamma, angle, shift) in shapes {
            for size in [[1920.0, 1080.0], [1280.0, 720.0]] {
                let vibration = Vibration { gamma, angle, shift };
                let carry = |point: [f64; 2], from, to| vibration.carry(point, from, to);
                let settings = WarpSettings::default();
                let truth = Truth { size, direction, settings, carry: &carry };
                let error = largest_error(&truth, &vibration.path());
                assert!(error < 0.01, "{direction:?} {gamma} {size:?}: {error}");
                worst = worst.max(error);
            }
        }
    }
    println!("largest error {worst:.5} px");
}

#[test]
fn a_pan_with_perspective_is_followed() {
    // A camera of focal length 1400 that pans by 0.1 and rolls by 0.05 during the readout.
    let f = 1400.0;
    let turn = |share: f64| {
        let ((s, c), (sr, cr)) = ((0.1 * share).sin_cos(), (0.05 * share).sin_cos());
        matrix![cr, -sr, 0.0; sr, cr, 0.0; 0.0, 0.0, 1.0] * matrix![c, 0.0, s; 0.0, 1.0, 0.0; -s, 0.0, c]
    };
    // The ray of a pixel, rotated back.
    let carry = |[x, y]: [f64; 2], from: f64, to: f64| {
        let ray = turn(to).transpose() * (turn(from) * nalgebra::vector![x, y, f]);
        [f * ray.x / ray.z, f * ray.y / ray.z]
    };
    let k = Matrix3::from_diagonal(&nalgebra::vector![f, f, 1.0]);
    let path = sampled(|share| k * turn(share) * k.try_inverse().unwrap());
    for direction in DIRECTIONS {
        for reference_row in [0.0, 0.5] {
            let settings = WarpSettings { reference_row, zoom: 1.05, ..WarpSettings::default() };
            let truth = Truth { size: [1920.0, 1080.0], direction, settings, carry: &carry };
            let error = largest_error(&truth, &path);
            assert!(error < 0.01, "{direction:?} {reference_row}: {error}");
        }
    }
}

#[test]
fn smooth_fields_are_followed() {
    let vibration = Vibration { gamma: 0.7, angle: 0.003, shift: [3.0, 2.0] };
    let size = [640.0, 480.0];
    // Bilinear, so that the mesh represents it exactly; up to 20 px a readout.
    let velocity = |x: f64, y: f64| [4.0 + 0.02 * x - 0.03 * y + 4e-5 * x * y, -2.0 - 0.01 * x + 0.03 * y];
    let carry = |[x, y]: [f64; 2], from: f64, to: f64| {
        let ([gx, gy], v) = (vibration.carry([x, y], from, to), velocity(x, y));
        [gx + (to - from) * v[0], gy + (to - from) * v[1]]
    };
    let mut worst: f64 = 0.0;
    for direction in DIRECTIONS {
        for (reference_row, strength) in [(0.5, 1.0), (0.0, 0.5), (1.0, 1.0)] {
            let settings = WarpSettings { reference_row, strength, ..WarpSettings::default() };
            let truth = Truth { size, direction, settings, carry: &carry };
            // A mesh that extends half a frame beyond the frame, as the closed form does.
            let path = vibration.path().with_residual(field([1280.0, 960.0], 8.0, velocity));
            let error = largest_error(&truth, &path);
            assert!(error < 0.01, "{direction:?} {reference_row}: {error}");
            worst = worst.max(error);
        }
    }
    println!("largest error {worst:.5} px");
}

#[test]
fn a_bump_is_followed_as_far_as_the_mesh_does() {
    let size = [1920.0, 1080.0];
    // 6 px a readout, 400 px wide: between nodes 16 px apart the mesh has an error of A·k²·16²/8 each way.
    let k = TAU / 400.0;
    let velocity = |x: f64, y: f64| [6.0 * (k * x).sin() * (k * y).cos(), 3.0 * (k * (x + y)).cos()];
    let mesh = 6.0 * k * k * 256.0 / 8.0 * 2.0;
    let carry = |[x, y]: [f64; 2], from: f64, to: f64| {
        let v = velocity(x, y);
        [x + (to - from) * v[0], y + (to - from) * v[1]]
    };
    for direction in [ReadoutDirection::TopToBottom, ReadoutDirection::RightToLeft] {
        let truth = Truth { size, direction, settings: WarpSettings::default(), carry: &carry };
        let path = MotionPath::STILL.with_residual(field([2400.0, 1500.0], 16.0, velocity));
        let error = largest_error(&truth, &path);
        assert!(error < 0.01 + 0.5 * mesh, "{direction:?}: {error}");
    }
}

/// A foreground in the right half moves by (40, −24) px a readout before a still background.
fn edge(x: f64, _: f64) -> [f64; 2] {
    if x > 0.0 { [40.0, -24.0] } else { [0.0, 0.0] }
}

#[test]
fn both_sides_of_a_depth_edge_are_accurate() {
    let size = [640.0, 480.0];
    let path = MotionPath::STILL.with_residual(field(size, 8.0, edge));
    for direction in DIRECTIONS {
        let carry = |[x, y]: [f64; 2], from: f64, to: f64| {
            let v = edge(x, y);
            [x + (to - from) * v[0], y + (to - from) * v[1]]
        };
        let truth = Truth { size, direction, settings: WarpSettings::default(), carry: &carry };
        let mut checked = 0;
        for_each_sample(&truth, &path, SampleGrid::FULL, |[x, y], [u, v]| {
            // Within half of 40 px of the depth edge, before or after the correction, any position is
            // accepted.
            if (x - 319.5).abs() > 50.0 {
                let [shown_x, shown_y] = truth.forward(u, v);
                let error = (shown_x - x).hypot(shown_y - y);
                assert!(error < 0.01, "{direction:?} {x} {y}: {error}");
                checked += 1;
            }
        });
        assert!(checked > 1500);
    }
}

#[test]
fn a_depth_edge_neither_tears_nor_folds_the_picture() {
    // Depth edges along both axes, for occlusion and disocclusion in each readout direction.
    let corner = |x: f64, y: f64| if x > 40.0 && y > -30.0 { [50.0, 40.0] } else { [-10.0, 0.0] };
    let size = [640, 480];
    let layout = PlaneLayout::packed(size[0], size[1], SampleFormat::U16);
    for direction in DIRECTIONS {
        let readout = readout(size[0], size[1], direction, 1.0);
        let path = MotionPath::STILL.with_residual(field(size.map(|size| size as f64), 8.0, corner));
        let mut warper = Warper::new();
        let settings = WarpSettings { interpolation: Interpolation::Linear, ..WarpSettings::default() };
        warper.solve(&FrameMotion::new(readout, path), &settings);
        // Both frame coordinates; displacements are 30 px at most, less at the border.
        let [across, down] = picture::positions(&warper, layout, SampleGrid::FULL);
        let at = |plane: &[f64], x: usize, y: usize| plane[y * size[0] + x];
        for (x, y) in (40..600).flat_map(|x| (40..440).map(move |y| (x, y))) {
            let (u, v) = (at(&across, x, y), at(&down, x, y));
            assert!((u - x as f64).abs() < 31.0 && (v - y as f64).abs() < 31.0, "{x} {y} shows {u} {v}");
            let (right, below) = (at(&across, x + 1, y) - u, at(&down, x, y + 1) - v);
            assert!((-0.02..2.5).contains(&right), "{direction:?}: at {x} {y} x grows by {right}");
            assert!((-0.02..6.0).contains(&below), "{direction:?}: at {x} {y} y grows by {below}");
            let (shear, slant) = (at(&down, x + 1, y) - v, at(&across, x, y + 1) - u);
            assert!(shear.abs() < 1.5 && slant.abs() < 6.0, "{direction:?}: {x} {y} {shear} {slant}");
        }
    }
}

#[test]
fn strength_fades_in_proportion() {
    // A vibration, which a share of the readout time would not fade, as it reverses.
    let vibration = Vibration { gamma: 1.0, angle: 0.0, shift: [12.0, 0.0] };
    let size = [640.0, 480.0];
    let shown = |strength: f64| {
        let settings = WarpSettings { strength, ..WarpSettings::default() };
        let carry = |point: [f64; 2], _: f64, _: f64| point;
        let direction = ReadoutDirection::TopToBottom;
        let truth = Truth { size, direction, settings, carry: &carry };
        let mut moved = Vec::new();
        for_each_sample(&truth, &vibration.path(), SampleGrid::FULL, |[x, _], [u, _]| moved.push(u - x));
        moved
    };
    // Translations along the rows: rows are unchanged, and displacements are scaled by the strength.
    let whole = shown(1.0);
    for strength in [1e-6, 1e-3, 0.3, 0.9, 0.999] {
        for (part, whole) in shown(strength).iter().zip(&whole) {
            assert!((part - strength * whole).abs() < 2e-3, "{strength}: {part} of {whole}");
        }
    }
}

#[test]
fn extreme_motions_give_a_picture() {
    let size = [320, 240];
    let readout = readout(size[0], size[1], ReadoutDirection::TopToBottom, 1.0);
    let layout = PlaneLayout::packed(size[0], size[1], SampleFormat::U8);
    let mut random = Random(9);
    let mut wild = |scale: f64| {
        let nodes: Vec<_> = (0..50 * 40).map(|_| [0; 2].map(|_| (scale * random.signed()) as f32)).collect();
        let mesh = ResidualMesh { columns: 50, rows: 40, origin: [-170.0, -150.0], spacing: [7.0; 2] };
        ResidualField::new(mesh, nodes).unwrap()
    };
    let spin = sampled(|share| {
        let (sin, cos) = (20.0 * share).sin_cos();
        matrix![cos, -sin, 900.0 * share; sin, cos, 0.0; 1e-3 * share, 1e-3 * sin, 1.0]
    });
    let uniform = |omega, vx| MotionPath::uniform(Twist::new(omega, vx, 1e3), 1.0);
    let paths = [
        spin.clone().with_residual(wild(50.0)),
        MotionPath::STILL.with_residual(wild(1e5)),
        uniform(9.0, -4e3).with_residual(wild(3e38)),
        uniform(f64::NAN, 1.0),
        uniform(1e300, f64::INFINITY),
        spin,
    ];
    for path in paths {
        let mut warper = Warper::new();
        warper.solve(&FrameMotion::new(readout, path), &WarpSettings::default());
        let out = rectify(&warper, &vec![77; 320 * 240], layout, SampleGrid::FULL);
        assert!(out.iter().all(|&sample| sample == 77));
    }
}
