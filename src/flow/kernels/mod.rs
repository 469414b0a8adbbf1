//! The sums over a patch of 8 × 8 pixels, which take nearly all of the flow's time, for each level of instructions.
//!
//! Each function reads rows of a picture from the first of the slice on, `stride` samples apart; `None` where the slice
//! is too short. All levels add in the same order and contract nothing, so that they agree to the last bit.

#[cfg(target_arch = "x86_64")]
mod avx2;
mod scalar;
#[cfg(test)]
mod tests;

use crate::cpu::CpuLevel;

/// Side of a patch in pixels.
pub(super) const SIDE: usize = 8;

/// Pixels of a patch.
pub(super) const AREA: f32 = (SIDE * SIDE) as f32;

/// A patch, row by row.
pub(super) type Block = [[f32; SIDE]; SIDE];

/// A patch less its mean, and its gradients less theirs and less what is a multiple of the patch.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Centred {
    pub(super) values: Block,
    pub(super) gradient_x: Block,
    pub(super) gradient_y: Block,
    /// Sums of the products of gradients: xx, xy, yy; and of the squared values.
    pub(super) products: [f32; 4],
}

/// Sums over the difference of two patches.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Sums {
    /// Of difference times gradient in x and in y.
    pub(super) slope: [f32; 2],
    /// Of the square of the difference, less its mean over the patch, over the quarters: top left, bottom left, top
    /// right, bottom right.
    pub(super) squares: [f32; 4],
    /// Of all quarters.
    pub(super) total: f32,
}

/// Takes out of the gradients what is a multiple of the values, so that a change of contrast makes no step.
///
/// Given the sums of products xx, xy, yy of the gradients, of the squared values, and of gradient times value in x and in
/// y: those of the gradients that remain (and of the squared values), and the multiples to be taken off.
#[inline(always)]
fn free_of_contrast([xx, xy, yy, energy, x, y]: [f32; 6]) -> ([f32; 4], [f32; 2]) {
    let share = 1.0 / (energy + f32::MIN_POSITIVE);
    let shares = [x * share, y * share];
    let [a, b] = shares;
    ([(xx - a * x).max(0.0), xy - a * y, (yy - b * y).max(0.0), energy], shares)
}

/// The patch whose top left pixel is one row below and one column right of the first sample of `rows`.
#[inline(always)]
pub(super) fn centred(cpu: CpuLevel, rows: &[f32], stride: usize) -> Option<Centred> {
    match cpu {
        // SAFETY: the level is a proof of AVX2.
        #[cfg(target_arch = "x86_64")]
        CpuLevel::Avx2(_) => unsafe { avx2::centred(rows, stride) },
        _ => scalar::centred(rows, stride),
    }
}

/// Compares a patch with the picture, which is read `across` and `down` of a pixel (0 to 1) after the first sample.
#[inline(always)]
pub(super) fn sums(
    cpu: CpuLevel,
    patch: &Centred,
    rows: &[f32],
    stride: usize,
    [across, down]: [f32; 2],
) -> Option<Sums> {
    match cpu {
        // SAFETY: the level is a proof of AVX2.
        #[cfg(target_arch = "x86_64")]
        CpuLevel::Avx2(_) => unsafe { avx2::sums(patch, rows, stride, across, down) },
        _ => scalar::sums(patch, rows, stride, across, down),
    }
}

/// Sums of the difference and of its square where the patch is compared with whole pixels.
#[inline(always)]
pub(super) fn whole_sums(cpu: CpuLevel, values: &Block, rows: &[f32], stride: usize) -> Option<[f32; 2]> {
    match cpu {
        // SAFETY: the level is a proof of AVX2.
        #[cfg(target_arch = "x86_64")]
        CpuLevel::Avx2(_) => unsafe { avx2::whole_sums(values, rows, stride) },
        _ => scalar::whole_sums(values, rows, stride),
    }
}
