// SPDX-License-Identifier: MIT OR Apache-2.0

//! The inverse map: the position in the frame for each output pixel.
//!
//! A point x of the frame (centred pixels), exposed at share s(x), is moved to
//!
//! > y = z · (x + α · (carry(x, s, ref) − x))
//!
//! with the strength α, the reference share ref and the zoom z; α = 1, z = 1 is 25.11. The placement P of a frame that is
//! stabilised applies before the zoom, y = z · P(x + …). Moving a point for
//! a share α of the time instead would not fade a vibration: of 2.3 cycles a frame, α = 0.9 can leave 0.7 of
//! the amplitude in the first row.
//!
//! Two scalar fields represent the inverse in the form needed by the two passes of the warp:
//!
//! * `across`: the frame's x for output pixel (X, Y), less X;
//! * `down`: the y at which *column* x of the frame is mapped to output *row* Y, less Y.
//!
//! Together they are the inverse: output (X, Y) shows (x, Y + down(x, Y)) with x = X + across(X, Y).
//!
//! The forward map is evaluated at the nodes of a mesh and inverted along lines, as a monotone sequence
//! (see [`monotone`](super::monotone)): first down each column of the frame, which gives `down` and the
//! output X of the column in each output row; then along each output row. The inversion is not iterative,
//! the motion is evaluated at the nodes only, and all nodes of the same exposure time share an interval.
//!
//! Nodes are 1/96 of the frame apart in the direction of the readout, so that two and a half cycles
//! a frame are interpolated to 10⁻³ of their amplitude, and 8, 32 or 64 pixels apart across it, where a
//! global motion is a homography; in both at most the spacing of a residual field. The largest measured
//! error of the whole warp is 0.004 px for 0.2 rad and 150 px a frame at 1920 × 1080, 0.008 px for a
//! vibration of 7 px at 2.3 cycles a frame and 0.009 px for one of 4 px with a field of small curvature
//! within a mesh cell, read sideways at 640 × 480.
//!
//! 1080p: 23 × 100 nodes, or 125 × 100 with a field on nodes 16 px apart; some 40 ns a node on one core:
//! 0.1 and 0.5 ms, distributed by lines of nodes.

use super::borders::kept_inside;
use super::correction::Correction;
use super::monotone::{Inverse, limit_slopes};
use super::nodes::Nodes;
use super::settings::WarpSettings;
use crate::cpu::{CpuLevel, for_each_cpu};
use crate::motion::{FrameMotion, IntervalMotion, MotionPath};
use crate::parallel::*;
use crate::readout::Readout;
use nalgebra::Vector2;
use std::cell::RefCell;

/// Least spacing of nodes in pixels: that of the warp's knots.
const MIN_SPACING: f64 = 8.0;
/// Largest slope of `across`, and of `down` in magnitude, along a row: a block of the warp holds 7 px
/// between two knots, less a tenth for the cubic between the nodes.
const MAX_SLOPE: f64 = 0.8;
/// Least slope of the forward map along a line, where it folds, and inverse of the largest, where it has a
/// gap.
const MIN_STRETCH: f64 = 0.25;

/// A scalar field sampled at nodes.
#[derive(Debug, Default)]
pub(super) struct MapField {
    /// Columns of nodes.
    pub x: Nodes,
    /// Rows of nodes.
    pub y: Nodes,
    /// One value per node, row by row, in frame pixels.
    pub values: Vec<f32>,
}

impl MapField {
    /// Takes new nodes; the values are still to be written.
    fn reset(&mut self, x: Nodes, y: Nodes) {
        (self.x, self.y) = (x, y);
        self.values.resize(x.count * y.count, 0.0);
    }
}

/// The inverse map of one frame.
#[derive(Debug, Default)]
pub(super) struct InverseMap {
    pub across: MapField,
    pub down: MapField,
    intervals: Vec<IntervalMotion>,
    crossings: Vec<Crossing>,
}

