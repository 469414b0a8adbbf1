//! Correspondences sampled from dense flow at the grid.

use super::correspondence::{Correspondence, to_full};
use super::field::{Motion, Slopes};
use super::grid::{Grid, centre};
use super::polish::{Start, polish};
use crate::cpu::CpuLevel;
use crate::flow::{DenseFlow, FlowField};
use crate::parallel::*;
use crate::plane::Luma;
use crate::pyramid::{Pyramid, Reducer, block_difference};
use nalgebra::Vector2;

/// From this confidence on a displacement of the flow is taken up.
const LEAST_CONFIDENCE: f64 = 0.5;

/// First decile of the smallest of the four squared deviations of [`scatter`] where the covariances are true: by
/// simulation of 60,000 points with normal errors.
const USUAL_DEVIATION: f64 = 0.0269;

/// Errors that are larger than their covariance says are in part the same for neighbours, where they do not show: as
/// much again, measured on footage through H.264 at 1.5 Mbit/s.
const SHARED: f64 = 2.0;

/// Fewer deviations tell nothing.
const FEWEST_DEVIATIONS: usize = 30;

/// What the covariances are multiplied by at least and at most.
const LEAST_SCATTER: f64 = 0.5;
const MOST_SCATTER: f64 = 100.0;

/// Measures correspondences between frames of one size on a uniform grid, from dense flow.
#[derive(Debug)]
pub struct Sampler {
    cpu: CpuLevel,
    reducer: Reducer,
    grid: Grid,
    flow: DenseFlow,
    motions: Vec<Option<Motion>>,
    found: Vec<Option<Correspondence>>,
    slopes: Slopes,
    /// Scratch.
    deviations: Vec<f64>,
}

impl Sampler {
    /// For frames of `width` × `height` pixels and a grid of cells, one point in each.
    ///
    /// Any size will do; frames (or grids) too small for a single patch yield no correspondences.
    pub fn new(width: usize, height: usize, grid_columns: usize, grid_rows: usize) -> Self {
        Self::with_cpu(CpuLevel::detect(), width, height, grid_columns, grid_rows)
    }

    /// As [`new`](Self::new), with the instructions of `cpu`; all measure the same but for rounding.
    pub fn with_cpu(
        cpu: CpuLevel,
        width: usize,
        height: usize,
        grid_columns: usize,
        grid_rows: usize,
    ) -> Self {
        let reducer = Reducer::new(width, height);
        let grid = Grid::new(reducer.size(), grid_columns, grid_rows);
        let flow = DenseFlow::with_cpu(cpu, &reducer);
        let cells = grid.len();
        Self {
            cpu,
            reducer,
            grid,
            flow,
            motions: vec![None; cells],
            found: vec![None; cells],
            slopes: Slopes::default(),
            deviations: Vec::new(),
        }
    }

    /// Full-frame pixels to an analysed pixel.
    pub fn pixel_scale(&self) -> f64 {
        self.reducer.scale()
    }

    /// Reduces `luma` into `pyramid`. A luma that is not of the sampler's size leaves nothing to be seen.
    pub fn build(&self, luma: &Luma<'_>, pyramid: &mut Pyramid) {
        self.reducer.build(luma, pyramid);
    }

    /// Estimates the flow between two frames, and measures its correspondences into `out`, in the order of the grid.
    ///
    /// `predict` says where a point (full-frame pixels) of the first frame is expected in the second; the identity where
    /// nothing is known.
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
        for (index, motion) in self.motions.iter_mut().enumerate() {
            *motion = grid.corner(index).and_then(|corner| sampled(field, corner, scale));
        }
        self.slopes.fill(&self.motions, grid.columns);
        let (motions, slopes, cpu) = (&self.motions, &self.slopes, self.cpu);
        self.found.par_iter_mut().enumerate().with_min_len(16).for_each(|(index, found)| {
            *found = grid.corner(index).and_then(|corner| {
                let motion = motions.get(index).copied().flatten()?;
                let start = Start { corner, shift: motion.shift, distortion: slopes.distortion(index) };
                polish(cpu, [from, to], &start, scale)
            });
        });
        let share = scatter(&self.found, self.grid.columns, &mut self.deviations);
        let scaled =
            |found: &Correspondence| Correspondence { covariance: found.covariance * share, ..*found };
        out.extend(self.found.iter().flatten().map(scaled));
    }

    /// How much two frames differ: the highest mean absolute grey difference of any block of 8 × 8 analysed pixels. Infinite
    /// where a pyramid is empty or not of the sampler's size.
    pub fn difference(&self, first: &Pyramid, second: &Pyramid) -> f64 {
        let size = self.reducer.size();
        if first.is_of(size) && second.is_of(size) { block_difference(first, second) } else { f64::INFINITY }
    }

    /// The flow of the pair measured last.
    pub fn flow(&self) -> &DenseFlow {
        &self.flow
    }
}

/// By what the covariances of a pair are to be multiplied: what neighbours say of each other's errors.
///
/// The residual of a patch tells nothing of errors that are the same all over it, as those of coded video are. They show
/// between patches: the difference of a displacement from the mean of those on either side is free of all that changes
/// evenly. Of the four pairs of opposite neighbours the best counts, and of all points the lowest tenth, so that depth
/// edges have no say.
fn scatter(found: &[Option<Correspondence>], columns: usize, deviations: &mut Vec<f64>) -> f64 {
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
    if deviations.len() < FEWEST_DEVIATIONS {
        return 1.0;
    }
    let rank = deviations.len() / 10;
    let low = *deviations.select_nth_unstable_by(rank, f64::total_cmp).1;
    (1.0 + SHARED * (low / USUAL_DEVIATION - 1.0)).clamp(LEAST_SCATTER, MOST_SCATTER)
}

/// The flow at the middle of a patch, in analysed pixels; `None` where it is not trusted.
fn sampled(field: &FlowField, corner: (usize, usize), scale: f64) -> Option<Motion> {
    let at = centre(Vector2::new(corner.0 as f32, corner.1 as f32));
    let full = to_full(at, scale);
    let (flow, confidence) = field.sample(full.x, full.y)?;
    let shift = Vector2::from(flow).map(|value| (value / scale) as f32);
    (confidence >= LEAST_CONFIDENCE).then_some(Motion { at, shift })
}
