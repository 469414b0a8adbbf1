//! A window around a pixel that counts what looks like that pixel, and where another frame shows the same.
//!
//! Pixels of another grey likely belong to something else, so a window that reaches over an edge sees its own side
//! only (adaptive support weights: K.-J. Yoon, I. S. Kweon, *Adaptive Support-Weight Approach for
//! Correspondence Search*, PAMI 28(4), 2006). It is followed by Gauss and Newton's steps with the gradients of the
//! first frame, differences weighted as by Geman and McClure.

use super::pyramid::Level;
use super::sampler::{Pair, Patch};
use super::tracker::FINE;
#[cfg(target_arch = "x86_64")]
use crate::cpu::Avx2;
use crate::cpu::CpuLevel;
use nalgebra::{Matrix2, Vector2};

/// Root mean square difference in grey levels that two patches have for rounding alone, about.
const LEAST_NOISE: f32 = 0.5;

/// Side of a window in pixels.
const SIDE: usize = 8;

/// Side of what its gradients need.
const WIDE: usize = SIDE + 2;

/// Grey levels by which things differ from each other, where there is little noise.
const CONTRAST: f32 = 20.0;

/// The same in differences that noise alone makes.
const BEYOND_NOISE: f32 = 4.0;

/// Distance in pixels at which a pixel counts half.
const REACH: f32 = 4.0;

/// Squared grey levels added to the eigenvalues: along an edge the start is kept.
const DAMPING: f32 = 1.0;

/// Samplings of the other frame, at most.
const SAMPLINGS: usize = 4;

/// A step shorter than this, in pixels, leads to no other sampling.
const LAST_STEP: f32 = 0.1;

/// A fit lies this close to its start, in pixels.
const MOST_STRAY: f32 = 2.5;

type Rows = [[f32; SIDE]; SIDE];

/// By what two frames differ where they show the same.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scale {
    /// Root mean square difference in grey levels.
    pub(super) noise: f32,
    /// Grey of the second frame over that of the first.
    pub(super) gain: f32,
}

impl Scale {
    /// The scale of a pair of frames, from the patches that were found in both.
    pub(super) fn of<'a>(pair: &Pair<'_>, found: impl Iterator<Item = &'a Patch<FINE>> + Clone) -> Self {
        let noise = median(found.clone().map(|patch| patch.found.residual));
        let gain = median(found.filter_map(|patch| gain(pair, patch)));
        Self { noise: noise.unwrap_or(0.0).max(LEAST_NOISE), gain: gain.unwrap_or(1.0) }
    }

    /// The scale of the way back.
    pub(super) fn reversed(self) -> Self {
        Self { gain: 1.0 / self.gain, ..self }
    }

    /// A mean squared difference that noise explains.
    pub(super) fn enough(&self) -> f32 {
        self.noise * self.noise
    }

    /// The squared difference that tells one thing from another.
    fn contrast(&self) -> f32 {
        CONTRAST.max(BEYOND_NOISE * self.noise).powi(2)
    }
}

/// Grey of a patch in the second frame over that in the first, from every fourth row on whole pixels.
fn gain(pair: &Pair<'_>, patch: &Patch<FINE>) -> Option<f32> {
    let sum = |level: &Level, corner: Vector2<f32>| {
        let (x, y) = (corner.x.round() as usize, corner.y.round() as usize);
        let row = |r: usize| level.data.get((y + r) * level.width + x..)?.get(..FINE);
        (0..FINE).step_by(4).map(|r| Some(row(r)?.iter().sum::<f32>())).sum::<Option<f32>>()
    };
    let before = sum(pair.first.first()?, patch.from)?;
    let after = sum(pair.second.first()?, patch.found.corner)?;
    (before > 0.0 && after > 0.0).then(|| after / before)
}

