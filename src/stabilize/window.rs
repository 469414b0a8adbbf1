// SPDX-License-Identifier: MIT OR Apache-2.0

//! How far the shown window may move before it leaves the picture.

use super::logarithm::{Coordinates, exponential};
use crate::motion::{FrameMotion, image_centre, project};
use nalgebra::{Matrix3, Vector2};

/// Points along each edge of the picture.
const POINTS: usize = 9;
/// Pixels at each edge that count as border: the widest interpolation takes so many beside the one shown.
const TAPS: f64 = 3.0;

/// The edges of a frame where they come to lie after its rectification, in radii.
#[derive(Clone, Debug)]
pub struct Edges {
    /// Left, right, top, bottom.
    points: [[Vector2<f64>; POINTS]; 4],
    /// Half the frame's size.
    half: [f64; 2],
    /// How far they come into the picture where the frame is not moved.
    pub rest: f64,
}

impl Edges {
    /// Of a frame that is rectified by this motion; `radius` in pixels.
    pub fn new(motion: &FrameMotion, radius: f64) -> Self {
        let readout = motion.readout();
        let [width, height] = [readout.width(), readout.height()];
        let centre = image_centre(width, height);
        let rectified = |pixel: Vector2<f64>| {
            let point = pixel - centre;
            let carried = motion.path().carry(point, readout.share(pixel.x, pixel.y), 0.5);
            let moved = point + (carried - point) * motion.weight();
            (if moved.iter().all(|value| value.is_finite()) { moved } else { point }) / radius
        };
        let near = centre.map(|half| TAPS.min(half));
        let far = centre * 2.0 - near;
        let between = |axis: usize, index: usize| {
            near[axis] + (far[axis] - near[axis]) * index as f64 / (POINTS - 1) as f64
        };
        let points = [
            std::array::from_fn(|index| rectified(Vector2::new(near.x, between(1, index)))),
            std::array::from_fn(|index| rectified(Vector2::new(far.x, between(1, index)))),
            std::array::from_fn(|index| rectified(Vector2::new(between(0, index), near.y))),
            std::array::from_fn(|index| rectified(Vector2::new(between(0, index), far.y))),
        ];
        let edges = Self { points, half: [centre.x / radius, centre.y / radius], rest: 0.0 };
        Self { rest: edges.inside(&Matrix3::identity()), ..edges }
    }

    /// How far an edge comes into the picture where the frame is moved by a homography, as a share of the frame's width or
    /// height; negative where all edges lie outside.
    pub fn inside(&self, placement: &Matrix3<f64>) -> f64 {
        let side = |(side, points): (usize, &[Vector2<f64>; POINTS])| {
            let (axis, outwards) = across(side);
            let length = self.length(axis);
            let inside = |point: &Vector2<f64>| 0.5 - outwards * project(placement, *point)[axis] / length;
            points.iter().map(inside).fold(f64::NEG_INFINITY, f64::max)
        };
        self.points.iter().enumerate().map(side).fold(f64::NEG_INFINITY, f64::max)
    }

    /// For each point of the edges, where the frame is moved by a homography: by how much it comes into the picture farther
    /// than `most`, a share of the frame's width or height, in radii, and how far outwards each coordinate of a further motion
    /// takes it.
    pub fn beyond(&self, placement: &Matrix3<f64>, most: f64) -> impl Iterator<Item = (f64, Coordinates)> {
        self.points.iter().enumerate().flat_map(move |(side, points)| {
            let (axis, outwards) = across(side);
            let limit = self.length(axis) * (0.5 - most);
            points.iter().map(move |point| {
                let shown = project(placement, *point);
                let mut moved = Coordinates::zeros();
                moved.fixed_rows_mut::<3>(3 * axis).copy_from(&shown.push(1.0));
                moved.fixed_rows_mut::<2>(6).copy_from(&(shown * -shown[axis]));
                (limit - outwards * shown[axis], moved * outwards)
            })
        })
    }

    /// The frame's width or height, in radii.
    fn length(&self, axis: usize) -> f64 {
        2.0 * self.half.get(axis).copied().unwrap_or(1.0).max(f64::MIN_POSITIVE)
    }

    /// The same of logarithmic coordinates.
    pub fn inside_by(&self, offset: &Coordinates) -> f64 {
        self.inside(&exponential(offset))
    }
}

/// The axis across a side, and which way is outwards.
const fn across(side: usize) -> (usize, f64) {
    (side / 2, if side.is_multiple_of(2) { -1.0 } else { 1.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{MotionPath, Twist};
    use crate::readout::{Readout, ReadoutDirection, ReadoutTime};

    fn edges(velocity: f64) -> Edges {
        let readout =
            Readout::new(641, 481, ReadoutDirection::TopToBottom, ReadoutTime::WholePeriod, 1.0).unwrap();
        let path = MotionPath::uniform(Twist::new(0.0, velocity, 0.0), 1.0);
        Edges::new(&FrameMotion::new(readout, path), 320.0)
    }

    fn shifted(x: f64, y: f64) -> Matrix3<f64> {
        Matrix3::new(1.0, 0.0, x / 320.0, 0.0, 1.0, y / 320.0, 0.0, 0.0, 1.0)
    }

    #[test]
    fn edges_move_with_the_frame() {
        let still = edges(0.0);
        // Three pixels count as border.
        assert!((still.rest - 3.0 / 480.0).abs() < 1e-12);
        for (x, y, expected) in [(61.0, 0.0, 0.1), (-61.0, 12.0, 0.1), (0.0, -45.0, 0.1)] {
            let found = still.inside(&shifted(x, y));
            assert!((found - expected).abs() < 1e-9, "{x} {y}: {found}");
        }
        let zoomed = Matrix3::from_diagonal(&nalgebra::vector![1.2, 1.2, 1.0]);
        assert!((still.inside(&zoomed) - (240.0 - 1.2 * 237.0) / 480.0).abs() < 1e-9);
    }

    #[test]
    fn rectification_counts_too() {
        // The first row but three moves by half of 64 px, less three and a half rows, and three pixels are border.
        let found = edges(64.0).inside(&Matrix3::identity());
        assert!((found - 35.0 / 640.0).abs() < 1e-3, "{found}");
    }

    #[test]
    fn how_far_a_point_is_beyond_changes_as_its_coordinates_say() {
        let still = edges(0.0);
        let at = exponential(&Coordinates::from([0.02, -0.1, 0.1, 0.1, 0.03, -0.05, 0.04, -0.02]));
        let change = Coordinates::from([2.0, -3.0, 4.0, 1.0, -1.0, 2.0, 3.0, 5.0]) * 1e-6;
        let later = exponential(&change) * at;
        let pairs = still.beyond(&at, 0.1).zip(still.beyond(&later, 0.1));
        for ((before, outwards), (after, _)) in pairs {
            assert!((before - after - outwards.dot(&change)).abs() < 1e-9, "{before} {after}");
        }
        let aside = shifted(61.0, 0.0);
        let most = still.beyond(&aside, 0.05).map(|(beyond, _)| beyond);
        // A tenth of the width, of which the half is too far.
        assert!((most.fold(f64::NEG_INFINITY, f64::max) - 0.05 * 2.0).abs() < 1e-2);
    }
}
