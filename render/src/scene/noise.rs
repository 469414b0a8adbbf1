// SPDX-License-Identifier: MIT OR Apache-2.0

//! Periodic gradient noise: the raw material of the procedural textures.

use std::ops::Range;

/// Noise on a lattice, determined by its seed; a hash, so that it needs no tables.
#[derive(Clone, Copy, Debug)]
pub struct Noise {
    seed: u32,
}

impl Noise {
    /// The noise of a seed.
    pub fn new(seed: u64) -> Self {
        Self { seed: scramble(seed as u32 ^ scramble((seed >> 32) as u32 ^ 0x9e37_79b9)) }
    }

    /// Another, unrelated noise.
    pub fn fork(self, label: u32) -> Self {
        Self { seed: scramble(self.seed ^ scramble(label.wrapping_add(0x85eb_ca6b))) }
    }

    /// A number in 0..1 for each cell.
    pub fn cell(self, x: i32, y: i32) -> f32 {
        self.hash(x, y) as f32 / 4_294_967_296.0
    }

    /// Gradient noise in about −1..1 that repeats after `period` cells, powers of two, in x and y.
    pub fn gradient(self, x: f32, y: f32, period: [i32; 2]) -> f32 {
        let ((x0, fx), (y0, fy)) = (split(x), split(y));
        let corner = |i: i32, j: i32| {
            let hash = self.hash((x0 + i) & (period[0] - 1), (y0 + j) & (period[1] - 1));
            let slope = |bits: u32| (bits & 0xffff) as f32 / 32768.0 - 1.0;
            slope(hash) * (fx - i as f32) + slope(hash >> 16) * (fy - j as f32)
        };
        let (sx, sy) = (quintic(fx), quintic(fy));
        let top = mix(corner(0, 0), corner(1, 0), sx);
        let bottom = mix(corner(0, 1), corner(1, 1), sx);
        1.6 * mix(top, bottom, sy)
    }

    /// A sum of octaves over the unit square: octave o has 2^o cells and weighs gain^o.
    pub fn fractal(self, u: f32, v: f32, octaves: Range<u32>, gain: f32) -> f32 {
        let mut weight = 1.0;
        let mut sum = 0.0;
        for octave in octaves {
            let cells = 1 << octave;
            sum += weight * self.fork(octave).gradient(u * cells as f32, v * cells as f32, [cells; 2]);
            weight *= gain;
        }
        sum
    }

    fn hash(self, x: i32, y: i32) -> u32 {
        scramble(self.seed ^ scramble((x as u32).wrapping_mul(0x27d4_eb2f) ^ (y as u32).rotate_left(16)))
    }
}

/// The integer below a number and what is above it. (`f32::floor` is a library call where the
/// target is not known to round in hardware, and this is the innermost loop.)
pub fn split(x: f32) -> (i32, f32) {
    let whole = x as i32 - i32::from(x < 0.0);
    (whole, x - whole as f32)
}

/// Linear interpolation from `a` to `b`.
pub fn mix(a: f32, b: f32, share: f32) -> f32 {
    a + (b - a) * share
}

/// A finaliser of 32-bit hashes (the constants of MurmurHash3's fmix32).
fn scramble(mut bits: u32) -> u32 {
    bits ^= bits >> 16;
    bits = bits.wrapping_mul(0x85eb_ca6b);
    bits ^= bits >> 13;
    bits = bits.wrapping_mul(0xc2b2_ae35);
    bits ^ (bits >> 16)
}

/// 6t⁵ − 15t⁴ + 10t³: first and second derivative vanish at both ends.
fn quintic(t: f32) -> f32 {
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeats_after_its_period_and_differs_by_seed() {
        let (a, b) = (Noise::new(1), Noise::new(2));
        for (x, y) in [(0.3, 0.7), (3.25, 1.5), (2.9, 3.1)] {
            let value = a.gradient(x, y, [4, 4]);
            assert!((value - a.gradient(x + 4.0, y - 4.0, [4, 4])).abs() < 1e-5);
            assert_ne!(value, b.gradient(x, y, [4, 4]));
        }
    }

    #[test]
    fn split_rounds_down() {
        assert_eq!(split(2.25), (2, 0.25));
        assert_eq!(split(-0.75), (-1, 0.25));
        assert_eq!(split(0.0), (0, 0.0));
    }

    #[test]
    fn gradient_noise_vanishes_on_the_lattice_and_stays_in_range() {
        let noise = Noise::new(7);
        assert_eq!(noise.gradient(2.0, 3.0, [8, 8]), 0.0);
        let values = (0..10_000).map(|i| noise.gradient(i as f32 * 0.137, i as f32 * 0.071, [64, 64]));
        let (low, high) = values.fold((0.0f32, 0.0f32), |(low, high), v| (low.min(v), high.max(v)));
        assert!(low > -1.7 && high < 1.7 && high - low > 0.8, "{low}..{high}");
    }
}
