// SPDX-License-Identifier: MIT OR Apache-2.0

//! By how many pixels rectifying a frame moves what it shows, without what steadying and cropping do besides.

use rsrectify::motion::{FrameMotion, image_centre};
use rsrectify::nalgebra::Vector2;

/// Intervals along each side of the frame between the points at which the largest displacement is sought: a path bends far less
/// within one, and so do residual velocities, whose cells are of this order.
const INTERVALS: usize = 16;
/// Pixels by which a frame must be corrected for any sample to change: positions are rounded to 1/2048 pixel.
pub const LEAST: f64 = 0.5 / 2048.0;

/// The displacement of what the frame shows at a pixel to where it is at the instant of `reference`, a share of the readout.
pub fn at(motion: &FrameMotion, pixel: Vector2<f64>, reference: f64) -> Vector2<f64> {
    let readout = motion.readout();
    let point = pixel - image_centre(readout.width(), readout.height());
    let moved = motion.path().carry(point, readout.share(pixel.x, pixel.y), reference);
    let moved = (moved - point) * motion.weight();
    if moved.iter().all(|coordinate| coordinate.is_finite()) { moved } else { Vector2::zeros() }
}

/// The largest displacement within the frame, in pixels.
pub fn largest(motion: &FrameMotion, reference: f64) -> f64 {
    if motion.weight() == 0.0 || motion.path().is_still() {
        return 0.0;
    }
    let size = [motion.readout().width(), motion.readout().height()].map(|side| side as f64 - 1.0);
    let along = |index: usize, axis: usize| size[axis] * index as f64 / INTERVALS as f64;
    let points = (0..=INTERVALS).flat_map(|row| (0..=INTERVALS).map(move |column| (column, row)));
    let lengths = points
        .map(|(column, row)| at(motion, Vector2::new(along(column, 0), along(row, 1)), reference).norm());
    lengths.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rsrectify::motion::{MotionPath, Twist};
    use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};

    #[test]
    fn each_row_is_taken_to_the_middle_of_the_readout() {
        // 200 px/s to the right over a readout of 20 ms: the first row is 2 px behind, the last 2 px ahead.
        let readout =
            Readout::new(80, 60, ReadoutDirection::TopToBottom, ReadoutTime::Seconds(0.02), 0.04).unwrap();
        let path = MotionPath::uniform(Twist::new(0.0, 200.0, 0.0), 0.02);
        let motion = FrameMotion::new(readout, path);
        for (row, shift) in [(-0.5, 2.0), (29.5, 0.0), (59.5, -2.0)] {
            let moved = at(&motion, Vector2::new(10.0, row), 0.5);
            assert!((moved - Vector2::new(shift, 0.0)).norm() < 1e-9, "{row}: {moved}");
        }
        let half = at(&motion.clone().with_weight(0.5), Vector2::new(10.0, -0.5), 0.5);
        assert!((half - Vector2::new(1.0, 0.0)).norm() < 1e-9);
        // The middles of the first and the last row are half a row further in; from the first row on it is all of the last.
        assert!((largest(&motion, 0.5) - 2.0 * 59.0 / 60.0).abs() < 1e-9);
        assert!((largest(&motion, 0.0) - 4.0 * 59.5 / 60.0).abs() < 1e-9);
        assert_eq!(largest(&motion.with_weight(0.0), 0.5), 0.0);
    }
}
