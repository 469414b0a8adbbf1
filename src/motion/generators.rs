// SPDX-License-Identifier: MIT OR Apache-2.0

//! The generators of image motions: velocity fields that together span the homographies.
//!
//! Points are in units of the radius R, half the frame's width, from the image centre, (u, v); a generator's rate is in
//! pixels, so that a rate of 1 moves points at the radius by about a pixel.
//!
//! | generator | field | camera motion |
//! |---|---|---|
//! | yaw | (1 + κu², κuv) | rotation about the vertical axis |
//! | pitch | (κuv, 1 + κv²) | rotation about the horizontal axis |
//! | roll | (−v, u) | rotation about the optical axis |
//! | right, down | (1, 0), (0, 1) | translation parallel to a frontal plane |
//! | scale | (u, v) | translation towards a frontal plane |
//! | stretch, shear | (u, −v), (v, u) | translation before a slanted plane |
//!
//! κ = (R/f)², R half the frame's width and f the focal length. With κ = 0 yaw and pitch are translations.

use nalgebra::{Matrix3, SMatrix, Vector2};

/// Number of generators.
pub const GENERATORS: usize = 8;
/// Number of rotation generators, which come first. Elsewhere they differ from the others in three things: their
/// effect does not depend on depth (`linear/residual.rs`, `normal.rs`); their paths have `RATIO` knots a block,
/// not one (`trajectory/splines.rs`); their prior has a start variance, a variance of the rate and, in
/// vibrations, a prediction of its own (`prior/smoothness.rs`).
pub const TURNS: usize = 3;

/// The image motions that are estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Model {
    /// All generators; their variances are estimated from the picture.
    #[default]
    Auto,
    /// Translation of the picture.
    Translation,
    /// Rotation and translation of the picture: the paper's model.
    Rotation,
    /// Rotation, translation and scale.
    Similarity,
    /// Rotation, translation, scale and shears.
    Affine,
    /// All eight generators.
    Homography,
    /// Rotation of the camera about its centre.
    Rotation3d,
}

impl Model {
    /// Which generators the model has.
    pub(crate) const fn generators(self) -> [bool; GENERATORS] {
        match self {
            Self::Translation => [true, true, false, false, false, false, false, false],
            Self::Rotation | Self::Rotation3d => [true, true, true, false, false, false, false, false],
            Self::Similarity => [true, true, true, false, false, true, false, false],
            Self::Affine => [true, true, true, false, false, true, true, true],
            Self::Auto | Self::Homography => [true; GENERATORS],
        }
    }

    /// Whether yaw and pitch depend on the focal length (κ > 0).
    pub const fn has_perspective(self) -> bool {
        matches!(self, Self::Auto | Self::Homography | Self::Rotation3d)
    }
}

/// The velocity fields of the generators at a point: their components in x, and in y.
#[inline(always)]
pub fn field_rows(point: Vector2<f64>, kappa: f64) -> [[f64; GENERATORS]; 2] {
    let (u, v) = (point.x, point.y);
    let across = kappa * u * v;
    [
        [1.0 + kappa * u * u, across, -v, 1.0, 0.0, u, u, v],
        [across, 1.0 + kappa * v * v, u, 0.0, 1.0, v, -v, u],
    ]
}

/// The same as a matrix, with a column for each generator.
#[inline(always)]
pub fn fields(point: Vector2<f64>, kappa: f64) -> SMatrix<f64, 2, GENERATORS> {
    SMatrix::from_row_slice(field_rows(point, kappa).as_flattened())
}

/// The velocity at a point by the turns, and by the other generators: the sums of their fields times `rates`.
#[inline(always)]
pub fn velocities(point: Vector2<f64>, kappa: f64, rates: &[f64; GENERATORS]) -> [Vector2<f64>; 2] {
    let (u, v) = (point.x, point.y);
    let [yaw, pitch, roll, right, down, scale, stretch, shear] = *rates;
    let bent = kappa * (u * yaw + v * pitch);
    [
        Vector2::new(yaw + u * bent - v * roll, pitch + v * bent + u * roll),
        Vector2::new(right + u * (scale + stretch) + v * shear, down + v * (scale - stretch) + u * shear),
    ]
}

/// The matrix A of the flow ẋ = A·x on homogeneous points (u, v, 1) whose velocity is the sum of
/// the fields times `rates`, in units of the radius.
pub fn flow_matrix(rates: &[f64; GENERATORS], kappa: f64) -> Matrix3<f64> {
    let [yaw, pitch, roll, right, down, scale, stretch, shear] = *rates;
    Matrix3::new(
        scale + stretch,
        shear - roll,
        yaw + right,
        shear + roll,
        scale - stretch,
        pitch + down,
        -kappa * yaw,
        -kappa * pitch,
        0.0,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_matrix_moves_points_by_the_fields() {
        let rates = [0.3, -0.2, 0.5, 0.7, -0.4, 0.1, 0.6, -0.8];
        let (kappa, x) = (0.4, Vector2::new(0.6, -0.9));
        let matrix = flow_matrix(&rates, kappa);
        // (A·x) is the velocity of the homogeneous point; the image point is its quotient.
        let velocity = matrix * x.push(1.0);
        let seen = velocity.xy() - x * velocity.z;
        let expected = fields(x, kappa) * SMatrix::<f64, GENERATORS, 1>::from(rates);
        assert!((seen - expected).norm() < 1e-12, "{seen} {expected}");
        let [by_turns, by_others] = velocities(x, kappa, &rates);
        let turns = fields(x, kappa).fixed_columns::<TURNS>(0)
            * SMatrix::<f64, TURNS, 1>::from_row_slice(&rates[..TURNS]);
        assert!((by_turns - turns).norm() < 1e-12 && (by_turns + by_others - expected).norm() < 1e-12);
    }

    #[test]
    fn rotation_generators_match_a_rotating_camera() {
        use nalgebra::{Rotation3, Vector3};
        // R = 1, f = 2: a point at (u, v) is seen along (u, v, f).
        let (focal, x) = (2.0, Vector2::new(0.7, -0.4));
        let see = |turn: Vector3<f64>| {
            let ray = Rotation3::new(turn) * Vector3::new(x.x, x.y, focal);
            ray.xy() * (focal / ray.z)
        };
        let step = 1e-6;
        let turns =
            [Vector3::new(0.0, 1.0, 0.0), Vector3::new(-1.0, 0.0, 0.0), Vector3::new(0.0, 0.0, focal)];
        for (j, turn) in turns.into_iter().enumerate() {
            let velocity = (see(turn * step) - see(-turn * step)) / (2.0 * step * focal);
            let field = fields(x, 1.0 / (focal * focal)).column(j).into_owned();
            assert!((velocity - field).norm() < 1e-8, "{j}: {velocity} {field}");
        }
    }
}
