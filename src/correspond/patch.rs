// SPDX-License-Identifier: MIT OR Apache-2.0

//! Square patches of grey: sampling at sub-pixel positions, and sums. The pixels of a row are in the lanes.

use crate::lanes::rows::SampleRows;
use crate::lanes::sums::{SUMS, add_products};
use crate::lanes::{FLOATS, WordCpu};
use crate::pyramid::Level;
use nalgebra::{Matrix2, Vector2};

/// Side of a patch in pixels.
pub(super) const PATCH_SIDE: usize = 16;

/// Vectors in a row of a patch.
const PARTS: usize = PATCH_SIDE / FLOATS;

/// Samples of a row that the cubic kernel reads for one row of a patch.
const CUBIC_WIDTH: usize = PATCH_SIDE + 3;

/// Samples in a row of a patch with a margin of one pixel.
const WIDTH_WITH_MARGIN: usize = PATCH_SIDE + 2;

/// The same in whole vectors.
const SAMPLES_WIDTH: usize = WIDTH_WITH_MARGIN.next_multiple_of(FLOATS);

/// A patch with a margin of one pixel, row by row; the last samples of each row are of no meaning.
pub(super) type Samples = [[f32; SAMPLES_WIDTH]; WIDTH_WITH_MARGIN];

/// A number for each pixel of a patch, row by row.
type Pixels<C> = [[C; PARTS]; PATCH_SIDE];

/// The pixels of a patch of the first frame.
#[derive(Clone, Copy)]
pub(super) struct Block<C: WordCpu> {
    /// Grey less `pivot`.
    values: Pixels<C::Lanes>,
    /// Differences of neighbours two pixels apart: twice the gradients.
    gradient_x: Pixels<C::Lanes>,
    gradient_y: Pixels<C::Lanes>,
    /// A grey of the patch; subtracting it avoids cancellation in the sums of squares.
    pub(super) pivot: f32,
}

/// Sums over a patch of the first frame: v its values, and d twice its gradients.
pub(super) struct BlockSums {
    /// ∑ v.
    pub(super) values: f32,
    /// ∑ v².
    pub(super) squares: f32,
    /// ∑ d.
    pub(super) gradients: Vector2<f32>,
    /// ∑ d·v.
    pub(super) products: Vector2<f32>,
    /// ∑ d·dᵀ.
    pub(super) tensor: Matrix2<f32>,
}

/// Sums over a patch of the second frame, for one step of the registration.
pub(super) struct Sums {
    /// ∑ v · patch.
    pub(super) values: f32,
    /// ∑ d · patch.
    pub(super) slope: Vector2<f32>,
    /// ∑ patch.
    pub(super) sum: f32,
    /// ∑ patch².
    pub(super) squares: f32,
}

impl<C: WordCpu> Block<C> {
    /// A block to be filled by [`take`](Self::take).
    #[inline(always)]
    pub(super) fn new(cpu: C) -> Self {
        let pixels = [[cpu.splat(0.0); PARTS]; PATCH_SIDE];
        Self { values: pixels, gradient_x: pixels, gradient_y: pixels, pivot: 0.0 }
    }

    /// Takes the patch of these samples. It takes 32 × 18 instructions.
    #[inline(always)]
    pub(super) fn take(&mut self, cpu: C, samples: &Samples) -> Option<BlockSums> {
        let rows =
            SampleRows::<WIDTH_WITH_MARGIN, SAMPLES_WIDTH>::new(samples.as_flattened(), SAMPLES_WIDTH)?;
        self.pivot = samples[PATCH_SIDE / 2][PATCH_SIDE / 2];
        let (pivot, zero) = (cpu.splat(self.pivot), cpu.splat(0.0));
        let mut sums = [zero; SUMS];
        for part in 0..PARTS {
            let c = FLOATS * part;
            for r in 0..PATCH_SIDE {
                let value = cpu.load(rows.at(r + 1, c + 1)) - pivot;
                let dx = cpu.load(rows.at(r + 1, c + 2)) - cpu.load(rows.at(r + 1, c));
                let dy = cpu.load(rows.at(r + 2, c + 1)) - cpu.load(rows.at(r, c + 1));
                self.values[r][part] = value;
                (self.gradient_x[r][part], self.gradient_y[r][part]) = (dx, dy);
                add_products(cpu, &mut sums, [value, dx, dy]);
            }
        }
        let [a, b, c, d, e, f, g, h, by_y] = sums;
        let [values, x, y, xx, xy, yy, squares, by_x] = cpu.store(cpu.totals([a, b, c, d, e, f, g, h]));
        let [by_y, ..] = cpu.store(cpu.totals([by_y, zero, zero, zero, zero, zero, zero, zero]));
        Some(BlockSums {
            values,
            squares,
            gradients: Vector2::new(x, y),
            products: Vector2::new(by_x, by_y),
            tensor: Matrix2::new(xx, xy, xy, yy),
        })
    }

