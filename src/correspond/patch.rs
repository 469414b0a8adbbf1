// SPDX-License-Identifier: MIT OR Apache-2.0

//! Square patches of grey: sampling at sub-pixel positions, and sums.
//!
//! All functions are inlined into their callers, which are compiled once for each CPU level. No sum
//! is reordered and no operations are fused, so that results are bit-exact across levels.

use crate::pyramid::Level;
use nalgebra::{Matrix2, Vector2};

/// Side of a patch in pixels.
pub(super) const PATCH_SIDE: usize = 16;

/// Samples of a row that the cubic kernel reads for one row of a patch.
const CUBIC_WIDTH: usize = PATCH_SIDE + 3;

/// Samples in a row of a patch with a margin of one pixel.
const WIDTH_WITH_MARGIN: usize = PATCH_SIDE + 2;

/// A patch, row by row.
pub(super) type PatchValues = [[f32; PATCH_SIDE]; PATCH_SIDE];

/// A patch with a margin of one pixel, row by row.
pub(super) type Samples = [[f32; WIDTH_WITH_MARGIN]; WIDTH_WITH_MARGIN];

/// Sums over a sampled patch, for one step of the registration.
pub(super) struct Sums {
    /// ∑ template · patch.
    pub(super) values: f32,
    /// ∑ gradient · patch.
    pub(super) slope: Vector2<f32>,
    /// ∑ patch.
    pub(super) sum: f32,
    /// ∑ patch².
    pub(super) squares: f32,
}

/// Weights of the cubic through four samples, at the fraction `t` between the middle two.
///
/// Lagrange's cubic, not Catmull–Rom: at a quarter of a pixel and a wavelength of 8 pixels its phase
/// error is 0.001 pixels, that of Catmull–Rom and of linear interpolation 0.01, which would be
/// measured as motion.
#[inline(always)]
fn cubic_weights(t: f32) -> [f32; 4] {
    let (a, b, c) = (t + 1.0, t - 1.0, t - 2.0);
    [-t * b * c / 6.0, a * b * c / 2.0, -a * t * c / 2.0, a * t * b / 6.0]
}

/// Samples a patch with top left pixel `corner`, subtracts `bias`, and sums the products with `values`
/// and `gradients`; `None` if the kernel leaves the image.
///
/// The patch is never stored: each of its rows is summed at once.
#[inline(always)]
pub(super) fn sample_sums(
    level: &Level,
    corner: Vector2<f32>,
    bias: f32,
    values: &PatchValues,
    gradients: [&PatchValues; 2],
) -> Option<Sums> {
    let whole = Vector2::new(corner.x.floor(), corner.y.floor());
    let last = Vector2::new(
        level.width() as f32 - (PATCH_SIDE + 2) as f32,
        level.height() as f32 - (PATCH_SIDE + 2) as f32,
    );
    let inside = whole.x >= 1.0 && whole.y >= 1.0 && whole.x <= last.x && whole.y <= last.y;
    if !inside {
        return None;
    }
    let across = cubic_weights(corner.x - whole.x);
    let down = cubic_weights(corner.y - whole.y);
    let (x, y) = (whole.x as i32 - 1, whole.y as i32 - 1);
    let mut rows = [[0.0; PATCH_SIDE]; CUBIC_WIDTH];
    for (r, row) in rows.iter_mut().enumerate() {
        let source: &[f32; CUBIC_WIDTH] = level.from(x, y + r as i32)?.first_chunk()?;
        for (c, value) in row.iter_mut().enumerate() {
            *value = (across[0] * source[c] + across[1] * source[c + 1])
                + (across[2] * source[c + 2] + across[3] * source[c + 3]);
        }
    }
    // One sum per column, so that the additions of a row are independent.
    let mut sums = [[0.0; PATCH_SIDE]; 5];
    for r in 0..PATCH_SIDE {
        let (value, [gradient_x, gradient_y]) = (&values[r], gradients.map(|gradient| &gradient[r]));
        for c in 0..PATCH_SIDE {
            let grey = (down[0] * rows[r][c] + down[1] * rows[r + 1][c])
                + (down[2] * rows[r + 2][c] + down[3] * rows[r + 3][c])
                - bias;
            sums[0][c] += value[c] * grey;
            sums[1][c] += gradient_x[c] * grey;
            sums[2][c] += gradient_y[c] * grey;
            sums[3][c] += grey;
            sums[4][c] += grey * grey;
        }
    }
    let [values, x, y, sum, squares] = sums.map(total);
    Some(Sums { values, slope: Vector2::new(x, y), sum, squares })
}

