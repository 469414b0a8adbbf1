//! Square patches of grey: sampling between pixels, and sums.
//!
//! Everything here is inlined into its callers, which are compiled once for each CPU level. No sum
//! is reordered and nothing is fused, so that all levels give the same bits.

use crate::pyramid::Level;
use nalgebra::{Matrix2, Vector2};

/// Side of a patch in pixels.
pub(super) const FINE: usize = 16;

/// Samples that a cubic kernel needs for the results of a row.
const TAPPED: usize = FINE + 3;

/// Samples of a row that a patch and its gradients need.
const AROUND: usize = FINE + 2;

/// A patch, row by row.
pub(super) type Block = [[f32; FINE]; FINE];

/// A patch and a pixel on each side.
pub(super) type Samples = [[f32; AROUND]; AROUND];

/// What one step of a registration needs to know of the patch it sampled.
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

/// Weights of the cubic through four samples, at `t` between the middle two.
///
/// Lagrange's cubic, not Catmull and Rom's: at a quarter of a pixel and a wavelength of 8 pixels its
/// phase is wrong by 0.001 pixels, theirs (and the linear one's) by 0.01, which would be measured as
/// motion.
#[inline(always)]
fn cubic_weights(t: f32) -> [f32; 4] {
    let (a, b, c) = (t + 1.0, t - 1.0, t - 2.0);
    [-t * b * c / 6.0, a * b * c / 2.0, -a * t * c / 2.0, a * t * b / 6.0]
}

