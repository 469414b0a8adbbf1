// SPDX-License-Identifier: MIT OR Apache-2.0

//! The residual velocities of a frame.

use super::chains::score_of_variance;
use super::diffuse::FieldPrior;
use super::estimate::VelocityEstimate;
use super::frame_flow::FrameFlow;
use super::path::Path;
use super::velocity::{NeighbourFlow, OUTLIER, combine};
use crate::cpu::CpuLevel;
use crate::flow::FlowField;
use crate::lanes::Cpu;
use crate::lanes::dispatch::with_cpu;
use crate::readout::Readout;
use nalgebra::Vector2;

/// Least variance of residual velocities in (pixels per readout)², far below what is seen.
const MIN_VARIANCE: f32 = 1e-4;

/// Steps from the least variance to the likeliest. Five more change no figure of `eval quick` by 1 %.
const SCORING_STEPS: usize = 3;

/// Columns and rows of the regions of a frame for which an expected error is reported.
pub const REGIONS: [usize; 2] = [6, 5];

/// Residual velocities at the centres of the flow's cells, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellVelocities {
    /// Cells in a row.
    pub columns: usize,
    /// Rows of cells.
    pub rows: usize,
    /// Frame pixels from one centre to the next; the first lies half of that from the frame's corner.
    pub side: f64,
    /// Pixels per whole readout.
    pub velocities: Vec<[f32; 2]>,
}

/// Residual velocity and expected error in a region of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Region {
    /// Mean residual velocity in pixels per readout.
    pub velocity: Vector2<f64>,
    /// Expected mean square error, in px², of the positions at the middle of the readout that path and
    /// residual velocities predict: variances of the velocities plus squared residuals of the flow, times the
    /// squared time until then.
    pub error: f64,
}

impl Region {
    /// The same in pixels smaller by `factor`.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self { velocity: self.velocity * factor, error: self.error * factor * factor }
    }
}

/// Solves the residual velocities of one frame after another.
#[derive(Debug, Default)]
pub struct ResidualSolver {
    cells: CellVelocities,
    sides: [NeighbourFlow; 2],
    own: Vec<VelocityEstimate>,
    posterior: Vec<VelocityEstimate>,
    regions: Vec<Region>,
}

impl ResidualSolver {
    /// The residual velocities of a frame from the flow to one or two neighbours; none without flow.
    pub fn solve(&mut self, readout: &Readout, flows: &[FrameFlow<'_>], path: &impl Path) -> &CellVelocities {
        self.cells.velocities.clear();
        self.regions.clear();
        let fields = flows.iter().filter(|flow| !flow.field.cells().is_empty());
        let flows: Vec<_> = fields.take(self.sides.len()).collect();
        let Some(first) = flows.first() else { return &self.cells };
        let Self { cells, sides, own, posterior, .. } = self;
        (cells.columns, cells.rows, cells.side) =
            (first.field.columns(), first.field.rows(), first.field.cell_side());
        let cpu = CpuLevel::detect();
        for (side, flow) in sides.iter_mut().zip(&flows) {
            side.fill(cpu, readout, flow, path);
        }
        let sides = sides.get(..flows.len()).unwrap_or_default();
        combine(readout, first.field, sides, own);
        let variance = variance(cpu, own);
        // Across the frame the steps add up to that variance. Half or twice as much changes no figure of `eval quick` by 1 %.
        let step = variance / cells.columns.max(1) as f32;
        let prior = 1.0 / variance;
        FieldPrior { cpu, columns: cells.columns, step, prior }.posterior(own, posterior);
        cells.velocities.extend(posterior.iter().map(VelocityEstimate::value));
        self.find_regions(readout, first.field, flows.len(), prior);
        &self.cells
    }

    /// The regions of the frame solved last, row by row; none without flow.
    pub fn regions(&self) -> &[Region] {
        &self.regions
    }

    fn find_regions(&mut self, readout: &Readout, field: &FlowField, sides: usize, prior: f32) {
        let [across, down] = REGIONS;
        let (columns, rows) = (self.cells.columns, self.cells.rows);
        self.regions.resize(across * down, Region::default());
        let mut counts = vec![0.0; across * down];
        let cells = self.cells.velocities.iter().zip(&self.posterior).enumerate();
        for (index, (velocity, posterior)) in cells {
            let (column, row) = (index % columns, index / columns);
            let place = row * down / rows * across + column * across / columns;
            let (Some(region), Some(count)) = (self.regions.get_mut(place), counts.get_mut(place)) else {
                continue;
            };
            let sides = self.sides.iter().take(sides);
            let squares = sides.filter_map(|side| side.squared_residual(index, *velocity, prior));
            let [sum, sources] =
                squares.fold([0.0; 2], |[sum, sources], square| [sum + square, sources + 1.0]);
            let [x, y] = field.centre(column, row);
            let elapsed = readout.share(x, y) - 0.5;
            region.velocity += Vector2::from(*velocity).cast::<f64>();
            // At most the prior variance: rounding loses the prior if the information along one axis is far
            // larger than along the other. NaN becomes the bound, too.
            let variance = posterior.variance().min(2.0 / prior);
            let square = (variance + sum / f32::max(sources, 1.0)).min(OUTLIER * OUTLIER);
            region.error += elapsed * elapsed * f64::from(square);
            *count += 1.0;
        }
        for (region, count) in self.regions.iter_mut().zip(counts) {
            region.velocity /= f64::max(count, 1.0);
            region.error /= f64::max(count, 1.0);
        }
    }
}

/// The variance of a coordinate of the velocities: the likeliest, by Fisher's scoring.
fn variance(cpu: CpuLevel, cells: &[VelocityEstimate]) -> f32 {
    let mut variance = MIN_VARIANCE;
    for _ in 0..SCORING_STEPS {
        let [score, information] = with_cpu!(cpu, cpu => cpu.vectorize(
            #[inline(always)]
            || score_of_variance(cpu, variance, cells)
        ));
        variance = (variance + score / information.max(f32::MIN_POSITIVE)).max(MIN_VARIANCE);
    }
    variance
}

#[cfg(test)]
#[path = "solver_tests.rs"]
mod tests;
