// SPDX-License-Identifier: MIT OR Apache-2.0

//! The coarsest level: exhaustive search of every patch.
//!
//! With t′ a patch less its mean and s a patch of the other frame, the residual about the mean is ∑t′² + ∑(s − s̄)² −
//! 2·∑t′·s. The first sum is the same everywhere, the second the same for all patches: only the last is computed for each
//! displacement, eight of them side by side.
//!
//! It makes the flow independent of any prediction. The level is at most 48 pixels long, so that a quarter of
//! the frame's width is 12 pixels at most and 25 × 25 displacements are compared for each of some 80 patches.

use super::level::LevelPair;
use super::patch::{AREA, GROUP, PatchGroup, SIDE, products};
use super::rows::{RowKernel, fill};
use crate::cpu::CpuLevel;
use crate::lanes::WordCpu;
use crate::lanes::rows::SampleRows;
use crate::pyramid::Level;

/// Largest displacement searched along each axis, as a share of the frame's width.
const REACH: f32 = 0.25;

/// Cost of a displacement per pixel of its length, in noise variances of a pixel: decides between equal
/// residuals only.
const LENGTH_COST: f32 = 0.1;

/// At least half of a patch must lie in the other frame, along each axis.
const OUTSIDE: usize = SIDE / 2;

/// Of every patch of a level its squared differences from its mean, summed.
#[derive(Debug, Default)]
pub(super) struct Spreads {
    sums: Vec<f32>,
    /// Patches in a row, and some to spare, so that eight can be read anywhere.
    stride: usize,
}

struct SpreadKernel<'a>(&'a Level);

impl RowKernel<f32> for SpreadKernel<'_> {
    type Scratch<C: WordCpu> = ();

    #[inline(always)]
    fn fill<C: WordCpu>(&self, cpu: C, (): &mut (), row: usize, out: &mut [f32]) {
        let y = row as i32 - OUTSIDE as i32;
        for (index, out) in out.as_chunks_mut::<GROUP>().0.iter_mut().enumerate() {
            let x = (index * GROUP) as i32 - OUTSIDE as i32;
            let samples = self.0.from(x, y).unwrap_or_default();
            let Some(rows) = SampleRows::<SIDE, { SIDE + GROUP }>::new(samples, self.0.stride()) else {
                *out = [f32::INFINITY; GROUP];
                continue;
            };
            // A grey of the patches, to avoid cancellation.
            let pivot = cpu.splat(rows.at(SIDE / 2, SIDE)[0]);
            let mut sums = [cpu.splat(0.0); 2];
            for r in 0..SIDE {
                for c in 0..SIDE {
                    let value = cpu.load(rows.at(r, c)) - pivot;
                    sums = [sums[0] + value, cpu.fused(value, value, sums[1])];
                }
            }
            *out = cpu.store(sums[1] - sums[0] * sums[0] * cpu.splat(1.0 / AREA));
        }
    }
}

impl Spreads {
    /// Those of a level.
    pub(super) fn fill(&mut self, cpu: CpuLevel, level: &Level) {
        self.stride = (level.width() + 1).next_multiple_of(GROUP) + GROUP;
        self.sums.resize(self.stride * (level.height() + 1), 0.0);
        fill(cpu, &SpreadKernel(level), self.stride, &mut self.sums);
    }

    /// The displacement (pixels of the level) of the lowest cost, for the patch in lane `k` of a group, whose top left
    /// pixel is (x, y); zero if the patch cannot be compared anywhere.
    #[inline(always)]
    pub(super) fn exhaustive<C: WordCpu>(
        &self,
        group: &PatchGroup<C>,
        k: usize,
        pair: LevelPair<'_>,
        [x, y]: [usize; 2],
    ) -> [f32; 2] {
        let (cpu, second) = (group.cpu, pair.second);
        let Some(patch) = group.centred(k) else { return [0.0; 2] };
        let reach = (REACH * second.width() as f32).ceil() as usize;
        // Counted from the first patch, which lies half outside.
        let range = |at: usize, length: usize| {
            (at + OUTSIDE).saturating_sub(reach)..(at + OUTSIDE + reach).min(length) + 1
        };
        let (across, down) = (range(x, second.width()), range(y, second.height()));
        let (unit, two) = (cpu.splat(AREA * LENGTH_COST * pair.noise), cpu.splat(2.0));
        let numbers = cpu.load(&std::array::from_fn(|lane| lane as f32));
        // Half a pixel more than the last displacement across.
        let last = cpu.splat(across.end as f32 - (x + OUTSIDE) as f32 - 0.5);
        let infinite = cpu.splat(f32::INFINITY);
        let mut best = [infinite, cpu.splat(0.0), cpu.splat(0.0)];
        for to_y in down {
            let shift_y = to_y as f32 - (y + OUTSIDE) as f32;
            for to_x in across.clone().step_by(GROUP) {
                let spreads = self.sums.get(to_y * self.stride + to_x..).and_then(|sums| sums.first_chunk());
                let samples = second.from(to_x as i32 - OUTSIDE as i32, to_y as i32 - OUTSIDE as i32);
                let (Some(spreads), Some(samples)) = (spreads, samples) else { continue };
                let Some(rows) = SampleRows::new(samples, second.stride()) else { continue };
                let shifts = cpu.splat(to_x as f32 - (x + OUTSIDE) as f32) + numbers;
                let length = cpu.root(shifts * shifts + cpu.splat(shift_y * shift_y));
                let spread = cpu.above_floats(shifts, last, infinite, cpu.load(spreads));
                let cost = unit * length + (spread - two * products(cpu, &patch, &rows));
                let [least, best_x, best_y] = best;
                best = [
                    cpu.above_floats(least, cost, cost, least),
                    cpu.above_floats(least, cost, shifts, best_x),
                    cpu.above_floats(least, cost, cpu.splat(shift_y), best_y),
                ];
            }
        }
        let [costs, x, y] = best.map(
            #[inline(always)]
            |lanes| cpu.store(lanes),
        );
        let mut best = (f32::INFINITY, [0.0; 2]);
        for ((cost, x), y) in costs.into_iter().zip(x).zip(y) {
            // Of equal costs the first in the order of rows.
            if cost < best.0 || (cost == best.0 && (y, x) < (best.1[1], best.1[0])) {
                best = (cost, [x, y]);
            }
        }
        best.1
    }
}
