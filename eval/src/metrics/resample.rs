// SPDX-License-Identifier: MIT OR Apache-2.0

//! The picture that a correction makes of a frame.

use baselines::methods::Correction;
use nalgebra::Vector2;
use rayon::prelude::*;
use render::scene::Frame;

/// Distance in pixels of the nodes at which a correction is inverted. Between them its inverse is
/// interpolated bilinearly.
const NODE_STEP: usize = 8;
/// A node is settled once the correction takes it to within this many pixels of its target.
const SETTLED: f64 = 1e-3;
/// The fixed point halves its error at least once a step for any displacement that changes by less
/// than half a pixel a pixel.
const MOST_STEPS: usize = 20;

/// A rectified picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rectified {
    /// The picture, of the frame's size.
    pub frame: Frame,
    /// Per pixel, row by row: whether it shows a place inside the frame as it arrived. The others
    /// repeat the colours of the border.
    pub inside: Vec<bool>,
}

/// Rectifies a frame: bicubic sampling (Catmull–Rom, as Keys 1981 with a = −½) of the places that
/// `correction` takes to each pixel, with the border repeated outwards.
///
/// `correction` maps pixels of the frame as it arrived to the rectified picture and is inverted here.
pub fn rectified(frame: &Frame, correction: &dyn Correction) -> Rectified {
    let inverse = Inverse::new(frame.width, frame.height, correction);
    let mut rgb = vec![0; frame.rgb.len()];
    let mut inside = vec![false; frame.width * frame.height];
    let rows = rgb.par_chunks_mut(3 * frame.width).zip(inside.par_chunks_mut(frame.width));
    rows.enumerate().for_each(|(y, (rgb, inside))| {
        for (x, (pixel, inside)) in rgb.chunks_exact_mut(3).zip(inside).enumerate() {
            let source = inverse.source(x, y);
            *inside = contains(frame, source);
            pixel.copy_from_slice(&bicubic(frame, source));
        }
    });
    Rectified { frame: Frame { width: frame.width, height: frame.height, rgb }, inside }
}

fn contains(frame: &Frame, at: Vector2<f64>) -> bool {
    let within = |value: f64, length: usize| value >= -0.5 && value <= length as f64 - 0.5;
    within(at.x, frame.width) && within(at.y, frame.height)
}

/// Where each pixel of a rectified picture is seen in the frame as it arrived.
struct Inverse {
    /// Nodes in a row.
    columns: usize,
    /// The sources of the nodes, row by row. The last row and column lie on the frame's edge or beyond.
    sources: Vec<Vector2<f64>>,
}

impl Inverse {
    fn new(width: usize, height: usize, correction: &dyn Correction) -> Self {
        let nodes = |length: usize| length.saturating_sub(1) / NODE_STEP + 2;
        let (columns, rows) = (nodes(width), nodes(height));
        let source = |index: usize| {
            let node = Vector2::new((index % columns) as f64, (index / columns) as f64);
            inverted(correction, node * NODE_STEP as f64)
        };
        Self { columns, sources: (0..rows * columns).into_par_iter().map(source).collect() }
    }

    fn source(&self, x: usize, y: usize) -> Vector2<f64> {
        let first = y / NODE_STEP * self.columns + x / NODE_STEP;
        let share = |value: usize| (value % NODE_STEP) as f64 / NODE_STEP as f64;
        let (right, down) = (share(x), share(y));
        let row = |start: usize| self.sources[start] * (1.0 - right) + self.sources[start + 1] * right;
        row(first) * (1.0 - down) + row(first + self.columns) * down
    }
}

/// The place that `correction` takes to `target`, by the fixed point x ← target − (C(x) − x).
fn inverted(correction: &dyn Correction, target: Vector2<f64>) -> Vector2<f64> {
    let mut source = target;
    for _ in 0..MOST_STEPS {
        let miss = target - correction.correct(source);
        source += miss;
        if miss.norm() < SETTLED {
            break;
        }
    }
    source
}

/// The weights of four neighbours for a point `t` (0 to 1) after the second.
fn catmull_rom(t: f32) -> [f32; 4] {
    let (squared, cubed) = (t * t, t * t * t);
    [
        -0.5 * t + squared - 0.5 * cubed,
        1.0 - 2.5 * squared + 1.5 * cubed,
        0.5 * t + 2.0 * squared - 1.5 * cubed,
        -0.5 * squared + 0.5 * cubed,
    ]
}

