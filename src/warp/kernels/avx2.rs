//! Both passes with AVX2: 8-bit samples, 1 to 4 per pixel, bit-exact with `scalar`.
//!
//! A block of 16 pixels with a step of n samples is n vectors of 16 samples. [`LaneMap`] maps each lane of a
//! vector to a half of the block and its position along it; all further operations are the same for all
//! steps: position → integer part and fraction → weights → taps. A tap is a vector at a constant distance
//! from the previous one (a row in the vertical pass, a pixel in the horizontal one); if the integer part
//! varies inside a block, the vectors of the next integer part are blended in.

use super::passes::{Passes, with_kernel};
use super::scalar::{self, Fixed};
use super::task::{Horizontal, Vertical};
use crate::cpu::Avx2;
use crate::warp::blocks::{BLOCK, Block};
use crate::warp::settings::Interpolation;
use crate::warp::weights::{
    Cubic, FRACTION_BITS, Kernel, Lanczos, Linear, MAX_TAPS, Nearest, ONE, WEIGHT_BITS,
};
use std::arch::x86_64::*;

/// The largest supported step.
pub(super) const MAX_STEP: usize = 4;

/// The pixels of a block to which the 16 lanes of one vector belong.
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

const fn lanes(step: usize) -> [LaneMap; MAX_STEP] {
    const EMPTY: LaneMap = LaneMap { start: [0; 32], change: [0; 32], ramp: [0; 16] };
    let mut table = [EMPTY; MAX_STEP];
    let mut sample = 0;
    while sample < BLOCK * step {
        let (vector, lane, pixel) = (sample / 16, sample % 16, sample / step);
        // A block starts with two starts and two changes, 16 bits each.
        let start = (pixel / 8 * 2) as u8;
        table[vector].start[2 * lane] = start;
        table[vector].start[2 * lane + 1] = start + 1;
        table[vector].change[2 * lane] = start + 4;
        table[vector].change[2 * lane + 1] = start + 5;
        table[vector].ramp[lane] = ((pixel % 8) << 12) as i16;
        sample += 1;
    }
    table
}

/// A kernel whose weights are computed in vectors.
trait VectorKernel: Kernel {
    /// As [`Kernel::fixed`], for 16 fractions.
    ///
    /// # Safety
    /// The CPU must have AVX2.
    unsafe fn weights(fraction: __m256i) -> [__m256i; MAX_TAPS];
}

impl VectorKernel for Nearest {
    #[inline(always)]
    unsafe fn weights(_: __m256i) -> [__m256i; MAX_TAPS] {
        // SAFETY: the caller's promise.
        unsafe { [_mm256_set1_epi16(1 << WEIGHT_BITS); MAX_TAPS] }
    }
}

impl VectorKernel for Linear {
    #[inline(always)]
    unsafe fn weights(fraction: __m256i) -> [__m256i; MAX_TAPS] {
        // SAFETY: the caller's promise.
        unsafe {
            let t = _mm256_slli_epi16::<{ (WEIGHT_BITS - FRACTION_BITS) as i32 }>(fraction);
            let none = _mm256_setzero_si256();
            [_mm256_sub_epi16(_mm256_set1_epi16(1 << WEIGHT_BITS), t), t, none, none, none, none]
        }
    }
}

impl VectorKernel for Cubic {
    #[inline(always)]
    unsafe fn weights(fraction: __m256i) -> [__m256i; MAX_TAPS] {
        // SAFETY: the caller's promise.
        unsafe {
            let t15 = _mm256_slli_epi16::<{ 15 - FRACTION_BITS as i32 }>(fraction);
            let t14 = _mm256_slli_epi16::<{ (WEIGHT_BITS - FRACTION_BITS) as i32 }>(fraction);
            let square = _mm256_mulhrs_epi16(t15, t15);
            let rest = _mm256_sub_epi16(_mm256_mulhrs_epi16(square, t15), square);
            let first = _mm256_sub_epi16(_mm256_sub_epi16(square, t15), rest);
            let first = _mm256_srai_epi16::<2>(first);
            let last = _mm256_srai_epi16::<2>(rest);
            let third = _mm256_sub_epi16(_mm256_add_epi16(t14, first), _mm256_add_epi16(last, last));
            let second = _mm256_sub_epi16(_mm256_set1_epi16(1 << WEIGHT_BITS), t14);
            let second = _mm256_sub_epi16(second, _mm256_add_epi16(first, first));
            let none = _mm256_setzero_si256();
            [first, _mm256_add_epi16(second, last), third, last, none, none]
        }
    }
}