/// Columns that the first pass of [`sample_distorted`] produces for a patch of small distortion.
const MIN_COLUMNS: usize = 24;

/// Columns that the first pass of [`sample_distorted`] produces at most.
const MAX_COLUMNS: usize = 40;

/// Zero columns on either side, which a shrinking patch reads with weights of zero.
const PADDING: usize = 12;

/// Allowed distance in x between neighbouring samples of a row, in pixels.
const SPACING: std::ops::RangeInclusive<f32> = 0.5..=2.0;

/// Samples at `first` + `distortion`·(c, r), for 18 columns c and rows r, linearly interpolated;
/// `None` if they leave the image or their spacing is not in [`SPACING`].
///
/// Two passes after Catmull and Smith: row r is first sampled down the columns, along the line on
/// which its samples lie, then along that line. Both passes weight the pixels near the line by the hat
/// function of their distance, which needs no gathers: of the order of 3 + 3 taps for each of 18 × 24
/// samples, five operations each, 13 k operations in vectors.
#[inline(always)]
pub(super) fn sample_distorted(
    level: &Level,
    first: Vector2<f32>,
    distortion: &Matrix2<f32>,
) -> Option<Samples> {
    let span = (WIDTH_WITH_MARGIN - 1) as f32;
    let corners = [(0.0, 0.0), (span, 0.0), (0.0, span), (span, span)];
    let last = Vector2::new(level.width() as f32 - 1.0, level.height() as f32 - 1.0);
    let inside = corners.iter().all(|&(c, r)| {
        let at = first + distortion * Vector2::new(c, r);
        at.x >= 0.0 && at.y >= 0.0 && at.x < last.x && at.y < last.y
    });
    let spacing = distortion.m11;
    if !inside || !SPACING.contains(&spacing) {
        return None;
    }
    let columns = (span * spacing) as usize + 3;
    let mut samples = [[0.0; WIDTH_WITH_MARGIN]; WIDTH_WITH_MARGIN];
    for (r, row) in samples.iter_mut().enumerate() {
        let start = first + distortion.column(1) * r as f32;
        let line = SampleLine { start, slope: distortion.m21 / spacing, columns };
        let mut middle = [0.0; PADDING + MAX_COLUMNS + PADDING];
        if columns <= MIN_COLUMNS {
            line.sample_down::<MIN_COLUMNS>(level, &mut middle);
        } else {
            line.sample_down::<MAX_COLUMNS>(level, &mut middle);
        }
        *row = *sample_along(&middle, start.x - start.x.floor(), spacing).first_chunk()?;
    }
    Some(samples)
}

/// The line on which the samples of one row lie.
struct SampleLine {
    start: Vector2<f32>,
    slope: f32,
    /// Whole columns that the line crosses.
    columns: usize,
}

impl SampleLine {
    /// Samples the picture where the line crosses the columns, starting with the column left of its start.
    #[inline(always)]
    fn sample_down<const W: usize>(&self, level: &Level, out: &mut [f32; PADDING + MAX_COLUMNS + PADDING]) {
        let left = self.start.x.floor();
        let first = self.start.y - self.slope * (self.start.x - left);
        let end = first + self.slope * (self.columns - 1) as f32;
        let top = first.min(end).floor();
        let taps = (first.max(end) - top) as usize + 2;
        let mut sums = [0.0; W];
        for tap in 0..taps {
            let row = (top + tap as f32).clamp(0.0, level.height() as f32 - 1.0) as i32;
            let pixels = padded::<W>(level, row, left as i32, self.columns);
            let distance = first - top - tap as f32;
            for (i, sum) in sums.iter_mut().enumerate() {
                *sum += hat(distance + self.slope * i as f32) * pixels[i];
            }
        }
        out[PADDING..PADDING + W].copy_from_slice(&sums);
    }
}

