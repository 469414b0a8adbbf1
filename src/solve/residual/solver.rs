//! The residual velocities of a frame.

use super::diffuse::{Field, Known};
use super::frame_flow::FrameFlow;
use super::path::Path;
use super::velocity::{FASTEST, Side, joined};
use crate::flow::FlowField;
use crate::readout::Readout;
use nalgebra::Vector2;

/// Variance in squared cells of the step from one cell's velocity to the next: a tenth of a pixel of eight, squared.
/// Five times as much or a fifth of it changes no figure of the evaluation by more than a tenth.
const STEP: f32 = 0.0016;

/// Variance that residual velocities have in squared cells, at least: below it they are noise.
const LEAST_VARIANCE: f32 = 0.00016;

/// Columns and rows of the regions of a frame for which an error is told.
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
    /// Mean square distance in px² at which path and residual velocities are expected to leave points from where they are at
    /// the middle of the readout: for the time until then, the variances of the velocities and their residuals in the flow.
    pub error: f64,
}

impl Region {
    /// The same in other pixels, of which `factor` make one of these.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self { velocity: self.velocity * factor, error: self.error * factor * factor }
    }
}

/// Solves the residual velocities of one frame after another.
#[derive(Debug, Default)]
pub struct ResidualSolver {
    cells: CellVelocities,
    sides: [Side; 2],
    own: Vec<Known>,
    posterior: Vec<Known>,
    regions: Vec<Region>,
}

impl ResidualSolver {
    /// The residual velocities of a frame, given the flow to its neighbours, one or two; none where there is no flow.
    pub fn solve(&mut self, readout: &Readout, flows: &[FrameFlow<'_>], path: &impl Path) -> &CellVelocities {
        self.cells.velocities.clear();
        self.regions.clear();
        let fields = flows.iter().filter(|flow| !flow.field.cells().is_empty());
        let flows: Vec<_> = fields.take(self.sides.len()).collect();
        let Some(first) = flows.first() else { return &self.cells };
        let Self { cells, sides, own, posterior, .. } = self;
        (cells.columns, cells.rows, cells.side) =
            (first.field.columns(), first.field.rows(), first.field.cell_side());
        for (side, flow) in sides.iter_mut().zip(&flows) {
            side.fill(readout, flow, path);
        }
        let sides = sides.get(..flows.len()).unwrap_or_default();
        joined(readout, first.field, sides, own);
        let area = (cells.side * cells.side) as f32;
        let prior = 1.0 / (variance(own, STEP * area) + LEAST_VARIANCE * area);
        Field { columns: cells.columns, step: STEP * area, prior }.posterior(own, posterior);
        cells.velocities.extend(posterior.iter().map(Known::value));
        self.find_regions(readout, first.field, flows.len(), prior);
        &self.cells
    }

    /// The regions of the frame that was solved last, row by row; none where there is no flow.
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
            let left = sides.filter_map(|side| side.difference(index, *velocity, prior));
            let [sum, known] = left.fold([0.0; 2], |[sum, known], square| [sum + square, known + 1.0]);
            let [x, y] = field.centre(column, row);
            let late = readout.share(x, y) - 0.5;
            region.velocity += Vector2::from(*velocity).cast::<f64>();
            // No more than before anything was measured: rounding hides the prior from what is known far better along
            // one axis. Not a number becomes the most, too.
            let variance = posterior.variance().min(2.0 / prior);
            let square = (variance + sum / f32::max(known, 1.0)).min(FASTEST * FASTEST);
            region.error += late * late * f64::from(square);
            *count += 1.0;
        }
        for (region, count) in self.regions.iter_mut().zip(counts) {
            region.velocity /= f64::max(count, 1.0);
            region.error /= f64::max(count, 1.0);
        }
    }
}

/// The variance of a coordinate of the velocities, of which those count half that are known with the variance `usual`.
fn variance(cells: &[Known], usual: f32) -> f32 {
    let (mut square, mut weights) = (0.0, f32::MIN_POSITIVE);
    for known in cells {
        let information = known.trace();
        let weight = information / (information + 1.0 / usual);
        let [x, y] = known.plus_prior(LITTLE).value();
        square += weight * 0.5 * (x * x + y * y);
        weights += weight;
    }
    square / weights
}

/// Information in (pixels per readout)⁻² that is next to none.
const LITTLE: f32 = 1e-6;

#[cfg(test)]
#[path = "solver_tests.rs"]
mod tests;