impl VectorKernel for Lanczos {
    /// The weights of each fraction are one row of the table: 16 rows are read and transposed, to avoid
    /// gathers, which are slow on many CPUs.
    #[inline(always)]
    unsafe fn weights(fraction: __m256i) -> [__m256i; MAX_TAPS] {
        let table = Lanczos::table();
        debug_assert!(table.len() >= (ONE as usize - 1) * MAX_TAPS + 8);
        // SAFETY: the caller's promise; a masked fraction is the index of a row, and 8 numbers can be read at
        // the start of each.
        unsafe {
            let mut rows = [0u16; 16];
            let fraction = _mm256_and_si256(fraction, _mm256_set1_epi16(ONE as i16 - 1));
            _mm256_storeu_si256(rows.as_mut_ptr().cast(), fraction);
            // No closures: they would be compiled for any CPU.
            let mut lanes = [_mm256_setzero_si256(); 8];
            for (index, lanes) in lanes.iter_mut().enumerate() {
                let row = table.as_ptr().add(usize::from(rows[index]) * MAX_TAPS);
                let next = table.as_ptr().add(usize::from(rows[index + 8]) * MAX_TAPS);
                let low = _mm256_castsi128_si256(_mm_loadu_si128(row.cast()));
                *lanes = _mm256_inserti128_si256::<1>(low, _mm_loadu_si128(next.cast()));
            }
            // In both halves alike: taps 0 and 1, 2 and 3, 4 and 5 of lanes 0 to 3 and of lanes 4 to 7.
            let mut four = [[_mm256_setzero_si256(); 3]; 2];
            for (index, four) in four.iter_mut().enumerate() {
                let (a, b) = (lanes[4 * index], lanes[4 * index + 1]);
                let (c, d) = (lanes[4 * index + 2], lanes[4 * index + 3]);
                let (ab, cd) = (_mm256_unpacklo_epi16(a, b), _mm256_unpacklo_epi16(c, d));
                let last = _mm256_unpacklo_epi32(_mm256_unpackhi_epi16(a, b), _mm256_unpackhi_epi16(c, d));
                *four = [_mm256_unpacklo_epi32(ab, cd), _mm256_unpackhi_epi32(ab, cd), last];
            }
            let mut weights = [_mm256_setzero_si256(); MAX_TAPS];
            for (index, (low, high)) in four[0].into_iter().zip(four[1]).enumerate() {
                weights[2 * index] = _mm256_unpacklo_epi64(low, high);
                weights[2 * index + 1] = _mm256_unpackhi_epi64(low, high);
            }
            weights
        }
    }
}

/// Vectors of 16 factors for `mulhrs`, at a constant distance from one another.
trait TapVectors: Copy {
    /// The factors of tap `index`.
    ///
    /// # Safety
    /// 16 samples must be readable there, and the CPU must have AVX2.
    unsafe fn load(self, index: usize) -> __m256i;
}

/// Rows of bytes, as factors times 2⁷.
#[derive(Clone, Copy)]
struct ByteRows(*const u8, usize);

impl TapVectors for ByteRows {
    #[inline(always)]
    unsafe fn load(self, index: usize) -> __m256i {
        // SAFETY: the caller's promise.
        unsafe {
            let bytes = _mm_loadu_si128(self.0.add(index * self.1).cast());
            _mm256_slli_epi16::<7>(_mm256_cvtepu8_epi16(bytes))
        }
    }
}

/// Neighbouring samples in the row between the passes.
#[derive(Clone, Copy)]
struct PixelTaps(*const i16, usize);

impl TapVectors for PixelTaps {
    #[inline(always)]
    unsafe fn load(self, index: usize) -> __m256i {
        // SAFETY: the caller's promise.
        unsafe { _mm256_loadu_si256(self.0.add(index * self.1).cast()) }
    }
}

/// Displacements of the 16 lanes less the block's least integer displacement, in 1/[`ONE`] px.
///
/// # Safety
/// The CPU must have AVX2.
#[inline(always)]
pub(super) unsafe fn positions(block: &Block, lanes: &LaneMap) -> __m256i {
    // SAFETY: the block's first 8 bytes are its starts and changes; lanes are aligned to 32 bytes.
    unsafe {
        let halves = _mm256_set1_epi64x(std::ptr::from_ref(block).cast::<i64>().read_unaligned());
        let start = _mm256_shuffle_epi8(halves, _mm256_load_si256(lanes.start.as_ptr().cast()));
        let change = _mm256_shuffle_epi8(halves, _mm256_load_si256(lanes.change.as_ptr().cast()));
        let ramp = _mm256_load_si256(lanes.ramp.as_ptr().cast());
        _mm256_add_epi16(start, _mm256_mulhrs_epi16(change, ramp))
    }
}

