//! The kernel: one patch of 8 × 8 pixels, its gradients, and its comparison with another frame between pixels.
//!
//! Inverse compositional (S. Baker, I. Matthews, *Lucas–Kanade 20 Years On*, IJCV 56(3), 2004): the gradients are the
//! template's, so that their matrix is inverted once. They are given a zero mean, which takes a difference of brightness
//! out of the step; the residual is taken about its mean.
//!
//! Per comparison: 9 rows of 9 samples read, 64 × 11 additions and multiplications. All of it is written over rows of 8
//! lanes and compiled twice, for any CPU and for AVX2, without contracting multiplications and additions: both give the
//! same to the last bit.

use crate::pyramid::Level;

/// Side of a patch in pixels.
pub(super) const SIDE: usize = 8;

/// Pixels of a patch.
pub(super) const AREA: f32 = (SIDE * SIDE) as f32;

/// Variance of the noise in a gradient, squared grey levels a pixel, at least: the quantisation of 8-bit luma (1/12),
/// taken three times for what compression adds. Added to both eigenvalues of the gradients' matrix, so that along an
/// edge the start is kept.
pub(super) const GRADIENT_NOISE: f32 = 0.25;

type Lanes = [f32; SIDE];
type Block = [Lanes; SIDE];

/// A patch of the first frame.
pub(super) struct Template {
    values: Block,
    gradient_x: Block,
    gradient_y: Block,
    /// Sums over the patch of the products of its zero-mean gradients: xx, xy, yy, in squared grey levels.
    pub(super) tensor: [f32; 3],
    /// Inverse of that matrix, with the gradients' noise added to its diagonal.
    inverse: [f32; 3],
    /// Sum of squared differences from the mean, in squared grey levels.
    pub(super) energy: f32,
}

/// How a patch of the second frame differs from the template.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Difference {
    /// The step of Gauss and Newton in pixels, to be added to the displacement.
    pub(super) step: [f32; 2],
    /// Squared differences, about the mean of the patch, summed over its quarters: top left, top right, bottom left,
    /// bottom right; squared grey levels.
    pub(super) squares: [f32; 4],
}

impl Difference {
    /// Sum of squared differences over the patch.
    #[inline(always)]
    pub(super) fn total(&self) -> f32 {
        (self.squares[0] + self.squares[1]) + (self.squares[2] + self.squares[3])
    }
}

impl Template {
    /// The patch of `level` whose top left pixel is (x, y); `None` further outside than the border.
    #[inline(always)]
    pub(super) fn new(level: &Level, x: isize, y: isize) -> Option<Self> {
        let (source, stride) = (level.from(x - 1, y - 1)?, level.stride());
        let rows = source.get(..(SIDE + 1) * stride + SIDE + 2)?;
        let row = |r: usize| -> Option<&[f32; SIDE + 2]> { rows.get(r * stride..)?.first_chunk() };
        let zero = [[0.0; SIDE]; SIDE];
        let (mut values, mut gradient_x, mut gradient_y) = (zero, zero, zero);
        let mut sums = [[0.0; SIDE]; 4];
        for r in 0..SIDE {
            let (above, here, below) = (row(r)?, row(r + 1)?, row(r + 2)?);
            for c in 0..SIDE {
                let (value, dx, dy) =
                    (here[c + 1], 0.5 * (here[c + 2] - here[c]), 0.5 * (below[c + 1] - above[c + 1]));
                values[r][c] = value;
                gradient_x[r][c] = dx;
                gradient_y[r][c] = dy;
                sums[0][c] += value;
                sums[1][c] += dx;
                sums[2][c] += dy;
            }
        }
        let mean = sums.map(|lanes| total(lanes) / AREA);
        let mut products = [[0.0; SIDE]; 4];
        for r in 0..SIDE {
            for c in 0..SIDE {
                let value = values[r][c] - mean[0];
                let (dx, dy) = (gradient_x[r][c] - mean[1], gradient_y[r][c] - mean[2]);
                values[r][c] = value;
                gradient_x[r][c] = dx;
                gradient_y[r][c] = dy;
                products[0][c] += dx * dx;
                products[1][c] += dx * dy;
                products[2][c] += dy * dy;
                products[3][c] += value * value;
            }
        }
        let [xx, xy, yy, energy] = products.map(total);
        let (a, d) = (xx + AREA * GRADIENT_NOISE, yy + AREA * GRADIENT_NOISE);
        let share = 1.0 / (a * d - xy * xy);
        let inverse = [d * share, -xy * share, a * share];
        Some(Self { values, gradient_x, gradient_y, tensor: [xx, xy, yy], inverse, energy })
    }

