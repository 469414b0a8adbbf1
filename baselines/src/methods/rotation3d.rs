// SPDX-License-Identifier: MIT OR Apache-2.0

//! Calibrated 3D rotation: a camera that turns about its centre.
//!
//! P.-E. Forssén and E. Ringaby, *Rectifying rolling shutter video from hand-held devices*, CVPR 2010,
//! and IJCV 96(3), 2012: rotations at knots, spherical linear interpolation between them.

use super::knots::Motion;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// M(t) = R(t); a knot is a rotation vector in radians.
#[derive(Clone, Copy, Debug)]
pub struct Rotation3d;

impl Motion for Rotation3d {
    const NAME: &'static str = "3d-rotation";
    const FREEDOMS: usize = 3;

    fn between(first: &[f64], second: &[f64], share: f64) -> Matrix3<f64> {
        slerp(first, second, share)
    }
}

/// Spherical linear interpolation between two rotation vectors.
pub(super) fn slerp(first: &[f64], second: &[f64], share: f64) -> Matrix3<f64> {
    let rotation = |knot: &[f64]| UnitQuaternion::from_scaled_axis(Vector3::new(knot[0], knot[1], knot[2]));
    let (first, second) = (rotation(first), rotation(second));
    let turn = (second * first.inverse()).scaled_axis() * share;
    (UnitQuaternion::from_scaled_axis(turn) * first).to_rotation_matrix().into_inner()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::Method;
    use crate::methods::knots::Knotted;
    use crate::methods::wall::{PERIOD, Wall};
    use nalgebra::{Rotation3, Vector2};
    use render::scene::{FirstEdge, Pose};

    const CONSTANT: Knotted<Rotation3d> = Knotted::new(2, 0);
    const THREE_FRAMES: Knotted<Rotation3d> = Knotted::new(3, 1);
    const ALL: [Knotted<Rotation3d>; 3] = [CONSTANT, Knotted::new(2, 1), THREE_FRAMES];

    #[test]
    fn a_constant_turn_is_undone_about_any_axis() {
        let turns = [
            (FirstEdge::Top, Vector3::new(0.8, 0.0, 0.0)),
            (FirstEdge::Bottom, Vector3::new(0.3, -0.7, 1.0)),
            (FirstEdge::Left, Vector3::new(0.0, 0.0, 1.5)),
        ];
        for (first, velocity) in turns {
            for method in ALL {
                let left = Wall::turning(first, 0.8, velocity).most_left(&method, 4);
                assert!(left < 1e-3, "{} {first:?}: {left} px", method.name());
            }
        }
    }

    /// A turn about a tilted axis whose angular velocity changes when a frame starts.
    fn jerking() -> Wall {
        let axis = Vector3::new(0.3, 0.8, 0.5);
        Wall::new(FirstEdge::Top, 1.0, move |t: f64| {
            let frames = t / PERIOD;
            let angle = [0.04, -0.03, 0.05].iter().enumerate().map(|(k, turn)| {
                turn * if k == 2 { (frames - 2.0).max(0.0) } else { (frames - k as f64).clamp(0.0, 1.0) }
            });
            Pose { rotation: Rotation3::new(axis * angle.sum::<f64>()), position: Vector3::zeros() }
        })
    }

    #[test]
    fn knots_at_the_starts_of_frames_follow_a_turn_that_changes_there() {
        let wall = jerking();
        let knotted = wall.most_left(&THREE_FRAMES, 3);
        assert!(knotted < 1e-3, "{knotted} px");
        let constant = wall.most_left(&CONSTANT, 3);
        assert!(constant > 1.0, "{constant} px");
    }

    #[test]
    fn a_fifth_of_wild_correspondences_does_little_harm() {
        let wall = Wall::turning(FirstEdge::Top, 1.0, Vector3::new(0.5, 0.6, 0.7));
        let mut pairs = wall.pairs(3);
        for found in pairs.iter_mut().flat_map(|pair| pair.iter_mut().step_by(5)) {
            found.to += Vector2::new(30.0, -20.0);
        }
        for method in ALL {
            let (left, _) = wall.left(&method, &pairs);
            assert!(left.iter().all(|left| *left < 0.1), "{} {left:?}", method.name());
        }
    }

    #[test]
    fn a_frame_without_correspondences_is_left_as_it_is() {
        let wall = Wall::turning(FirstEdge::Top, 1.0, Vector3::new(0.5, 0.6, 0.7));
        let mut pairs = wall.pairs(4);
        pairs[2].clear();
        let (left, uncorrected) = wall.left(&CONSTANT, &pairs);
        assert!(left[0] < 1e-3 && left[1] < 1e-3, "{left:?}");
        assert!(left[2] > 0.9 * uncorrected && left[3] > 0.9 * uncorrected, "{left:?}");
    }

    #[test]
    fn a_global_shutter_leaves_nothing_to_correct() {
        let wall = Wall::turning(FirstEdge::Top, 0.0, Vector3::new(0.5, 0.6, 0.7));
        for method in ALL {
            let (left, _) = wall.left(&method, &wall.pairs(4));
            assert!(left.iter().all(|left| *left < 1e-6), "{} {left:?}", method.name());
        }
    }
}