/// The sum of weight × sample for 16 lanes of a block.
///
/// # Safety
/// `taps` 0 to `K::TAPS − 1 + span` must be readable, and the CPU must have AVX2.
#[inline(always)]
unsafe fn sum<K: VectorKernel>(taps: impl TapVectors, block: &Block, lanes: &LaneMap) -> __m256i {
    // SAFETY: the caller's promise.
    unsafe {
        let position = positions(block, lanes);
        let weights = K::weights(_mm256_and_si256(position, _mm256_set1_epi16(ONE as i16 - 1)));

        let mut samples = [_mm256_setzero_si256(); MAX_TAPS];
        for (tap, samples) in samples.iter_mut().enumerate().take(K::TAPS) {
            *samples = taps.load(tap);
        }
        // A block spans at most 14 integer displacements: the limit is below 2¹⁵.
        for more in 1..=block.span as usize {
            let limit = _mm256_set1_epi16(more as i16 * ONE as i16 - 1);
            let further = _mm256_cmpgt_epi16(position, limit);
            for (tap, samples) in samples.iter_mut().enumerate().take(K::TAPS) {
                *samples = _mm256_blendv_epi8(*samples, taps.load(tap + more), further);
            }
        }
        let mut sum = _mm256_mulhrs_epi16(samples[0], weights[0]);
        for tap in 1..K::TAPS {
            sum = _mm256_add_epi16(sum, _mm256_mulhrs_epi16(samples[tap], weights[tap]));
        }
        sum
    }
}

/// `STEP` is the plane's step, a constant so that the loop around a block's few instructions is unrolled.
///
/// # Safety
/// The CPU must have AVX2.
#[target_feature(enable = "avx2")]
unsafe fn vertical<K: VectorKernel, const STEP: usize>(
    task: &Vertical<'_>,
    patch: &mut Vec<u8>,
    middle: &mut Vec<i16>,
) {
    middle.resize(task.blocks.len() * BLOCK * STEP, 0);
    let blocks = task.blocks.iter().enumerate();
    for ((index, block), out) in blocks.zip(middle.chunks_exact_mut(BLOCK * STEP)) {
        let window = task.window::<K>(index, patch);
        let last = window.offset + (K::TAPS - 1 + block.span as usize) * window.stride;
        let bytes = &window.bytes[window.offset..last + BLOCK * STEP];
        for (vector, lanes) in LANE_MAPS[STEP - 1].iter().enumerate().take(STEP) {
            // SAFETY: `bytes` holds 16 · STEP samples in each row of the window, `out` 16 · STEP numbers.
            unsafe {
                let taps = ByteRows(bytes.as_ptr().add(16 * vector), window.stride);
                let sum = sum::<K>(taps, block, lanes);
                _mm256_storeu_si256(out.as_mut_ptr().add(16 * vector).cast(), sum);
            }
        }
    }
}

/// `STEP` is the step of the samples between the passes.
///
/// # Safety
/// The CPU must have AVX2.
#[target_feature(enable = "avx2")]
unsafe fn horizontal<K: VectorKernel, const STEP: usize>(task: &Horizontal<'_, i16>, row: &mut [u8]) {
    let output = task.output;
    let in_place = output.channels == STEP && output.step == STEP;
    let whole = if in_place { (task.width / BLOCK).min(task.blocks.len()) } else { 0 };
    let (inside, rest) = task.blocks.split_at(whole);
    for ((index, block), out) in inside.iter().enumerate().zip(row.chunks_exact_mut(BLOCK * STEP)) {
        // SAFETY: the caller's promise.
        unsafe { horizontal_block::<K, STEP>(task, index, block, out) };
    }
    for (index, block) in (whole..).zip(rest) {
        let mut buffer = [0u8; BLOCK * MAX_STEP];
        // SAFETY: the caller's promise.
        unsafe { horizontal_block::<K, STEP>(task, index, block, &mut buffer[..BLOCK * STEP]) };
        scatter(&buffer, STEP, task, index * BLOCK, row);
    }
}

