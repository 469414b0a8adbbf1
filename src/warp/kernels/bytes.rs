// SPDX-License-Identifier: MIT OR Apache-2.0

//! Both passes in vectors: 8-bit samples, 1 to 4 per pixel, bit-exact with `scalar`.
//!
//! A block of 16 pixels with a step of n samples is n vectors of 16 samples. [`LaneMap`] maps each lane of a
//! vector to a half of the block and its position along it; all further operations are the same for all
//! steps: position → integer part and fraction → weights → taps. A tap is a vector at a constant distance
//! from the previous one (a row in the vertical pass, a pixel in the horizontal one); if the integer part
//! varies inside a block, the vectors of the next integer part are blended in.
//!
//! With four samples a pixel, positions and weights of the 16 pixels are computed in one vector ([`QUARTERS`]) and
//! each is repeated for the four samples.

use super::passes::{Passes, with_kernel};
use super::scalar::Fixed;
use super::task::{Horizontal, Vertical};
use crate::lanes::{WORDS, WordCpu};
use crate::warp::blocks::{BLOCK, Block};
use crate::warp::settings::Interpolation;
use crate::warp::weights::{
    Cubic, FRACTION_BITS, Kernel, Lanczos, Linear, MAX_TAPS, Nearest, ONE, WEIGHT_BITS,
};

/// The largest supported step.
pub(super) const MAX_STEP: usize = 4;

/// The pixels of a block to which the 16 lanes of one vector belong.
#[derive(Clone, Copy)]
#[repr(C, align(32))]
pub(super) struct LaneMap {
    /// Byte shuffle that gives each lane the start of its half of the block.
    start: [u8; 32],
    /// The same for the change.
    change: [u8; 32],
    /// Position of a lane along its half, 0 to 1, times 2¹⁵.
    ramp: [i16; 16],
}

/// `LANE_MAPS[step − 1][vector]`.
pub(super) static LANE_MAPS: [[LaneMap; MAX_STEP]; MAX_STEP] = [lanes(1), lanes(2), lanes(3), lanes(4)];

const EMPTY: LaneMap = LaneMap { start: [0; 32], change: [0; 32], ramp: [0; 16] };

const fn lanes(step: usize) -> [LaneMap; MAX_STEP] {
    let mut table = [EMPTY; MAX_STEP];
    let mut sample = 0;
    while sample < BLOCK * step {
        let (vector, lane, pixel) = (sample / 16, sample % 16, sample / step);
        table[vector] = with_lane(table[vector], lane, pixel);
        sample += 1;
    }
    table
}

/// One lane a pixel, in the order in which [`WordCpu::doubled`] and [`WordCpu::doubled_pairs`] repeat them: lanes 2N and 2N + 1 of
/// both halves are pixels 4N to 4N + 3.
static QUARTERS: LaneMap = {
    let mut map = EMPTY;
    let mut lane = 0;
    while lane < WORDS {
        let (half, within) = (lane / 8, lane % 8);
        map = with_lane(map, lane, within / 2 * 4 + half * 2 + within % 2);
        lane += 1;
    }
    map
};

/// The map with the pixel of a lane.
const fn with_lane(mut map: LaneMap, lane: usize, pixel: usize) -> LaneMap {
    // A block starts with two starts and two changes, 16 bits each.
    let start = (pixel / 8 * 2) as u8;
    map.start[2 * lane] = start;
    map.start[2 * lane + 1] = start + 1;
    map.change[2 * lane] = start + 4;
    map.change[2 * lane + 1] = start + 5;
    map.ramp[lane] = ((pixel % 8) << 12) as i16;
    map
}

/// A kernel whose weights are computed in vectors.
trait VectorKernel: Kernel {
    /// As [`Kernel::fixed`], for 16 fractions.
    fn weights<C: WordCpu>(cpu: C, fraction: C::Words) -> [C::Words; MAX_TAPS];
}

impl VectorKernel for Nearest {
    #[inline(always)]
    fn weights<C: WordCpu>(cpu: C, _: C::Words) -> [C::Words; MAX_TAPS] {
        [cpu.splat_words(1 << WEIGHT_BITS); MAX_TAPS]
    }
}