    /// Samples a patch of `level` with top left pixel `corner`, subtracts `bias`, and sums the products with this
    /// one; `None` if the kernel leaves the image.
    ///
    /// The patch is never stored: each of its rows is summed at once. It takes 38 × 4 instructions along the rows, and
    /// 32 × 9 down the columns and for the sums.
    #[inline(always)]
    pub(super) fn sample_sums(&self, cpu: C, level: &Level, corner: Vector2<f32>, bias: f32) -> Option<Sums> {
        let whole = Vector2::new(corner.x.floor(), corner.y.floor());
        let [width, height] = level.extent();
        let margin = (PATCH_SIDE + 2) as f32;
        let inside =
            whole.x >= 1.0 && whole.y >= 1.0 && whole.x <= width - margin && whole.y <= height - margin;
        if !inside {
            return None;
        }
        let samples = level.from(whole.x as i32 - 1, whole.y as i32 - 1)?;
        let rows = SampleRows::<CUBIC_WIDTH, CUBIC_WIDTH>::new(samples, level.stride())?;
        let across = cubic_weights(cpu, corner.x - whole.x);
        let down = cubic_weights(cpu, corner.y - whole.y);
        let (bias, zero) = (cpu.splat(-bias), cpu.splat(0.0));
        let mut sums = [zero; 5];
        for part in 0..PARTS {
            let column = FLOATS * part;
            let mut first = interpolated(cpu, &rows, [0, column], &across);
            let mut second = interpolated(cpu, &rows, [1, column], &across);
            let mut third = interpolated(cpu, &rows, [2, column], &across);
            for r in 0..PATCH_SIDE {
                let fourth = interpolated(cpu, &rows, [r + 3, column], &across);
                let grey = cpu.fused(down[0], first, bias);
                let grey = cpu.fused(down[2], third, cpu.fused(down[1], second, grey));
                let grey = cpu.fused(down[3], fourth, grey);
                sums[0] = cpu.fused(self.values[r][part], grey, sums[0]);
                sums[1] = cpu.fused(self.gradient_x[r][part], grey, sums[1]);
                sums[2] = cpu.fused(self.gradient_y[r][part], grey, sums[2]);
                sums[3] = sums[3] + grey;
                sums[4] = cpu.fused(grey, grey, sums[4]);
                (first, second, third) = (second, third, fourth);
            }
        }
        let [a, b, c, d, e] = sums;
        let [values, x, y, sum, squares, ..] = cpu.store(cpu.totals([a, b, c, d, e, zero, zero, zero]));
        Some(Sums { values, slope: Vector2::new(x, y), sum, squares })
    }
}

/// Weights of the cubic through four samples, at the fraction `t` between the middle two.
///
/// Lagrange's cubic, not Catmull–Rom: at a quarter of a pixel and a wavelength of 8 pixels its phase
/// error is 0.001 pixels, that of Catmull–Rom and of linear interpolation 0.01, which would be
/// measured as motion.
#[inline(always)]
fn cubic_weights<C: WordCpu>(cpu: C, t: f32) -> [C::Lanes; 4] {
    let (a, b, c) = (t + 1.0, t - 1.0, t - 2.0);
    let (ab, ct) = (a * b, c * t);
    let (sixth, half) = (1.0 / 6.0, 0.5);
    [
        cpu.splat(-sixth * b * ct),
        cpu.splat(half * ab * c),
        cpu.splat(-half * a * ct),
        cpu.splat(sixth * ab * t),
    ]
}

