// SPDX-License-Identifier: MIT OR Apache-2.0

//! By how many pixels a frame's rectification moves what it shows, without stabilisation and crop.

use super::{FrameMotion, image_centre};
use nalgebra::Vector2;

/// Intervals along each side of the frame between the points at which the largest displacement is sought: a path bends far less
/// within one, and so do residual velocities, whose cells are of this order.
const INTERVALS: usize = 16;

impl FrameMotion {
    /// Pixels by which a frame must be corrected for any sample to change: the warp rounds positions to 1/2048 px.
    pub const MIN_DISPLACEMENT: f64 = 0.5 / 2048.0;

    /// Centre of the picture in pixels of the frame: the origin of centred points.
    #[must_use]
    pub fn centre(&self) -> Vector2<f64> {
        let [x, y] = self.area().origin().map(|at| at as f64);
        image_centre(self.readout().width(), self.readout().height()) + Vector2::new(x, y)
    }

    /// Share of the readout that has elapsed where a pixel of the frame is exposed; beside the picture, as if it went on there.
    #[must_use]
    pub fn share(&self, pixel: Vector2<f64>) -> f64 {
        let [x, y] = self.area().origin().map(|at| at as f64);
        self.readout().share(pixel.x - x, pixel.y - y)
    }

    /// The displacement of what the frame shows at `pixel` (pixel centres at integers) to where it is at the instant
    /// `reference`, a share of the readout, in pixels; 0 where the path has none that is finite.
    #[must_use]
    pub fn displacement(&self, pixel: Vector2<f64>, reference: f64) -> Vector2<f64> {
        let point = pixel - self.centre();
        let moved = self.path().carry(point, self.share(pixel), reference);
        let moved = (moved - point) * self.weight();
        if moved.iter().all(|coordinate| coordinate.is_finite()) { moved } else { Vector2::zeros() }
    }

    /// The largest [displacement](Self::displacement) within the frame, in pixels, of 17 × 17 points.
    #[must_use]
    pub fn largest_displacement(&self, reference: f64) -> f64 {
        self.displacements(reference).fold(0.0, f64::max)
    }

    /// Whether no sample of the frame changes where it is rectified to the instant `reference`.
    pub(crate) fn corrects_nothing(&self, reference: f64) -> bool {
        self.displacements(reference).all(|length| length < Self::MIN_DISPLACEMENT)
    }

    /// Lengths of the displacements of points that cover the frame; none where nothing is corrected.
    fn displacements(&self, reference: f64) -> impl Iterator<Item = f64> + '_ {
        let rows = if self.weight() == 0.0 || self.path().is_still() { 0 } else { INTERVALS + 1 };
        let size = [self.readout().width(), self.readout().height()].map(|side| side as f64 - 1.0);
        let origin = self.area().origin().map(|at| at as f64);
        let along =
            move |index: usize, axis: usize| origin[axis] + size[axis] * index as f64 / INTERVALS as f64;
        let points = (0..rows).flat_map(|row| (0..=INTERVALS).map(move |column| (column, row)));
        points.map(move |(column, row)| {
            self.displacement(Vector2::new(along(column, 0), along(row, 1)), reference).norm()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{MotionPath, Twist};
    use crate::readout::{Readout, ReadoutDirection, ReadoutTime};

    #[test]
    fn each_row_is_taken_to_the_middle_of_the_readout() {
        // 200 px/s to the right over a readout of 20 ms: the first row is 2 px behind, the last 2 px ahead.
        let readout =
            Readout::new(80, 60, ReadoutDirection::TopToBottom, ReadoutTime::Seconds(0.02), 0.04).unwrap();
        let path = MotionPath::uniform(Twist::new(0.0, 200.0, 0.0), 0.02);
        let motion = FrameMotion::new(readout, path);
        for (row, shift) in [(-0.5, 2.0), (29.5, 0.0), (59.5, -2.0)] {
            let moved = motion.displacement(Vector2::new(10.0, row), 0.5);
            assert!((moved - Vector2::new(shift, 0.0)).norm() < 1e-9, "{row}: {moved}");
        }
        let half = motion.clone().with_weight(0.5).displacement(Vector2::new(10.0, -0.5), 0.5);
        assert!((half - Vector2::new(1.0, 0.0)).norm() < 1e-9);
        // The middles of the first and the last row are half a row further in; from the first row on it is all of the last.
        assert!((motion.largest_displacement(0.5) - 2.0 * 59.0 / 60.0).abs() < 1e-9);
        assert!((motion.largest_displacement(0.0) - 4.0 * 59.5 / 60.0).abs() < 1e-9);
        assert!(!motion.corrects_nothing(0.5));
        let without = motion.with_weight(0.0);
        assert_eq!(without.largest_displacement(0.5), 0.0);
        assert!(without.corrects_nothing(0.5));
    }
}
