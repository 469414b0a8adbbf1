// SPDX-License-Identifier: MIT OR Apache-2.0

//! Square patches of grey: sampling at sub-pixel positions, and sums. The pixels of a row are in the lanes.

use crate::lanes::rows::SampleRows;
use crate::lanes::sums::{SUMS, add_products};
use crate::lanes::wholes::{ROUND, floor, whole};
use crate::lanes::{FLOATS, WordCpu};
use crate::pyramid::Level;
use nalgebra::{Matrix2, Vector2};

/// Side of a patch in pixels.
pub(super) const PATCH_SIDE: usize = 16;

/// Pixels of a patch.
pub(super) const AREA: f32 = (PATCH_SIDE * PATCH_SIDE) as f32;

/// The centre of a patch, given its top left pixel.
#[inline(always)]
pub(super) fn centre(corner: Vector2<f32>) -> Vector2<f32> {
    corner.add_scalar(0.5 * (PATCH_SIDE as f32 - 1.0))
}

/// Vectors in a row of a patch.
const PARTS: usize = PATCH_SIDE / FLOATS;

/// Samples of a row that the cubic kernel reads for one row of a patch.
const CUBIC_WIDTH: usize = PATCH_SIDE + 3;

/// Pixels around a patch that are needed for its gradients.
pub(super) const MARGIN: usize = 1;

/// Samples in a row of a patch with its margin.
pub(super) const WIDTH_WITH_MARGIN: usize = MARGIN + PATCH_SIDE + MARGIN;

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

/// Vectors that the first pass of [`DistortedPatch::sample`] produces for a row of small distortion.
const MIN_VECTORS: usize = SAMPLES_WIDTH / FLOATS;

/// Vectors that the first pass of [`DistortedPatch::sample`] produces at most.
const MAX_VECTORS: usize = 5;

/// Zero columns on either side, which a shrinking patch reads with weights of zero.
const PADDING: usize = 12;

/// The columns along a line, between those of the padding.
type Columns = [f32; PADDING + MAX_VECTORS * FLOATS + PADDING];

/// Allowed distance in x between neighbouring samples of a row, in pixels.
const SPACING: std::ops::RangeInclusive<f32> = 0.5..=2.0;

/// Memory for sampling a distorted patch, used again for the next one.
pub(super) struct DistortedPatch {
    /// Of each row the columns along its line.
    columns: [Columns; WIDTH_WITH_MARGIN],
    samples: Samples,
}

impl DistortedPatch {
    pub(super) fn new() -> Self {
        Self {
            columns: [[0.0; PADDING + MAX_VECTORS * FLOATS + PADDING]; WIDTH_WITH_MARGIN],
            samples: [[0.0; SAMPLES_WIDTH]; WIDTH_WITH_MARGIN],
        }
    }

    /// Samples at `first` + `distortion`·(c, r), for 18 columns c and rows r, linearly interpolated;
    /// `None` if they leave the image or their spacing is not in [`SPACING`].
    ///
    /// Two passes after Catmull and Smith: row r is first sampled down the columns, along the line on
    /// which its samples lie, then along that line. Both passes go from tap to tap, which needs no gathers: two or three
    /// taps of four instructions in each pass, for each of 18 × 3 vectors, some 1000 in all. All rows are through the
    /// first pass before the second, which would wait for what it reads to be written.
    #[inline(always)]
    pub(super) fn sample<C: WordCpu>(
        &mut self,
        cpu: C,
        level: &Level,
        first: Vector2<f32>,
        distortion: &Matrix2<f32>,
    ) -> Option<&Samples> {
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
        let last_column = (span * spacing).floor() + 2.0;
        let slope = distortion.m21 / spacing;
        let (rises, growth) = (multiples(cpu, slope), multiples(cpu, spacing - 1.0));
        let lines =
            SampleLines::of(cpu, level, [first, distortion.column(1).into()], [slope, spacing], last_column);
        for (r, columns) in self.columns.iter_mut().enumerate() {
            if last_column < (MIN_VECTORS * FLOATS) as f32 {
                lines.sample_down::<C, MIN_VECTORS>(cpu, level, r, &rises, columns)?;
            } else {
                lines.sample_down::<C, MAX_VECTORS>(cpu, level, r, &rises, columns)?;
            }
        }
        for (r, (columns, row)) in self.columns.iter().zip(&mut self.samples).enumerate() {
            lines.sample_along(cpu, columns, r, &growth, row)?;
        }
        Some(&self.samples)
    }
}

/// A number for each row of a patch.
type Rows = [f32; SAMPLES_WIDTH];

/// Where taps begin, how many there are, and how far beyond the first of them the first sample lies. To the whole numbers
/// [`ROUND`] was added.
#[derive(Default)]
struct Taps {
    first: Rows,
    count: Rows,
    distance: Rows,
}

/// The lines on which the samples of each row lie.
struct SampleLines {
    /// Down the columns, from the picture's sample in the column left of the line's start.
    down: Taps,
    /// Along the line, from the column that belongs to sample 0.
    along: Taps,
}