/// The middle one of some numbers.
fn median(numbers: impl Iterator<Item = f32>) -> Option<f32> {
    let mut numbers: Vec<f32> = numbers.collect();
    let middle = numbers.len() / 2;
    (!numbers.is_empty()).then(|| *numbers.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Where a window was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit {
    pub(super) shift: Vector2<f32>,
    /// Weighted mean of the squared difference, in squared grey levels; none counts more than a contrast.
    pub(super) cost: f32,
    /// The smaller eigenvalue of the gradients' matrix, as weighted mean.
    pub(super) texture: f32,
}

/// A window and what its pixels count.
pub(super) struct Window {
    cpu: CpuLevel,
    /// Its top left pixel.
    corner: Vector2<f32>,
    /// Grey and its gradients, as the second frame is to show them.
    values: Rows,
    gradient_x: Rows,
    gradient_y: Rows,
    weights: Rows,
    /// Inverse of the sum of the weights.
    share: f32,
    /// Inverse of the squared contrast.
    precision: f32,
    /// A cost that noise explains.
    enough: f32,
}

/// What a sampling says.
struct Look {
    fit: Fit,
    step: Vector2<f32>,
}

impl Window {
    /// The window around a whole pixel; `None` where it and a margin of one pixel do not fit.
    pub(super) fn new(cpu: CpuLevel, level: &Level, at: Vector2<f32>, scale: Scale) -> Option<Self> {
        let (x, y) = ((at.x as usize).checked_sub(WIDE / 2)?, (at.y as usize).checked_sub(WIDE / 2)?);
        if x + WIDE > level.width || y + WIDE > level.height {
            return None;
        }
        let mut samples = [[0.0; WIDE]; WIDE];
        for (r, row) in samples.iter_mut().enumerate() {
            *row = *level.data.get((y + r) * level.width + x..)?.first_chunk()?;
        }
        let corner = Vector2::new(x as f32 + 1.0, y as f32 + 1.0);
        Some(match cpu {
            // SAFETY: the level is a proof of AVX2.
            #[cfg(target_arch = "x86_64")]
            CpuLevel::Avx2(avx2) => unsafe { Self::weighed_avx2(avx2, &samples, corner, scale) },
            _ => Self::weighed(CpuLevel::Scalar, &samples, corner, scale),
        })
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn weighed_avx2(avx2: Avx2, samples: &[[f32; WIDE]; WIDE], corner: Vector2<f32>, scale: Scale) -> Self {
        Self::weighed(CpuLevel::Avx2(avx2), samples, corner, scale)
    }

    #[inline(always)]
    fn weighed(cpu: CpuLevel, samples: &[[f32; WIDE]; WIDE], corner: Vector2<f32>, scale: Scale) -> Self {
        let precision = 1.0 / scale.contrast();
        let own = middle(samples);
        let rows = [[0.0; SIDE]; SIDE];
        let (mut values, mut gradient_x, mut gradient_y, mut weights) = (rows, rows, rows, rows);
        let mut sums = [0.0; SIDE];
        for r in 0..SIDE {
            for c in 0..SIDE {
                let (x, y) = (c as f32 - (SIDE / 2) as f32, r as f32 - (SIDE / 2) as f32);
                let difference = samples[r + 1][c + 1] - own;
                let alike = 1.0 / (1.0 + difference * difference * precision);
                let near = 1.0 / (1.0 + (x * x + y * y) / (REACH * REACH));
                weights[r][c] = alike * alike * near;
                sums[c] += weights[r][c];
                values[r][c] = scale.gain * samples[r + 1][c + 1];
                gradient_x[r][c] = 0.5 * scale.gain * (samples[r + 1][c + 2] - samples[r + 1][c]);
                gradient_y[r][c] = 0.5 * scale.gain * (samples[r + 2][c + 1] - samples[r][c + 1]);
            }
        }
        let share = 1.0 / sums.iter().sum::<f32>();
        Self {
            cpu,
            corner,
            values,
            gradient_x,
            gradient_y,
            weights,
            share,
            precision,
            enough: scale.enough(),
        }
    }

    /// Follows the window from a start, for as long as it fits better; `None` where the start is outside the image.
    pub(super) fn fit(&self, level: &Level, start: Vector2<f32>) -> Option<Fit> {
        let mut best = self.look(level, start)?;
        for _ in 1..SAMPLINGS {
            let shift = best.fit.shift + best.step;
            let is_far = (shift - start).norm() > MOST_STRAY;
            if is_far || best.step.norm() < LAST_STEP || best.fit.cost <= self.enough {
                break;
            }
            match self.look(level, shift) {
                Some(look) if look.fit.cost < best.fit.cost => best = look,
                _ => break,
            }
        }
        Some(best.fit)
    }

    fn look(&self, level: &Level, shift: Vector2<f32>) -> Option<Look> {
        match self.cpu {
            // SAFETY: the level is a proof of AVX2.
            #[cfg(target_arch = "x86_64")]
            CpuLevel::Avx2(_) => unsafe { self.look_avx2(level, shift) },
            _ => self.look_scalar(level, shift),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn look_avx2(&self, level: &Level, shift: Vector2<f32>) -> Option<Look> {
        self.look_scalar(level, shift)
    }

    /// Compares with the other frame, sampled linearly.
    #[inline(always)]
    fn look_scalar(&self, level: &Level, shift: Vector2<f32>) -> Option<Look> {
        let rows = Sampled::new(level, self.corner + shift)?;
        let mut sums = [[0.0; SIDE]; 6];
        for r in 0..SIDE {
            let (greys, values, weights) = (rows.row(r), &self.values[r], &self.weights[r]);
            let (gradient_x, gradient_y) = (&self.gradient_x[r], &self.gradient_y[r]);
            for c in 0..SIDE {
                let difference = greys[c] - values[c];
                let square = difference * difference;
                let share = 1.0 / (1.0 + square * self.precision);
                let (x, y) = (gradient_x[c], gradient_y[c]);
                let weight = weights[c] * share;
                sums[0][c] += weight * square;
                let weight = weight * share;
                sums[1][c] += weight * x * difference;
                sums[2][c] += weight * y * difference;
                sums[3][c] += weight * x * x;
                sums[4][c] += weight * x * y;
                sums[5][c] += weight * y * y;
            }
        }
        let [cost, x, y, xx, xy, yy] = sums.map(|sums| sums.iter().sum::<f32>() * self.share);
        let texture = 0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        let matrix = Matrix2::new(xx + DAMPING, xy, xy, yy + DAMPING);
        let step = matrix.try_inverse()? * -Vector2::new(x, y);
        Some(Look { fit: Fit { shift, cost, texture: texture.max(0.0) }, step })
    }
}

/// The grey of the middle, with less noise than one pixel has.
#[inline(always)]
fn middle(samples: &[[f32; WIDE]; WIDE]) -> f32 {
    let m = WIDE / 2;
    let beside = (samples[m - 1][m] + samples[m + 1][m]) + (samples[m][m - 1] + samples[m][m + 1]);
    0.5 * samples[m][m] + 0.125 * beside
}

/// A window of a frame between its pixels.
struct Sampled {
    rows: [[f32; SIDE]; SIDE + 1],
    /// How far each row lies from the one above, as a share.
    down: f32,
}

impl Sampled {
    /// From `corner` on; `None` where that leaves the image.
    #[inline(always)]
    fn new(level: &Level, corner: Vector2<f32>) -> Option<Self> {
        let whole = Vector2::new(corner.x.floor(), corner.y.floor());
        let inside = |at: f32, length: usize| at >= 0.0 && at + (SIDE as f32) < length as f32;
        if !(inside(whole.x, level.width) && inside(whole.y, level.height)) {
            return None;
        }
        let (x, y) = (whole.x as usize, whole.y as usize);
        let across = corner.x - whole.x;
        let mut rows = [[0.0; SIDE]; SIDE + 1];
        for (r, row) in rows.iter_mut().enumerate() {
            let source: &[f32; SIDE + 1] = level.data.get((y + r) * level.width + x..)?.first_chunk()?;
            for (c, value) in row.iter_mut().enumerate() {
                *value = source[c] + across * (source[c + 1] - source[c]);
            }
        }
        Some(Self { rows, down: corner.y - whole.y })
    }

    #[inline(always)]
    fn row(&self, r: usize) -> [f32; SIDE] {
        let (above, below) = (&self.rows[r], &self.rows[r + 1]);
        std::array::from_fn(|c| above[c] + self.down * (below[c] - above[c]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCALE: Scale = Scale { noise: 1.0, gain: 1.0 };

    fn level(grey: impl Fn(f32, f32) -> f32) -> Level {
        let (width, height) = (48, 40);
        let data = (0..width * height).map(|i| grey((i % width) as f32, (i / width) as f32)).collect();
        Level { width, height, data }
    }

    fn wave(x: f32, y: f32) -> f32 {
        100.0 + 20.0 * (x / 2.5 + 0.3 * y).sin() + 15.0 * (y / 3.0 - 0.2 * x).cos()
    }

    fn window(level: &Level, scale: Scale) -> Window {
        Window::new(CpuLevel::Scalar, level, Vector2::new(20.0, 18.0), scale).unwrap()
    }

    #[test]
    fn a_shift_is_found_between_pixels_from_two_pixels_off() {
        let (first, second) = (level(wave), level(|x, y| wave(x - 3.4, y + 1.7)));
        let fit = window(&first, SCALE).fit(&second, Vector2::new(2.0, -1.0)).unwrap();
        assert!((fit.shift - Vector2::new(3.4, -1.7)).norm() < 0.15, "{fit:?}");
        assert!(fit.cost < 2.0 && fit.texture > 1.0, "{fit:?}");
    }

    #[test]
    fn a_brighter_frame_fits_as_well_once_the_gain_is_known() {
        let (first, second) = (level(wave), level(|x, y| 1.3 * wave(x - 2.0, y)));
        let shift = Vector2::new(2.0, 0.0);
        let cost = |gain| window(&first, Scale { gain, ..SCALE }).fit(&second, shift).unwrap().cost;
        assert!(cost(1.3) < 1e-3 && cost(1.0) > 100.0, "{} {}", cost(1.3), cost(1.0));
    }

    #[test]
    fn beside_an_edge_the_own_side_counts() {
        // From x = 22 on something bright moves by 5 pixels; the place at 20 stands still.
        let scene =
            |edge: f32| level(move |x, y| if x < edge { wave(x, y) } else { 150.0 + wave(x - edge, y) });
        let (first, second) = (scene(22.0), scene(27.0));
        let window = window(&first, SCALE);
        let cost = |x: f32| window.fit(&second, Vector2::new(x, 0.0)).unwrap().cost;
        assert!(cost(0.0) < 2.0 && cost(5.0) > 50.0, "{} {}", cost(0.0), cost(5.0));
    }

    #[test]
    fn outside_there_is_nothing() {
        let level = level(wave);
        for at in [(4.0, 18.0), (20.0, 4.0), (44.0, 18.0), (20.0, 36.0)] {
            assert!(Window::new(CpuLevel::Scalar, &level, Vector2::new(at.0, at.1), SCALE).is_none());
        }
        let window = window(&level, SCALE);
        for shift in [(-17.0, 0.0), (0.0, -15.0), (24.5, 0.0), (0.0, 18.5), (f32::NAN, 0.0)] {
            assert_eq!(window.fit(&level, Vector2::new(shift.0, shift.1)), None, "{shift:?}");
        }
    }

    #[test]
    fn all_levels_measure_the_same() {
        let (first, second) = (level(wave), level(|x, y| wave(x - 1.3, y - 0.6)));
        let fit = |cpu| {
            let window = Window::new(cpu, &first, Vector2::new(20.0, 18.0), SCALE).unwrap();
            window.fit(&second, Vector2::new(0.5, 0.0))
        };
        assert_eq!(fit(CpuLevel::detect()), fit(CpuLevel::Scalar));
    }
}
