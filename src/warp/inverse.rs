//! The inverse map: where the picture shown at an output pixel lies in the frame as it arrived.
//!
//! A point x of the frame (centred pixels), exposed at share s(x), is shown at
//!
//! > y = z · carry(x, s, s + α·(ref − s))
//!
//! with the strength α, the reference share ref and the zoom z; α = 1, z = 1 is 25.11. Two
//! scalar fields describe the inverse in the form in which the two passes of the warp need it:
//!
//! * `across`: the x at which the frame shows output pixel (X, Y), less X;
//! * `down`: the y at which *column* x of the frame shows something of output *row* Y, less Y.
//!
//! Together they are the inverse: output (X, Y) shows (x, Y + down(x, Y)) with x = X + across(X, Y).
//!
//! Both are solved exactly at nodes 32 pixels apart (8 in small frames) and interpolated by
//! Catmull–Rom cubics, whose error is of third order: (32 px)³ · f‴/(72√3)-like, some 1e-4 px for 0.2 rad
//! on 1080 rows. 1080p: 2 × 2200 nodes of about three carries each, 40 ns a carry: 0.5 ms on one
//! core, spread by rows of nodes.

use super::WarpSettings;
use crate::motion::{MotionPath, image_centre};
use crate::readout::Readout;
use nalgebra::Vector2;
use rayon::prelude::*;

/// Largest zoom that is honoured.
pub(super) const MAX_ZOOM: f64 = 8.0;

/// A scalar field sampled at nodes `spacing` frame pixels apart.
#[derive(Debug, Default)]
pub(super) struct Field {
    /// Frame pixel of node (0, 0), in x and y.
    pub origin: [f64; 2],
    /// Frame pixels between nodes.
    pub spacing: f64,
    /// Nodes in a row.
    pub columns: usize,
    /// One value a node, row by row, in frame pixels.
    pub values: Vec<f32>,
}

impl Field {
    /// Lays nodes over `x` and `y` (first and last frame pixel) with one to spare on each side, and
    /// fills them; `row` gets the node's y, its first x and the spacing, and the values to write.
    fn fill(
        &mut self,
        x: [f64; 2],
        y: [f64; 2],
        spacing: f64,
        row: impl Fn(f64, f64, f64, &mut [f32]) + Sync,
    ) {
        let first = |from: f64| ((from / spacing).floor() - 1.0) * spacing;
        let count = |from: f64, to: f64| (((to - first(from)) / spacing).ceil() as usize + 2).max(4);
        self.origin = [first(x[0]), first(y[0])];
        self.spacing = spacing;
        self.columns = count(x[0], x[1]);
        let rows = count(y[0], y[1]);
        self.values.clear();
        self.values.resize(self.columns * rows, 0.0);
        let [x0, y0] = self.origin;
        self.values
            .par_chunks_mut(self.columns)
            .enumerate()
            .for_each(|(index, values)| row(y0 + index as f64 * spacing, x0, spacing, values));
    }

    /// Rows of nodes.
    pub fn rows(&self) -> usize {
        self.values.len() / self.columns.max(1)
    }
}

/// The inverse map of one frame.
#[derive(Debug, Default)]
pub(super) struct InverseMap {
    pub across: Field,
    pub down: Field,
}

impl InverseMap {
    /// Solves the map of one frame, into the buffers that are there.
    pub fn solve(&mut self, readout: &Readout, path: &MotionPath, settings: &WarpSettings) {
        let correction = Correction::new(readout, path, settings);
        let size = [readout.width as f64, readout.height as f64];
        let spacing = if size[0].min(size[1]) < 512.0 { 8.0 } else { 32.0 };
        let rows = [0.0, size[1] - 1.0];
        self.across.fill([0.0, size[0] - 1.0], rows, spacing, |y, x, step, values| {
            correction.across(y, x, step, values);
        });
        let seen = self.columns_seen(size[0]);
        self.down.fill(seen, rows, spacing, |y, x, step, values| correction.down(y, x, step, values));
    }

    /// First and last frame column that the output shows, at most a width outside the frame.
    fn columns_seen(&self, width: f64) -> [f64; 2] {
        let Field { origin, spacing, columns, values } = &self.across;
        let mut seen = [0.0, width - 1.0];
        for row in values.chunks(*columns) {
            for (column, &value) in row.iter().enumerate() {
                let x = origin[0] + spacing * column as f64 + f64::from(value);
                seen = [seen[0].min(x), seen[1].max(x)];
            }
        }
        [seen[0].max(-width), seen[1].min(2.0 * width)]
    }
}

