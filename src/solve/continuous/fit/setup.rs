// SPDX-License-Identifier: MIT OR Apache-2.0

//! The givens of a fit.

use crate::cpu::CpuLevel;
use crate::solve::continuous::data::ScanAxis;
use crate::solve::continuous::prior::CameraBelief;

/// The givens of a fit: scan axis, noise floor, and beliefs about γ and κ.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    pub cpu: CpuLevel,
    pub scan_axis: ScanAxis,
    /// Least standard deviation of a coordinate in pixels.
    pub noise: f64,
    pub camera: CameraBelief,
}
