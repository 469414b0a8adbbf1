//! An exhaustive search for small things that move unlike all that is around them.

use super::pyramid::Level;
use super::tracker::COARSE;
use crate::cpu::CpuLevel;
use nalgebra::Vector2;

/// Shifts searched, either way along both axes, in pixels of the level.
const RADIUS: usize = 16;

/// Shifts along one axis; one more than needed, for whole vectors.
const SHIFTS: usize = 2 * RADIUS;

/// Side of the window of the second frame that all shifts touch.
const WINDOW: usize = SHIFTS + COARSE;

/// Variance (squared grey levels) under which contrast counts as noise.
const NOISE: f32 = 0.5;

/// The shift near `expected` at which a patch of `first` around `at` correlates best with `second`, and
/// its coefficient of correlation; all in pixels of the level.
///
/// 32 × 32 shifts × 64 multiply-adds.
pub(super) fn best_shift(
    cpu: CpuLevel,
    [first, second]: [&Level; 2],
    at: Vector2<f32>,
    expected: Vector2<f32>,
) -> Option<(Vector2<f32>, f32)> {
    match cpu {
        // SAFETY: the caller vouches for the level.
        #[cfg(target_arch = "x86_64")]
        CpuLevel::Avx2 => unsafe { best_shift_avx2([first, second], at, expected) },
        _ => best_shift_scalar([first, second], at, expected),
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn best_shift_avx2(
    levels: [&Level; 2],
    at: Vector2<f32>,
    expected: Vector2<f32>,
) -> Option<(Vector2<f32>, f32)> {
    best_shift_scalar(levels, at, expected)
}

#[inline(always)]
fn best_shift_scalar(
    [first, second]: [&Level; 2],
    at: Vector2<f32>,
    expected: Vector2<f32>,
) -> Option<(Vector2<f32>, f32)> {
    let half = 0.5 * (COARSE as f32 - 1.0);
    let fit = |at: f32, length: usize| {
        let last = length.checked_sub(COARSE)?;
        Some((at - half).round().clamp(0.0, last as f32) as usize)
    };
    let (x, y) = (fit(at.x, first.width)?, fit(at.y, first.height)?);
    let mut patch = [[0.0f32; COARSE]; COARSE];
    for (r, row) in patch.iter_mut().enumerate() {
        row.copy_from_slice(first.data.get((y + r) * first.width + x..)?.get(..COARSE)?);
    }
    let mean = patch.as_flattened().iter().sum::<f32>() / (COARSE * COARSE) as f32;
    patch.as_flattened_mut().iter_mut().for_each(|value| *value -= mean);
    let energy: f32 = patch.as_flattened().iter().map(|value| value * value).sum();
    let floor = NOISE * (COARSE * COARSE) as f32;
    if energy < floor {
        return None;
    }
    let centre = expected.map(f32::round);
    let left = x as isize + centre.x as isize - RADIUS as isize;
    let top = y as isize + centre.y as isize - RADIUS as isize;
    let window = window(second, left, top, mean);
    let mut best: Option<(Vector2<f32>, f32)> = None;
    for dy in 0..SHIFTS {
        let row = top + dy as isize;
        if row < 0 || row + COARSE as isize > second.height as isize {
            continue;
        }
        let mut product = [0.0f32; SHIFTS];
        let mut sums = [0.0f32; WINDOW];
        let mut squares = [0.0f32; WINDOW];
        for r in 0..COARSE {
            let source = &window[dy + r];
            for c in 0..COARSE {
                let value = patch[r][c];
                for dx in 0..SHIFTS {
                    product[dx] += value * source[c + dx];
                }
            }
            for i in 0..WINDOW {
                sums[i] += source[i];
                squares[i] += source[i] * source[i];
            }
        }
        for dx in 0..SHIFTS {
            let column = left + dx as isize;
            if column < 0 || column + COARSE as isize > second.width as isize {
                continue;
            }
            let sum: f32 = sums[dx..dx + COARSE].iter().sum();
            let square: f32 = squares[dx..dx + COARSE].iter().sum();
            let other = square - sum * sum / (COARSE * COARSE) as f32;
            let score = product[dx] / ((energy + floor) * (other + floor)).sqrt();
            if best.is_none_or(|best| score > best.1) {
                let shift = Vector2::new(dx as f32, dy as f32).add_scalar(-(RADIUS as f32));
                best = Some((centre + shift, score));
            }
        }
    }
    best
}

/// The window of a level from (`left`, `top`) on, less `mean`; zeros outside the picture.
#[inline(always)]
fn window(level: &Level, left: isize, top: isize, mean: f32) -> [[f32; WINDOW]; WINDOW] {
    let mut window = [[0.0; WINDOW]; WINDOW];
    for (r, out) in window.iter_mut().enumerate() {
        let row = top + r as isize;
        if row < 0 || row >= level.height as isize {
            continue;
        }
        for (c, out) in out.iter_mut().enumerate() {
            let column = left + c as isize;
            if column >= 0 && column < level.width as isize {
                *out = level.data[row as usize * level.width + column as usize] - mean;
            }
        }
    }
    window
}
