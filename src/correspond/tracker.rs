//! Sub-pixel registration of one patch: inverse-compositional Lucas–Kanade.
//!
//! S. Baker, I. Matthews, *Lucas–Kanade 20 Years On: A Unifying Framework*, IJCV 56(3), 2004. The
//! patch moves by a translation; a local distortion that is known beforehand is taken out of the
//! template. Brightness changes I = a·T + b are projected out: the steepest-descent images g are
//! made orthogonal to 1 and to T, so that ∑ g·T = 0 and the step is H⁻¹ ∑ g·I / a. Its fixed point
//! does not depend on the gradient filter, a or b.
//!
//! One sampling of N×N pixels takes 4·N·(2N + 3) multiply-adds, its sums 4·N²: 3.3 k for N = 16.

use super::pyramid::Level;
use nalgebra::{Matrix2, Vector2};

/// Side of a patch on the finest level, in pixels.
pub(super) const FINE: usize = 16;

/// Side of a patch on the coarser levels, in their pixels.
pub(super) const COARSE: usize = 8;

/// Contrast of the second frame over that of the first, at most, and its inverse at least.
const MAX_GAIN: f32 = 3.0;

/// A template on the finest level.
pub(super) type FineTemplate = Template<FINE, { FINE + 3 }>;

/// A template on a coarser level.
pub(super) type CoarseTemplate = Template<COARSE, { COARSE + 3 }>;

type Rows<const N: usize, const R: usize> = [[f32; N]; R];

/// What is looked for: a patch of `N` × `N` pixels, its gradients and their matrix.
///
/// `M` is N + 3: the samples that a cubic kernel needs for N results in a row.
pub(super) struct Template<const N: usize, const M: usize> {
    /// Mean grey.
    mean: f32,
    /// Grey less its mean.
    values: Rows<N, N>,
    /// Sum of squares of `values`.
    energy: f32,
    /// Gradients, orthogonal to 1 and to `values`.
    gradient_x: Rows<N, N>,
    gradient_y: Rows<N, N>,
    /// Inverse of the matrix of the gradients.
    inverse: Matrix2<f32>,
    /// The smaller eigenvalue of the matrix of the gradients, per pixel.
    pub(super) texture: f32,
}

/// Where a template was found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Match {
    /// The top left pixel of the patch, pixels of the level.
    pub(super) corner: Vector2<f32>,
    /// Length of the last step in pixels.
    pub(super) step: f32,
    /// Root mean square difference after brightness was matched, grey levels.
    pub(super) residual: f32,
    /// Coefficient of correlation of the two patches, 0 to 1.
    pub(super) correlation: f32,
}

/// How a template is followed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Effort {
    /// Samplings of the image, at most.
    pub(super) iterations: usize,
    /// A step shorter than this, in pixels, is the last.
    pub(super) tolerance: f32,
}

impl<const N: usize, const M: usize> Template<N, M> {
    /// The patch whose top left pixel is `corner`; `None` where it and a margin of one pixel do not
    /// fit, or where it has no contrast at all.
    ///
    /// `damping` (squared grey levels) is added to the eigenvalues: along an edge, where nothing
    /// can be measured, the start is then kept.
    pub(super) fn new(level: &Level, corner: (usize, usize), damping: f32) -> Option<Self> {
        let (x, y) = (corner.0.checked_sub(1)?, corner.1.checked_sub(1)?);
        if x + N + 2 > level.width || y + N + 2 > level.height {
            return None;
        }
        let mut samples = [[0.0; M]; M];
        for (r, row) in samples.iter_mut().enumerate().take(N + 2) {
            let start = (y + r) * level.width + x;
            row[..N + 2].copy_from_slice(&level.data[start..start + N + 2]);
        }
        Self::from_samples(&samples, damping)
    }

