// SPDX-License-Identifier: MIT OR Apache-2.0

//! Pictures of one channel: smoothing, halving, sampling between pixels.

use rayon::prelude::*;

/// One number a pixel, row by row; pixel centres are at integers.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width` × `height` numbers.
    pub data: Vec<f32>,
}

/// The value and the derivatives of an image at a point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Jet {
    /// The value.
    pub value: f32,
    /// ∂/∂x and ∂/∂y, per pixel.
    pub slope: [f32; 2],
}

impl Image {
    /// An image of `width` × `height` numbers.
    ///
    /// # Panics
    /// Where there are not so many, or none.
    pub fn new(width: usize, height: usize, data: Vec<f32>) -> Self {
        assert_eq!(data.len(), width * height, "an image of {width}×{height}");
        assert!(!data.is_empty(), "an image without pixels");
        Self { width, height, data }
    }

    /// The image whose pixel (x, y) is `of(x, y)`.
    pub fn from_fn(width: usize, height: usize, of: impl Fn(usize, usize) -> f32 + Sync) -> Self {
        let mut data = vec![0.0; width * height];
        let rows = data.par_chunks_mut(width.max(1)).enumerate();
        rows.with_min_len(16)
            .for_each(|(y, row)| row.iter_mut().enumerate().for_each(|(x, at)| *at = of(x, y)));
        Self::new(width, height, data)
    }

    /// An image of the same size, from the value of each pixel.
    pub fn map(&self, of: impl Fn(f32) -> f32 + Sync) -> Self {
        Self::from_fn(self.width, self.height, |x, y| of(self.at(x, y)))
    }

    /// The pixel in column x of row y.
    pub fn at(&self, x: usize, y: usize) -> f32 {
        self.data[y * self.width + x]
    }

    /// The pixel nearest to (x, y), which may be outside: the border goes on as it is.
    pub fn clamped(&self, x: isize, y: isize) -> f32 {
        let (x, y) = (x.max(0) as usize, y.max(0) as usize);
        self.at(x.min(self.width - 1), y.min(self.height - 1))
    }

    /// Row y.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.width..][..self.width]
    }

    /// Whether (x, y) lies between pixel centres.
    pub fn contains(&self, x: f32, y: f32) -> bool {
        (0.0..=(self.width - 1) as f32).contains(&x) && (0.0..=(self.height - 1) as f32).contains(&y)
    }

    /// Half the size, rounded up. Smoothed by (1 3 3 1)/8, so that the pixel (x, y) of the half is
    /// centred at (2x + ½, 2y + ½).
    pub fn halved(&self) -> Self {
        const KERNEL: [f32; 4] = [0.125, 0.375, 0.375, 0.125];
        let taps = |middle: usize, of: &dyn Fn(isize) -> f32| -> f32 {
            let first = 2 * middle as isize - 1;
            KERNEL.iter().zip(first..).map(|(weight, at)| weight * of(at)).sum()
        };
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let narrow =
            Self::from_fn(width, self.height, |x, y| taps(x, &|column| self.clamped(column, y as isize)));
        Self::from_fn(width, height, |x, y| taps(y, &|row| narrow.clamped(x as isize, row)))
    }

    /// Linear interpolation; outside, the nearest border.
    pub fn linear(&self, x: f32, y: f32) -> f32 {
        let (left, top) = (x.floor(), y.floor());
        let (fx, fy) = (x - left, y - top);
        let (left, top) = (left as isize, top as isize);
        let row = |y| self.clamped(left, y) * (1.0 - fx) + self.clamped(left + 1, y) * fx;
        row(top) * (1.0 - fy) + row(top + 1) * fy
    }

    /// Cubic interpolation (Lagrange's cubic through four samples a direction) and its derivatives;
    /// outside, the border goes on.
    pub fn cubic(&self, x: f32, y: f32) -> Jet {
        let (left, top) = (x.floor(), y.floor());
        let across = cubic_weights(x - left);
        let down = cubic_weights(y - top);
        let (left, top) = (left as isize - 1, top as isize - 1);
        let inside = left >= 0 && left + 4 <= self.width as isize;
        let mut jet = Jet::default();
        for j in 0..4 {
            let y = (top + j as isize).clamp(0, self.height as isize - 1);
            let mut samples = [0.0; 4];
            if inside {
                samples.copy_from_slice(&self.row(y as usize)[left as usize..][..4]);
            } else {
                (left..).zip(&mut samples).for_each(|(x, sample)| *sample = self.clamped(x, y));
            }
            let (value, slope) = (dot(&across.values, &samples), dot(&across.slopes, &samples));
            jet.value += down.values[j] * value;
            jet.slope[0] += down.values[j] * slope;
            jet.slope[1] += down.slopes[j] * value;
        }
        jet
    }

    /// ∂/∂x and ∂/∂y at a pixel by (1 −8 0 8 −1)/12, as the paper's code takes them.
    pub fn slope(&self, x: usize, y: usize) -> [f32; 2] {
        let (x, y) = (x as isize, y as isize);
        let difference = |of: &dyn Fn(isize) -> f32| (8.0 * (of(1) - of(-1)) - (of(2) - of(-2))) / 12.0;
        [difference(&|d| self.clamped(x + d, y)), difference(&|d| self.clamped(x, y + d))]
    }
}

