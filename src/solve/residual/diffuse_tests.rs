// SPDX-License-Identifier: MIT OR Apache-2.0

use super::super::chains::{QUARTER_WEIGHT_DISTANCE, score_of_variance};
use super::*;
use crate::robust::loss::{GemanMcClure, Loss};

/// The same in plain Rust, one cell after the other.
impl VelocityEstimate {
    /// The squared Mahalanobis norm of a vector.
    #[inline(always)]
    fn squared_norm(&self, [x, y]: [f32; 2]) -> f32 {
        let [xx, xy, yy, ..] = self.0;
        xx * x * x + 2.0 * xy * x * y + yy * y * y
    }

    #[inline(always)]
    fn times(self, share: f32) -> Self {
        Self(self.0.map(|value| share * value))
    }

    /// The message to the next cell, a random step of variance q away: (I + q·Λ)⁻¹ times information and sum.
    #[inline(always)]
    fn after_step(&self, q: f32) -> Self {
        let [xx, xy, yy, x, y, ..] = self.0;
        let (trace, determinant) = (xx + yy, (xx * yy - xy * xy).max(0.0));
        let share = 1.0 / (1.0 + q * trace + q * q * determinant);
        let [x, y] = [x + q * (yy * x - xy * y), y + q * (xx * y - xy * x)];
        let [xx, xy, yy] = [xx + q * determinant, xy, yy + q * determinant];
        Self([xx, xy, yy, x, y, 0.0, 0.0, 0.0].map(|value| value * share))
    }

    /// The message, down-weighted where it contradicts the cell's own measurement; `value` is the cell's
    /// posterior without the message.
    #[inline(always)]
    fn accept(&self, value: [f32; 2], message: &Self) -> Self {
        let other = message.value();
        let difference = [value[0] - other[0], value[1] - other[1]];
        let (own, other) = (self.squared_norm(difference), message.squared_norm(difference));
        // The variances of the two along their difference add up.
        let square = own * other / (own + other + f32::MIN_POSITIVE);
        message.times(GemanMcClure(QUARTER_WEIGHT_DISTANCE).weight(square))
    }
}

/// The same of one chain.
impl FieldPrior {
    /// Passes messages along a chain, by the indices of its cells.
    fn pass_one(
        &self,
        cells: impl Iterator<Item = usize>,
        own: &[VelocityEstimate],
        out: &mut [VelocityEstimate],
    ) {
        let mut message = VelocityEstimate::default();
        for cell in cells {
            let alone = own[cell].plus_prior(self.prior);
            let accepted = own[cell].accept(alone.value(), &message);
            out[cell] = out[cell].plus(accepted);
            message = own[cell].plus(accepted).after_step(self.step);
        }
    }
}

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
    assert!(after.0.iter().zip(expected).all(|(is, ought)| (is - ought).abs() < 1e-5));
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
fn far_from_all_measurements_the_prior_is_what_is_known() {
    let measured =
        |index: usize| if index % 60 < 10 { round(50.0, [9.0, 0.0]) } else { VelocityEstimate::default() };
    let own: Vec<VelocityEstimate> = (0..60 * 20).map(measured).collect();
    let mut out = Vec::new();
    FieldPrior { prior: 0.25, ..field(60) }.posterior(&own, &mut out);
    // A message along the row, fifty steps of variance 0.1 away, and the prior, of variance 4 in each coordinate.
    let expected = 2.0 / (1.0 / 5.02 + 0.25);
    let variance = out[10 * 60 + 59].variance();
    assert!((variance / expected - 1.0).abs() < 0.01, "{variance}, not {expected}");
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

#[test]
fn the_score_of_a_variance_is_the_same_for_several_cells_as_for_one() {
    let measured = |index: usize| {
        let (a, b) = ((index as f32 * 1.7).sin(), (index as f32 * 0.3).sin());
        VelocityEstimate::new([9.0 * a * a, 7.0 * a * b, 9.0 * b * b], [2.0 * a, 4.0 * b])
    };
    let cells: Vec<VelocityEstimate> = (0..3 * CHAINS + 5).map(measured).collect();
    let of_one = |cell: &VelocityEstimate| {
        let [xx, xy, yy, x, y, ..] = cell.after_step(0.3).0;
        [x * x + y * y - (xx + yy), xx * xx + 2.0 * xy * xy + yy * yy]
    };
    let expected = cells.iter().map(of_one).fold([0.0; 2], |[a, b], [x, y]| [a + x, b + y]);
    for cpu in CpuLevel::supported() {
        let found =
            with_cpu!(cpu, cpu => cpu.vectorize(#[inline(always)] || score_of_variance(cpu, 0.3, &cells)));
        assert!(
            found.iter().zip(expected).all(|(found, expected)| (found / expected - 1.0).abs() < 1e-4),
            "{cpu}"
        );
    }
}
