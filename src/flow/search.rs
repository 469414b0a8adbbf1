// SPDX-License-Identifier: MIT OR Apache-2.0

//! The coarsest level: exhaustive search of every patch.
//!
//! It makes the flow independent of any prediction. The level is at most 48 pixels long, so that a quarter of
//! the frame's width is 12 pixels at most and 25 × 25 displacements are compared for each of some 80 patches.

use super::level::LevelPair;
use super::patch::{AREA, PatchGroup, SIDE};
use crate::lanes::WordCpu;

/// Largest displacement searched along each axis, as a share of the frame's width.
const REACH: f32 = 0.25;

/// Cost of a displacement per pixel of its length, in noise variances of a pixel: decides between equal
/// residuals only.
const LENGTH_COST: f32 = 0.1;

/// The displacement (pixels of the level) of the lowest cost, for the patch in lane `k` of a group, whose top left pixel
/// is (x, y); zero if the patch cannot be compared anywhere.
#[inline(always)]
pub(super) fn exhaustive<C: WordCpu>(
    group: &PatchGroup<C>,
    k: usize,
    pair: LevelPair<'_>,
    [x, y]: [usize; 2],
) -> [f32; 2] {
    let (second, noise) = (pair.second, pair.noise);
    let reach = (REACH * second.width() as f32).ceil() as i32;
    // At least half of the patch must lie in the second frame, along each axis.
    let half = SIDE as i32 / 2;
    let range = |at: usize, length: usize| {
        let at = at as i32;
        (at - reach).max(-half)..=(at + reach).min(length as i32 - half)
    };
    let mut best = ([0.0; 2], f32::INFINITY);
    let across = range(x, second.width());
    let first = *across.start();
    for to_y in range(y, second.height()) {
        let Some(samples) = second.from(first, to_y) else { continue };
        let mut shift = [(first - x as i32) as f32 - 1.0, (to_y - y as i32) as f32];
        for samples in (0..across.clone().count()).filter_map(|column| samples.get(column..)) {
            shift[0] += 1.0;
            let length = (shift[0] * shift[0] + shift[1] * shift[1]).sqrt();
            let Some(residual) = group.residual_at(k, samples, second.stride()) else { continue };
            let cost = residual + AREA * LENGTH_COST * noise * length;
            if cost < best.1 {
                best = (shift, cost);
            }
        }
    }
    best.0
}
