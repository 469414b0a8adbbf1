// SPDX-License-Identifier: MIT OR Apache-2.0

//! Vectors on a grid of cells, each measured with its own information: the posterior of each, given all.
//!
//! In a Gaussian Markov random field neighbouring vectors differ by a random step of variance q along each
//! axis. As on a chain, messages are passed along the rows and along the columns, in both directions:
//!
//! > message = (Λ⁻¹ + q·I)⁻¹, Λ = own information + prior + message of the previous cell
//!
//! and a cell's posterior is the sum of its own information, the prior and the four messages (belief
//! propagation, cut off after one sweep along each axis). A message that contradicts a cell's measurement
//! indicates a depth edge between them and is down-weighted.

use super::chains::{CHAINS, pass_along};
use super::estimate::VelocityEstimate;
use crate::cpu::CpuLevel;
use crate::lanes::Cpu;
use crate::lanes::dispatch::with_word_cpu;
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
        let rows = out.len() / columns;
        let several = CHAINS * columns;
        out.par_chunks_mut(several).zip(own.par_chunks(several)).for_each(|(out, own)| {
            if out.len() == several {
                self.pass_several(0..columns, columns, own, out);
                self.pass_several((0..columns).rev(), columns, own, out);
            } else {
                for start in (0..out.len()).step_by(columns) {
                    self.pass_one(start..start + columns, own, out);
                    self.pass_one((start..start + columns).rev(), own, out);
                }
            }
        });
        let whole = columns - columns % CHAINS;
        for column in (0..whole).step_by(CHAINS) {
            let cells = (0..rows).map(|row| row * columns + column);
            self.pass_several(cells.clone(), 1, own, out);
            self.pass_several(cells.rev(), 1, own, out);
        }
        for column in whole..columns {
            let cells = (0..rows).map(|row| row * columns + column);
            self.pass_one(cells.clone(), own, out);
            self.pass_one(cells.rev(), own, out);
        }
    }

    /// Passes messages along eight chains that are `stride` cells apart, by the indices of the first chain's cells.
    fn pass_several(
        &self,
        cells: impl Iterator<Item = usize>,
        stride: usize,
        own: &[VelocityEstimate],
        out: &mut [VelocityEstimate],
    ) {
        let field = [self.step, self.prior];
        with_word_cpu!(self.cpu, cpu => cpu.vectorize(
            #[inline(always)]
            || pass_along(cpu, field, cells, stride, own, out)
        ));
    }

    /// Passes messages along a chain, by the indices of its cells.
    fn pass_one(
        &self,
        cells: impl Iterator<Item = usize>,
        own: &[VelocityEstimate],
        out: &mut [VelocityEstimate],
    ) {
        let mut message = VelocityEstimate::default();
        for cell in cells {
            let (Some(own), Some(out)) = (own.get(cell), out.get_mut(cell)) else { return };
            message = self.pass(own, message, out);
        }
    }

    /// Adds a message to a cell's posterior, and returns the message to the next cell.
    ///
    /// Messages are compared with the cell's measurement only, not with the prior: neighbours predict a cell
    /// better than the mean of the frame.
    #[inline(always)]
    fn pass(
        &self,
        own: &VelocityEstimate,
        message: VelocityEstimate,
        out: &mut VelocityEstimate,
    ) -> VelocityEstimate {
        let alone = own.plus_prior(self.prior);
        let accepted = own.accept(alone.value(), &message);
        *out = out.plus(accepted);
        alone.plus(accepted).after_step(self.step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(columns: usize) -> FieldPrior {
        FieldPrior { cpu: CpuLevel::detect(), columns, step: 0.1, prior: 0.0 }
    }

    fn round(information: f32, value: [f32; 2]) -> VelocityEstimate {
        VelocityEstimate::new([information, 0.0, information], value)
    }

    #[test]
    fn a_step_adds_to_the_covariance() {
        let before = VelocityEstimate::new([3.0, 1.0, 2.0], [4.0, -5.0]);
        let after = before.after_step(0.5);
        // Λ = (3 1; 1 2), Λ⁻¹ + ½·I = (0.9 −0.2; −0.2 1.1), whose inverse is (1.1 0.2; 0.2 0.9)/0.95.
        let expected = [1.1 / 0.95, 0.2 / 0.95, 0.9 / 0.95];
        assert!(after.information.iter().zip(expected).all(|(is, ought)| (is - ought).abs() < 1e-5));
        let [x, y] = after.value();
        assert!((x - 4.0).abs() < 1e-4 && (y + 5.0).abs() < 1e-4, "{x} {y}");
    }

    #[test]
    fn a_gap_is_bridged_and_an_edge_is_kept() {
        let at = |column: usize| match column {
            0..8 => round(50.0, [1.0, -2.0]),
            // Only a prior here.
            8..12 => round(0.01, [0.0; 2]),
            _ => round(50.0, [9.0, 6.0]),
        };
        let own: Vec<VelocityEstimate> = (0..20 * 15).map(|index| at(index % 20)).collect();
        let mut out = Vec::new();
        field(20).posterior(&own, &mut out);
        let row: Vec<[f32; 2]> = out[7 * 20..8 * 20].iter().map(VelocityEstimate::value).collect();
        let is_near = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) < 0.1;
        assert!(is_near(row[3], [1.0, -2.0]) && is_near(row[16], [9.0, 6.0]), "{row:?}");
        assert!(is_near(row[7], [1.0, -2.0]) && is_near(row[12], [9.0, 6.0]), "{row:?}");
        assert!((8..12).all(|column| row[column][0] > 0.8 && row[column][0] < 9.2), "{row:?}");
    }

    #[test]
    fn a_cell_measured_along_one_axis_is_completed_by_its_neighbours() {
        let at = |index: usize| match index {
            5 => VelocityEstimate::new([100.0, 0.0, 0.0], [3.0, 0.0]),
            _ => round(20.0, [2.0, 7.0]),
        };
        let own: Vec<VelocityEstimate> = (0..11).map(at).collect();
        let mut out = Vec::new();
        field(11).posterior(&own, &mut out);
        let [x, y] = out[5].value();
        assert!((x - 3.0).abs() < 0.3 && (y - 7.0).abs() < 0.1, "{x} {y}");
    }

    #[test]
    fn where_nothing_is_measured_neighbours_count_more_than_the_prior() {
        let measured =
            |column: usize| if column < 3 { round(50.0, [9.0, 0.0]) } else { VelocityEstimate::default() };
        let own: Vec<VelocityEstimate> = (0..10).map(measured).collect();
        let mut out = Vec::new();
        // A deviation of 10, of which the steps over all cells make a tenth.
        FieldPrior { prior: 0.01, ..field(10) }.posterior(&own, &mut out);
        let last = out[9].value()[0];
        assert!(last > 8.0 && last < 9.0, "{last}");
    }

    #[test]
    fn without_information_the_posterior_is_zero() {
        let mut out = Vec::new();
        field(4).posterior(&[VelocityEstimate::default(); 12], &mut out);
        assert!(out.iter().all(|posterior| posterior.value() == [0.0; 2]));
        field(0).posterior(&[], &mut out);
        assert!(out.is_empty());
    }

    #[test]
    fn several_chains_are_passed_along_as_one_is() {
        let wave = |index: usize, by: f32| (index as f32 * by).sin();
        let measured = |index: usize| {
            let (a, b) = (wave(index, 1.7), wave(index, 0.3));
            let certainty = if index.is_multiple_of(7) { 0.0 } else { 9.0 };
            let information = [a * a, 0.9 * a * b, b * b].map(|one| one * certainty);
            VelocityEstimate::new(information, [wave(index, 2.3), 4.0 * wave(index, 0.9)])
        };
        // Rows and columns beside those that fill vectors.
        let (columns, rows) = (2 * CHAINS + 3, CHAINS + 2);
        let own: Vec<VelocityEstimate> = (0..columns * rows).map(measured).collect();
        for cpu in CpuLevel::supported() {
            let field = FieldPrior { cpu, prior: 0.2, ..field(columns) };
            let mut out = Vec::new();
            field.posterior(&own, &mut out);
            let mut expected: Vec<_> = own.iter().map(|own| own.plus_prior(field.prior)).collect();
            for row in 0..rows {
                let cells = row * columns..(row + 1) * columns;
                field.pass_one(cells.clone(), &own, &mut expected);
                field.pass_one(cells.rev(), &own, &mut expected);
            }
            for column in 0..columns {
                let cells = (0..rows).map(|row| row * columns + column);
                field.pass_one(cells.clone(), &own, &mut expected);
                field.pass_one(cells.rev(), &own, &mut expected);
            }
            assert_eq!(out, expected, "{cpu}");
        }
    }
}