/// Samples a patch from `corner` on, less `bias`, and sums their products with `values` and
/// `gradients`; `None` where the kernel leaves the image.
///
/// The patch is never stored: each of its rows is made, used, and forgotten.
#[inline(always)]
pub(super) fn sample_sums(
    level: &Level,
    corner: Vector2<f32>,
    bias: f32,
    values: &Block,
    gradients: [&Block; 2],
) -> Option<Sums> {
    let whole = Vector2::new(corner.x.floor(), corner.y.floor());
    let last =
        Vector2::new(level.width() as f32 - (FINE + 2) as f32, level.height() as f32 - (FINE + 2) as f32);
    let inside = whole.x >= 1.0 && whole.y >= 1.0 && whole.x <= last.x && whole.y <= last.y;
    if !inside {
        return None;
    }
    let across = cubic_weights(corner.x - whole.x);
    let down = cubic_weights(corner.y - whole.y);
    let (x, y) = (whole.x as i32 - 1, whole.y as i32 - 1);
    let mut rows = [[0.0; FINE]; TAPPED];
    for (r, row) in rows.iter_mut().enumerate() {
        let source: &[f32; TAPPED] = level.from(x, y + r as i32)?.first_chunk()?;
        for (c, value) in row.iter_mut().enumerate() {
            *value = (across[0] * source[c] + across[1] * source[c + 1])
                + (across[2] * source[c + 2] + across[3] * source[c + 3]);
        }
    }
    // One sum a column: the additions of a row do not wait for each other.
    let mut sums = [[0.0; FINE]; 5];
    for r in 0..FINE {
        let (value, [gradient_x, gradient_y]) = (&values[r], gradients.map(|gradient| &gradient[r]));
        for c in 0..FINE {
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

/// Columns that the first pass of [`stretched`] makes, at least: more than a patch that is hardly
/// stretched needs.
const FEW_COLUMNS: usize = 24;

/// Columns that the first pass of [`stretched`] can make.
const MOST_COLUMNS: usize = 40;

/// Free columns on either side, which a patch that shrinks reaches into with weights of zero.
const PADDING: usize = 12;

/// How far apart neighbouring samples of a row may be in x, in pixels, at least and at most.
const SPREAD: std::ops::RangeInclusive<f32> = 0.5..=2.0;

/// Samples at `first` + `distortion`·(c, r), for 18 columns c and rows r, linearly interpolated;
/// `None` where they leave the image or their columns are too far apart.
///
/// Two passes after Catmull and Smith: row r is sampled down the columns along the line on which its
/// samples lie, then along that line. Both passes weigh the pixels near the line by the hat function
/// of their distance, so no pixel is looked up on its own: of the order of 3 + 3 taps for each of 18 ×
/// 24 samples, five operations each, 13 k operations in vectors.
#[inline(always)]
pub(super) fn stretched(level: &Level, first: Vector2<f32>, distortion: &Matrix2<f32>) -> Option<Samples> {
    let span = (AROUND - 1) as f32;
    let corners = [(0.0, 0.0), (span, 0.0), (0.0, span), (span, span)];
    let last = Vector2::new(level.width() as f32 - 1.0, level.height() as f32 - 1.0);
    let inside = corners.iter().all(|&(c, r)| {
        let at = first + distortion * Vector2::new(c, r);
        at.x >= 0.0 && at.y >= 0.0 && at.x < last.x && at.y < last.y
    });
    let spread = distortion.m11;
    if !inside || !SPREAD.contains(&spread) {
        return None;
    }
    let columns = (span * spread) as usize + 3;
    let mut samples = [[0.0; AROUND]; AROUND];
    for (r, row) in samples.iter_mut().enumerate() {
        let start = first + distortion.column(1) * r as f32;
        let line = Line { start, slope: distortion.m21 / spread, columns };
        let mut middle = [0.0; PADDING + MOST_COLUMNS + PADDING];
        if columns <= FEW_COLUMNS {
            line.sample_down::<FEW_COLUMNS>(level, &mut middle);
        } else {
            line.sample_down::<MOST_COLUMNS>(level, &mut middle);
        }
        *row = *sample_along(&middle, start.x - start.x.floor(), spread).first_chunk()?;
    }
    Some(samples)
}

/// The line on which the samples of one row lie.
struct Line {
    start: Vector2<f32>,
    slope: f32,
    /// Whole columns that it crosses.
    columns: usize,
}

impl Line {
    /// The picture where the line crosses the columns from the one left of its start on.
    #[inline(always)]
    fn sample_down<const W: usize>(&self, level: &Level, out: &mut [f32; PADDING + MOST_COLUMNS + PADDING]) {
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

/// `W` pixels of a row of a level from `left` on, of which those past the first `count` do not matter.
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

/// Samples at `fraction` + `spread`·c after the padding.
#[inline(always)]
fn sample_along(
    middle: &[f32; PADDING + MOST_COLUMNS + PADDING],
    fraction: f32,
    spread: f32,
) -> [f32; FEW_COLUMNS] {
    // Sample c lies at pixel c + offset, offset from `fraction` on.
    let growth = (spread - 1.0) * (FEW_COLUMNS - 1) as f32;
    let (least, most) = (fraction + growth.min(0.0), fraction + growth.max(0.0));
    let lowest = least.floor();
    let taps = (most - lowest) as usize + 2;
    let mut out = [0.0; FEW_COLUMNS];
    for tap in 0..taps {
        let at = (PADDING as f32 + lowest) as usize + tap;
        let Some(pixels) = middle.get(at..).and_then(|rest| rest.first_chunk::<FEW_COLUMNS>()) else { break };
        let distance = fraction - lowest - tap as f32;
        for (c, out) in out.iter_mut().enumerate() {
            *out += hat(distance + (spread - 1.0) * c as f32) * pixels[c];
        }
    }
    out
}

/// Weight of a pixel in linear interpolation, by distance.
#[inline(always)]
fn hat(distance: f32) -> f32 {
    let weight = 1.0 - distance.abs();
    if weight > 0.0 { weight } else { 0.0 }
}

/// Sum of a column's sums, a power of two of them: halves are added, so few additions wait for others.
#[inline(always)]
fn total(mut sums: [f32; FINE]) -> f32 {
    let mut half = FINE / 2;
    while half > 0 {
        for i in 0..half {
            sums[i] += sums[i + half];
        }
        half /= 2;
    }
    sums[0]
}

#[inline(always)]
pub(super) fn dot(a: &Block, b: &Block) -> f32 {
    let mut sums = [0.0; FINE];
    for (a, b) in a.iter().zip(b) {
        for c in 0..FINE {
            sums[c] += a[c] * b[c];
        }
    }
    total(sums)
}

/// Adds `factor` times `b` to `a`.
#[inline(always)]
pub(super) fn combine(a: &mut Block, b: &Block, factor: f32) {
    for (a, b) in a.as_flattened_mut().iter_mut().zip(b.as_flattened()) {
        *a += factor * b;
    }
}

/// Takes the mean off, and returns it.
#[inline(always)]
pub(super) fn remove_mean(a: &mut Block) -> f32 {
    let mut sums = [0.0; FINE];
    for row in a.iter() {
        for c in 0..FINE {
            sums[c] += row[c];
        }
    }
    let mean = total(sums) / (FINE * FINE) as f32;
    a.as_flattened_mut().iter_mut().for_each(|value| *value -= mean);
    mean
}
