//! Both passes with AVX2: 16-bit words, 1 to 4 per pixel, in `f32` and in the order of `scalar`, so
//! that the results are bit-exact.
//!
//! As in `avx2`, with 8 lanes: cubic, 24 instructions for positions and weights, 4 × 5 (vertical)
//! or 4 × 3 (horizontal) for the taps: some 80 for both passes of 8 samples.

use super::avx2::{LANE_MAPS, LaneMap, MAX_STEP, positions};
use super::passes::{Passes, with_kernel};
use super::scalar::Float;
use super::task::{Horizontal, Vertical};
use crate::cpu::Avx2;
use crate::warp::blocks::{BLOCK, Block};
use crate::warp::settings::Interpolation;
use crate::warp::weights::{Cubic, Kernel, Linear, Nearest, ONE};
use std::arch::x86_64::*;

/// A kernel whose weights are computed in vectors.
trait FloatVectorKernel: Kernel {
    /// As [`Kernel::float`], for 8 fractions already divided by [`ONE`].
    ///
    /// # Safety
    /// The CPU must have AVX2.
    unsafe fn weights(t: __m256) -> [__m256; 4];
}

impl FloatVectorKernel for Nearest {
    #[inline(always)]
    unsafe fn weights(_: __m256) -> [__m256; 4] {
        // SAFETY: the caller's promise.
        unsafe { [_mm256_set1_ps(1.0); 4] }
    }
}

impl FloatVectorKernel for Linear {
    #[inline(always)]
    unsafe fn weights(t: __m256) -> [__m256; 4] {
        // SAFETY: the caller's promise.
        unsafe { [_mm256_sub_ps(_mm256_set1_ps(1.0), t), t, t, t] }
    }
}

impl FloatVectorKernel for Cubic {
    #[inline(always)]
    unsafe fn weights(t: __m256) -> [__m256; 4] {
        // SAFETY: the caller's promise.
        unsafe {
            let (half, one) = (_mm256_set1_ps(0.5), _mm256_set1_ps(1.0));
            let square = _mm256_mul_ps(t, t);
            let rest = _mm256_sub_ps(_mm256_mul_ps(square, t), square);
            let first = _mm256_mul_ps(_mm256_sub_ps(_mm256_sub_ps(square, t), rest), half);
            let last = _mm256_mul_ps(rest, half);
            let third = _mm256_sub_ps(_mm256_add_ps(t, first), _mm256_add_ps(last, last));
            let second = _mm256_sub_ps(_mm256_sub_ps(one, t), _mm256_add_ps(first, first));
            [first, _mm256_add_ps(second, last), third, last]
        }
    }
}

/// Vectors of 8 samples at a constant distance from one another.
trait FloatTapVectors: Copy {
    /// # Safety
    /// 8 samples must be readable at tap `index`, and the CPU must have AVX2.
    unsafe fn load(self, index: usize) -> __m256;
}

/// Rows of words: start, bytes between rows, and the format's shift.
#[derive(Clone, Copy)]
struct WordRows(*const u8, usize, __m128i);

impl FloatTapVectors for WordRows {
    #[inline(always)]
    unsafe fn load(self, index: usize) -> __m256 {
        // SAFETY: the caller's promise.
        unsafe {
            let words = _mm_srl_epi16(_mm_loadu_si128(self.0.add(index * self.1).cast()), self.2);
            _mm256_cvtepi32_ps(_mm256_cvtepu16_epi32(words))
        }
    }
}

/// Neighbouring samples in the row between the passes.
#[derive(Clone, Copy)]
struct FloatTaps(*const f32, usize);

impl FloatTapVectors for FloatTaps {
    #[inline(always)]
    unsafe fn load(self, index: usize) -> __m256 {
        // SAFETY: the caller's promise.
        unsafe { _mm256_loadu_ps(self.0.add(index * self.1)) }
    }
}

/// Positions of lanes 0 to 7 and 8 to 15, as 32-bit integers.
///
/// # Safety
/// The CPU must have AVX2.
#[inline(always)]
unsafe fn halves(block: &Block, lanes: &LaneMap) -> [__m256i; 2] {
    // SAFETY: the caller's promise.
    unsafe {
        let all = positions(block, lanes);
        let high = _mm256_extracti128_si256::<1>(all);
        [_mm256_cvtepi16_epi32(_mm256_castsi256_si128(all)), _mm256_cvtepi16_epi32(high)]
    }
}

/// The sum of weight × sample for 8 lanes of a block.
///
/// # Safety
/// `taps` 0 to `K::TAPS − 1 + span` must be readable, and the CPU must have AVX2.
#[inline(always)]
unsafe fn sum<K: FloatVectorKernel>(taps: impl FloatTapVectors, position: __m256i, span: usize) -> __m256 {
    // SAFETY: the caller's promise.
    unsafe {
        let fraction = _mm256_and_si256(position, _mm256_set1_epi32(ONE - 1));
        let t = _mm256_mul_ps(_mm256_cvtepi32_ps(fraction), _mm256_set1_ps(1.0 / ONE as f32));
        let weights = K::weights(t);
        let mut samples = [_mm256_setzero_ps(); 4];
        for (tap, samples) in samples.iter_mut().enumerate().take(K::TAPS) {
            *samples = taps.load(tap);
        }
        for more in 1..=span {
            let limit = _mm256_set1_epi32(more as i32 * ONE - 1);
            let further = _mm256_castsi256_ps(_mm256_cmpgt_epi32(position, limit));
            for (tap, samples) in samples.iter_mut().enumerate().take(K::TAPS) {
                *samples = _mm256_blendv_ps(*samples, taps.load(tap + more), further);
            }
        }
        let mut sum = _mm256_mul_ps(samples[0], weights[0]);
        for tap in 1..K::TAPS {
            sum = _mm256_add_ps(sum, _mm256_mul_ps(samples[tap], weights[tap]));
        }
        sum
    }
}