/// Weights of four successive samples.
struct Weights {
    /// For the value.
    values: [f32; 4],
    /// For the derivative.
    slopes: [f32; 4],
}

/// The weights for the place `t` between the middle two samples.
#[inline(always)]
fn cubic_weights(t: f32) -> Weights {
    let (a, b, c) = (t + 1.0, t - 1.0, t - 2.0);
    let square = 3.0 * t * t;
    Weights {
        values: [-t * b * c / 6.0, a * b * c / 2.0, -a * t * c / 2.0, a * t * b / 6.0],
        slopes: [
            -(square - 6.0 * t + 2.0) / 6.0,
            (square - 4.0 * t - 1.0) / 2.0,
            -(square - 2.0 * t - 2.0) / 2.0,
            (square - 1.0) / 6.0,
        ],
    }
}

#[inline(always)]
fn dot(a: &[f32; 4], b: &[f32; 4]) -> f32 {
    (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// x³ − 2x²y + 3y + 1, scaled to moderate numbers, and its derivatives.
    fn cubic(x: f32, y: f32) -> Jet {
        let (x, y) = (x / 8.0, y / 8.0);
        let slope = [(3.0 * x * x - 4.0 * x * y) / 8.0, (3.0 - 2.0 * x * x) / 8.0];
        Jet { value: x * x * x - 2.0 * x * x * y + 3.0 * y + 1.0, slope }
    }

    #[test]
    fn cubics_are_interpolated_exactly() {
        let image = Image::from_fn(16, 12, |x, y| cubic(x as f32, y as f32).value);
        for (x, y) in [(3.0, 4.0), (5.25, 6.5), (1.75, 9.125), (11.9, 3.3)] {
            let (found, exact) = (image.cubic(x, y), cubic(x, y));
            assert!((found.value - exact.value).abs() < 1e-4, "{found:?} is not {exact:?}");
            for (found, exact) in found.slope.iter().zip(exact.slope) {
                assert!((found - exact).abs() < 1e-4, "{found} is not {exact}");
            }
        }
        let (found, exact) = (image.slope(6, 5), cubic(6.0, 5.0).slope);
        assert!((found[0] - exact[0]).abs() < 1e-5 && (found[1] - exact[1]).abs() < 1e-5);
    }

    #[test]
    fn half_a_ramp_is_a_ramp_seen_at_half_pixels() {
        let half = Image::from_fn(17, 10, |x, y| x as f32 + 10.0 * y as f32).halved();
        assert_eq!((half.width, half.height), (9, 5));
        let exact = (2.0 * 3.0 + 0.5) + 10.0 * (2.0 * 2.0 + 0.5);
        assert!((half.at(3, 2) - exact).abs() < 1e-4, "{} is not {exact}", half.at(3, 2));
    }

    #[test]
    fn linear_interpolation_by_hand() {
        let image = Image::new(2, 2, vec![0.0, 4.0, 8.0, 20.0]);
        // ¾ of the way across: 3 and 17; half of the way down: 10. Outside, the corner.
        assert_eq!(image.linear(0.75, 0.5), 10.0);
        assert_eq!(image.linear(5.0, 9.0), 20.0);
        assert!(image.contains(1.0, 0.0) && !image.contains(1.01, 0.0) && !image.contains(0.5, -0.01));
    }
}
