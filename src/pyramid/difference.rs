// SPDX-License-Identifier: MIT OR Apache-2.0

//! The difference of two frames, to detect duplicates.

use super::level::Level;
use super::reducer::Pyramid;
use crate::parallel::*;

/// Side of a block in pixels of level 1.
const SIDE: usize = 4;

/// The difference of two frames of one size: the largest mean absolute grey difference (0 to 255) of any
/// block of 8 × 8 analysed pixels, computed from 4 × 4 pixels at half the resolution.
///
/// The largest block instead of the mean of the frame detects small motions of small objects in a still
/// scene; half the resolution suppresses the noise of re-encoding. An exact duplicate has 0, a re-encoded one
/// 1 to 10; an object of 12 pixels and a contrast of 50 grey levels that moves by one pixel has 3 to 6.
/// Infinite if a pyramid is empty.
pub(crate) fn block_difference(first: &Pyramid, second: &Pyramid) -> f64 {
    let level = |pyramid: &'_ Pyramid| pyramid.levels().len().checked_sub(1).map(|last| last.min(1));
    let levels = level(first).zip(level(second));
    let Some((a, b)) = levels.and_then(|(a, b)| first.levels().get(a).zip(second.levels().get(b))) else {
        return f64::INFINITY;
    };
    let bands = (0..a.height()).into_par_iter().step_by(SIDE);
    f64::from(bands.map(|top| band_difference(a, b, top)).max_by(f32::total_cmp).unwrap_or(0.0))
}

/// The largest difference of the blocks whose first row is `top`.
fn band_difference(first: &Level, second: &Level, top: usize) -> f32 {
    let rows = top..(top + SIDE).min(first.height());
    let columns = (0..first.width()).step_by(SIDE).map(|left| {
        let count = SIDE.min(first.width() - left);
        let sums = rows.clone().map(|y| {
            let of = |level| Level::from(level, left as i32, y as i32).unwrap_or(&[]).iter().take(count);
            of(first).zip(of(second)).map(|(a, b)| (a - b).abs()).sum::<f32>()
        });
        sums.sum::<f32>() / (count * rows.len()) as f32
    });
    columns.fold(0.0, f32::max)
}
