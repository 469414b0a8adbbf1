// SPDX-License-Identifier: MIT OR Apache-2.0

//! Both passes in vectors: 16-bit words, 1 to 4 per pixel, in `f32` and in the order of `scalar`, so
//! that the results are bit-exact.
//!
//! As in `bytes`, with 8 lanes. AVX2: cubic, 24 instructions for positions and weights, 4 × 5 (vertical)
//! or 4 × 3 (horizontal) for the taps: some 80 for both passes of 8 samples.

use super::bytes::{LANE_MAPS, LaneMap, MAX_STEP, positions};
use super::passes::{Passes, with_kernel};
use super::scalar::Float;
use super::task::{Horizontal, Vertical};
use crate::lanes::{FLOATS, WORDS, WordCpu};
use crate::warp::blocks::{BLOCK, Block};
use crate::warp::settings::Interpolation;
use crate::warp::weights::{Cubic, Kernel, Linear, Nearest, ONE};

/// A kernel whose weights are computed in vectors.
trait FloatVectorKernel: Kernel {
    /// As [`Kernel::float`], for 8 fractions already divided by [`ONE`].
    fn weights<C: WordCpu>(cpu: C, t: C::Lanes) -> [C::Lanes; 4];
}

impl FloatVectorKernel for Nearest {
    #[inline(always)]
    fn weights<C: WordCpu>(cpu: C, _: C::Lanes) -> [C::Lanes; 4] {
        [cpu.splat(1.0); 4]
    }
}

impl FloatVectorKernel for Linear {
    #[inline(always)]
    fn weights<C: WordCpu>(cpu: C, t: C::Lanes) -> [C::Lanes; 4] {
        [cpu.splat(1.0) - t, t, t, t]
    }
}

impl FloatVectorKernel for Cubic {
    #[inline(always)]
    fn weights<C: WordCpu>(cpu: C, t: C::Lanes) -> [C::Lanes; 4] {
        let half = cpu.splat(0.5);
        let square = t * t;
        let rest = square * t - square;
        let first = (square - t - rest) * half;
        let last = rest * half;
        let third = (t + first) - (last + last);
        let second = (cpu.splat(1.0) - t) - (first + first);
        [first, second + last, third, last]
    }
}

/// Vectors of 8 samples at a constant distance from one another.
trait FloatTapVectors: Copy {
    /// # Safety
    /// 8 samples must be readable at tap `index`.
    unsafe fn load<C: WordCpu>(self, cpu: C, index: usize) -> C::Lanes;
}

/// Rows of words: start, bytes between rows, and the format's shift.
#[derive(Clone, Copy)]
struct WordRows(*const u8, usize, u32);

impl FloatTapVectors for WordRows {
    #[inline(always)]
    unsafe fn load<C: WordCpu>(self, cpu: C, index: usize) -> C::Lanes {
        // SAFETY: the caller's promise.
        cpu.load_samples(unsafe { &*self.0.add(index * self.1).cast() }, self.2)
    }
}

/// Neighbouring samples in the row between the passes.
#[derive(Clone, Copy)]
struct FloatTaps(*const f32, usize);

impl FloatTapVectors for FloatTaps {
    #[inline(always)]
    unsafe fn load<C: WordCpu>(self, cpu: C, index: usize) -> C::Lanes {
        // SAFETY: the caller's promise.
        cpu.load(unsafe { &*self.0.add(index * self.1).cast() })
    }
}

/// Where 8 lanes of a block lie: their positions and the fractions of these, in 1/[`ONE`] px.
#[derive(Clone, Copy)]
struct Positions<C: WordCpu> {
    all: C::Lanes,
    fraction: C::Lanes,
}

/// Positions of lanes 0 to 7 and 8 to 15.
#[inline(always)]
fn halves<C: WordCpu>(cpu: C, block: &Block, lanes: &LaneMap) -> [Positions<C>; 2] {
    let all = positions(cpu, block, lanes);
    let [low, high] = cpu.floats(cpu.and(all, cpu.splat_words(ONE as i16 - 1)));
    let [first, last] = cpu.floats(all);
    [Positions { all: first, fraction: low }, Positions { all: last, fraction: high }]
}

/// The sum of weight × sample for 8 lanes of a block.
///
/// # Safety
/// `taps` 0 to `K::TAPS − 1 + span` must be readable.
#[inline(always)]
unsafe fn sum<C: WordCpu, K: FloatVectorKernel>(
    cpu: C,
    taps: impl FloatTapVectors,
    position: Positions<C>,
    span: usize,
) -> C::Lanes {
    let weights = K::weights(cpu, position.fraction * cpu.splat(1.0 / ONE as f32));
    let mut samples = [cpu.splat(0.0); 4];
    for (tap, samples) in samples.iter_mut().enumerate().take(K::TAPS) {
        // SAFETY: the caller's promise.
        *samples = unsafe { taps.load(cpu, tap) };
    }
    for more in 1..=span {
        let limit = cpu.splat((more as i32 * ONE - 1) as f32);
        for (tap, samples) in samples.iter_mut().enumerate().take(K::TAPS) {
            // SAFETY: the caller's promise.
            let next = unsafe { taps.load(cpu, tap + more) };
            *samples = cpu.above_floats(position.all, limit, next, *samples);
        }
    }
    let mut sum = samples[0] * weights[0];
    for tap in 1..K::TAPS {
        sum = sum + samples[tap] * weights[tap];
    }
    sum
}

