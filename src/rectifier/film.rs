// SPDX-License-Identifier: MIT OR Apache-2.0

//! Frames of a picture whose motion is known in closed form, and their way through a rectifier.

use super::*;
use crate::plane::{Plane, PlaneLayout, SampleFormat};
use nalgebra::Vector2;

pub const WIDTH: usize = 320;
pub const HEIGHT: usize = 240;
pub const PERIOD: f64 = 0.04;
/// Pixels a second by which most films move.
pub const VELOCITY: Vector2<f64> = Vector2::new(180.0, -60.0);

/// Smooth, non-repetitive texture at three scales.
pub fn texture(x: f64, y: f64) -> f64 {
    128.0
        + 60.0 * noise(x / 4.0, y / 4.0)
        + 60.0 * noise(x / 11.0, y / 11.0)
        + 60.0 * noise(x / 31.0, y / 31.0)
}

/// Noise in −1 to 1 on the integer lattice, smoothly interpolated. Without functions of the C library: with them, drawing the frames
/// takes most of the tests' time.
fn noise(x: f64, y: f64) -> f64 {
    let floor = |value: f64| value as i64 - i64::from(value < value as i64 as f64);
    let (column, row) = (floor(x), floor(y));
    let ease = |t: f64| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
    let (u, v) = (ease(x - column as f64), ease(y - row as f64));
    let corner = |i: i64, j: i64| {
        let place = (column + i).wrapping_mul(0x9e37_79b1) ^ (row + j).wrapping_mul(0x85eb_ca77);
        let mixed = ((place ^ (place >> 15)) as u64).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (mixed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    let upper = corner(0, 0) * (1.0 - u) + corner(1, 0) * u;
    let lower = corner(0, 1) * (1.0 - u) + corner(1, 1) * u;
    upper * (1.0 - v) + lower * v
}

/// A frame that starts at `time` of a picture that moves by `velocity` px/s, read top to bottom over
/// a whole period.
pub fn frame(time: f64, velocity: Vector2<f64>) -> Vec<u8> {
    let pixels = (0..HEIGHT).flat_map(|row| (0..WIDTH).map(move |column| (row, column)));
    pixels
        .map(|(row, column)| {
            let exposed = time + PERIOD * (row as f64 + 0.5) / HEIGHT as f64;
            let at = Vector2::new(column as f64, row as f64) - velocity * exposed;
            (texture(at.x, at.y) + 0.5) as u8
        })
        .collect()
}

pub fn push(rectifier: &mut Rectifier, pixels: &[u8], time: f64, duplicate: Duplicate) {
    let layout = PlaneLayout::packed(WIDTH, HEIGHT, SampleFormat::U8);
    rectifier.push(&Luma::from(Plane::new(pixels, layout).unwrap()), Some(time), duplicate).unwrap();
}

pub fn pops(rectifier: &mut Rectifier) -> Vec<FrameSolution> {
    std::iter::from_fn(|| rectifier.pop()).collect()
}

pub fn assert_velocity(solution: &FrameSolution, velocity: Vector2<f64>) {
    let twist = solution.motion.path().mean_twist();
    let off = (twist.velocity - velocity).norm() * PERIOD;
    assert!(off < 0.1 && (twist.omega * PERIOD).abs() < 5e-4, "{off} px a frame off: {solution:?}");
    assert!(solution.confidence > 0.9, "{solution:?}");
}
