//! What does not change from fit to fit.

use crate::cpu::CpuLevel;
use crate::solve::continuous::data::matches::ScanAxis;

/// What a fit takes as given.
#[derive(Clone, Copy, Debug)]
pub struct Problem {
    pub cpu: CpuLevel,
    pub scan_axis: ScanAxis,
    /// Least standard deviation of a coordinate in pixels.
    pub noise: f64,
}