/// # Safety
/// The CPU must have AVX2.
#[target_feature(enable = "avx2")]
unsafe fn vertical<K: FloatVectorKernel>(task: &Vertical<'_>, patch: &mut Vec<u8>, middle: &mut Vec<f32>) {
    let layout = task.plane.layout();
    let step = layout.step;
    let shift = _mm_cvtsi32_si128(layout.format.shift() as i32);
    middle.resize(task.blocks.len() * BLOCK * step, 0.0);
    for (index, out) in middle.chunks_exact_mut(BLOCK * step).enumerate() {
        let block = &task.blocks[index];
        let (window, span) = (task.window::<K>(index, patch), block.span as usize);
        let last = window.offset + (K::TAPS - 1 + span) * window.stride;
        let bytes = &window.bytes[window.offset..last + 2 * BLOCK * step];
        for (vector, (out, lanes)) in out.chunks_exact_mut(16).zip(&LANE_MAPS[step - 1]).enumerate() {
            // SAFETY: `bytes` holds 16 · step words in each row of the window, `out` 16 numbers.
            unsafe {
                for (half, position) in halves(block, lanes).into_iter().enumerate() {
                    let taps = WordRows(bytes.as_ptr().add(32 * vector + 16 * half), window.stride, shift);
                    _mm256_storeu_ps(out.as_mut_ptr().add(8 * half), sum::<K>(taps, position, span));
                }
            }
        }
    }
}

/// # Safety
/// The CPU must have AVX2.
#[target_feature(enable = "avx2")]
unsafe fn horizontal<K: FloatVectorKernel>(task: &Horizontal<'_, f32>, row: &mut [u8]) {
    let step = task.step;
    let mut stored = [0u16; 16 * MAX_STEP];
    for (index, block) in task.blocks.iter().enumerate() {
        let (pixel, span) = (index * BLOCK, block.span as usize);
        let at = (pixel as isize + block.first as isize + K::FIRST - task.column) as usize * step;
        let read = &task.middle[at..at + (BLOCK + K::TAPS - 1 + span) * step];
        for (vector, (out, lanes)) in
            stored.chunks_exact_mut(16).zip(&LANE_MAPS[step - 1]).take(step).enumerate()
        {
            // SAFETY: `read` holds 16 · step numbers from each tap on, `out` 16 words.
            unsafe {
                let [low, high] = halves(block, lanes);
                let taps = FloatTaps(read.as_ptr().add(16 * vector), step);
                let low = sum::<K>(taps, low, span);
                let high = sum::<K>(FloatTaps(taps.0.add(8), step), high, span);
                let words = words(low, high, task.output.max, task.output.shift);
                _mm256_storeu_si256(out.as_mut_ptr().cast(), words);
            }
        }
        store(&stored, task, pixel, row);
    }
}

/// Two sums as stored words.
///
/// # Safety
/// The CPU must have AVX2.
#[inline(always)]
unsafe fn words(low: __m256, high: __m256, max: u16, shift: u32) -> __m256i {
    // SAFETY: the caller's promise.
    unsafe {
        let bounded = |sum: __m256| {
            let sum = _mm256_min_ps(_mm256_max_ps(sum, _mm256_setzero_ps()), _mm256_set1_ps(f32::from(max)));
            _mm256_cvtps_epi32(sum)
        };
        let packed = _mm256_packus_epi32(bounded(low), bounded(high));
        let ordered = _mm256_permute4x64_epi64::<0b11_01_10_00>(packed);
        _mm256_sll_epi16(ordered, _mm_cvtsi32_si128(shift as i32))
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
    fn vertical_avx2(
        _: Avx2,
        interpolation: Interpolation,
        task: &Vertical<'_>,
        patch: &mut Vec<u8>,
        middle: &mut Vec<f32>,
    ) -> bool {
        if task.plane.layout().step > MAX_STEP {
            return false;
        }
        with_kernel!(interpolation, K => {
            // SAFETY: the caller shows that the CPU has AVX2.
            unsafe { vertical::<K>(task, patch, middle) };
            true
        }, Lanczos => false)
    }

    fn horizontal_avx2(
        _: Avx2,
        interpolation: Interpolation,
        task: &Horizontal<'_, f32>,
        row: &mut [u8],
    ) -> bool {
        if task.step > MAX_STEP {
            return false;
        }
        with_kernel!(interpolation, K => {
            // SAFETY: the caller shows that the CPU has AVX2.
            unsafe { horizontal::<K>(task, row) };
            true
        }, Lanczos => false)
    }
}
