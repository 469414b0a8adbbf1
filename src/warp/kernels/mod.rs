//! The two passes of the warp, for each CPU level.
//!
//! OutputFormat row Y is the image of a curve y = Y + down(x, Y) through the frame. The *vertical* pass
//! samples each column where the curve crosses it; the *horizontal* pass samples the resulting row
//! at x = X + across(X, Y). This is two-pass resampling after Catmull and Smith: 2·T taps per sample
//! instead of T², memory read in order, no gathers. It is exact for linear ramps, and its error is of
//! the order of the 2D kernel's for the slopes due to a rolling shutter (up to some 0.3).
//!
//! 8-bit samples: values times 2⁷, weights times 2¹⁴, products rounded to 16 bits (`mulhrs`); there are
//! 6 fraction bits between the passes and 5 in the sum, so the rounding error is at most 4/2⁷ + 4/2⁶ =
//! 0.1 grey levels before the last rounding. All other samples: `f32`.
//!
//! Cubic, 8 bits, AVX2, a block of 16 samples with a constant integer displacement: 5 instructions for
//! the positions, 14 for the weights, 4 × 4 (vertical) or 4 × 3 (horizontal) for the taps, some 4 for
//! rounding and storing: 75 to 80 for both passes, 5 per sample; at three per cycle, 1.6 cycles. Counted,
//! with addressing and varying integer displacements: 85 (vertical) and 57 (horizontal), 9 per sample.
//! Lanczos: 54 for the weights, which are rows of a table, and 6 taps; counted, 146 and 111, 16 per sample.
//! Memory: one byte read and one written per sample, everything else is in the L1 cache (a source row is
//! read four times from there, two bytes per sample between the passes): 2 × 3.1 MB for 1080p I420, 0.4 ms
//! at 15 GB/s. The lower bound is the arithmetic: 3.1 M × 1.6 cycles = 5 M cycles, 1.6 ms on one core of
//! 3.1 GHz.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx2_words;
mod scalar;
mod window;

use super::BorderMode;
use super::Interpolation;
use super::blocks::Block;
use super::weights::{Cubic, Kernel, Lanczos, Linear, Nearest};
#[cfg(target_arch = "x86_64")]
use crate::cpu::Avx2;
use crate::cpu::CpuLevel;
use crate::plane::Plane;
use scalar::Arithmetic;
pub(super) use scalar::{Fixed, Float};

/// One output row of the vertical pass.
#[derive(Clone, Copy)]
pub(super) struct Vertical<'a> {
    /// The source plane.
    pub plane: Plane<'a>,
    /// The picture outside of it.
    pub border: BorderMode,
    /// Value outside for [`BorderMode::Constant`], one per channel.
    pub fill: [u16; 4],
    /// The output row.
    pub row: isize,
    /// The first column, a multiple of 16.
    pub column: isize,
    /// Displacements of the columns.
    pub blocks: &'a [Block],
}

/// One output row of the horizontal pass.
#[derive(Clone, Copy)]
pub(super) struct Horizontal<'a, M> {
    /// Samples from the vertical pass, `step` per pixel.
    pub middle: &'a [M],
    /// Column of the first sample.
    pub column: isize,
    /// Samples from one pixel to the next in `middle`.
    pub step: usize,
    /// Displacements of the pixels.
    pub blocks: &'a [Block],
    /// Pixels in the row.
    pub width: usize,
    /// How the output row is stored.
    pub output: OutputFormat,
}

/// How the output row is stored.
#[derive(Clone, Copy)]
pub(super) struct OutputFormat {
    /// Bytes a sample: 1 or 2.
    pub bytes: usize,
    /// Samples written per pixel.
    pub channels: usize,
    /// Samples from one pixel to the next.
    pub step: usize,
    /// The largest value, before the shift.
    pub max: u16,
    /// The format's shift.
    pub shift: u32,
}

/// `$body` with `$kernel` bound to the type of an interpolation. A separate expression can be given for
/// Lanczos, if it has no vector kernel.
macro_rules! with_kernel {
    ($interpolation:expr, $kernel:ident => $body:expr) => {
        with_kernel!($interpolation, $kernel => $body, Lanczos => {
            type $kernel = Lanczos;
            $body
        })
    };
    ($interpolation:expr, $kernel:ident => $body:expr, Lanczos => $lanczos:expr) => {
        match $interpolation {
            Interpolation::Nearest => {
                type $kernel = Nearest;
                $body
            }
            Interpolation::Linear => {
                type $kernel = Linear;
                $body
            }
            Interpolation::Cubic => {
                type $kernel = Cubic;
                $body
            }
            Interpolation::Lanczos => $lanczos,
        }
    };
}
#[cfg(target_arch = "x86_64")]
use with_kernel;

/// First and last tap, relative to the integer position, and the rounding of positions.
pub(super) fn reach(interpolation: Interpolation) -> (isize, isize, i32) {
    with_kernel!(interpolation, K => (K::FIRST, K::FIRST + K::TAPS as isize - 1, K::ROUND))
}

/// Σ weight · node + round, rounded to integers, for four rows of `nodes` as long as `knots`.
pub(super) fn knots(level: CpuLevel, nodes: &[f32], weights: [f32; 4], round: f32, knots: &mut [i32]) {
    #[cfg(target_arch = "x86_64")]
    if let CpuLevel::Avx2(avx2) = level {
        return avx2::knots(avx2, nodes, weights, round, knots);
    }
    let _ = level;
    scalar::knots(nodes, weights, round, knots);
}

/// Arithmetic whose passes may have vector kernels.
pub(super) trait Passes: Arithmetic {
    /// The vertical pass; returns false and does nothing if there is no kernel for it.
    #[cfg(target_arch = "x86_64")]
    fn vertical_avx2(
        avx2: Avx2,
        interpolation: Interpolation,
        task: &Vertical<'_>,
        patch: &mut Vec<u8>,
        middle: &mut Vec<Self::Number>,
    ) -> bool;

    /// The horizontal pass; returns false and does nothing if there is no kernel for it.
    #[cfg(target_arch = "x86_64")]
    fn horizontal_avx2(
        avx2: Avx2,
        interpolation: Interpolation,
        task: &Horizontal<'_, Self::Number>,
        row: &mut [u8],
    ) -> bool;
}

#[cfg(not(target_arch = "x86_64"))]
impl<A: Arithmetic> Passes for A {}

/// Vertical pass of a row; `middle` is resized as needed.
pub(super) fn vertical<A: Passes>(
    level: CpuLevel,
    interpolation: Interpolation,
    task: &Vertical<'_>,
    patch: &mut Vec<u8>,
    middle: &mut Vec<A::Number>,
) {
    #[cfg(target_arch = "x86_64")]
    if let CpuLevel::Avx2(avx2) = level
        && A::vertical_avx2(avx2, interpolation, task, patch, middle)
    {
        return;
    }
    let _ = level;
    with_kernel!(interpolation, K => scalar::vertical::<A, K>(task, patch, middle));
}

/// Horizontal pass of a row.
pub(super) fn horizontal<A: Passes>(
    level: CpuLevel,
    interpolation: Interpolation,
    task: &Horizontal<'_, A::Number>,
    row: &mut [u8],
) {
    #[cfg(target_arch = "x86_64")]
    if let CpuLevel::Avx2(avx2) = level
        && A::horizontal_avx2(avx2, interpolation, task, row)
    {
        return;
    }
    let _ = level;
    with_kernel!(interpolation, K => scalar::horizontal::<A, K>(task, row));
}