impl SampleLines {
    /// Those that begin at `first` and, from one to the next, `next` further. `last_column` is the number of the last whole
    /// column that a line crosses, counted from that left of its start.
    #[inline(always)]
    fn of<C: WordCpu>(
        cpu: C,
        level: &Level,
        [first, next]: [Vector2<f32>; 2],
        [slope, spacing]: [f32; 2],
        last_column: f32,
    ) -> Self {
        let mut lines = Self { down: Taps::default(), along: Taps::default() };
        let (zero, two, round) = (cpu.splat(0.0), cpu.splat(2.0), cpu.splat(ROUND));
        // Sample c lies at pixel c + offset; the offset grows from one sample to the next.
        let most = cpu.splat((WIDTH_WITH_MARGIN - 1) as f32 * (spacing - 1.0));
        let (down, along) = (multiples(cpu, next.y), multiples(cpu, next.x));
        for part in 0..MIN_VECTORS {
            let (x, y) = (cpu.splat(first.x) + along[part], cpu.splat(first.y) + down[part]);
            let left = floor(cpu, x);
            let fraction = x - left;
            let y = y - cpu.splat(slope) * fraction;
            let end = y + cpu.splat(slope * last_column);
            let top = floor(cpu, cpu.lesser(y, end));
            let start =
                cpu.splat(level.origin() as f32 + ROUND) + left + top * cpu.splat(level.stride() as f32);
            let count = floor(cpu, cpu.greater(y, end) - top) + two + round;
            lines.down.put(cpu, part, [start, count, y - top]);
            let lowest = floor(cpu, fraction + cpu.lesser(most, zero));
            let count = floor(cpu, fraction + cpu.greater(most, zero) - lowest) + two + round;
            let start = cpu.splat(PADDING as f32 + ROUND) + lowest;
            lines.along.put(cpu, part, [start, count, fraction - lowest]);
        }
        lines
    }

    /// Samples the picture where the line of row `r` crosses the columns, starting with the column left of its start; `rises`
    /// are the multiples of the slope.
    #[inline(always)]
    fn sample_down<C: WordCpu, const VECTORS: usize>(
        &self,
        cpu: C,
        level: &Level,
        r: usize,
        rises: &[C::Lanes; MAX_VECTORS],
        out: &mut Columns,
    ) -> Option<()> {
        // Below and beside the picture there is a border, so that no row is too short.
        let samples = level.samples().get(whole(self.down.first[r]) as usize..)?;
        let out = out.get_mut(PADDING..)?.as_chunks_mut::<FLOATS>().0;
        self.down.sample::<C, VECTORS>(cpu, samples, level.stride(), r, rises, out)
    }

    /// Samples along the line of row `r`; `growth` has the multiples of g, the samples' distance less 1.
    #[inline(always)]
    fn sample_along<C: WordCpu>(
        &self,
        cpu: C,
        columns: &Columns,
        r: usize,
        growth: &[C::Lanes; MAX_VECTORS],
        out: &mut Rows,
    ) -> Option<()> {
        let pixels = columns.get(whole(self.along.first[r]) as usize..)?;
        self.along.sample::<C, MIN_VECTORS>(cpu, pixels, 1, r, growth, out.as_chunks_mut::<FLOATS>().0)
    }
}

impl Taps {
    /// Those of eight rows.
    #[inline(always)]
    fn put<C: WordCpu>(&mut self, cpu: C, part: usize, [first, count, distance]: [C::Lanes; 3]) {
        let outs = [(&mut self.first, first), (&mut self.count, count), (&mut self.distance, distance)];
        for (out, lanes) in outs {
            out.as_chunks_mut::<FLOATS>().0[part] = cpu.store(lanes);
        }
    }

    /// Interpolates linearly between the taps of row `r`, `stride` apart, at its distance and `more` from the first one.
    #[inline(always)]
    fn sample<C: WordCpu, const VECTORS: usize>(
        &self,
        cpu: C,
        pixels: &[f32],
        stride: usize,
        r: usize,
        more: &[C::Lanes; MAX_VECTORS],
        out: &mut [[f32; FLOATS]],
    ) -> Option<()> {
        let (distance, one) = (cpu.splat(self.distance[r]), cpu.splat(1.0));
        let (mut before, mut sums, mut rest) = ([one; VECTORS], [one; VECTORS], [one; VECTORS]);
        let first = pixels.as_chunks::<FLOATS>().0.first_chunk::<VECTORS>()?;
        for v in 0..VECTORS {
            before[v] = cpu.load(&first[v]);
            (sums[v], rest[v]) = (before[v], distance + more[v]);
        }
        // What lies between two taps counts as far as a sample lies beyond the first of them.
        let last = (whole(self.count[r]) - 1) as usize;
        for tap in 1..last {
            let pixels = pixels.get(tap * stride..)?.as_chunks::<FLOATS>().0.first_chunk::<VECTORS>()?;
            for v in 0..VECTORS {
                let (pixel, share) = (cpu.load(&pixels[v]), cpu.lesser(rest[v], one));
                sums[v] = cpu.fused(share, pixel - before[v], sums[v]);
                (before[v], rest[v]) = (pixel, rest[v] - share);
            }
        }
        let pixels =
            pixels.get(last.checked_mul(stride)?..)?.as_chunks::<FLOATS>().0.first_chunk::<VECTORS>()?;
        for (v, out) in out.iter_mut().enumerate().take(VECTORS) {
            *out = cpu.store(cpu.fused(rest[v], cpu.load(&pixels[v]) - before[v], sums[v]));
        }
        Some(())
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
