// SPDX-License-Identifier: MIT OR Apache-2.0

//! The correction of one frame: displacements from the frame to the rectified frame.

use super::nodes::Nodes;
use super::settings::WarpSettings;
use crate::motion::{FrameMotion, IntervalMotion, MotionPath, image_centre, project};
use crate::readout::Readout;
use nalgebra::{Matrix3, Vector2};

/// Largest zoom.
const MAX_ZOOM: f64 = 8.0;

/// Points along each edge and iterations with which [`Correction::visible`] finds the visible part of the
/// frame.
const EDGE_SAMPLES: usize = 16;
const EDGE_ROUNDS: usize = 3;

/// The correction of one frame as a function of centred points; see [`inverse`](super::inverse).
pub(super) struct Correction<'a> {
    readout: &'a Readout,
    path: &'a MotionPath,
    pub centre: Vector2<f64>,
    reference: f64,
    /// Share of the path's displacement that is applied.
    strength: f64,
    /// The placement and the share of its displacement that is applied.
    placement: Option<(Matrix3<f64>, f64)>,
    pub zoom: f64,
}

impl<'a> Correction<'a> {
    pub fn new(motion: &'a FrameMotion, settings: &WarpSettings) -> Self {
        Self::with_shares(motion, settings, 1.0, 1.0)
    }

    /// The correction with less of the path's displacement and of the placement's than is asked for.
    pub fn with_shares(
        motion: &'a FrameMotion,
        settings: &WarpSettings,
        of_path: f64,
        of_placement: f64,
    ) -> Self {
        let (readout, path) = (motion.readout(), motion.path());
        let reference = within(settings.reference_row, 0.0, 1.0, 0.5);
        let share = within(settings.strength, 0.0, 1.0, 1.0);
        let strength = motion.weight() * share * of_path;
        // From the reference to the middle of the readout, as far as the path is applied at all.
        let to_middle = |placement: &Matrix3<f64>| {
            let identity = Matrix3::identity();
            let back = identity + (path.global_over(reference, 0.5) - identity) * strength;
            (if reference == 0.5 { *placement } else { placement * back }, share * of_placement)
        };
        Self {
            readout,
            path,
            centre: image_centre(readout.width, readout.height),
            reference,
            strength,
            placement: motion.placement().map(to_middle),
            zoom: within(settings.zoom, 1.0, MAX_ZOOM, 1.0),
        }
    }

    /// The intervals to the reference, one per row of nodes, or per column if the sensor is read by columns.
    pub fn intervals(&self, x: &Nodes, y: &Nodes, intervals: &mut Vec<IntervalMotion>) {
        let axis = if self.readout.direction.is_by_rows() { y } else { x };
        intervals.clear();
        intervals.extend((0..axis.count).map(|index| self.interval(axis.at(index), axis.at(index))));
    }

    /// The interval to the reference from a pixel of the frame.
    fn interval(&self, x: f64, y: f64) -> IntervalMotion {
        self.path.over(self.readout.share(x, y), self.reference)
    }

    /// The same from a point of the frame (centred pixels).
    pub fn interval_at(&self, point: Vector2<f64>) -> IntervalMotion {
        let pixel = point + self.centre;
        self.interval(pixel.x, pixel.y)
    }

    /// Displacement of a point of the frame (centred pixels), before the zoom: finite, and at most one and
    /// a half frames.
    pub fn displacement(&self, interval: &IntervalMotion, point: Vector2<f64>) -> Vector2<f64> {
        self.applied(point, self.path.carry_by(interval, point))
    }

    /// The same of a point with the x of [`velocities`](Self::velocities).
    #[inline(always)]
    pub fn displacement_in(
        &self,
        velocities: &[Vector2<f64>],
        interval: &IntervalMotion,
        point: Vector2<f64>,
    ) -> Vector2<f64> {
        self.applied(point, self.path.carry_in(interval, point, velocities))
    }

    /// The velocities of the residual field at one x (centred pixels), which all points of a column share.
    #[inline(always)]
    pub fn velocities(&self, x: f64, velocities: &mut Vec<Vector2<f64>>) {
        if let Some(field) = self.path.residual() {
            field.column(x, velocities);
        }
    }

    /// The displacement of a point that the path carries to `carried`.
    #[inline(always)]
    fn applied(&self, point: Vector2<f64>, carried: Vector2<f64>) -> Vector2<f64> {
        let moved = self.strength * (carried - point);
        let moved = match &self.placement {
            Some((placement, share)) => {
                let rectified = point + moved;
                moved + *share * (project(placement, rectified) - rectified)
            }
            None => moved,
        };
        let bound = |value: f64, size: usize| within(value, -1.5 * size as f64, 1.5 * size as f64, 0.0);
        Vector2::new(bound(moved.x, self.readout.width), bound(moved.y, self.readout.height))
    }

    /// First and last pixel, in x and in y, of the part of the frame's plane that is visible within `output`
    /// (in the same form); at least `output`, and at most a frame more on each side.
    ///
    /// Each edge is moved outwards by the distance by which it appears inside the output's edge, and again,
    /// as points farther out have larger displacements.
    pub fn visible(&self, output: &[[f64; 2]; 2]) -> [[f64; 2]; 2] {
        let size = self.centre * 2.0 + Vector2::repeat(1.0);
        let mut visible = *output;
        for _ in 0..EDGE_ROUNDS {
            let inside = [0, 1].map(|axis| [0, 1].map(|end| self.inside(&visible, output, axis, end)));
            for axis in [0, 1] {
                visible[axis][0] = (visible[axis][0] - inside[axis][0]).max(output[axis][0] - size[axis]);
                visible[axis][1] = (visible[axis][1] + inside[axis][1]).min(output[axis][1] + size[axis]);
            }
        }
        visible
    }

    /// Largest distance by which one edge of `visible` appears inside the output's edge; at least 0.
    fn inside(&self, visible: &[[f64; 2]; 2], output: &[[f64; 2]; 2], axis: usize, end: usize) -> f64 {
        let [from, to] = visible[1 - axis];
        let edge = (output[axis][end] - self.centre[axis]) / self.zoom;
        let inwards = if end == 0 { 1.0 } else { -1.0 };
        (0..=EDGE_SAMPLES).fold(0.0, |most, sample| {
            let mut pixel = Vector2::repeat(visible[axis][end]);
            pixel[1 - axis] = from + (to - from) * sample as f64 / EDGE_SAMPLES as f64;
            let point = pixel - self.centre;
            let shown = point + self.displacement(&self.interval(pixel.x, pixel.y), point);
            most.max(inwards * (shown[axis] - edge))
        })
    }
}

/// `value` clamped to bounds; `otherwise` if it is NaN.
#[inline(always)]
pub(super) fn within(value: f64, low: f64, high: f64, otherwise: f64) -> f64 {
    if value.is_nan() { otherwise } else { value.clamp(low, high) }
}