/// The point of a column of the frame that is mapped to a row of the output.
#[derive(Clone, Copy, Debug, Default)]
struct Crossing {
    /// y in the frame less Y in the output.
    down: f64,
    /// x in the output, centred, before the zoom.
    shown: f64,
}

/// Buffers of one thread.
#[derive(Debug, Default)]
struct LineBuffers {
    /// Positions in the output along the line.
    shown: Vec<f64>,
    /// Displacements across the line.
    sideways: Vec<f64>,
    /// Velocities of the residual field along the line.
    velocities: Vec<Vector2<f64>>,
    spare: Vec<f64>,
}

thread_local! {
    static SCRATCH: RefCell<LineBuffers> = RefCell::default();
}

impl InverseMap {
    /// Solves the map of one frame.
    pub fn solve(&mut self, level: CpuLevel, motion: &FrameMotion, settings: &WarpSettings) {
        let (readout, path) = (motion.readout(), motion.path());
        let correction = kept_inside(motion, settings);
        let spacing = spacing(readout, path);
        let last = [readout.width as f64 - 1.0, readout.height as f64 - 1.0];
        let [x, y] = [0, 1].map(|axis| Nodes::over(0.0, last[axis], spacing[axis]));
        let visible = correction.visible(&[x, y].map(|axis| [axis.first, axis.at(axis.count - 1)]));
        let [frame_x, frame_y] =
            [0, 1].map(|axis| Nodes::over(visible[axis][0], visible[axis][1], spacing[axis]));
        self.across.reset(x, y);
        self.down.reset(frame_x, y);
        self.crossings.resize(frame_x.count * y.count, Crossing::default());
        correction.intervals(&frame_x, &frame_y, &mut self.intervals);
        let lines =
            Lines { level, correction, by_rows: readout.direction.is_by_rows(), frame_x, frame_y, x, y };
        lines.columns(&self.intervals, &mut self.crossings);
        lines.rows(&self.crossings, &mut self.across.values, &mut self.down.values);
    }
}

/// Pixels between nodes, in x and y.
fn spacing(readout: &Readout, path: &MotionPath) -> [f64; 2] {
    let size = [readout.width as f64, readout.height as f64];
    let coarse = match readout.width.min(readout.height) {
        ..400 => 8.0,
        400..1000 => 32.0,
        _ => 64.0,
    };
    let read = usize::from(readout.direction.is_by_rows());
    let mut spacing = [coarse; 2];
    spacing[read] = (size[read] / 96.0).min(coarse);
    if let Some(field) = path.residual() {
        spacing = [0, 1].map(|axis| spacing[axis].min(field.mesh().spacing[axis]));
    }
    spacing.map(|spacing| spacing.max(MIN_SPACING))
}

/// The lines along which the map is inverted.
struct Lines<'a> {
    level: CpuLevel,
    correction: Correction<'a>,
    by_rows: bool,
    /// Nodes of the frame.
    frame_x: Nodes,
    frame_y: Nodes,
    /// Nodes of the output.
    x: Nodes,
    y: Nodes,
}

impl Lines<'_> {
    /// Inverts the map down each column of the frame; crossings are stored column by column.
    fn columns(&self, intervals: &[IntervalMotion], crossings: &mut [Crossing]) {
        crossings.par_chunks_mut(self.y.count).enumerate().for_each(|(column, crossings)| {
            SCRATCH.with_borrow_mut(|scratch| {
                invert_column(self.level, self, column, intervals, crossings, scratch);
            });
        });
    }

    /// Inverts the map along each row of the output, from its crossings with the frame's columns.
    fn rows(&self, crossings: &[Crossing], across: &mut [f32], down: &mut [f32]) {
        let across = across.par_chunks_mut(self.x.count);
        let down = down.par_chunks_mut(self.frame_x.count);
        across.zip(down).enumerate().for_each(|(row, (across, down))| {
            SCRATCH.with_borrow_mut(|scratch| {
                invert_row(self.level, self, row, crossings, across, down, scratch);
            });
        });
    }
}

