//! An exhaustive search for small things that move unlike all that is around them.
//!
//! The search at the start looks at regions of a quarter of the frame, so what is smaller and nearer
//! than its surroundings (or farther) is lost. Here one small patch is looked for on a level in between.

use super::pyramid::Level;
use super::tracker::COARSE;
use crate::cpu::CpuLevel;
use nalgebra::Vector2;

/// Shifts searched, either way along both axes, in pixels of the level.
const RADIUS: usize = 16;

/// Shifts along one axis: one less on the far side, for whole vectors.
const SHIFTS: usize = 2 * RADIUS;

/// Side of the window of the second frame that all shifts touch.
const WINDOW: usize = SHIFTS + COARSE;

/// Pixels of a patch.
const COUNT: f32 = (COARSE * COARSE) as f32;

/// Variance (squared grey levels) under which contrast counts as noise.
const NOISE: f32 = 0.5;

type Patch = [[f32; COARSE]; COARSE];
type Window = [[f32; WINDOW]; WINDOW];

/// The shift near `expected` at which the patch of the first level around `at` correlates best with the
/// second, and its coefficient of correlation; all in pixels of the level. `None` without contrast.
///
/// 32 × 32 shifts of 64 multiply-adds: 66 k.
pub(super) fn best_shift(
    cpu: CpuLevel,
    levels: [&Level; 2],
    at: Vector2<f32>,
    expected: Vector2<f32>,
) -> Option<(Vector2<f32>, f32)> {
    match cpu {
        // SAFETY: the level is a proof of AVX2.
        #[cfg(target_arch = "x86_64")]
        CpuLevel::Avx2(_) => unsafe { best_shift_avx2(levels, at, expected) },
        _ => best_shift_scalar(levels, at, expected),
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
    let (x, y) = (corner(at.x, first.width)?, corner(at.y, first.height)?);
    let (patch, mean) = patch(first, x, y)?;
    let energy: f32 = patch.as_flattened().iter().map(|value| value * value).sum();
    if energy < NOISE * COUNT {
        return None;
    }
    let middle = expected.map(f32::round);
    let origin = |corner: usize, shift: f32| {
        (corner as isize).saturating_add(shift as isize).saturating_sub(RADIUS as isize)
    };
    let (left, top) = (origin(x, middle.x), origin(y, middle.y));
    let window = window(second, left, top, mean);
    let fits =
        |first: isize, length: usize| first >= 0 && first.saturating_add(COARSE as isize) <= length as isize;
    let mut best = None;
    for dy in (0..SHIFTS).filter(|dy| fits(top.saturating_add(*dy as isize), second.height)) {
        let scores = correlations(&patch, energy, &window, dy);
        for (dx, score) in scores.into_iter().enumerate() {
            let is_better = best.is_none_or(|(_, highest)| score > highest);
            if is_better && fits(left.saturating_add(dx as isize), second.width) {
                let shift = Vector2::new(dx as f32, dy as f32).add_scalar(-(RADIUS as f32));
                best = Some((middle + shift, score));
            }
        }
    }
    best
}

/// The first pixel of a patch around a point, moved into the picture.
fn corner(at: f32, length: usize) -> Option<usize> {
    let last = length.checked_sub(COARSE)?;
    Some((at - 0.5 * (COARSE as f32 - 1.0)).round().clamp(0.0, last as f32) as usize)
}

/// A patch less its mean, and the mean.
#[inline(always)]
fn patch(level: &Level, x: usize, y: usize) -> Option<(Patch, f32)> {
    let mut patch = [[0.0; COARSE]; COARSE];
    for (r, row) in patch.iter_mut().enumerate() {
        *row = *level.data.get((y + r) * level.width + x..)?.first_chunk()?;
    }
    let mean = patch.as_flattened().iter().sum::<f32>() / COUNT;
    patch.as_flattened_mut().iter_mut().for_each(|value| *value -= mean);
    Some((patch, mean))
}

/// The window of a level from (`left`, `top`) on, less `mean`; zeros outside the picture.
#[inline(always)]
fn window(level: &Level, left: isize, top: isize, mean: f32) -> Window {
    let mut window = [[0.0; WINDOW]; WINDOW];
    for (r, out) in window.iter_mut().enumerate() {
        let Some(y) = top.checked_add_unsigned(r).and_then(|y| usize::try_from(y).ok()) else { continue };
        let Some(row) = level.data.chunks_exact(level.width).nth(y) else { continue };
        for (c, out) in out.iter_mut().enumerate() {
            let x = left.checked_add_unsigned(c).and_then(|x| usize::try_from(x).ok());
            if let Some(grey) = x.and_then(|x| row.get(x)) {
                *out = grey - mean;
            }
        }
    }
    window
}

/// Coefficients of correlation of a patch with the window's patches from row `dy` on, by column.
#[inline(always)]
fn correlations(patch: &Patch, energy: f32, window: &Window, dy: usize) -> [f32; SHIFTS] {
    let mut products = [0.0; SHIFTS];
    let mut sums = [0.0; WINDOW];
    let mut squares = [0.0; WINDOW];
    for (values, source) in patch.iter().zip(&window[dy..dy + COARSE]) {
        for (c, value) in values.iter().enumerate() {
            for dx in 0..SHIFTS {
                products[dx] += value * source[c + dx];
            }
        }
        for i in 0..WINDOW {
            sums[i] += source[i];
            squares[i] += source[i] * source[i];
        }
    }
    let floor = NOISE * COUNT;
    std::array::from_fn(|dx| {
        let sum: f32 = sums[dx..dx + COARSE].iter().sum();
        let square: f32 = squares[dx..dx + COARSE].iter().sum();
        let other = (square - sum * sum / COUNT).max(0.0);
        products[dx] / ((energy + floor) * (other + floor)).sqrt()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hashed grey: no two patches are alike.
    fn level(shift: (usize, usize), gain: f32) -> Level {
        let grey = |x: usize, y: usize| {
            let hash = x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663);
            gain * ((((hash ^ (hash >> 7)) as u32).wrapping_mul(2_654_435_761) >> 9) % 200) as f32 + 9.0
        };
        let data = (0..60 * 80).map(|i| grey(i % 80 + 64 - shift.0, i / 80 + 64 - shift.1)).collect();
        Level { width: 80, height: 60, data }
    }

    #[test]
    fn a_shift_is_found_in_spite_of_brightness() {
        let (first, second) = (level((0, 0), 1.0), level((11, 7), 0.7));
        for cpu in CpuLevel::supported() {
            for at in [Vector2::new(20.0, 20.0), Vector2::new(3.0, 2.0)] {
                let (shift, score) = best_shift(cpu, [&first, &second], at, Vector2::zeros()).unwrap();
                assert_eq!(shift, Vector2::new(11.0, 7.0));
                assert!(score > 0.99);
            }
        }
    }

    #[test]
    fn expectations_beyond_the_picture_find_nothing() {
        let first = level((0, 0), 1.0);
        let far = Vector2::new(-1e20, 1e20);
        assert_eq!(best_shift(CpuLevel::Scalar, [&first, &first], Vector2::new(20.0, 20.0), far), None);
        let flat = Level { width: 20, height: 20, data: vec![7.0; 400] };
        assert_eq!(best_shift(CpuLevel::Scalar, [&flat, &flat], Vector2::zeros(), Vector2::zeros()), None);
    }
}