    /// The patch as the second frame is to show it: sampled at c + `distortion`·(x − c), with c the
    /// centre of the patch at `corner`.
    ///
    /// Sampled linearly: c is at the same place between pixels on all sides, so the errors of the
    /// interpolation are odd about c and cancel.
    pub(super) fn distorted(level: &Level, corner: (usize, usize), distortion: Matrix2<f32>) -> Option<Self> {
        let half = 0.5 * (N as f32 - 1.0);
        let centre = Vector2::new(corner.0 as f32 + half, corner.1 as f32 + half);
        let first = centre - distortion * Vector2::new(half + 1.0, half + 1.0);
        let reach = (half + 1.0) * Vector2::new(distortion.row(0).abs().sum(), distortion.row(1).abs().sum());
        let (least, most) = (centre - reach, centre + reach);
        let last = Vector2::new(level.width as f32 - 1.0, level.height as f32 - 1.0);
        let inside = least.x >= 0.0 && least.y >= 0.0 && most.x < last.x && most.y < last.y;
        if !inside {
            return None;
        }
        let mut samples = [[0.0; M]; M];
        for (r, row) in samples.iter_mut().enumerate().take(N + 2) {
            let start = first + distortion.column(1) * r as f32;
            for (c, sample) in row.iter_mut().enumerate().take(N + 2) {
                *sample = linear(level, start + distortion.column(0) * c as f32);
            }
        }
        Self::from_samples(&samples, 0.0)
    }

    /// From (N + 2) × (N + 2) samples: the patch and a margin of one pixel.
    fn from_samples(samples: &Rows<M, M>, damping: f32) -> Option<Self> {
        let mut values = [[0.0; N]; N];
        let mut gradient_x = [[0.0; N]; N];
        let mut gradient_y = [[0.0; N]; N];
        for r in 0..N {
            for c in 0..N {
                values[r][c] = samples[r + 1][c + 1];
                gradient_x[r][c] = 0.5 * (samples[r + 1][c + 2] - samples[r + 1][c]);
                gradient_y[r][c] = 0.5 * (samples[r + 2][c + 1] - samples[r][c + 1]);
            }
        }
        let mean = remove_mean(&mut values);
        let energy = dot(&values, &values);
        if !(energy > 0.0 && energy.is_finite()) {
            return None;
        }
        for gradient in [&mut gradient_x, &mut gradient_y] {
            remove_mean(gradient);
            let share = dot(gradient, &values) / energy;
            combine(gradient, &values, -share);
        }
        let xx = dot(&gradient_x, &gradient_x);
        let xy = dot(&gradient_x, &gradient_y);
        let yy = dot(&gradient_y, &gradient_y);
        let count = (N * N) as f32;
        let texture = (0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt()) / count;
        let damping = Matrix2::identity() * (damping * count);
        let inverse = (Matrix2::new(xx, xy, xy, yy) + damping).try_inverse()?;
        Some(Self { mean, values, energy, gradient_x, gradient_y, inverse, texture: texture.max(0.0) })
    }

    /// Follows the template in `level` from a start near it; `None` where it leaves the image, or
    /// where what is there has nothing in common with it.
    pub(super) fn find(&self, level: &Level, start: Vector2<f32>, effort: Effort) -> Option<Match> {
        let mut corner = start;
        let mut patch = [[0.0; N]; N];
        let mut best = None;
        for _ in 0..effort.iterations {
            sample::<N, M>(level, corner, self.mean, &mut patch)?;
            let gain = dot(&self.values, &patch) / self.energy;
            if !(gain > 1.0 / MAX_GAIN && gain < MAX_GAIN) {
                return None;
            }
            let slope = Vector2::new(dot(&self.gradient_x, &patch), dot(&self.gradient_y, &patch));
            let step = self.inverse * slope / gain;
            corner -= step;
            best = Some((gain, step.norm()));
            if step.norm() < effort.tolerance {
                break;
            }
        }
        let (gain, step) = best?;
        let (residual, correlation) = self.compare(&mut patch, gain);
        step.is_finite().then_some(Match { corner, step, residual, correlation })
    }

