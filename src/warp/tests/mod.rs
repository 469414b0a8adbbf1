// SPDX-License-Identifier: MIT OR Apache-2.0

mod accuracy;
mod borders;
mod kernels;
mod paths;
mod picture;

use super::*;
use crate::motion::{MotionPath, Twist};
use crate::plane::SampleFormat;
use crate::readout::{Readout, ReadoutDirection, ReadoutTime};
use nalgebra::Vector2;

/// A readout of ratio `gamma` at one frame a second, so that twists are per frame.
fn readout(width: usize, height: usize, direction: ReadoutDirection, gamma: f64) -> Readout {
    Readout::new(width, height, direction, ReadoutTime::Seconds(gamma), 1.0).unwrap()
}

fn path(readout: &Readout, omega: f64, vx: f64, vy: f64) -> MotionPath {
    MotionPath::uniform(Twist::new(omega, vx, vy), readout.time)
}

/// Rectifies packed samples of a full-size plane.
fn rectify(warper: &Warper, data: &[u8], layout: PlaneLayout, grid: SampleGrid) -> Vec<u8> {
    let mut out = vec![0; data.len()];
    let mut dst = PlaneMut::new(&mut out, layout).unwrap();
    warper.warp(&Plane::new(data, layout).unwrap(), &mut dst, grid, 0).unwrap();
    out
}

/// A plane of one 8-bit channel from a function of the pixel.
fn picture(width: usize, height: usize, value: impl Fn(f64, f64) -> f64) -> Vec<u8> {
    let pixel = |index: usize| ((index % width) as f64, (index / width) as f64);
    (0..width * height)
        .map(|index| {
            let (x, y) = pixel(index);
            value(x, y).round().clamp(0.0, 255.0) as u8
        })
        .collect()
}

/// Reproducible pseudo-random numbers (xorshift).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() >> 11) as usize % limit
    }

    /// From −1 to 1.
    fn signed(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}
