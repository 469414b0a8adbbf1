// SPDX-License-Identifier: MIT OR Apache-2.0

//! The kernel of a pass: by interpolation and by arithmetic.

use super::scalar::Arithmetic;
use super::task::{Horizontal, Vertical};
use crate::lanes::WordCpu;
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
    fn vertical<C: WordCpu>(
        cpu: C,
        interpolation: Interpolation,
        task: &Vertical<'_>,
        patch: &mut Vec<u8>,
        middle: &mut Vec<Self::Number>,
    ) -> bool;

    /// The horizontal pass; returns false and does nothing if there is no kernel for it.
    fn horizontal<C: WordCpu>(
        cpu: C,
        interpolation: Interpolation,
        task: &Horizontal<'_, Self::Number>,
        row: &mut [u8],
    ) -> bool;
}