    /// Residual and correlation of a patch (the template's mean taken off) of known gain.
    fn compare(&self, patch: &mut Rows<N, N>, gain: f32) -> (f32, f32) {
        remove_mean(patch);
        let energy = dot(patch, patch);
        let explained = gain * gain * self.energy;
        let residual = ((energy - explained).max(0.0) / (N * N) as f32).sqrt();
        (residual, (explained / energy.max(f32::MIN_POSITIVE)).min(1.0).sqrt())
    }
}

/// Weights of the cubic through four samples, at `t` between the middle two.
///
/// Lagrange's cubic, not Catmull and Rom's: at a quarter of a pixel and a wavelength of 8 pixels its
/// phase is wrong by 0.001 pixels, theirs (and the linear one's) by 0.01, which would be measured as
/// motion.
fn cubic_weights(t: f32) -> [f32; 4] {
    let (a, b, c) = (t + 1.0, t - 1.0, t - 2.0);
    [-t * b * c / 6.0, a * b * c / 2.0, -a * t * c / 2.0, a * t * b / 6.0]
}

/// Samples N × N pixels from `corner` on, less `bias`; `None` where the kernel leaves the image.
fn sample<const N: usize, const M: usize>(
    level: &Level,
    corner: Vector2<f32>,
    bias: f32,
    out: &mut Rows<N, N>,
) -> Option<()> {
    let whole = Vector2::new(corner.x.floor(), corner.y.floor());
    let last = Vector2::new(level.width as f32 - (N + 2) as f32, level.height as f32 - (N + 2) as f32);
    let inside = whole.x >= 1.0 && whole.y >= 1.0 && whole.x <= last.x && whole.y <= last.y;
    if !inside {
        return None;
    }
    let across = cubic_weights(corner.x - whole.x);
    let down = cubic_weights(corner.y - whole.y);
    let (x, y) = (whole.x as usize - 1, whole.y as usize - 1);
    let mut rows = [[0.0; N]; M];
    for (r, row) in rows.iter_mut().enumerate() {
        let start = (y + r) * level.width + x;
        let source: &[f32; M] = level.data.get(start..)?.first_chunk()?;
        for (c, value) in row.iter_mut().enumerate() {
            *value = (across[0] * source[c] + across[1] * source[c + 1])
                + (across[2] * source[c + 2] + across[3] * source[c + 3]);
        }
    }
    for (r, row) in out.iter_mut().enumerate() {
        for (c, value) in row.iter_mut().enumerate() {
            *value = (down[0] * rows[r][c] + down[1] * rows[r + 1][c])
                + (down[2] * rows[r + 2][c] + down[3] * rows[r + 3][c])
                - bias;
        }
    }
    Some(())
}

/// Linear interpolation at a point inside the image.
fn linear(level: &Level, at: Vector2<f32>) -> f32 {
    let (x, y) = (at.x as usize, at.y as usize);
    let (u, v) = (at.x - x as f32, at.y - y as f32);
    let start = y * level.width + x;
    let pair = |start: usize| level.data.get(start..start + 2).map_or(0.0, |p| p[0] + u * (p[1] - p[0]));
    let (above, below) = (pair(start), pair(start + level.width));
    above + v * (below - above)
}

fn dot<const N: usize>(a: &Rows<N, N>, b: &Rows<N, N>) -> f32 {
    // One sum a column: the additions of a row do not wait for each other.
    let mut sums = [0.0; N];
    for (a, b) in a.iter().zip(b) {
        for c in 0..N {
            sums[c] += a[c] * b[c];
        }
    }
    sums.iter().sum()
}

fn combine<const N: usize>(a: &mut Rows<N, N>, b: &Rows<N, N>, factor: f32) {
    for (a, b) in a.as_flattened_mut().iter_mut().zip(b.as_flattened()) {
        *a += factor * b;
    }
}

fn remove_mean<const N: usize>(a: &mut Rows<N, N>) -> f32 {
    let mut sums = [0.0; N];
    for row in a.iter() {
        for c in 0..N {
            sums[c] += row[c];
        }
    }
    let mean = sums.iter().sum::<f32>() / (N * N) as f32;
    a.as_flattened_mut().iter_mut().for_each(|value| *value -= mean);
    mean
}