impl VectorKernel for Linear {
    #[inline(always)]
    fn weights<C: WordCpu>(cpu: C, fraction: C::Words) -> [C::Words; MAX_TAPS] {
        let t = cpu.shifted_left::<{ (WEIGHT_BITS - FRACTION_BITS) as i32 }>(fraction);
        let none = cpu.splat_words(0);
        [cpu.splat_words(1 << WEIGHT_BITS) - t, t, none, none, none, none]
    }
}

impl VectorKernel for Cubic {
    #[inline(always)]
    fn weights<C: WordCpu>(cpu: C, fraction: C::Words) -> [C::Words; MAX_TAPS] {
        let t15 = cpu.shifted_left::<{ 15 - FRACTION_BITS as i32 }>(fraction);
        let t14 = cpu.shifted_left::<{ (WEIGHT_BITS - FRACTION_BITS) as i32 }>(fraction);
        let square = cpu.scaled(t15, t15);
        let rest = cpu.scaled(square, t15) - square;
        let first = cpu.shifted_right::<2>(square - t15 - rest);
        let last = cpu.shifted_right::<2>(rest);
        let third = (t14 + first) - (last + last);
        // That of the sum of all four, one, as integers are exact.
        let second = (cpu.splat_words(1 << WEIGHT_BITS) - third) - (first + last);
        let none = cpu.splat_words(0);
        [first, second, third, last, none, none]
    }
}

impl VectorKernel for Lanczos {
    /// The weights of each fraction are one row of the table: 16 rows are read and transposed, to avoid
    /// gathers, which are slow on many CPUs.
    #[inline(always)]
    fn weights<C: WordCpu>(cpu: C, fraction: C::Words) -> [C::Words; MAX_TAPS] {
        let table = Lanczos::table();
        debug_assert!(table.len() >= (ONE as usize - 1) * MAX_TAPS + 8);
        let fractions = cpu.store_words(cpu.and(fraction, cpu.splat_words(ONE as i16 - 1)));
        let mut rows = [table.as_ptr(); WORDS];
        for (row, fraction) in rows.iter_mut().zip(fractions) {
            // SAFETY: a masked fraction is the index of a row.
            *row = unsafe { table.as_ptr().add(fraction as usize * MAX_TAPS) };
        }
        // SAFETY: 8 numbers can be read at the start of each row of the table.
        unsafe { cpu.columns(&rows) }
    }
}

/// Vectors of 16 factors for [`WordCpu::scaled`], at a constant distance from one another.
trait TapVectors: Copy {
    /// The factors of tap `index`.
    ///
    /// # Safety
    /// 16 samples must be readable there.
    unsafe fn load<C: WordCpu>(self, cpu: C, index: usize) -> C::Words;
}

/// Rows of bytes, as factors times 2⁷.
#[derive(Clone, Copy)]
struct ByteRows(*const u8, usize);

impl TapVectors for ByteRows {
    #[inline(always)]
    unsafe fn load<C: WordCpu>(self, cpu: C, index: usize) -> C::Words {
        // SAFETY: the caller's promise.
        cpu.load_bytes(unsafe { &*self.0.add(index * self.1).cast() })
    }
}

/// Neighbouring samples in the row between the passes.
#[derive(Clone, Copy)]
struct PixelTaps(*const i16, usize);

impl TapVectors for PixelTaps {
    #[inline(always)]
    unsafe fn load<C: WordCpu>(self, cpu: C, index: usize) -> C::Words {
        // SAFETY: the caller's promise.
        cpu.load_words(unsafe { &*self.0.add(index * self.1).cast() })
    }
}

/// Displacements of the 16 lanes less the block's least integer displacement, in 1/[`ONE`] px.
#[inline(always)]
pub(super) fn positions<C: WordCpu>(cpu: C, block: &Block, lanes: &LaneMap) -> C::Words {
    let halves = block.halves();
    let start = cpu.shuffled(halves, &lanes.start);
    let change = cpu.shuffled(halves, &lanes.change);
    start + cpu.scaled(change, cpu.load_words(&lanes.ramp))
}

