// SPDX-License-Identifier: MIT OR Apache-2.0

//! The difference of two frames, to detect duplicates.

use super::level::Level;
use super::reducer::Pyramid;
use crate::cpu::{CpuLevel, for_each_cpu};
use crate::parallel::*;

/// Side of a block in pixels of level 1.
const SIDE: usize = 4;

/// Pixels of a row of two blocks, which are compared side by side.
const PAIR: usize = 2 * SIDE;

/// The difference of two frames of one size: the largest mean absolute grey difference (0 to 255) of any
/// block of 8 × 8 analysed pixels, computed from 4 × 4 pixels at half the resolution.
///
/// The largest block instead of the mean of the frame detects small motions of small objects in a still
/// scene; half the resolution suppresses the noise of re-encoding. An exact duplicate has 0, a re-encoded one
/// 1 to 10; an object of 12 pixels and a contrast of 50 grey levels that moves by one pixel has 3 to 6.
/// Infinite if a pyramid is empty.
pub(crate) fn block_difference(cpu: CpuLevel, first: &Pyramid, second: &Pyramid) -> f64 {
    let level = |pyramid: &'_ Pyramid| pyramid.levels().len().checked_sub(1).map(|last| last.min(1));
    let levels = level(first).zip(level(second));
    let Some((a, b)) = levels.and_then(|(a, b)| first.levels().get(a).zip(second.levels().get(b))) else {
        return f64::INFINITY;
    };
    let bands = (0..a.height()).into_par_iter().step_by(SIDE);
    f64::from(bands.map(|top| band_difference(cpu, a, b, top)).max_by(f32::total_cmp).unwrap_or(0.0))
}

/// The largest difference of the blocks whose first row is `top`.
fn band_difference(cpu: CpuLevel, first: &Level, second: &Level, top: usize) -> f32 {
    let rows = |level| -> [&[f32]; SIDE] {
        std::array::from_fn(|r| Level::from(level, 0, (top + r) as i32).unwrap_or_default())
    };
    // Blocks that the picture has in full and in pairs, and the others.
    let is_full = top + SIDE <= first.height();
    let pairs = if is_full { first.width() / PAIR } else { 0 };
    let inside = pairs_difference(cpu, rows(first), rows(second), pairs);
    let others = (pairs * PAIR..first.width()).step_by(SIDE).map(|left| {
        let (count, rows) = (SIDE.min(first.width() - left), top..(top + SIDE).min(first.height()));
        let sums = rows.clone().map(|y| {
            let of = |level| Level::from(level, left as i32, y as i32).unwrap_or(&[]).iter().take(count);
            of(first).zip(of(second)).map(|(a, b)| (a - b).abs()).sum::<f32>()
        });
        sums.sum::<f32>() / (count * rows.len()) as f32
    });
    others.fold(inside, f32::max)
}

for_each_cpu! {
    /// The largest difference of the first blocks of four rows, so many pairs.
    fn pairs_difference(first: [&[f32]; SIDE], second: [&[f32]; SIDE], pairs: usize) -> f32 {
        let [a, b, c, d] = first;
        let [e, f, g, h] = second;
        let (a, b, c, d) = (pairs_of(a), pairs_of(b), pairs_of(c), pairs_of(d));
        let (e, f, g, h) = (pairs_of(e), pairs_of(f), pairs_of(g), pairs_of(h));
        let first = a.iter().zip(b).zip(c.iter().zip(d));
        let second = e.iter().zip(f).zip(g.iter().zip(h));
        let mut most = 0f32;
        for (((a, b), (c, d)), ((e, f), (g, h))) in first.zip(second).take(pairs) {
            let mut sums = [0f32; PAIR];
            for (k, sum) in sums.iter_mut().enumerate() {
                *sum = ((a[k] - e[k]).abs() + (b[k] - f[k]).abs()) + ((c[k] - g[k]).abs() + (d[k] - h[k]).abs());
            }
            let [p, q, r, s, t, u, v, w] = sums;
            most = most.max((p + q) + (r + s)).max((t + u) + (v + w));
        }
        most / (SIDE * SIDE) as f32
    }
}

/// The samples of a row, as pairs of blocks have them.
#[inline(always)]
fn pairs_of(row: &[f32]) -> &[[f32; PAIR]] {
    row.as_chunks().0
}
