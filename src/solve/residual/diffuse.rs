// SPDX-License-Identifier: MIT OR Apache-2.0

//! Vectors on a grid of cells, each measured with its own information: the posterior of each, given all.
//!
//! In a Gaussian Markov random field neighbouring vectors differ by a random step of variance q along each
//! axis. As on a chain, messages are passed along the rows and along the columns, in both directions:
//!
//! > message = (Λ⁻¹ + q·I)⁻¹, Λ = own information + message of the previous cell
//!
//! and a cell's posterior is the sum of its own information, the prior and the four messages (belief
//! propagation, cut off after one sweep along each axis). A message that contradicts a cell's measurement
//! indicates a depth edge between them and is down-weighted.

use super::chains::{CHAINS, pass_along};
use super::estimate::VelocityEstimate;
use crate::cpu::CpuLevel;
use crate::lanes::Cpu;
use crate::lanes::dispatch::with_cpu;
use crate::parallel::*;

/// Smoothness and prior of the field.
#[derive(Clone, Copy, Debug)]
pub(super) struct FieldPrior {
    pub(super) cpu: CpuLevel,
    /// Cells in a row.
    pub(super) columns: usize,
    /// Variance q of the step from one cell to the next.
    pub(super) step: f32,
    /// Prior information of each cell, about zero.
    pub(super) prior: f32,
}

impl FieldPrior {
    /// The posterior of each cell from the measurements of all.
    pub(super) fn posterior(&self, own: &[VelocityEstimate], out: &mut Vec<VelocityEstimate>) {
        out.clear();
        out.extend(own.iter().map(|own| own.plus_prior(self.prior)));
        let columns = self.columns.max(1);
        out.par_chunks_mut(CHAINS * columns).zip(own.par_chunks(CHAINS * columns)).for_each(|(out, own)| {
            let chains = [out.len() / columns, columns];
            self.pass(0..columns, chains, own, out);
            self.pass((0..columns).rev(), chains, own, out);
        });
        let rows = out.len() / columns;
        for column in (0..columns).step_by(CHAINS) {
            let cells = (0..rows).map(|row| row * columns + column);
            let chains = [CHAINS.min(columns - column), 1];
            self.pass(cells.clone(), chains, own, out);
            self.pass(cells.rev(), chains, own, out);
        }
    }

    /// Passes messages along up to eight chains, by the indices of the first chain's cells; `chains` are their number, and cells from one
    /// to the next.
    fn pass(
        &self,
        cells: impl Iterator<Item = usize>,
        chains: [usize; 2],
        own: &[VelocityEstimate],
        out: &mut [VelocityEstimate],
    ) {
        let field = [self.step, self.prior];
        with_cpu!(self.cpu, cpu => cpu.vectorize(
            #[inline(always)]
            || pass_along(cpu, field, cells, chains, own, out)
        ));
    }
}

#[cfg(test)]
#[path = "diffuse_tests.rs"]
mod tests;