    /// Compares with the patch of `level` whose top left pixel lies at `corner`, sampled linearly. A corner further
    /// outside than the border is moved to it; `None` only for a level without pixels.
    #[inline(always)]
    pub(super) fn compare(&self, level: &Level, corner: [f32; 2]) -> Option<Difference> {
        let x = corner[0].clamp(-(SIDE as f32), level.width() as f32);
        let y = corner[1].clamp(-(SIDE as f32), level.height() as f32);
        let (left, top) = (x.floor(), y.floor());
        let (across, down) = (x - left, y - top);
        let stride = level.stride();
        let rows = level.from(left as isize, top as isize)?.get(..SIDE * stride + SIDE + 1)?;
        let mut above = blended(rows, across)?;
        let mut sums = [[0.0; SIDE]; 6];
        for r in 0..SIDE {
            let below = blended(rows.get((r + 1) * stride..)?, across)?;
            let half = r / (SIDE / 2);
            let (mut mean, mut square) = (sums[2 + half], sums[4 + half]);
            for c in 0..SIDE {
                let sample = above[c] + down * (below[c] - above[c]);
                let difference = sample - self.values[r][c];
                sums[0][c] += self.gradient_x[r][c] * difference;
                sums[1][c] += self.gradient_y[r][c] * difference;
                mean[c] += difference;
                square[c] += difference * difference;
            }
            (sums[2 + half], sums[4 + half]) = (mean, square);
            above = below;
        }
        let [x, y] = [total(sums[0]), total(sums[1])];
        let [a, b, c] = self.inverse;
        let (means, squares) = ([halves(sums[2]), halves(sums[3])], [halves(sums[4]), halves(sums[5])]);
        let mean = ((means[0][0] + means[0][1]) + (means[1][0] + means[1][1])) / AREA;
        let quarter = |row: usize, column: usize| {
            let square = squares[row][column] - mean * (2.0 * means[row][column] - 0.25 * AREA * mean);
            square.max(0.0)
        };
        Some(Difference {
            step: [-(a * x + b * y), -(b * x + c * y)],
            squares: [quarter(0, 0), quarter(0, 1), quarter(1, 0), quarter(1, 1)],
        })
    }

    /// The residual at a whole displacement: sum of squared differences about their mean.
    #[inline(always)]
    pub(super) fn residual_at(&self, level: &Level, x: isize, y: isize) -> Option<f32> {
        let stride = level.stride();
        let rows = level.from(x, y)?.get(..(SIDE - 1) * stride + SIDE)?;
        let mut sums = [[0.0; SIDE]; 2];
        for r in 0..SIDE {
            let row: &Lanes = rows.get(r * stride..)?.first_chunk()?;
            for c in 0..SIDE {
                let difference = row[c] - self.values[r][c];
                sums[0][c] += difference;
                sums[1][c] += difference * difference;
            }
        }
        let mean = total(sums[0]);
        Some((total(sums[1]) - mean * mean / AREA).max(0.0))
    }
}

/// A row of samples between pixels.
#[inline(always)]
fn blended(row: &[f32], across: f32) -> Option<Lanes> {
    let row: &[f32; SIDE + 1] = row.first_chunk()?;
    let mut out = [0.0; SIDE];
    for c in 0..SIDE {
        out[c] = row[c] + across * (row[c + 1] - row[c]);
    }
    Some(out)
}

/// Sums of the left and of the right half.
#[inline(always)]
fn halves(lanes: Lanes) -> [f32; 2] {
    let pairs = [lanes[0] + lanes[2], lanes[1] + lanes[3], lanes[4] + lanes[6], lanes[5] + lanes[7]];
    [pairs[0] + pairs[1], pairs[2] + pairs[3]]
}

#[inline(always)]
fn total(lanes: Lanes) -> f32 {
    let [left, right] = halves(lanes);
    left + right
}
