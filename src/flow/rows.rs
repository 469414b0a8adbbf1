// SPDX-License-Identifier: MIT OR Apache-2.0

//! Runs row kernels on all cores, with the instructions that the machine has.

use crate::cpu::CpuLevel;
use crate::lanes::dispatch::with_cpu;
use crate::lanes::{Cpu, WordCpu};
use crate::parallel::*;

/// Memory that is made once and serves many rows.
pub(super) trait Scratch<C> {
    fn new(cpu: C) -> Self;
}

impl<C> Scratch<C> for () {
    fn new(_: C) {}
}

/// A kernel that computes rows of results independently of each other.
pub(super) trait RowKernel<T>: Sync {
    /// What one row leaves to be used again by another.
    type Scratch<C: WordCpu>: Scratch<C>;

    /// Fills a row. Must be `inline(always)` with everything it calls: functions that are not inlined are
    /// compiled for any CPU.
    fn fill<C: WordCpu>(&self, cpu: C, scratch: &mut Self::Scratch<C>, row: usize, out: &mut [T]);
}

/// Fills all rows of `across` results each.
pub(super) fn fill<T: Send, K: RowKernel<T>>(cpu: CpuLevel, kernel: &K, across: usize, out: &mut [T]) {
    let rows = out.par_chunks_mut(across.max(1)).enumerate();
    with_cpu!(cpu, cpu => rows.for_each_init(
        || Scratch::new(cpu),
        |scratch, (row, out)| cpu.vectorize(#[inline(always)] || kernel.fill(cpu, scratch, row, out)),
    ));
}