/// `W` pixels of a row of a level, starting at `left`; those past the first `count` are arbitrary.
#[inline(always)]
fn padded<const W: usize>(level: &Level, row: i32, left: i32, count: usize) -> [f32; W] {
    let rest = level.from(left, row).unwrap_or(&[]);
    if let Some(pixels) = rest.first_chunk() {
        return *pixels;
    }
    let mut pixels = [0.0; W];
    pixels.iter_mut().zip(rest).take(count).for_each(|(out, pixel)| *out = *pixel);
    pixels
}

/// Samples at `fraction` + `spacing`·c, counted from the end of the padding.
#[inline(always)]
fn sample_along(
    middle: &[f32; PADDING + MAX_COLUMNS + PADDING],
    fraction: f32,
    spacing: f32,
) -> [f32; MIN_COLUMNS] {
    // Sample c lies at pixel c + offset; the offset starts at `fraction`.
    let growth = (spacing - 1.0) * (MIN_COLUMNS - 1) as f32;
    let (least, most) = (fraction + growth.min(0.0), fraction + growth.max(0.0));
    let lowest = least.floor();
    let taps = (most - lowest) as usize + 2;
    let mut out = [0.0; MIN_COLUMNS];
    for tap in 0..taps {
        let at = (PADDING as f32 + lowest) as usize + tap;
        let Some(pixels) = middle.get(at..).and_then(|rest| rest.first_chunk::<MIN_COLUMNS>()) else { break };
        let distance = fraction - lowest - tap as f32;
        for (c, out) in out.iter_mut().enumerate() {
            *out += hat(distance + (spacing - 1.0) * c as f32) * pixels[c];
        }
    }
    out
}

/// Weight of a pixel in linear interpolation, as a function of its distance.
#[inline(always)]
fn hat(distance: f32) -> f32 {
    let weight = 1.0 - distance.abs();
    if weight > 0.0 { weight } else { 0.0 }
}

/// Sum over all columns: pairwise, for a short dependency chain.
#[inline(always)]
fn total(sums: [f32; PATCH_SIDE]) -> f32 {
    let mut eight = [0.0; PATCH_SIDE / 2];
    for (i, eight) in eight.iter_mut().enumerate() {
        *eight = sums[i] + sums[i + PATCH_SIDE / 2];
    }
    let [a, b, c, d, e, f, g, h] = eight;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

#[inline(always)]
pub(super) fn dot(a: &PatchValues, b: &PatchValues) -> f32 {
    let mut sums = [0.0; PATCH_SIDE];
    for (a, b) in a.iter().zip(b) {
        for c in 0..PATCH_SIDE {
            sums[c] += a[c] * b[c];
        }
    }
    total(sums)
}

/// Adds `factor` times `b` to `a`.
#[inline(always)]
pub(super) fn combine(a: &mut PatchValues, b: &PatchValues, factor: f32) {
    for (a, b) in a.as_flattened_mut().iter_mut().zip(b.as_flattened()) {
        *a += factor * b;
    }
}

/// Subtracts the mean, and returns it.
#[inline(always)]
pub(super) fn remove_mean(a: &mut PatchValues) -> f32 {
    let mut sums = [0.0; PATCH_SIDE];
    for row in a.iter() {
        for c in 0..PATCH_SIDE {
            sums[c] += row[c];
        }
    }
    let mean = total(sums) / (PATCH_SIDE * PATCH_SIDE) as f32;
    a.as_flattened_mut().iter_mut().for_each(|value| *value -= mean);
    mean
}