#[inline(always)]
fn vertical<C: WordCpu, K: FloatVectorKernel>(
    cpu: C,
    task: &Vertical<'_>,
    patch: &mut Vec<u8>,
    middle: &mut Vec<f32>,
) {
    let layout = task.plane.layout();
    let (step, shift) = (layout.step, layout.format.shift());
    middle.resize(task.blocks.len() * BLOCK * step, 0.0);
    let windows = task.windows::<K>();
    let blocks = task.blocks.iter().enumerate();
    for ((index, block), out) in blocks.zip(middle.chunks_exact_mut(BLOCK * step)) {
        let (window, span) = (windows.of(index, block, patch), block.span as usize);
        let outs = out.as_chunks_mut::<FLOATS>().0.as_chunks_mut::<2>().0;
        for (vector, (out, lanes)) in outs.iter_mut().zip(&LANE_MAPS[step - 1]).enumerate() {
            let positions = halves(cpu, block, lanes);
            for (half, (out, position)) in out.iter_mut().zip(positions).enumerate() {
                // SAFETY: the window holds 16 · step words in each of `TAPS + span` rows.
                let sum = unsafe {
                    let at = window.bytes.as_ptr().add(2 * WORDS * vector + 2 * FLOATS * half);
                    sum::<C, K>(cpu, WordRows(at, window.stride, shift), position, span)
                };
                *out = cpu.store(sum);
            }
        }
    }
}

#[inline(always)]
fn horizontal<C: WordCpu, K: FloatVectorKernel>(cpu: C, task: &Horizontal<'_, f32>, row: &mut [u8]) {
    let step = task.step;
    let mut stored = [0u16; WORDS * MAX_STEP];
    for (index, block) in task.blocks.iter().enumerate() {
        let (pixel, span) = (index * BLOCK, block.span as usize);
        let at = (pixel as isize + block.first as isize + K::FIRST - task.column) as usize * step;
        let read = &task.middle[at..at + (BLOCK + K::TAPS - 1 + span) * step];
        let outs = stored.as_chunks_mut::<WORDS>().0;
        for (vector, (out, lanes)) in outs.iter_mut().zip(&LANE_MAPS[step - 1]).take(step).enumerate() {
            let [low, high] = halves(cpu, block, lanes);
            // SAFETY: `read` holds 16 · step numbers from each tap on.
            let sums = unsafe {
                let at = read.as_ptr().add(WORDS * vector);
                let low = sum::<C, K>(cpu, FloatTaps(at, step), low, span);
                [low, sum::<C, K>(cpu, FloatTaps(at.add(FLOATS), step), high, span)]
            };
            *out = cpu.store_samples(sums, task.output.max, task.output.shift);
        }
        store(&stored, task, pixel, row);
    }
}

/// Writes the view's own samples of a block, 16 pixels or the rest of the row.
fn store(block: &[u16], task: &Horizontal<'_, f32>, pixel: usize, row: &mut [u8]) {
    let output = task.output;
    let (step, pixels) = (2 * output.step, BLOCK.min(task.width - pixel));
    let row = &mut row[pixel * step..];
    if output.channels == task.step && output.step == task.step {
        let samples = block.iter().take(pixels * task.step);
        for (out, sample) in row.chunks_exact_mut(2).zip(samples) {
            out.copy_from_slice(&sample.to_le_bytes());
        }
        return;
    }
    for (out, samples) in row.chunks_mut(step).zip(block.chunks_exact(task.step)).take(pixels) {
        for (out, sample) in out.chunks_exact_mut(2).zip(&samples[..output.channels]) {
            out.copy_from_slice(&sample.to_le_bytes());
        }
    }
}

impl Passes for Float {
    #[inline(always)]
    fn vertical<C: WordCpu>(
        cpu: C,
        interpolation: Interpolation,
        task: &Vertical<'_>,
        patch: &mut Vec<u8>,
        middle: &mut Vec<f32>,
    ) -> bool {
        if task.plane.layout().step > MAX_STEP {
            return false;
        }
        with_kernel!(interpolation, K => {
            cpu.vectorize(#[inline(always)] || vertical::<C, K>(cpu, task, patch, middle));
            true
        }, Lanczos => false)
    }

    #[inline(always)]
    fn horizontal<C: WordCpu>(
        cpu: C,
        interpolation: Interpolation,
        task: &Horizontal<'_, f32>,
        row: &mut [u8],
    ) -> bool {
        if task.step > MAX_STEP {
            return false;
        }
        with_kernel!(interpolation, K => {
            cpu.vectorize(#[inline(always)] || horizontal::<C, K>(cpu, task, row));
            true
        }, Lanczos => false)
    }
}
