//! Runs row kernels on all cores, with the instructions that the machine has.

use super::lanes::{Cpu, Scalar};
#[cfg(target_arch = "x86_64")]
use crate::cpu::Avx2;
use crate::cpu::CpuLevel;
use crate::parallel::*;

/// A kernel that computes rows of results independently of each other.
pub(super) trait RowKernel<T>: Sync {
    /// Fills a row. Must be `inline(always)` with everything it calls: functions that are not inlined are
    /// compiled for any CPU.
    fn fill<C: Cpu>(&self, cpu: C, row: usize, out: &mut [T]);
}

/// Fills all rows of `across` results each.
pub(super) fn fill<T: Send, K: RowKernel<T>>(cpu: CpuLevel, kernel: &K, across: usize, out: &mut [T]) {
    out.par_chunks_mut(across.max(1)).enumerate().for_each(|(row, out)| match cpu {
        // SAFETY: the level is a proof of AVX2 and FMA.
        #[cfg(target_arch = "x86_64")]
        CpuLevel::Avx2(cpu) => unsafe { fill_avx2(cpu, kernel, row, out) },
        _ => kernel.fill(Scalar, row, out),
    });
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn fill_avx2<T, K: RowKernel<T>>(cpu: Avx2, kernel: &K, row: usize, out: &mut [T]) {
    kernel.fill(cpu, row, out);
}
