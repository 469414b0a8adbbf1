//! What a fit takes as given.

use crate::cpu::CpuLevel;
use crate::solve::continuous::data::ScanAxis;
use crate::solve::continuous::prior::CameraBelief;

/// How the sensor is read, how well points are measured, and what is believed of γ and κ.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    pub cpu: CpuLevel,
    pub scan_axis: ScanAxis,
    /// Least standard deviation of a coordinate in pixels.
    pub noise: f64,
    pub camera: CameraBelief,
}
