//! Where to start: an exhaustive search of large regions on the coarsest level.
//!
//! The coarsest level is at most 64 pixels a side, so a shift of 14 of its pixels is 22 % of the
//! frame: 150 pixels at a width of 1024, and a rotation by 7° on top. Regions of 16 × 16 pixels that
//! overlap by about a third are matched by normalised correlation of the *detail* (the level less
//! its local mean), so that neither brightness nor a slow gradient of it speaks for a shift.
//!
//! 18 regions × 841 shifts × 256 multiply-adds = 3.9 M for a 16:9 frame.

use super::pyramid::Level;
use crate::cpu::CpuLevel;
use nalgebra::Vector2;
use rayon::prelude::*;

/// Shifts searched, either way along both axes, in pixels of the coarsest level.
const RADIUS: usize = 14;

/// Shifts along one axis.
const SHIFTS: usize = 2 * RADIUS + 1;

/// Side of a region.
const REGION: usize = 16;

/// Pixels from one region to the next, about.
const SPACING: usize = 10;

/// Half the side of the local mean that is taken off.
const MEAN_REACH: usize = 2;

/// Variance (squared grey levels) under which contrast counts as noise.
const NOISE: f32 = 0.5;

/// How much the other regions' scores count beside the region's own.
const COMMON_WEIGHT: f32 = 0.4;

/// Pixels from the expected motion within which a second, calm motion is looked for.
const NEAR: f32 = 1.5;

/// Score taken off for each pixel away from the expected motion: decides between the equal peaks of
/// a repeated texture.
const SURPRISE: f32 = 0.004;

/// The coarsest level less its local mean, within a frame of zeros; and the energy of each window.
#[derive(Clone, Debug, Default)]
pub(super) struct Detail {
    width: usize,
    height: usize,
    /// `width + 2·RADIUS + REGION` pixels a row, so that no window of the search leaves it.
    data: Vec<f32>,
    /// Sum of squares of the window that starts at each pixel of `data`.
    energy: Vec<f32>,
    scratch: Vec<f32>,
}

impl Detail {
    fn stride(&self) -> usize {
        self.width + 2 * RADIUS + REGION
    }

    fn padded_rows(&self) -> usize {
        self.height + 2 * RADIUS + REGION
    }

    /// Takes a level; it is small, at most 64 × 64.
    pub(super) fn fill(&mut self, level: &Level) {
        (self.width, self.height) = (level.width, level.height);
        let (stride, rows) = (self.stride(), self.padded_rows());
        self.data.clear();
        self.data.resize(stride * rows, 0.0);
        for y in 0..level.height {
            let start = (y + RADIUS) * stride + RADIUS;
            for (x, out) in self.data[start..start + level.width].iter_mut().enumerate() {
                *out = level.data[y * level.width + x] - local_mean(level, x, y);
            }
        }
        self.fill_energy();
    }

    /// Window sums of squares, along the rows and then down the columns.
    fn fill_energy(&mut self) {
        let (stride, rows) = (self.stride(), self.padded_rows());
        self.scratch.clear();
        self.scratch.resize(stride * rows, 0.0);
        for (out, row) in self.scratch.chunks_exact_mut(stride).zip(self.data.chunks_exact(stride)) {
            for (out, window) in out.iter_mut().zip(row.windows(REGION)) {
                *out = window.iter().map(|value| value * value).sum();
            }
        }
        self.energy.clear();
        self.energy.resize(stride * rows, 0.0);
        for y in 0..=rows - REGION {
            let out = &mut self.energy[y * stride..(y + 1) * stride];
            for row in self.scratch[y * stride..(y + REGION) * stride].chunks_exact(stride) {
                out.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
            }
        }
    }

    /// The window whose top left pixel is (x, y) of the padded picture.
    #[inline(always)]
    fn window(&self, x: usize, y: usize) -> impl Iterator<Item = &[f32; REGION]> {
        let rows = self.data.get(y * self.stride()..).unwrap_or(&[]).chunks(self.stride());
        rows.take(REGION).filter_map(move |row| row.get(x..)?.first_chunk())
    }

    fn window_energy(&self, x: usize, y: usize) -> f32 {
        self.energy.get(y * self.stride() + x).copied().unwrap_or(0.0)
    }
}

