// SPDX-License-Identifier: MIT OR Apache-2.0

//! Flow minus path: the residual velocity of each cell, and its information.

use super::estimate::VelocityEstimate;
use super::frame_flow::FrameFlow;
use super::path::Path;
use crate::cpu::CpuLevel;
use crate::flow::FlowField;
use crate::lanes::dispatch::with_cpu;
use crate::lanes::matrices::{Columns, columns, times};
use crate::lanes::{Cpu, DoubleCpu};
use crate::parallel::*;
use crate::readout::Readout;
use nalgebra::Matrix3;

/// Largest residual velocity in pixels per readout, largest interval from a frame to a neighbour in readouts, and inverse of
/// the smallest: what is beyond is an outlier, and its weighted square overflows `f32`.
pub(super) const OUTLIER: f32 = 1e6;

/// Residual velocities from the flow to one neighbour.
#[derive(Debug, Default)]
pub(super) struct NeighbourFlow {
    /// Interval from the frame to the neighbour in readouts; negative for the previous frame.
    ahead: f32,
    /// Velocity in pixels per readout and its information (xx, xy, yy), per cell.
    cells: Vec<([f32; 2], [f32; 3])>,
}

/// The path at the instants at which the lines of a neighbour are exposed: homographies from the first
/// instant to equidistant ones, interpolated linearly. The error for a vibration of 7 px at 2.3 cycles a
/// readout is 0.01 px.
struct ArrivalPath {
    /// Seconds.
    first: f64,
    step: f64,
    homographies: Vec<Columns>,
}

impl ArrivalPath {
    /// Samples per readout.
    const SAMPLES_PER_READOUT: f64 = 128.0;
    /// Margin before the first line's exposure and after the last one's, in readouts, for points that leave
    /// the frame.
    const MARGIN: f64 = 0.25;

    fn new(interval: f64, readout: f64, until: impl Fn(f64) -> Matrix3<f64> + Sync) -> Self {
        let (first, step) = (interval - Self::MARGIN * readout, readout / Self::SAMPLES_PER_READOUT);
        let count = (Self::SAMPLES_PER_READOUT * (1.0 + 2.0 * Self::MARGIN)) as usize + 2;
        let homographies = (0..count)
            .into_par_iter()
            .with_min_len(32)
            .map(|index| columns(&until(first + index as f64 * step)));
        Self { first, step, homographies: homographies.collect() }
    }

    /// Where a point, seen at the first instant, is at a time; constant beyond the outermost samples.
    #[inline(always)]
    fn carry<C: DoubleCpu>(&self, cpu: C, point: [f64; 3], time: f64) -> Option<[f64; 3]> {
        let last = self.homographies.len().checked_sub(2)?;
        let at = ((time - self.first) / self.step).clamp(0.0, last as f64);
        // NaN becomes 0.
        let index = at as usize;
        let [a, b] = self.homographies.get(index..)?.first_chunk()?;
        let share = cpu.splat_double(at - index as f64);
        let mut columns = [cpu.splat_double(0.0); 3];
        for (column, (a, b)) in columns.iter_mut().zip(a.iter().zip(b)) {
            let a = cpu.load_doubles(a);
            *column = a + (cpu.load_doubles(b) - a) * share;
        }
        Some(times(cpu, columns, point))
    }
}

/// The flow to a neighbour, and the path between the exposures of both frames.
struct Flown<'a> {
    readout: &'a Readout,
    flow: &'a FrameFlow<'a>,
    /// Exposure time of each line of cells, and the homography from there to the first instant.
    starts: Vec<(f64, Columns)>,
    arrivals: ArrivalPath,
}

impl Flown<'_> {
    /// Residual velocity and information of a cell.
    #[inline(always)]
    fn velocity<C: DoubleCpu>(&self, cpu: C, column: usize, row: usize) -> Option<([f32; 2], [f32; 3])> {
        let FrameFlow { field, interval: ahead } = *self.flow;
        let cell = field.cells().get(row * field.columns() + column).filter(|cell| cell.confidence > 0.0)?;
        let here = field.centre(column, row);
        let there = [here[0] + f64::from(cell.flow[0]), here[1] + f64::from(cell.flow[1])];
        let (from, back) =
            self.starts.get(if self.readout.direction().is_by_rows() { row } else { column })?;
        let back = [cpu.load_doubles(&back[0]), cpu.load_doubles(&back[1]), cpu.load_doubles(&back[2])];
        let to = ahead + self.readout.offset(there[0], there[1]);
        let at_first = times(cpu, back, [here[0], here[1], 1.0]);
        let [x, y, z] = self.arrivals.carry(cpu, at_first, to)?;
        // Time between the two exposures in readouts.
        let interval = ((to - from) / self.readout.time()) as f32;
        let [x, y] = [(there[0] - x / z) as f32 / interval, (there[1] - y / z) as f32 / interval];
        let weight = cell.confidence * interval * interval;
        let is_valid = x.abs() < OUTLIER && y.abs() < OUTLIER && weight.is_finite();
        is_valid.then(|| ([x, y], cell.information.map(|value| value * weight)))
    }
}