/// Eight samples of a row from a column on, interpolated along it.
#[inline(always)]
fn interpolated<C: WordCpu>(
    cpu: C,
    rows: &SampleRows<'_, CUBIC_WIDTH, CUBIC_WIDTH>,
    [row, column]: [usize; 2],
    [a, b, c, d]: &[C::Lanes; 4],
) -> C::Lanes {
    let sum = *a * cpu.load(rows.at(row, column));
    let sum = cpu.fused(*b, cpu.load(rows.at(row, column + 1)), sum);
    let sum = cpu.fused(*c, cpu.load(rows.at(row, column + 2)), sum);
    cpu.fused(*d, cpu.load(rows.at(row, column + 3)), sum)
}

/// Vectors that the first pass of [`sample_distorted`] produces for a row of small distortion.
const MIN_VECTORS: usize = SAMPLES_WIDTH / FLOATS;

/// Vectors that the first pass of [`sample_distorted`] produces at most.
const MAX_VECTORS: usize = 5;

/// Zero columns on either side, which a shrinking patch reads with weights of zero.
const PADDING: usize = 12;

/// The columns along a line, between those of the padding.
type Columns = [f32; PADDING + MAX_VECTORS * FLOATS + PADDING];

/// Allowed distance in x between neighbouring samples of a row, in pixels.
const SPACING: std::ops::RangeInclusive<f32> = 0.5..=2.0;

/// Samples at `first` + `distortion`·(c, r), for 18 columns c and rows r, linearly interpolated;
/// `None` if they leave the image or their spacing is not in [`SPACING`].
///
/// Two passes after Catmull and Smith: row r is first sampled down the columns, along the line on
/// which its samples lie, then along that line. Both passes weight the pixels near the line by the hat
/// function of their distance, which needs no gathers: two or three taps of five instructions in each pass, for
/// each of 18 × 3 vectors, some 1300 in all.
#[inline(always)]
pub(super) fn sample_distorted<C: WordCpu>(
    cpu: C,
    level: &Level,
    first: Vector2<f32>,
    distortion: &Matrix2<f32>,
) -> Option<Samples> {
    let span = (WIDTH_WITH_MARGIN - 1) as f32;
    let [width, height] = level.extent();
    let mut inside = true;
    for (c, r) in [(0.0, 0.0), (span, 0.0), (0.0, span), (span, span)] {
        let at = first + distortion * Vector2::new(c, r);
        inside &= at.x >= 0.0 && at.y >= 0.0 && at.x < width - 1.0 && at.y < height - 1.0;
    }
    let spacing = distortion.m11;
    if !inside || !SPACING.contains(&spacing) {
        return None;
    }
    let last_column = (span * spacing) as usize + 2;
    let slope = distortion.m21 / spacing;
    let (rises, growth) = (multiples(cpu, slope), multiples(cpu, spacing - 1.0));
    let mut samples = [[0.0; SAMPLES_WIDTH]; WIDTH_WITH_MARGIN];
    let mut columns = [0.0; PADDING + MAX_VECTORS * FLOATS + PADDING];
    for (r, row) in samples.iter_mut().enumerate() {
        let line = SampleLine { start: first + distortion.column(1) * r as f32, slope, last_column };
        if last_column < MIN_VECTORS * FLOATS {
            line.sample_down::<C, MIN_VECTORS>(cpu, level, &rises, &mut columns)?;
        } else {
            line.sample_down::<C, MAX_VECTORS>(cpu, level, &rises, &mut columns)?;
        }
        let fraction = line.start.x - line.start.x.floor();
        sample_along(cpu, &columns, fraction, span * (spacing - 1.0), &growth, row)?;
    }
    Some(samples)
}