fn local_mean(level: &Level, x: usize, y: usize) -> f32 {
    let (left, right) = (x.saturating_sub(MEAN_REACH), (x + MEAN_REACH + 1).min(level.width));
    let (top, bottom) = (y.saturating_sub(MEAN_REACH), (y + MEAN_REACH + 1).min(level.height));
    let rows = level.data[top * level.width..bottom * level.width].chunks_exact(level.width);
    let sum: f32 = rows.map(|row| row[left..right].iter().sum::<f32>()).sum();
    sum / ((right - left) * (bottom - top)) as f32
}

/// The motions found by the search: of each region, and of the whole frame.
#[derive(Debug, Default)]
pub(super) struct Search {
    columns: usize,
    rows: usize,
    /// Pixels of the coarsest level from one region's corner to the next.
    spacing: Vector2<f32>,
    /// Correlation by shift, region by region.
    scores: Vec<f32>,
    common: Vec<f32>,
    shifts: Vec<Vector2<f32>>,
    common_shift: Vector2<f32>,
    calm_shift: Vector2<f32>,
}

impl Search {
    /// Searches all regions. `expected` gives the motion expected at a point; points and motions
    /// are in pixels of the coarsest level.
    pub(super) fn run(
        &mut self,
        cpu: CpuLevel,
        first: &Detail,
        second: &Detail,
        expected: impl Fn(Vector2<f32>) -> Vector2<f32>,
    ) {
        self.lay_out(first.width, first.height);
        let (columns, corners) = (self.columns, self.corners());
        let scores = self.scores.par_chunks_exact_mut(SHIFTS * SHIFTS).enumerate();
        scores.for_each(|(index, scores)| {
            let corner = corners(index % columns, index / columns);
            match cpu {
                // SAFETY: the level is a proof of AVX2.
                #[cfg(target_arch = "x86_64")]
                CpuLevel::Avx2(_) => unsafe { score_avx2(first, second, corner, scores) },
                _ => score(first, second, corner, scores),
            }
        });
        self.sum_up();
        let middle = Vector2::new(first.width as f32, first.height as f32) * 0.5;
        self.common_shift = best_shift(&self.common, &self.common, expected(middle), f32::INFINITY);
        self.calm_shift = best_shift(&self.common, &self.common, expected(middle), NEAR);
        for index in 0..self.columns * self.rows {
            let (x, y) = corners(index % columns, index / columns);
            let middle = Vector2::new(x as f32, y as f32).add_scalar(0.5 * (REGION - 1) as f32);
            let scores = &self.scores[index * SHIFTS * SHIFTS..][..SHIFTS * SHIFTS];
            self.shifts[index] = best_shift(scores, &self.common, expected(middle), f32::INFINITY);
        }
    }

    fn lay_out(&mut self, width: usize, height: usize) {
        let count = |length: usize| length.saturating_sub(REGION).div_ceil(SPACING) + 1;
        (self.columns, self.rows) = (count(width), count(height));
        let spacing =
            |length: usize, count: usize| length.saturating_sub(REGION) as f32 / (count - 1).max(1) as f32;
        self.spacing = Vector2::new(spacing(width, self.columns), spacing(height, self.rows));
        self.scores.resize(self.columns * self.rows * SHIFTS * SHIFTS, 0.0);
        self.shifts.resize(self.columns * self.rows, Vector2::zeros());
    }

    /// The top left pixel of a region by its column and row.
    fn corners(&self) -> impl Fn(usize, usize) -> (usize, usize) + use<> {
        let spacing = self.spacing;
        move |i, j| ((i as f32 * spacing.x).round() as usize, (j as f32 * spacing.y).round() as usize)
    }

    /// Mean of the regions' scores.
    fn sum_up(&mut self) {
        self.common.clear();
        self.common.resize(SHIFTS * SHIFTS, 0.0);
        let share = 1.0 / (self.columns * self.rows) as f32;
        for scores in self.scores.chunks_exact(SHIFTS * SHIFTS) {
            self.common.iter_mut().zip(scores).for_each(|(sum, score)| *sum += share * score);
        }
    }

