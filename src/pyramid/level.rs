// SPDX-License-Identifier: MIT OR Apache-2.0

//! One level of a pyramid: grey values with a border, so that a patch may extend beyond the picture.

use crate::cpu::{CpuLevel, for_each_cpu};
use crate::parallel::*;

/// Pixels of border on each side, replicated from the picture's edge. A patch of 8 pixels that lies wholly
/// outside and is sampled at sub-pixel positions needs 9, its gradients one more; a picture whose width is
/// not a multiple of 4 up to 3.
pub(crate) const BORDER: usize = 13;

/// Rows of a level per task.
const BAND: usize = 32;

/// Samples that are added side by side.
const LANES: usize = 8;

/// Grey of one resolution, 0 to 255, row by row, with [`BORDER`] replicated pixels on each side.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Level {
    width: usize,
    height: usize,
    stride: usize,
    /// Width and height as numbers that positions are compared with.
    extent: [f32; 2],
    data: Vec<f32>,
}

impl Level {
    /// Pixels in a row, without the border.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// Rows, without the border.
    pub(crate) fn height(&self) -> usize {
        self.height
    }

    /// Width and height.
    #[inline(always)]
    pub(crate) fn extent(&self) -> [f32; 2] {
        self.extent
    }

    /// Samples from one row to the next.
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    /// The samples from pixel (x, y) to the end of the level; indices in the border start at −[`BORDER`].
    /// `None` outside the border.
    #[inline(always)]
    pub(crate) fn from(&self, x: i32, y: i32) -> Option<&[f32]> {
        let [column, row] = [x, y].map(|at| at.wrapping_add(BORDER as i32) as usize);
        // Negative indices have wrapped to values larger than any size.
        if column >= self.stride {
            return None;
        }
        self.data.get(row.wrapping_mul(self.stride).wrapping_add(column)..)
    }

    /// The samples with the border, row by row. There are less than 2²², for an analysed picture has at most 960 pixels a
    /// side: their indices are exact as floats.
    #[inline(always)]
    pub(crate) fn samples(&self) -> &[f32] {
        &self.data
    }

    /// The index of pixel (0, 0) among the [`samples`](Self::samples).
    #[inline(always)]
    pub(crate) fn origin(&self) -> usize {
        BORDER * self.stride + BORDER
    }

    #[cfg(test)]
    pub(crate) fn pixel(&self, x: i32, y: i32) -> f32 {
        self.from(x, y).unwrap()[0]
    }

    /// Mean square of the gradient, by differences of neighbours, of every fourth row.
    pub(crate) fn mean_square_gradient(&self, cpu: CpuLevel) -> f64 {
        let rows = (0..self.height.saturating_sub(1)).step_by(4);
        let count = rows.len() * (self.width / LANES * LANES);
        let row_sum = |y: usize| {
            let (Some(row), Some(below)) = (self.from(0, y as i32), self.from(0, y as i32 + 1)) else {
                return 0.0;
            };
            square_gradients(cpu, row, below, self.width / LANES)
        };
        let sum: f64 = rows.map(|y| f64::from(row_sum(y))).sum();
        sum / count.max(1) as f64
    }

    /// A level for tests.
    #[cfg(test)]
    pub(crate) fn of(width: usize, height: usize, grey: impl Fn(f32, f32) -> f32) -> Self {
        let mut level = Self::default();
        level.write(width, height, |inside, stride| {
            for (y, row) in inside.chunks_exact_mut(stride).enumerate() {
                let pixels = row.iter_mut().skip(BORDER).take(width).enumerate();
                pixels.for_each(|(x, out)| *out = grey(x as f32, y as f32));
                replicate(row, width);
            }
        });
        level
    }

    /// Takes a size and writes the pixels: `work` gets the rows of the picture, and how many samples each has with its
    /// border, which it must [`replicate`].
    pub(super) fn write(&mut self, width: usize, height: usize, work: impl FnOnce(&mut [f32], usize)) {
        self.resize(width, height);
        let stride = self.stride;
        if let Some(inside) = self.data.get_mut(BORDER * stride..(BORDER + height) * stride) {
            work(inside, stride);
        }
        self.replicate_rows();
    }

    /// Weighted means of 4 × 4 pixels of a finer level, (1, 3, 3, 1)/8 along each axis; an odd last row or
    /// column is dropped. Means of 2 × 2 would alias: fine patterns appear as coarser ones with a different
    /// motion.
    pub(super) fn halve(&mut self, cpu: CpuLevel, fine: &Self) {
        let (width, height) = (fine.width / 2, fine.height / 2);
        self.write(width, height, |inside, stride| {
            inside.par_chunks_mut(stride * BAND).enumerate().for_each_init(Vec::new, |line, (band, rows)| {
                line.resize(2 * width + 2, 0.0);
                for (y, row) in rows.chunks_exact_mut(stride).enumerate() {
                    halve_row(cpu, fine, 2 * (band * BAND + y) as i32, line, row, width);
                    replicate(row, width);
                }
            });
        });
    }

