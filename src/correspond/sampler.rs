// SPDX-License-Identifier: MIT OR Apache-2.0

//! Correspondences sample_flow from dense flow at the grid.

use super::correspondence::{Correspondence, to_full};
use super::distortion::{Distortions, GridDisplacement};
use super::grid::Grid;
use super::patch::centre;
use super::polish::{InitialEstimate, polish};
use super::template::Template;
use crate::cpu::CpuLevel;
use crate::flow::{DenseFlow, FlowField, MIN_CONFIDENCE};
use crate::lanes::Cpu;
use crate::lanes::dispatch::with_cpu;
use crate::parallel::*;
use crate::plane::Luma;
use crate::pyramid::{Effort, Pyramid, Reducer, block_difference};
use nalgebra::Vector2;

/// First decile of the smallest of the four squared deviations of [`covariance_factor`] if the covariances
/// are correct: by simulation of 60,000 points with normal errors.
const EXPECTED_FIRST_DECILE: f64 = 0.0269;

/// Factor on the excess of the measured variance: excess errors are in part common to neighbours and cancel
/// in their difference; the common part is as large again, measured on footage through H.264 at 1.5 Mbit/s.
const COMMON_ERROR_FACTOR: f64 = 2.0;

/// With fewer deviations than this the factor is 1.
const MIN_DEVIATIONS: usize = 30;

/// Limits of the factor on the covariances.
const COVARIANCE_FACTORS: [f64; 2] = [0.5, 100.0];

/// Measures correspondences between frames of one size on a uniform grid, from dense flow.
#[derive(Debug)]
pub struct Sampler {
    cpu: CpuLevel,
    reducer: Reducer,
    grid: Grid,
    flow: DenseFlow,
    displacements: Vec<Option<GridDisplacement>>,
    found: Vec<Option<Correspondence>>,
    distortions: Distortions,
    /// Scratch.
    deviations: Vec<f64>,
}

impl Sampler {
    /// As [`with_effort`](Self::with_effort), with the usual effort.
    #[cfg(feature = "unstable")]
    pub fn new(width: usize, height: usize, grid_columns: usize, grid_rows: usize) -> Self {
        Self::with_effort(Effort::default(), width, height, grid_columns, grid_rows)
    }

    /// For frames of `width` × `height` pixels analysed at the size that `effort` selects, and a grid of cells
    /// with one point each.
    ///
    /// Any size is valid; frames (or grids) too small for a single patch yield no correspondences.
    pub fn with_effort(
        effort: Effort,
        width: usize,
        height: usize,
        grid_columns: usize,
        grid_rows: usize,
    ) -> Self {
        let reducer = Reducer::with_effort(width, height, effort);
        Self::of(CpuLevel::detect(), reducer, grid_columns, grid_rows)
    }

    /// As [`new`](Self::new), with the instructions of `cpu`; results differ by rounding only.
    #[cfg(feature = "unstable")]
    pub fn with_cpu(
        cpu: CpuLevel,
        width: usize,
        height: usize,
        grid_columns: usize,
        grid_rows: usize,
    ) -> Self {
        Self::of(cpu, Reducer::new(width, height), grid_columns, grid_rows)
    }

    fn of(cpu: CpuLevel, reducer: Reducer, grid_columns: usize, grid_rows: usize) -> Self {
        let grid = Grid::new(reducer.size(), grid_columns, grid_rows);
        let flow = DenseFlow::with_cpu(cpu, &reducer);
        let cells = grid.len();
        Self {
            cpu,
            reducer,
            grid,
            flow,
            displacements: vec![None; cells],
            found: vec![None; cells],
            distortions: Distortions::default(),
            deviations: Vec::new(),
        }
    }

    /// Width of an analysed pixel in full-frame pixels.
    pub fn pixel_scale(&self) -> f64 {
        self.reducer.scale()
    }

    /// Reduces `luma` into `pyramid`. A luma that is not of the sampler's size leaves the pyramid empty.
    pub fn build(&self, luma: &Luma<'_>, pyramid: &mut Pyramid) {
        self.reducer.build(luma, pyramid);
    }

