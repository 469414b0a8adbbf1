//! The kernel of a pass: by interpolation and by arithmetic.

use super::scalar::Arithmetic;
#[cfg(target_arch = "x86_64")]
use super::task::{Horizontal, Vertical};
#[cfg(target_arch = "x86_64")]
use crate::cpu::Avx2;
#[cfg(target_arch = "x86_64")]
use crate::warp::settings::Interpolation;

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
pub(super) use with_kernel;

/// Arithmetic whose passes may have vector kernels.
pub(in crate::warp) trait Passes: Arithmetic {
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