/// Positions of 16 lanes of a block and the weights of their taps.
#[derive(Clone, Copy)]
struct Weighted<C: WordCpu> {
    position: C::Words,
    weights: [C::Words; MAX_TAPS],
}

impl<C: WordCpu> Weighted<C> {
    #[inline(always)]
    fn of<K: VectorKernel>(cpu: C, block: &Block, lanes: &LaneMap) -> Self {
        let position = positions(cpu, block, lanes);
        Self { position, weights: K::weights(cpu, cpu.and(position, cpu.splat_words(ONE as i16 - 1))) }
    }

    /// Those of eight pixels, each twice, from those of [`QUARTERS`].
    #[inline(always)]
    fn doubled<K: VectorKernel, const LAST: bool>(mut self, cpu: C) -> Self {
        self.position = cpu.doubled::<LAST>(self.position);
        for weights in self.weights.iter_mut().take(K::TAPS) {
            *weights = cpu.doubled::<LAST>(*weights);
        }
        self
    }

    /// Those of four pixels, each four times, from [`doubled`](Self::doubled) ones.
    #[inline(always)]
    fn quadrupled<K: VectorKernel, const LAST: bool>(mut self, cpu: C) -> Self {
        self.position = cpu.doubled_pairs::<LAST>(self.position);
        for weights in self.weights.iter_mut().take(K::TAPS) {
            *weights = cpu.doubled_pairs::<LAST>(*weights);
        }
        self
    }

    /// The sum of weight × sample, of a block that spans so many integer displacements.
    ///
    /// # Safety
    /// `taps` 0 to `K::TAPS − 1 + span` must be readable.
    #[inline(always)]
    unsafe fn sum<K: VectorKernel>(self, cpu: C, taps: impl TapVectors, span: usize) -> C::Words {
        let mut samples = [cpu.splat_words(0); MAX_TAPS];
        for (tap, samples) in samples.iter_mut().enumerate().take(K::TAPS) {
            // SAFETY: the caller's promise.
            *samples = unsafe { taps.load(cpu, tap) };
        }
        // A block spans at most 14 integer displacements: the limit is below 2¹⁵.
        if span == 1 {
            // Most blocks that are not of one integer part: the next tap's samples are there but for the last.
            let limit = cpu.splat_words(ONE as i16 - 1);
            for tap in 1..K::TAPS {
                samples[tap - 1] = cpu.above(self.position, limit, samples[tap], samples[tap - 1]);
            }
            // SAFETY: the caller's promise.
            let next = unsafe { taps.load(cpu, K::TAPS) };
            samples[K::TAPS - 1] = cpu.above(self.position, limit, next, samples[K::TAPS - 1]);
        } else {
            for more in 1..=span {
                let limit = cpu.splat_words(more as i16 * ONE as i16 - 1);
                for (tap, samples) in samples.iter_mut().enumerate().take(K::TAPS) {
                    // SAFETY: the caller's promise.
                    let next = unsafe { taps.load(cpu, tap + more) };
                    *samples = cpu.above(self.position, limit, next, *samples);
                }
            }
        }
        let mut sum = cpu.scaled(samples[0], self.weights[0]);
        for (samples, weights) in samples.into_iter().zip(self.weights).take(K::TAPS).skip(1) {
            sum = sum + cpu.scaled(samples, weights);
        }
        sum
    }
}