/// The correction of one frame as a function of centred points.
struct Correction<'a> {
    readout: &'a Readout,
    path: &'a MotionPath,
    centre: Vector2<f64>,
    reference: f64,
    strength: f64,
    zoom: f64,
}

impl<'a> Correction<'a> {
    fn new(readout: &'a Readout, path: &'a MotionPath, settings: &WarpSettings) -> Self {
        Self {
            readout,
            path,
            centre: image_centre(readout.width, readout.height),
            reference: within(settings.reference_row, 0.0, 1.0, 0.5),
            strength: within(settings.strength, 0.0, 1.0, 1.0),
            zoom: within(settings.zoom, 1.0, MAX_ZOOM, 1.0),
        }
    }

    fn share(&self, point: Vector2<f64>) -> f64 {
        self.readout.share(point.x + self.centre.x, point.y + self.centre.y)
    }

    /// The share at whose instant a point exposed at `share` is shown: s + α·(ref − s).
    fn shown(&self, share: f64) -> f64 {
        share + self.strength * (self.reference - share)
    }

    /// x − X at the nodes of one row. The unknown is the share s at which the point was exposed:
    /// s = share(carry(Y/z, shown(s), s)).
    fn across(&self, y: f64, x0: f64, step: f64, values: &mut [f32]) {
        let size = self.readout.width as f64;
        let tolerance = self.tolerance();
        let mut shift = 0.0;
        for (index, value) in values.iter_mut().enumerate() {
            let x = x0 + step * index as f64;
            let point = (Vector2::new(x, y) - self.centre) / self.zoom;
            let source = |share: f64| self.path.carry(point, self.shown(share), share);
            let start = self.share(point);
            let share = root(|share| self.share(source(share)) - share, start + shift, tolerance);
            shift = share - start;
            *value = displacement(source(share).x + self.centre.x - x, size);
        }
    }

    /// y − Y at the nodes of one row: carry((x, y), s, shown(s)) has the height Y/z.
    fn down(&self, y: f64, x0: f64, step: f64, values: &mut [f32]) {
        let size = self.readout.height as f64;
        let height = (y - self.centre.y) / self.zoom;
        let mut start = height;
        for (index, value) in values.iter_mut().enumerate() {
            let x = x0 + step * index as f64 - self.centre.x;
            let missing = |y: f64| {
                let point = Vector2::new(x, y);
                let share = self.share(point);
                height - self.path.carry(point, share, self.shown(share)).y
            };
            start = root(missing, start, TOLERANCE);
            *value = displacement(start + self.centre.y - y, size);
        }
    }

    /// The share that is read in the time of [`TOLERANCE`] pixels.
    fn tolerance(&self) -> f64 {
        TOLERANCE / self.readout.width.max(self.readout.height).max(1) as f64
    }
}

/// How far from the root the iteration may stop, in pixels. The last step is taken after the
/// residual was seen to be small, so what remains is smaller by another factor of ten.
const TOLERANCE: f64 = 1e-3;

/// The root of a function whose slope is about −1, as that of `target(u) − u` is in a fixed point.
///
/// The first step is the fixed point's, the others a secant's whose slope is kept within
/// [−4, −¼]; eight steps at most, so that a map without a solution ends too. Not a number ends
/// the iteration at `start`.
fn root(residual: impl Fn(f64) -> f64, start: f64, tolerance: f64) -> f64 {
    let (mut at, mut slope) = (start, -1.0);
    let mut missing = residual(at);
    for _ in 0..8 {
        let step = -missing / slope;
        at += step;
        if missing.abs() < tolerance {
            break;
        }
        let left = residual(at);
        slope = ((left - missing) / step).clamp(-4.0, -0.25);
        missing = left;
    }
    if at.is_finite() { at } else { if start.is_finite() { start } else { 0.0 } }
}

/// A displacement that can be worked with: finite and at most one and a half frames.
fn displacement(value: f64, size: f64) -> f32 {
    if value.is_finite() { value.clamp(-1.5 * size, 1.5 * size) as f32 } else { 0.0 }
}

/// `value` kept within bounds; `otherwise` where it is not a number.
pub(super) fn within(value: f64, low: f64, high: f64, otherwise: f64) -> f64 {
    if value.is_nan() { otherwise } else { value.clamp(low, high) }
}
