// SPDX-License-Identifier: MIT OR Apache-2.0

//! Homographies as exponentials of velocity fields.
//!
//! The homographies near the identity are exp(A), A = Σⱼ aⱼ·Gⱼ over eight generators: shift (2), roll, zoom, two shears and two
//! tilts. Where motions are small, those of successive intervals add up in these *logarithmic coordinates*.

use nalgebra::{Matrix3, SVector};

/// Logarithmic coordinates: the elements, row by row, of the matrix A whose last element is 0.
pub type Coordinates = SVector<f64, 8>;

/// Halvings of the coordinates before the exponential series: up to a motion of 4 its terms from the sixth on are below 10⁻⁹.
const HALVINGS: i32 = 6;

/// The homography of logarithmic coordinates, at unit time.
pub fn exponential(coordinates: &Coordinates) -> Matrix3<f64> {
    let c = coordinates * 0.5_f64.powi(HALVINGS);
    let a = Matrix3::new(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], 0.0);
    let a2 = a * a;
    let mut power = Matrix3::identity() + a + a2 / 2.0 + a2 * a / 6.0 + a2 * a2 / 24.0 + a2 * a2 * a / 120.0;
    for _ in 0..HALVINGS {
        power *= power;
    }
    power
}

/// Logarithmic coordinates of a homography; `None` where it is too far from the identity (a turn of a right angle, a shift by
/// more than the radius at once) or not finite.
///
/// By log X = 2·(Z + Z³/3 + Z⁵/5 + …), Z = (X − 1)·(X + 1)⁻¹; the scale of X is that of determinant 1.
pub fn logarithm(homography: &Matrix3<f64>) -> Option<Coordinates> {
    let determinant = homography.determinant();
    if !(determinant.is_finite() && determinant > 0.0) {
        return None;
    }
    let x = homography / determinant.cbrt();
    let identity = Matrix3::identity();
    let z = (x - identity) * (x + identity).try_inverse()?;
    if z.norm() > 1.0 {
        return None;
    }
    let z2 = z * z;
    // Horner's scheme; the first term left out is below 10⁻⁹ for |Z| = 0.4.
    let sum = (0..=11).rev().fold(Matrix3::zeros(), |sum, k| sum * z2 + identity / f64::from(2 * k + 1));
    let a = z * sum * 2.0;
    // A multiple of the identity is the scale of the homography.
    let a = a - identity * a[(2, 2)];
    let coordinates = Coordinates::from_fn(|index, _| a[(index / 3, index % 3)]);
    coordinates.iter().all(|value| value.is_finite()).then_some(coordinates)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3, matrix};

    #[test]
    fn a_roll_and_a_zoom_are_their_angle_and_logarithm() {
        let (sin, cos) = 0.3_f64.sin_cos();
        let motion = matrix![cos, -sin, 0.0; sin, cos, 0.0; 0.0, 0.0, 1.0 / 1.2];
        let found = logarithm(&motion).unwrap();
        let expected = Coordinates::from([1.2_f64.ln(), -0.3, 0.0, 0.3, 1.2_f64.ln(), 0.0, 0.0, 0.0]);
        assert!((found - expected).norm() < 1e-9, "{found}");
    }

    #[test]
    fn half_of_a_turn_is_the_turn_by_half_the_angle() {
        let turn = |share: f64| {
            let f = 1.8;
            let k = Matrix3::from_diagonal(&Vector3::new(f, f, 1.0));
            k * Rotation3::new(Vector3::new(0.11, -0.3, 0.2) * share).matrix() * k.try_inverse().unwrap()
        };
        let half = exponential(&(logarithm(&turn(1.0)).unwrap() / 2.0));
        let difference = half / half[(2, 2)] - turn(0.5) / turn(0.5)[(2, 2)];
        assert!(difference.norm() < 1e-9, "{difference}");
    }

    #[test]
    fn what_has_no_logarithm_is_refused() {
        let mirrored = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
        let half_turn = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
        for bad in
            [Matrix3::zeros(), Matrix3::repeat(f64::NAN), mirrored, half_turn, Matrix3::repeat(f64::MAX)]
        {
            assert_eq!(logarithm(&bad), None, "{bad}");
        }
    }
}
