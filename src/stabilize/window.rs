// SPDX-License-Identifier: MIT OR Apache-2.0

//! How far the shown window may move before it leaves the picture.

use super::logarithm::{Coordinates, exponential};
use crate::motion::{FrameMotion, image_centre, project};
use nalgebra::{Matrix3, Vector2};

/// Projections onto the limits of edge points: each side meets its limit once or twice.
const PROJECTIONS: usize = 8;
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
            let (axis, outwards) = Self::side(side);
            let length = self.length(axis);
            let inside = |point: &Vector2<f64>| 0.5 - outwards * project(placement, *point)[axis] / length;
            points.iter().map(inside).fold(f64::NEG_INFINITY, f64::max)
        };
        self.points.iter().enumerate().map(side).fold(f64::NEG_INFINITY, f64::max)
    }

    /// The same of logarithmic coordinates.
    pub fn inside_by(&self, offset: &Coordinates) -> f64 {
        self.inside(&exponential(offset))
    }

    /// An offset near this one with which no edge comes in farther than `most`, a share of the frame's width or height, or hardly
    /// so; none where an edge does even if the frame is not moved.
    ///
    /// The limit of an edge point is a half-space of offsets, for how far the point moves is linear in a small offset: the
    /// offset is projected onto that of the point which is farthest beyond, again and again.
    pub fn nearest(&self, offset: &Coordinates, most: f64) -> Coordinates {
        if most <= self.rest || !offset.iter().all(|value| value.is_finite()) {
            return Coordinates::zeros();
        }
        let mut nearest = *offset;
        for _ in 0..PROJECTIONS {
            let (beyond, normal) = self.farthest_beyond(&exponential(&nearest), most);
            if beyond <= 0.0 {
                break;
            }
            nearest += normal * (beyond / normal.norm_squared());
        }
        nearest
    }

    /// By how much an edge point comes in farther than `most`, in radii, for the point where that is most, and how far an offset moves
    /// that point outwards, by coordinate.
    fn farthest_beyond(&self, placement: &Matrix3<f64>, most: f64) -> (f64, Coordinates) {
        let mut farthest = (f64::NEG_INFINITY, Coordinates::zeros());
        for (side, points) in self.points.iter().enumerate() {
            let (axis, outwards) = Self::side(side);
            let length = self.length(axis);
            for point in points {
                let shown = project(placement, *point);
                let beyond = length * (0.5 - most) - outwards * shown[axis];
                if beyond > farthest.0 {
                    let [x, y] = [shown.x, shown.y];
                    let mut normal = Coordinates::zeros();
                    normal.fixed_rows_mut::<3>(3 * axis).copy_from(&shown.push(1.0));
                    normal.fixed_rows_mut::<2>(6).copy_from(&(Vector2::new(x, y) * -shown[axis]));
                    farthest = (beyond, normal * outwards);
                }
            }
        }
        farthest
    }

    /// The axis across a side, and which way is outwards.
    const fn side(side: usize) -> (usize, f64) {
        (side / 2, if side.is_multiple_of(2) { -1.0 } else { 1.0 })
    }

    /// The frame's width or height, in radii.
    fn length(&self, axis: usize) -> f64 {
        2.0 * self.half.get(axis).copied().unwrap_or(1.0).max(f64::MIN_POSITIVE)
    }
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
    fn the_nearest_offset_within_a_limit_is_on_it() {
        let still = edges(0.0);
        for offset in [
            [0.01, -0.02, 0.3, 0.02, 0.01, -0.25, 0.0, 0.0],
            [-0.3, 0.1, 0.1, -0.1, -0.3, 0.0, 0.05, -0.02],
            [0.0, 0.3, 0.0, -0.3, 0.0, 0.0, 0.0, 0.0],
        ] {
            let offset = Coordinates::from(offset);
            let nearest = still.nearest(&offset, 0.1);
            // The last one turns by 17°, which is not small.
            assert!((still.inside_by(&nearest) - 0.1).abs() < 0.02, "{}", still.inside_by(&nearest));
            // No farther away than what is left by scaling.
            let scaled = (1..100).map(|k| offset * (f64::from(k) / 100.0));
            let scaled = scaled.rev().find(|scaled| still.inside_by(scaled) <= 0.1).unwrap();
            assert!((nearest - offset).norm() < (scaled - offset).norm());
            let small = offset * 0.05;
            assert_eq!(still.nearest(&small, 0.1), small);
        }
        assert_eq!(still.nearest(&Coordinates::repeat(0.1), 0.005), Coordinates::zeros());
        assert_eq!(still.nearest(&Coordinates::repeat(f64::NAN), 0.1), Coordinates::zeros());
    }
}