/// The sums of weight × sample of the `STEP` vectors of a block, each with its number handed to `put`.
///
/// # Safety
/// Taps 0 to `K::TAPS − 1 + span` of each of the vectors of `taps` must be readable.
#[inline(always)]
unsafe fn sums<C: WordCpu, K: VectorKernel, const STEP: usize, T: TapVectors>(
    cpu: C,
    taps: impl Fn(usize) -> T,
    block: &Block,
    mut put: impl FnMut(usize, C::Words),
) {
    let span = block.span as usize;
    if STEP == 4 {
        let pixels = Weighted::of::<K>(cpu, block, &QUARTERS);
        // SAFETY: the caller's promise.
        unsafe {
            let eight = pixels.doubled::<K, false>(cpu);
            put(0, eight.quadrupled::<K, false>(cpu).sum::<K>(cpu, taps(0), span));
            put(1, eight.quadrupled::<K, true>(cpu).sum::<K>(cpu, taps(1), span));
            let eight = pixels.doubled::<K, true>(cpu);
            put(2, eight.quadrupled::<K, false>(cpu).sum::<K>(cpu, taps(2), span));
            put(3, eight.quadrupled::<K, true>(cpu).sum::<K>(cpu, taps(3), span));
        }
        return;
    }
    for (vector, lanes) in LANE_MAPS[STEP - 1].iter().enumerate().take(STEP) {
        let weighted = Weighted::of::<K>(cpu, block, lanes);
        // SAFETY: the caller's promise.
        put(vector, unsafe { weighted.sum::<K>(cpu, taps(vector), span) });
    }
}

/// `STEP` is the plane's step, a constant so that the loop around a block's few instructions is unrolled.
#[inline(always)]
fn vertical<C: WordCpu, K: VectorKernel, const STEP: usize>(
    cpu: C,
    task: &Vertical<'_>,
    patch: &mut Vec<u8>,
    middle: &mut Vec<i16>,
) {
    // Of its own: what is written cannot change it.
    let task = *task;
    middle.resize(task.blocks.len() * BLOCK * STEP, 0);
    let windows = task.windows::<K>();
    let blocks = task.blocks.iter().enumerate();
    for ((index, block), out) in blocks.zip(middle.chunks_exact_mut(BLOCK * STEP)) {
        let window = windows.of(index, block, patch);
        let bytes = window.bytes.as_ptr();
        // The row below is new to the next output row. Without this, half of the time of large frames is spent waiting for it.
        if STEP == MAX_STEP {
            cpu.prefetch(bytes.wrapping_add((K::TAPS + block.span as usize) * window.stride));
        }
        let outs = out.as_chunks_mut::<WORDS>().0;
        // SAFETY: the window holds 16 · STEP samples in each of `TAPS + span` rows.
        unsafe {
            sums::<C, K, STEP, _>(
                cpu,
                #[inline(always)]
                |vector| ByteRows(bytes.add(WORDS * vector), window.stride),
                block,
                #[inline(always)]
                |vector, sum| outs[vector] = cpu.store_words(sum),
            );
        }
    }
}

/// `STEP` is the step of the samples between the passes.
#[inline(always)]
fn horizontal<C: WordCpu, K: VectorKernel, const STEP: usize>(
    cpu: C,
    task: &Horizontal<'_, i16>,
    row: &mut [u8],
) {
    let task = *task;
    let output = task.output;
    let in_place = output.channels == STEP && output.step == STEP;
    let whole = if in_place { (task.width / BLOCK).min(task.blocks.len()) } else { 0 };
    let (inside, rest) = task.blocks.split_at(whole);
    for ((index, block), out) in inside.iter().enumerate().zip(row.chunks_exact_mut(BLOCK * STEP)) {
        horizontal_block::<C, K, STEP>(cpu, &task, index, block, out);
    }
    for (index, block) in (whole..).zip(rest) {
        let mut buffer = [0u8; BLOCK * MAX_STEP];
        horizontal_block::<C, K, STEP>(cpu, &task, index, block, &mut buffer[..BLOCK * STEP]);
        scatter(&buffer, STEP, &task, index * BLOCK, row);
    }
}