    /// Estimates the flow between two frames, and measures its correspondences into `out`, in the order of
    /// the grid.
    ///
    /// `predict` maps a point of the first frame (full-frame pixels) to its expected position in the second:
    /// the identity without a prediction.
    pub fn correspond(
        &mut self,
        first: &Pyramid,
        second: &Pyramid,
        predict: impl Fn(Vector2<f64>) -> Vector2<f64>,
        out: &mut Vec<Correspondence>,
    ) {
        out.clear();
        self.flow.estimate(first, second, predict);
        let (Some(from), Some(to)) = (first.levels().first(), second.levels().first()) else { return };
        if self.flow.forward().cells().is_empty() {
            return;
        }
        let (scale, grid, field) = (self.reducer.scale(), &self.grid, self.flow.forward());
        for (index, displacement) in self.displacements.iter_mut().enumerate() {
            *displacement = grid.corner(index).and_then(|corner| sample_flow(field, corner, scale));
        }
        self.distortions.fill(self.cpu, &self.displacements, grid.columns);
        let (displacements, distortions, cpu) = (&self.displacements, &self.distortions, self.cpu);
        let initial = |index: usize| {
            let displacement = displacements.get(index).copied().flatten()?;
            Some(InitialEstimate {
                corner: grid.corner(index)?,
                shift: displacement.shift,
                distortion: distortions.at(index),
            })
        };
        let found = self.found.par_iter_mut().enumerate().with_min_len(16);
        with_cpu!(cpu, cpu => found.for_each_init(
            || Template::new(cpu),
            |template, (index, found)| {
                *found = initial(index).and_then(|start| {
                    cpu.vectorize(#[inline(always)] || polish(template, [from, to], &start, scale))
                });
            },
        ));
        let factor = covariance_factor(&self.found, self.grid.columns, &mut self.deviations);
        let scaled =
            |found: &Correspondence| Correspondence { covariance: found.covariance * factor, ..*found };
        out.extend(self.found.iter().flatten().map(scaled));
    }

    /// How much two frames differ: the highest mean absolute grey difference of any block of 8 × 8 analysed pixels. Infinite
    /// where a pyramid is empty or not of the sampler's size.
    pub fn difference(&self, first: &Pyramid, second: &Pyramid) -> f64 {
        let size = self.reducer.size();
        if first.is_of(size) && second.is_of(size) {
            block_difference(self.cpu, first, second)
        } else {
            f64::INFINITY
        }
    }

    /// Mean square of a frame's gradient at the finest level, in squared grey levels per pixel; 0 of a pyramid that holds none.
    pub fn sharpness(&self, frame: &Pyramid) -> f64 {
        frame.levels().first().map_or(0.0, |finest| finest.mean_square_gradient(self.cpu))
    }

    /// The flow of the pair measured last.
    pub fn flow(&self) -> &DenseFlow {
        &self.flow
    }
}

/// The factor on the covariances of a pair, estimated from the covariance_factor between neighbours.
///
/// Errors that are constant over a patch, as in coded video, do not show in its residual. They show between
/// patches: the difference of a displacement from the mean of two opposite neighbours cancels all linear
/// change. The smallest of the four pairs of opposite neighbours and the first decile over all points are
/// used, to exclude depth edges.
fn covariance_factor(found: &[Option<Correspondence>], columns: usize, deviations: &mut Vec<f64>) -> f64 {
    let at = |index: Option<usize>| found.get(index?)?.as_ref();
    let shift = |found: &Correspondence| found.to - found.from;
    deviations.clear();
    for (index, own) in found.iter().enumerate() {
        let Some(own) = own else { continue };
        let column = index % columns.max(1);
        if column == 0 || column + 1 == columns {
            continue;
        }
        let mut squares = [f64::INFINITY; 4];
        for (square, offset) in squares.iter_mut().zip([1, columns - 1, columns, columns + 1]) {
            if let (Some(before), Some(after)) = (at(index.checked_sub(offset)), at(Some(index + offset))) {
                let difference = shift(own) - 0.5 * (shift(before) + shift(after));
                let trace = before.covariance.trace() + after.covariance.trace();
                *square = difference.norm_squared() / (own.covariance.trace() + 0.25 * trace);
            }
        }
        squares.sort_unstable_by(f64::total_cmp);
        if squares.iter().all(|square| square.is_finite()) {
            deviations.push(squares[0]);
        }
    }
    if deviations.len() < MIN_DEVIATIONS {
        return 1.0;
    }
    let rank = deviations.len() / 10;
    let low = *deviations.select_nth_unstable_by(rank, f64::total_cmp).1;
    let [least, most] = COVARIANCE_FACTORS;
    (1.0 + COMMON_ERROR_FACTOR * (low / EXPECTED_FIRST_DECILE - 1.0)).clamp(least, most)
}

/// The flow at the centre of a patch, in analysed pixels; `None` if its confidence is too low.
fn sample_flow(field: &FlowField, corner: (usize, usize), scale: f64) -> Option<GridDisplacement> {
    let at = centre(Vector2::new(corner.0 as f32, corner.1 as f32));
    let full = to_full(at, scale);
    let (flow, confidence) = field.sample(full.x, full.y)?;
    let shift = Vector2::from(flow).map(|value| (value / scale) as f32);
    (confidence >= f64::from(MIN_CONFIDENCE)).then_some(GridDisplacement { at, shift })
}
