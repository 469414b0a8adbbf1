// SPDX-License-Identifier: MIT OR Apache-2.0

//! Calibrated 3D rotation and translation in front of a wall.
//!
//! The full model of P.-E. Forssén and E. Ringaby, *Rectifying rolling shutter video from hand-held
//! devices*, CVPR 2010. A small turn looks nearly like a small sideways step: what tells them apart
//! is of second order in the image coordinates, and parallax drowns it. As in the source, nothing
//! but the shortness of the window keeps the fit in check.

use super::knots::Motion;
use super::rotation3d::slerp;
use super::translation3d::shift;
use nalgebra::Matrix3;

/// M(t) = R(t) D(t); a knot is a rotation vector and a displacement.
#[derive(Clone, Copy, Debug)]
pub struct Full3d;

impl Motion for Full3d {
    const NAME: &'static str = "3d-full";
    const FREEDOMS: usize = 6;

    fn between(first: &[f64], second: &[f64], share: f64) -> Matrix3<f64> {
        slerp(&first[..3], &second[..3], share) * shift(&first[3..], &second[3..], share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::Method;
    use crate::methods::knots::Knotted;
    use crate::methods::wall::Wall;
    use nalgebra::Vector3;
    use render::scene::FirstEdge;

    #[test]
    fn constant_turns_and_moves_are_undone() {
        let walls = [
            Wall::turning(FirstEdge::Top, 0.8, Vector3::new(0.8, 0.0, 0.0)),
            Wall::turning(FirstEdge::Bottom, 0.8, Vector3::new(0.3, -0.7, 1.0)),
            Wall::moving(FirstEdge::Top, 0.8, Vector3::new(1.5, 0.0, 0.0)),
            Wall::moving(FirstEdge::Left, 0.8, Vector3::new(-0.4, 0.5, 2.0)),
        ];
        for (index, wall) in walls.iter().enumerate() {
            for method in [Knotted::<Full3d>::new(2, 0), Knotted::new(2, 1)] {
                let left = wall.most_left(&method, 3);
                assert!(left < 0.05, "{} {index}: {left} px", method.name());
            }
        }
    }
}