/// The 16 · `STEP` samples of block `index`.
#[inline(always)]
fn horizontal_block<C: WordCpu, K: VectorKernel, const STEP: usize>(
    cpu: C,
    task: &Horizontal<'_, i16>,
    index: usize,
    block: &Block,
    out: &mut [u8],
) {
    let at = ((index * BLOCK) as isize + block.first as isize + K::FIRST - task.column) as usize * STEP;
    let read = &task.middle[at..at + (BLOCK + K::TAPS - 1 + block.span as usize) * STEP];
    let outs = out[..BLOCK * STEP].as_chunks_mut::<WORDS>().0;
    // SAFETY: `read` holds 16 · STEP samples from each tap on.
    unsafe {
        sums::<C, K, STEP, _>(
            cpu,
            #[inline(always)]
            |vector| PixelTaps(read.as_ptr().add(WORDS * vector), STEP),
            block,
            #[inline(always)]
            |vector, sum| {
                outs[vector] = cpu.store_bytes(cpu.shifted_right::<5>(sum + cpu.splat_words(16)));
            },
        );
    }
}

/// Writes the view's own samples of a block, 16 pixels or the rest of the row.
fn scatter(block: &[u8], step: usize, task: &Horizontal<'_, i16>, pixel: usize, row: &mut [u8]) {
    let output = task.output;
    let pixels = row[pixel * output.step..].chunks_mut(output.step).take(task.width - pixel);
    for (out, samples) in pixels.zip(block.chunks_exact(step).take(BLOCK)) {
        out[..output.channels].copy_from_slice(&samples[..output.channels]);
    }
}

impl Passes for Fixed {
    #[inline(always)]
    fn vertical<C: WordCpu>(
        cpu: C,
        interpolation: Interpolation,
        task: &Vertical<'_>,
        patch: &mut Vec<u8>,
        middle: &mut Vec<i16>,
    ) -> bool {
        with_kernel!(interpolation, K => {
            match task.plane.layout().step {
                1 => cpu.vectorize(#[inline(always)] || vertical::<C, K, 1>(cpu, task, patch, middle)),
                2 => cpu.vectorize(#[inline(always)] || vertical::<C, K, 2>(cpu, task, patch, middle)),
                3 => cpu.vectorize(#[inline(always)] || vertical::<C, K, 3>(cpu, task, patch, middle)),
                4 => cpu.vectorize(#[inline(always)] || vertical::<C, K, 4>(cpu, task, patch, middle)),
                _ => return false,
            }
            true
        })
    }

    #[inline(always)]
    fn horizontal<C: WordCpu>(
        cpu: C,
        interpolation: Interpolation,
        task: &Horizontal<'_, i16>,
        row: &mut [u8],
    ) -> bool {
        with_kernel!(interpolation, K => {
            match task.step {
                1 => cpu.vectorize(#[inline(always)] || horizontal::<C, K, 1>(cpu, task, row)),
                2 => cpu.vectorize(#[inline(always)] || horizontal::<C, K, 2>(cpu, task, row)),
                3 => cpu.vectorize(#[inline(always)] || horizontal::<C, K, 3>(cpu, task, row)),
                4 => cpu.vectorize(#[inline(always)] || horizontal::<C, K, 4>(cpu, task, row)),
                _ => return false,
            }
            true
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::CpuLevel;
    use crate::lanes::Cpu;
    use crate::lanes::dispatch::with_cpu;

    #[inline(always)]
    fn check<C: WordCpu, K: VectorKernel>(cpu: C) {
        for first in (0..ONE as i16).step_by(16) {
            let fractions: [i16; WORDS] = std::array::from_fn(|lane| (first + 7 * lane as i16) % ONE as i16);
            let found = K::weights(cpu, cpu.load_words(&fractions));
            for (tap, found) in found.into_iter().enumerate().take(K::TAPS) {
                for (weight, fraction) in cpu.store_words(found).into_iter().zip(fractions) {
                    assert_eq!(weight, K::fixed(fraction)[tap], "{fraction}");
                }
            }
        }
    }

    #[test]
    fn weights_are_those_of_plain_rust() {
        for level in CpuLevel::supported() {
            with_cpu!(
                level,
                cpu => cpu.vectorize(#[inline(always)] || {
                    check::<_, Nearest>(cpu);
                    check::<_, Linear>(cpu);
                    check::<_, Cubic>(cpu);
                    check::<_, Lanczos>(cpu);
                }),
                _ => {}
            );
        }
    }
}