/// The 16 · `STEP` samples of block `index`.
///
/// # Safety
/// The CPU must have AVX2.
#[inline(always)]
unsafe fn horizontal_block<K: VectorKernel, const STEP: usize>(
    task: &Horizontal<'_, i16>,
    index: usize,
    block: &Block,
    out: &mut [u8],
) {
    let at = ((index * BLOCK) as isize + block.first as isize + K::FIRST - task.column) as usize * STEP;
    let read = &task.middle[at..at + (BLOCK + K::TAPS - 1 + block.span as usize) * STEP];
    let out = &mut out[..BLOCK * STEP];
    for (vector, lanes) in LANE_MAPS[STEP - 1].iter().enumerate().take(STEP) {
        // SAFETY: `read` holds 16 · STEP samples from each tap on, `out` 16 · STEP bytes.
        unsafe {
            let taps = PixelTaps(read.as_ptr().add(16 * vector), STEP);
            let sum = _mm256_add_epi16(sum::<K>(taps, block, lanes), _mm256_set1_epi16(16));
            let sum = _mm256_srai_epi16::<5>(sum);
            let bytes = _mm_packus_epi16(_mm256_castsi256_si128(sum), _mm256_extracti128_si256::<1>(sum));
            _mm_storeu_si128(out.as_mut_ptr().add(16 * vector).cast(), bytes);
        }
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

/// As [`scalar::knots`], eight knots at a time; the remainder by the scalar function.
pub(super) fn knots(_: Avx2, nodes: &[f32], weights: [f32; 4], round: f32, knots: &mut [i32]) {
    let columns = knots.len();
    assert!(nodes.len() >= 4 * columns);
    // SAFETY: the caller shows that the CPU has AVX2; there are four rows of nodes.
    unsafe { eight_knots(nodes, weights, round, knots) };
    for column in columns / 8 * 8..columns {
        let four = [0, 1, 2, 3].map(|row| nodes[row * columns + column]);
        scalar::knots(&four, weights, round, &mut knots[column..column + 1]);
    }
}

/// # Safety
/// The CPU must have AVX2, and `nodes` four rows as long as `knots`.
#[target_feature(enable = "avx2")]
unsafe fn eight_knots(nodes: &[f32], weights: [f32; 4], round: f32, knots: &mut [i32]) {
    let columns = knots.len();
    for (index, knots) in knots.chunks_exact_mut(8).enumerate() {
        // SAFETY: columns 8 · index to 8 · index + 7 exist in all four rows and in `knots`.
        unsafe {
            let row = |row: usize| {
                let node = _mm256_loadu_ps(nodes.as_ptr().add(row * columns + 8 * index));
                _mm256_mul_ps(_mm256_set1_ps(weights[row]), node)
            };
            let sum = _mm256_add_ps(_mm256_add_ps(_mm256_add_ps(row(0), row(1)), row(2)), row(3));
            let sum = _mm256_add_ps(sum, _mm256_set1_ps(round));
            let sum = _mm256_min_ps(_mm256_max_ps(sum, _mm256_set1_ps(-1.0e9)), _mm256_set1_ps(1.0e9));
            _mm256_storeu_si256(knots.as_mut_ptr().cast(), _mm256_cvtps_epi32(sum));
        }
    }
}

impl Passes for Fixed {
    fn vertical_avx2(
        _: Avx2,
        interpolation: Interpolation,
        task: &Vertical<'_>,
        patch: &mut Vec<u8>,
        middle: &mut Vec<i16>,
    ) -> bool {
        with_kernel!(interpolation, K => {
            // SAFETY: the caller shows that the CPU has AVX2.
            unsafe {
                match task.plane.layout().step {
                    1 => vertical::<K, 1>(task, patch, middle),
                    2 => vertical::<K, 2>(task, patch, middle),
                    3 => vertical::<K, 3>(task, patch, middle),
                    4 => vertical::<K, 4>(task, patch, middle),
                    _ => return false,
                }
            };
            true
        })
    }

    fn horizontal_avx2(
        _: Avx2,
        interpolation: Interpolation,
        task: &Horizontal<'_, i16>,
        row: &mut [u8],
    ) -> bool {
        with_kernel!(interpolation, K => {
            // SAFETY: the caller shows that the CPU has AVX2.
            unsafe {
                match task.step {
                    1 => horizontal::<K, 1>(task, row),
                    2 => horizontal::<K, 2>(task, row),
                    3 => horizontal::<K, 3>(task, row),
                    4 => horizontal::<K, 4>(task, row),
                    _ => return false,
                }
            };
            true
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check<K: VectorKernel>() {
        for first in (0..ONE as i16).step_by(16) {
            let fractions: [i16; 16] = std::array::from_fn(|lane| (first + 7 * lane as i16) % ONE as i16);
            let mut weights = [[0i16; 16]; MAX_TAPS];
            // SAFETY: the caller shows that the CPU has AVX2; all arrays are 32 bytes.
            unsafe {
                let found = K::weights(_mm256_loadu_si256(fractions.as_ptr().cast()));
                for (weights, found) in weights.iter_mut().zip(found) {
                    _mm256_storeu_si256(weights.as_mut_ptr().cast(), found);
                }
            }
            for (lane, fraction) in fractions.into_iter().enumerate() {
                let truth = K::fixed(fraction);
                assert!((0..K::TAPS).all(|tap| weights[tap][lane] == truth[tap]), "{fraction}");
            }
        }
    }

    #[test]
    fn weights_are_those_of_plain_rust() {
        if Avx2::detect().is_some() {
            check::<Nearest>();
            check::<Linear>();
            check::<Cubic>();
            check::<Lanczos>();
        }
    }
}