    /// The motion most of the frame shares, in pixels of the coarsest level.
    pub(super) fn common(&self) -> Vector2<f32> {
        self.common_shift
    }

    /// The motion most of the frame may share that is near the expected one.
    pub(super) fn calm(&self) -> Vector2<f32> {
        self.calm_shift
    }

    /// The motion of the region nearest to a point of the coarsest level.
    pub(super) fn nearest(&self, at: Vector2<f32>) -> Vector2<f32> {
        let (column, row) = self.position(at);
        self.shift(column.round().max(0.0) as usize, row.round().max(0.0) as usize)
    }

    /// The motion at a point by linear interpolation (and, near the borders, extrapolation) of
    /// the four regions around it: follows rotation, and shear along the rows.
    pub(super) fn interpolated(&self, at: Vector2<f32>) -> Vector2<f32> {
        let (column, row) = self.position(at);
        let cell = |position: f32, count: usize| (position.max(0.0) as usize).min(count.saturating_sub(2));
        let (i, j) = (cell(column, self.columns), cell(row, self.rows));
        let (u, v) = (column - i as f32, row - j as f32);
        let along = |j| self.shift(i, j) * (1.0 - u) + self.shift(i + 1, j) * u;
        along(j) * (1.0 - v) + along(j + 1) * v
    }

    /// A point in units of regions: whole numbers are their middles.
    fn position(&self, at: Vector2<f32>) -> (f32, f32) {
        let from_middle = at.add_scalar(-0.5 * (REGION - 1) as f32);
        let along = |value: f32, spacing: f32, count: usize| {
            if count > 1 { (value / spacing).clamp(-0.8, count as f32 - 0.2) } else { 0.0 }
        };
        (along(from_middle.x, self.spacing.x, self.columns), along(from_middle.y, self.spacing.y, self.rows))
    }

    fn shift(&self, column: usize, row: usize) -> Vector2<f32> {
        let (column, row) = (column.min(self.columns.max(1) - 1), row.min(self.rows.max(1) - 1));
        self.shifts.get(row * self.columns + column).copied().unwrap_or_default()
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn score_avx2(first: &Detail, second: &Detail, corner: (usize, usize), scores: &mut [f32]) {
    score(first, second, corner, scores);
}

/// Correlation of the region at `corner` with the second frame, for each shift, row by row.
///
/// The part that leaves the frame is zeros there but counts in the region's own energy: the less
/// there is to compare, the lower the score.
#[inline(always)]
fn score(first: &Detail, second: &Detail, (x, y): (usize, usize), scores: &mut [f32]) {
    let mut region = [[0.0; REGION]; REGION];
    for (out, row) in region.iter_mut().zip(first.window(x + RADIUS, y + RADIUS)) {
        *out = *row;
    }
    let floor = NOISE * (REGION * REGION) as f32;
    let energy = first.window_energy(x + RADIUS, y + RADIUS) + floor;
    for (dy, scores) in scores.chunks_exact_mut(SHIFTS).enumerate() {
        for (dx, score) in scores.iter_mut().enumerate() {
            let mut sums = [0.0; REGION];
            for (a, b) in region.iter().zip(second.window(x + dx, y + dy)) {
                for c in 0..REGION {
                    sums[c] += a[c] * b[c];
                }
            }
            let product: f32 = sums.iter().sum();
            *score = product / (energy * (second.window_energy(x + dx, y + dy) + floor)).sqrt();
        }
    }
}

/// The shift of the highest score, own and common, at most `reach` from the expected one along either
/// axis; the expected one where none is.
fn best_shift(scores: &[f32], common: &[f32], expected: Vector2<f32>, reach: f32) -> Vector2<f32> {
    let mut best = (f32::NEG_INFINITY, expected);
    for (index, (score, common)) in scores.iter().zip(common).enumerate() {
        let (dx, dy) = (index % SHIFTS, index / SHIFTS);
        let shift = Vector2::new(dx as f32, dy as f32).add_scalar(-(RADIUS as f32));
        let score = score + COMMON_WEIGHT * common - SURPRISE * (shift - expected).norm();
        if score > best.0 && (shift - expected).amax() <= reach {
            best = (score, shift);
        }
    }
    best.1
}