for_each_cpu! {
    fn invert_column(
        lines: &Lines<'_>,
        column: usize,
        intervals: &[IntervalMotion],
        crossings: &mut [Crossing],
        scratch: &mut LineBuffers,
    ) {
        let LineBuffers { shown, sideways, velocities, spare } = scratch;
        let centre = lines.correction.centre;
        let x = lines.frame_x.at(column) - centre.x;
        shown.resize(lines.frame_y.count, 0.0);
        sideways.resize(lines.frame_y.count, 0.0);
        lines.correction.velocities(x, velocities);
        for (row, (shown, sideways)) in shown.iter_mut().zip(sideways.iter_mut()).enumerate() {
            let interval = &intervals[if lines.by_rows { row } else { column }];
            let point = Vector2::new(x, lines.frame_y.at(row) - centre.y);
            let displacement = lines.correction.displacement_in(velocities, interval, point);
            *shown = point.y + displacement.y;
            *sideways = displacement.x;
        }
        let step = lines.frame_y.spacing;
        limit_slopes(shown, MIN_STRETCH * step, step / MIN_STRETCH, spare);
        let mut inverse = Inverse::new(shown, step);
        for (row, crossing) in crossings.iter_mut().enumerate() {
            let y = lines.y.at(row);
            let at = inverse.at((y - centre.y) / lines.correction.zoom);
            let (node, weights) = cubic(at, sideways.len());
            let moved: f64 =
                weights.iter().zip(&sideways[node..]).map(|(weight, moved)| weight * moved).sum();
            *crossing = Crossing { down: lines.frame_y.first + at * step - y, shown: x + moved };
        }
    }
}

for_each_cpu! {
    /// x − X along one output row from the X of the frame's columns in it, and the y − Y of these columns.
    fn invert_row(
        lines: &Lines<'_>,
        row: usize,
        crossings: &[Crossing],
        across: &mut [f32],
        down: &mut [f32],
        scratch: &mut LineBuffers,
    ) {
        let LineBuffers { shown, sideways, spare, .. } = scratch;
        shown.resize(lines.frame_x.count, 0.0);
        sideways.resize(lines.frame_x.count, 0.0);
        let columns = crossings.chunks_exact(lines.y.count);
        for ((shown, sideways), column) in shown.iter_mut().zip(sideways.iter_mut()).zip(columns) {
            *shown = column[row].shown;
            *sideways = column[row].down;
        }
        let step = lines.frame_x.spacing;
        limit_slopes(shown, step / (1.0 + MAX_SLOPE), step / MIN_STRETCH, spare);
        let mut inverse = Inverse::new(shown, step);
        for (column, value) in across.iter_mut().enumerate() {
            let x = lines.x.at(column);
            let at = inverse.at((x - lines.correction.centre.x) / lines.correction.zoom);
            *value = (lines.frame_x.first + at * step - x) as f32;
        }
        limit_slopes(sideways, -MAX_SLOPE * step, MAX_SLOPE * step, spare);
        down.iter_mut().zip(sideways).for_each(|(to, from)| *to = *from as f32);
    }
}

/// First of four nodes and their Catmull–Rom weights at position `at` among `count` ≥ 4 nodes.
#[inline(always)]
pub(super) fn cubic(at: f64, count: usize) -> (usize, [f64; 4]) {
    let last = count.saturating_sub(3).max(1);
    let at = super::correction::within(at, 1.0, (last + 1) as f64, 1.0);
    let node = (at as usize).min(last);
    let t = at - node as f64;
    let weights = [
        -0.5 * t * (1.0 - t) * (1.0 - t),
        1.0 + t * t * (1.5 * t - 2.5),
        t * (0.5 + t * (2.0 - 1.5 * t)),
        -0.5 * t * t * (1.0 - t),
    ];
    (node - 1, weights)
}
