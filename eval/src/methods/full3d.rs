//! Calibrated 3D rotation and translation in front of a wall.
//!
//! The full model of P.-E. Forssén and E. Ringaby, *Rectifying rolling shutter video from hand-held
//! devices*, CVPR 2010. A small turn looks nearly like a small sideways step: what tells them apart
//! is of second order in the image coordinates, and parallax drowns it. As in the source, nothing
//! but the shortness of the window keeps the fit in check.

use super::knots::{self, Motion, Window};
use super::rotation3d::slerp;
use super::translation3d::shift;
use super::{Corrections, Input, Method};
use anyhow::Result;
use nalgebra::Matrix3;

/// The method, over a window of frames.
#[derive(Clone, Copy, Debug)]
pub struct Full3d(pub Window);

impl Full3d {
    /// Two frames, one angular and one linear velocity: 6 unknowns.
    pub const CONSTANT: Self = Self(Window { frames: 2, knots: 0 });
    /// Two frames with a knot at the start of each and at the end of the last: 12 unknowns.
    pub const TWO_FRAMES: Self = Self(Window { frames: 2, knots: 1 });
}

impl Method for Full3d {
    fn name(&self) -> String {
        self.0.name("3d-full")
    }

    fn solve(&self, input: &Input) -> Result<Corrections> {
        Ok(knots::solve::<Full>(self.0, input))
    }
}

/// M(t) = R(t) D(t); a knot is a rotation vector and a displacement.
#[derive(Clone)]
struct Full;

impl Motion for Full {
    const FREEDOMS: usize = 6;

    fn between(first: &[f64], second: &[f64], share: f64) -> Matrix3<f64> {
        slerp(&first[..3], &second[..3], share) * shift(&first[3..], &second[3..], share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::wall::Wall;
    use crate::scene::FirstEdge;
    use nalgebra::Vector3;

    #[test]
    fn constant_turns_and_moves_are_undone() {
        let walls = [
            Wall::turning(FirstEdge::Top, 0.8, Vector3::new(0.8, 0.0, 0.0)),
            Wall::turning(FirstEdge::Bottom, 0.8, Vector3::new(0.3, -0.7, 1.0)),
            Wall::moving(FirstEdge::Top, 0.8, Vector3::new(1.5, 0.0, 0.0)),
            Wall::moving(FirstEdge::Left, 0.8, Vector3::new(-0.4, 0.5, 2.0)),
        ];
        for (index, wall) in walls.iter().enumerate() {
            for method in [Full3d::CONSTANT, Full3d::TWO_FRAMES] {
                let left = wall.most_left(&method, 3);
                assert!(left < 0.05, "{} {index}: {left} px", method.name());
            }
        }
    }
}