/// The line on which the samples of one row lie.
struct SampleLine {
    start: Vector2<f32>,
    slope: f32,
    /// Number of the last whole column that the line crosses, counted from that left of its start.
    last_column: usize,
}

impl SampleLine {
    /// Samples the picture where the line crosses the columns, starting with the column left of its start; `rises` are
    /// the multiples of the slope.
    #[inline(always)]
    fn sample_down<C: WordCpu, const VECTORS: usize>(
        &self,
        cpu: C,
        level: &Level,
        rises: &[C::Lanes; MAX_VECTORS],
        out: &mut Columns,
    ) -> Option<()> {
        let left = self.start.x.floor();
        let first = self.start.y - self.slope * (self.start.x - left);
        let end = first + self.slope * self.last_column as f32;
        let top = first.min(end).floor();
        let taps = (first.max(end) - top) as usize + 2;
        // Below and beside the picture there is a border, so that no row is too short.
        let samples = level.from(left as i32, top as i32)?;
        let mut sums = [cpu.splat(0.0); VECTORS];
        let mut distance = first - top;
        for row in samples.chunks(level.stride()).take(taps) {
            add_tap(cpu, &mut sums, distance, rises, row.as_chunks::<FLOATS>().0.first_chunk::<VECTORS>()?);
            distance -= 1.0;
        }
        let out = out.get_mut(PADDING..)?.as_chunks_mut::<FLOATS>().0;
        for (out, sum) in out.iter_mut().zip(sums) {
            *out = cpu.store(sum);
        }
        Some(())
    }
}

/// Samples at `fraction` + (1 + g)·c, counted from the end of the padding: `growth` has the multiples of g, and `most`
/// is the last of them that counts.
#[inline(always)]
fn sample_along<C: WordCpu>(
    cpu: C,
    columns: &Columns,
    fraction: f32,
    most: f32,
    growth: &[C::Lanes; MAX_VECTORS],
    out: &mut [f32; SAMPLES_WIDTH],
) -> Option<()> {
    // Sample c lies at pixel c + offset; the offset starts at `fraction`.
    let lowest = (fraction + most.min(0.0)).floor();
    let taps = (fraction + most.max(0.0) - lowest) as usize + 2;
    let first = (PADDING as f32 + lowest) as usize;
    let mut sums = [cpu.splat(0.0); MIN_VECTORS];
    for tap in 0..taps {
        let pixels = columns.get(first + tap..)?.as_chunks::<FLOATS>().0.first_chunk::<MIN_VECTORS>()?;
        add_tap(cpu, &mut sums, fraction - lowest - tap as f32, growth, pixels);
    }
    for (out, sum) in out.as_chunks_mut::<FLOATS>().0.iter_mut().zip(sums) {
        *out = cpu.store(sum);
    }
    Some(())
}

/// Adds pixels at the distances `first` + `more` from the samples, times their weights in linear interpolation.
#[inline(always)]
fn add_tap<C: WordCpu, const VECTORS: usize>(
    cpu: C,
    sums: &mut [C::Lanes; VECTORS],
    first: f32,
    more: &[C::Lanes; MAX_VECTORS],
    pixels: &[[f32; FLOATS]; VECTORS],
) {
    let (first, one, zero) = (cpu.splat(first), cpu.splat(1.0), cpu.splat(0.0));
    for ((sum, more), pixels) in sums.iter_mut().zip(more).zip(pixels) {
        let weight = cpu.greater(one - cpu.magnitude(first + *more), zero);
        *sum = cpu.fused(weight, cpu.load(pixels), *sum);
    }
}

/// 0, 1, 2, … times a number.
#[inline(always)]
fn multiples<C: WordCpu>(cpu: C, factor: f32) -> [C::Lanes; MAX_VECTORS] {
    let mut multiples = [cpu.load(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]); MAX_VECTORS];
    for (k, multiple) in multiples.iter_mut().enumerate() {
        *multiple = cpu.splat(factor) * (*multiple + cpu.splat((FLOATS * k) as f32));
    }
    multiples
}

#[cfg(test)]
#[path = "patch_tests.rs"]
mod tests;