fn bicubic(frame: &Frame, at: Vector2<f64>) -> [u8; 3] {
    let (column, row) = (at.x.floor(), at.y.floor());
    let across = catmull_rom((at.x - column) as f32);
    let down = catmull_rom((at.y - row) as f32);
    let columns = neighbours(column, frame.width).map(|x| 3 * x);
    let mut sum = [0.0f32; 3];
    for (y, weight) in neighbours(row, frame.height).into_iter().zip(down) {
        let line = &frame.rgb[3 * y * frame.width..];
        for (x, across) in columns.into_iter().zip(across) {
            let weight = weight * across;
            for (sum, byte) in sum.iter_mut().zip(&line[x..x + 3]) {
                *sum += weight * f32::from(*byte);
            }
        }
    }
    sum.map(|value| value.round() as u8)
}

/// The four places around `first` to `first` + 1, the border repeated. A place that is no number counts as 0.
fn neighbours(first: f64, length: usize) -> [usize; 4] {
    [-1.0, 0.0, 1.0, 2.0].map(|step| (first + step).max(0.0).min((length - 1) as f64) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture whose colours are functions of the place.
    fn picture(width: usize, height: usize, colour: impl Fn(f64, f64) -> [f64; 3]) -> Frame {
        let place = |index: usize| ((index % width) as f64, (index / width) as f64);
        let rgb = (0..width * height).flat_map(|index| {
            let (x, y) = place(index);
            colour(x, y).map(|value| value.round() as u8)
        });
        Frame { width, height, rgb: rgb.collect() }
    }

    fn waves(x: f64, y: f64) -> [f64; 3] {
        [120.0 + 90.0 * (x / 9.0).sin(), 120.0 + 90.0 * (y / 8.0).cos(), 60.0 + x / 2.0 + y / 3.0]
    }

    #[test]
    fn no_correction_changes_no_byte() {
        let frame = picture(37, 21, waves);
        let same = rectified(&frame, &|pixel| pixel);
        assert_eq!(same.frame, frame);
        assert!(same.inside.iter().all(|inside| *inside));
    }

    #[test]
    fn a_whole_shift_moves_bytes_and_repeats_the_border() {
        let frame = picture(40, 24, waves);
        let moved = rectified(&frame, &|pixel| pixel + Vector2::new(3.0, -2.0));
        let at = |frame: &Frame, x: usize, y: usize| {
            let start = 3 * (y * frame.width + x);
            [0, 1, 2].map(|channel| frame.rgb[start + channel])
        };
        for y in 0..24 {
            for x in 0..40 {
                let (from_x, from_y) = (x.max(3) - 3, (y + 2).min(23));
                assert_eq!(at(&moved.frame, x, y), at(&frame, from_x, from_y), "{x} {y}");
                assert_eq!(moved.inside[y * 40 + x], x >= 3 && y < 22, "{x} {y}");
            }
        }
    }

    #[test]
    fn a_shear_with_a_known_inverse_is_undone() {
        // The lean of a sideways pan, and a sinusoid over the rows as vibration makes it.
        let lean = |y: f64| 0.05 * (y - 120.0) + 2.0 * (y / 30.0).sin();
        let seen = picture(320, 240, |x, y| waves(x + lean(y), y));
        let upright = picture(320, 240, waves);
        let rectified =
            rectified(&seen, &|pixel: Vector2<f64>| Vector2::new(pixel.x + lean(pixel.y), pixel.y));
        let mut worst = 0;
        for y in 8..232 {
            for x in 16..304 {
                let start = 3 * (y * 320 + x);
                for channel in start..start + 3 {
                    worst = worst.max(rectified.frame.rgb[channel].abs_diff(upright.rgb[channel]));
                }
            }
        }
        // Half a grey level of rounding each; interpolation between nodes adds 0.018 px × 10 levels a pixel.
        assert!(worst <= 1, "{worst} grey levels");
    }

    #[test]
    fn the_inverse_is_exact_at_nodes_and_close_between() {
        // A turn about a point, growing over the rows: 12 px at the corners.
        let centre = Vector2::new(319.5, 239.5);
        let correction = move |pixel: Vector2<f64>| {
            let (sin, cos) = (0.1 * (0.5 - pixel.y / 480.0)).sin_cos();
            let x = pixel - centre;
            centre + Vector2::new(cos * x.x - sin * x.y, sin * x.x + cos * x.y)
        };
        let inverse = Inverse::new(640, 480, &correction);
        let miss =
            |x: usize, y: usize| (correction(inverse.source(x, y)) - Vector2::new(x as f64, y as f64)).norm();
        for y in (0..480).step_by(3) {
            for x in (0..640).step_by(3) {
                let most = if x % NODE_STEP == 0 && y % NODE_STEP == 0 { SETTLED } else { 0.01 };
                assert!(miss(x, y) <= most, "{} px at {x} {y}", miss(x, y));
            }
        }
    }
}