impl NeighbourFlow {
    /// Computes the residual velocities of the flow to a neighbour.
    pub(super) fn fill(&mut self, cpu: CpuLevel, readout: &Readout, flow: &FrameFlow<'_>, path: &impl Path) {
        let field = flow.field;
        let (across, rows) = (field.columns(), field.rows());
        self.ahead = (flow.interval / readout.time) as f32;
        // The cells of the frame before are overwritten below.
        self.cells.resize(across * rows, Default::default());
        if !(self.ahead.abs() < OUTLIER && self.ahead.abs() > OUTLIER.recip()) {
            return self.cells.fill(Default::default());
        }
        let arrivals = ArrivalPath::new(flow.interval, readout.time, |time| path.until(time));
        let by_rows = readout.direction.is_by_rows();
        // All cells of a line have the same exposure time.
        let start = |line: usize| {
            let [x, y] = if by_rows { field.centre(0, line) } else { field.centre(line, 0) };
            let time = readout.offset(x, y);
            (time, columns(&path.back(time)))
        };
        let starts = (0..if by_rows { rows } else { across }).map(start).collect();
        let flown = Flown { readout, flow, starts, arrivals };
        self.cells.par_chunks_mut(across.max(1)).enumerate().for_each(|(row, cells)| {
            with_cpu!(cpu, cpu => cpu.vectorize(
                #[inline(always)]
                || for (column, cell) in cells.iter_mut().enumerate() {
                    *cell = flown.velocity(cpu, column, row).unwrap_or_default();
                }
            ));
        });
    }

    /// Squared difference between a velocity and that of the flow to the neighbour in a cell, in px² per
    /// readout²; `None` if the trace of the flow's information is at most `least`.
    pub(super) fn squared_residual(&self, index: usize, velocity: [f32; 2], least: f32) -> Option<f32> {
        let (own, [xx, _, yy]) = self.cells.get(index)?;
        let difference = [own[0] - velocity[0], own[1] - velocity[1]];
        (xx + yy > least).then_some(difference[0] * difference[0] + difference[1] * difference[1])
    }
}

/// The mean velocity of each cell between its exposure and the middle of the readout, from one or two
/// neighbours.
///
/// The mean velocity over the interval to a neighbour is that at half the interval. The velocity at half the
/// time to the middle of the readout is interpolated linearly between the two if their information is
/// similar, and tends to their weighted mean otherwise.
pub(super) fn combine(
    readout: &Readout,
    field: &FlowField,
    sides: &[NeighbourFlow],
    out: &mut Vec<VelocityEstimate>,
) {
    out.clear();
    let (Some(first), last) = (sides.first(), sides.last()) else { return };
    let second = last.filter(|_| sides.len() > 1);
    out.extend(first.cells.iter().enumerate().map(|(index, (velocity, information))| {
        let own = VelocityEstimate::new(*information, *velocity);
        let Some((second, (other_velocity, other_information))) =
            second.and_then(|second| Some((second, second.cells.get(index)?)))
        else {
            return own;
        };
        let other = VelocityEstimate::new(*other_information, *other_velocity);
        let both = own.plus(other);
        let least = own.trace().min(other.trace());
        if least <= 0.0 {
            return both;
        }
        let [x, y] = field.centre(index % field.columns(), index / field.columns());
        let share = readout.share(x, y) as f32;
        let along = ((0.5 - share - first.ahead) / (second.ahead - first.ahead)).clamp(-0.5, 1.5);
        let balance = (4.0 * least / both.trace()).min(1.0);
        let mean = both.plus_prior(1e-6 * both.trace()).value();
        let interpolated = [0, 1].map(|axis| {
            let line = velocity[axis] + (other_velocity[axis] - velocity[axis]) * along;
            mean[axis] + balance * (line - mean[axis])
        });
        both.with_value(interpolated)
    }));
}