    fn resize(&mut self, width: usize, height: usize) {
        (self.width, self.height, self.stride) = (width, height, width + 2 * BORDER);
        self.extent = [width as f32, height as f32];
        self.data.resize(self.stride * (height + 2 * BORDER), 0.0);
    }

    fn replicate_rows(&mut self) {
        let stride = self.stride;
        if self.height == 0 {
            return;
        }
        let last = BORDER + self.height - 1;
        for row in 0..BORDER {
            self.data.copy_within(BORDER * stride..(BORDER + 1) * stride, row * stride);
            self.data.copy_within(last * stride..(last + 1) * stride, (last + 1 + row) * stride);
        }
    }
}

for_each_cpu! {
    /// The sum of the squared gradients of a row's first pixels, so many times [`LANES`].
    fn square_gradients(row: &[f32], below: &[f32], count: usize) -> f32 {
        let right = row.get(1..).unwrap_or(&[]);
        // As many sums as a register holds: floats are added in the order of the code.
        let mut sums = [0.0; LANES];
        let (row, right) = (row.as_chunks::<LANES>().0, right.as_chunks::<LANES>().0);
        let below = below.as_chunks::<LANES>().0;
        for ((row, right), below) in row.iter().zip(right).zip(below).take(count) {
            for (lane, sum) in sums.iter_mut().enumerate() {
                let (x, y) = (right[lane] - row[lane], below[lane] - row[lane]);
                *sum += x * x + y * y;
            }
        }
        sums.iter().sum::<f32>()
    }
}

for_each_cpu! {
    /// One row of `width` pixels from rows `y` − 1 to `y` + 2 of `fine`; `line` is one row between the passes.
    fn halve_row(fine: &Level, y: i32, line: &mut [f32], row: &mut [f32], width: usize) {
        let (Some(a), Some(b), Some(c), Some(d)) =
            (fine.from(-1, y - 1), fine.from(-1, y), fine.from(-1, y + 1), fine.from(-1, y + 2))
        else {
            return;
        };
        for ((((out, a), b), c), d) in line.iter_mut().zip(a).zip(b).zip(c).zip(d) {
            *out = 0.125 * ((a + d) + 3.0 * (b + c));
        }
        let pairs = line.as_chunks::<2>().0;
        let both = pairs.iter().zip(pairs.iter().skip(1));
        for (out, ([a, b], [c, d])) in row.iter_mut().skip(BORDER).take(width).zip(both) {
            *out = 0.125 * ((a + d) + 3.0 * (b + c));
        }
    }
}

/// Fills the border left and right of a row.
pub(super) fn replicate(row: &mut [f32], width: usize) {
    let Some(inside) = row.get(BORDER..BORDER + width) else { return };
    let (Some(&first), Some(&last)) = (inside.first(), inside.last()) else { return };
    row.iter_mut().take(BORDER).for_each(|value| *value = first);
    row.iter_mut().skip(BORDER + width).for_each(|value| *value = last);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_takes_weighted_means_and_drops_the_odd_edge() {
        // Linear except in the border, which repeats the edge.
        let fine = Level::of(9, 5, |x, y| 5.0 * y + x);
        let mut coarse = Level::default();
        coarse.halve(CpuLevel::detect(), &fine);
        assert_eq!((coarse.width(), coarse.height()), (4, 2));
        assert_eq!(coarse.pixel(1, 1), 5.0 * 2.5 + 2.5);
        assert_eq!(coarse.pixel(0, 1), 5.0 * 2.5 + 0.5 + 0.125);
    }

    #[test]
    fn halving_does_not_alias() {
        let stripes = Level::of(64, 16, |x, _| 100.0 * (x % 2.0) + 50.0);
        let mut coarse = Level::default();
        coarse.halve(CpuLevel::detect(), &stripes);
        assert!((1..31).all(|x| (coarse.pixel(x, 4) - 100.0).abs() < 1e-3));
    }

    #[test]
    fn the_gradient_of_a_slope_is_its_steepness() {
        let slope = Level::of(35, 9, |x, y| 3.0 * x + 4.0 * y);
        assert!((slope.mean_square_gradient(CpuLevel::detect()) - 25.0).abs() < 1e-3);
        assert_eq!(Level::of(5, 1, |x, _| x).mean_square_gradient(CpuLevel::detect()), 0.0);
    }

    #[test]
    fn the_border_repeats_the_edge() {
        let level = Level::of(4, 3, |x, y| 10.0 * y + x);
        let border = BORDER as i32;
        assert_eq!(level.pixel(-border, -border), 0.0);
        assert_eq!(level.pixel(-2, 1), 10.0);
        assert_eq!(level.pixel(3 + border, 2 + border), 23.0);
        assert!(level.from(-border - 1, 0).is_none() && level.from(0, 3 + border).is_none());
    }
}
