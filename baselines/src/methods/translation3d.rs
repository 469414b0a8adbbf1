// SPDX-License-Identifier: MIT OR Apache-2.0

//! Calibrated 3D translation in front of a wall.
//!
//! The translational model of P.-E. Forssén and E. Ringaby, *Rectifying rolling shutter video from
//! hand-held devices*, CVPR 2010: the scene is a plane that faces the camera at depth 1, the
//! camera's displacement is interpolated linearly between knots.

use super::knots::Motion;
use nalgebra::Matrix3;

/// M(t) = D(t); a knot is a displacement of the scene in units of its depth.
#[derive(Clone, Copy, Debug)]
pub struct Translation3d;

impl Motion for Translation3d {
    const NAME: &'static str = "3d-translation";
    const FREEDOMS: usize = 3;

    fn between(first: &[f64], second: &[f64], share: f64) -> Matrix3<f64> {
        shift(first, second, share)
    }
}

/// D = [1 0 d₁; 0 1 d₂; 0 0 1 + d₃], which takes (X, Y, 1) to (X, Y, 1) + d, linear between knots.
pub(super) fn shift(first: &[f64], second: &[f64], share: f64) -> Matrix3<f64> {
    let d = |axis: usize| first[axis] + (second[axis] - first[axis]) * share;
    Matrix3::new(1.0, 0.0, d(0), 0.0, 1.0, d(1), 0.0, 0.0, 1.0 + d(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::knots::Knotted;
    use crate::methods::wall::Wall;
    use nalgebra::Vector3;
    use render::scene::FirstEdge;

    #[test]
    fn a_constant_move_past_a_wall_is_undone() {
        let moves = [
            (FirstEdge::Top, Vector3::new(1.5, 0.0, 0.0)),
            (FirstEdge::Bottom, Vector3::new(0.7, -1.0, 0.0)),
            (FirstEdge::Right, Vector3::new(-0.4, 0.5, 2.0)),
        ];
        for (first, velocity) in moves {
            let left = Wall::moving(first, 0.7, velocity).most_left(&Knotted::<Translation3d>::new(3, 1), 4);
            assert!(left < 1e-3, "{first:?}: {left} px");
        }
    }
}
