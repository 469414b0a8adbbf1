// SPDX-License-Identifier: MIT OR Apache-2.0

//! The twist: the 2D rotation of 25.2 in a parametrisation without singularities.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};

/// The velocity of a rigid image motion: a rotation by ω about c = (−v_y/ω, v_x/ω).
///
/// ω → 0 is a translation by (v_x, v_y), where the (θ, c_x, c_y) of 25.2 has its centre at
/// infinity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Angular velocity ω in rad/s; from the x axis towards the y axis.
    pub omega: f64,
    /// Velocity in px/s of the point at the image centre.
    pub velocity: Vector2<f64>,
}

impl Twist {
    /// No motion.
    pub const ZERO: Self = Self { omega: 0.0, velocity: Vector2::new(0.0, 0.0) };

    /// A twist from ω (rad/s) and v (px/s).
    #[must_use]
    pub const fn new(omega: f64, vx: f64, vy: f64) -> Self {
        Self { omega, velocity: Vector2::new(vx, vy) }
    }

    /// The rotation with ω (rad/s) about a fixed centre (centred pixels), as in 25.2.
    #[must_use]
    pub fn about(omega: f64, centre: Vector2<f64>) -> Self {
        Self::new(omega, omega * centre.y, -omega * centre.x)
    }

    /// The twist that rotates by `angle` and shifts the image centre by `shift` pixels in `time` seconds:
    /// the inverse of [`after`](Self::after).
    pub(super) fn between(angle: f64, shift: Vector2<f64>, time: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        let (along, across) = chord(angle, sin, cos);
        let turned = Vector2::new(along * shift.x + across * shift.y, along * shift.y - across * shift.x);
        let velocity = turned / ((along * along + across * across) * time);
        Self { omega: angle / time, velocity }
    }

    /// (ω, v_x, v_y) as a vector.
    #[must_use]
    pub fn to_vector(self) -> Vector3<f64> {
        Vector3::new(self.omega, self.velocity.x, self.velocity.y)
    }

    /// A twist from the vector (ω, v_x, v_y).
    #[must_use]
    pub fn from_vector(vector: Vector3<f64>) -> Self {
        Self::new(vector.x, vector.y, vector.z)
    }

    /// The centre of rotation in centred pixels; `None` for a pure translation.
    #[must_use]
    pub fn centre(&self) -> Option<Vector2<f64>> {
        let centre = Vector2::new(-self.velocity.y / self.omega, self.velocity.x / self.omega);
        (self.omega != 0.0 && centre.iter().all(|c| c.is_finite())).then_some(centre)
    }

    /// Whether all three numbers are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.to_vector().iter().all(|value| value.is_finite())
    }

    /// The motion after `time` seconds: f(x, ω·time, c) of 25.2.
    #[must_use]
    pub fn after(&self, time: f64) -> Rigid {
        let angle = self.omega * time;
        let (sin, cos) = angle.sin_cos();
        let (along, across) = chord(angle, sin, cos);
        let v = self.velocity * time;
        Rigid { cos, sin, shift: Vector2::new(along * v.x - across * v.y, across * v.x + along * v.y) }
    }

    /// The Jacobian ∂f(x, ω·time, c)/∂(ω, v_x, v_y) of the position of `point` (centred pixels) after
    /// `time` seconds.
    #[must_use]
    pub fn jacobian(&self, point: Vector2<f64>, time: f64) -> Matrix2x3<f64> {
        let angle = self.omega * time;
        let (sin, cos) = angle.sin_cos();
        let (along, across) = chord(angle, sin, cos);
        let (along_slope, across_slope) = chord_slope(angle, sin, cos);
        let v = self.velocity * time;
        let turn_x = -sin * point.x - cos * point.y + along_slope * v.x - across_slope * v.y;
        let turn_y = cos * point.x - sin * point.y + across_slope * v.x + along_slope * v.y;
        Matrix2x3::new(turn_x, along, -across, turn_y, across, along) * time
    }
}

/// sin(a)/a and (1 − cos(a))/a, by series for small a, where the quotients cancel.
fn chord(angle: f64, sin: f64, cos: f64) -> (f64, f64) {
    if angle.abs() < 1e-3 {
        let square = angle * angle;
        (1.0 - square / 6.0 * (1.0 - square / 20.0), angle / 2.0 * (1.0 - square / 12.0))
    } else {
        (sin / angle, (1.0 - cos) / angle)
    }
}

/// The derivatives of the two functions of [`chord`] with respect to the angle.
fn chord_slope(angle: f64, sin: f64, cos: f64) -> (f64, f64) {
    if angle.abs() < 1e-3 {
        let square = angle * angle;
        (-angle / 3.0 * (1.0 - square / 10.0), 0.5 * (1.0 - square / 4.0))
    } else {
        let (along, across) = chord(angle, sin, cos);
        ((cos - along) / angle, (sin - across) / angle)
    }
}

/// A rotation about the image centre followed by a shift: x ↦ R·x + shift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid {
    /// Cosine of the angle.
    pub cos: f64,
    /// Sine of the angle.
    pub sin: f64,
    /// Shift in pixels, after the rotation.
    pub shift: Vector2<f64>,
}

impl Rigid {
    /// The identity.
    pub const IDENTITY: Self = Self { cos: 1.0, sin: 0.0, shift: Vector2::new(0.0, 0.0) };

    /// The rotation R.
    #[must_use]
    pub fn rotation(&self) -> Matrix2<f64> {
        Matrix2::new(self.cos, -self.sin, self.sin, self.cos)
    }

    /// The motion as a homography.
    pub(crate) fn to_homogeneous(self) -> Matrix3<f64> {
        let Self { cos, sin, shift } = self;
        Matrix3::new(cos, -sin, shift.x, sin, cos, shift.y, 0.0, 0.0, 1.0)
    }

    /// Applies the motion to a point (centred pixels).
    #[must_use]
    pub fn apply(&self, point: Vector2<f64>) -> Vector2<f64> {
        Vector2::new(
            self.cos * point.x - self.sin * point.y + self.shift.x,
            self.sin * point.x + self.cos * point.y + self.shift.y,
        )
    }

    /// Applies the inverse motion to a point (centred pixels).
    #[must_use]
    pub fn apply_inverse(&self, point: Vector2<f64>) -> Vector2<f64> {
        let point = point - self.shift;
        Vector2::new(self.cos * point.x + self.sin * point.y, self.cos * point.y - self.sin * point.x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    /// 25.2 as printed.
    fn equation_2(x: Vector2<f64>, theta: f64, c: Vector2<f64>) -> Vector2<f64> {
        Matrix2::new(theta.cos(), -theta.sin(), theta.sin(), theta.cos()) * (x - c) + c
    }

    #[test]
    fn equals_equation_2() {
        let x = Vector2::new(123.0, -45.0);
        for theta in [1e-5, -2e-3, 0.07, -0.6] {
            for c in [Vector2::new(0.0, 0.0), Vector2::new(30.0, -80.0), Vector2::new(-4e4, 9e4)] {
                let twist = Twist::about(theta / 0.04, c);
                let error = (twist.after(0.04).apply(x) - equation_2(x, theta, c)).norm();
                assert!(error < 1e-8 * (1.0 + c.norm()), "θ = {theta}, c = {c}: {error}");
                assert!((twist.centre().unwrap() - c).norm() < 1e-9 * (1.0 + c.norm()));
            }
        }
    }

    #[test]
    fn a_translation_is_not_singular() {
        let twist = Twist::new(0.0, 100.0, -20.0);
        assert_eq!(twist.centre(), None);
        assert_eq!(twist.after(0.1).apply(Vector2::new(1.0, 2.0)), Vector2::new(11.0, 0.0));
        let nearly = Twist::new(1e-12, 100.0, -20.0);
        assert!((nearly.after(0.1).apply(Vector2::new(1.0, 2.0)) - Vector2::new(11.0, 0.0)).norm() < 1e-9);
    }

    #[test]
    fn angle_and_shift_determine_the_twist() {
        // A quarter of a turn about (3, 4) in half a second takes the origin to (3 + 4, 4 − 3).
        let twist = Twist::between(FRAC_PI_2, Vector2::new(7.0, 1.0), 0.5);
        assert!((twist.omega - PI).abs() < 1e-12);
        assert!((twist.centre().unwrap() - Vector2::new(3.0, 4.0)).norm() < 1e-12);
    }

    #[test]
    fn series_and_quotients_meet() {
        let at = |angle: f64| chord(angle, angle.sin(), angle.cos());
        let (below, above) = (at(1e-3 * (1.0 - 1e-12)), at(1e-3));
        assert!((below.0 - above.0).abs() < 1e-12 && (below.1 - above.1).abs() < 1e-12);
    }

    #[test]
    fn the_jacobian_is_the_limit_of_differences() {
        let x = Vector2::new(150.0, -210.0);
        for twist in [Twist::ZERO, Twist::new(0.01, 30.0, -9.0), Twist::new(-4.0, 500.0, 800.0)] {
            let jacobian = twist.jacobian(x, 0.04);
            for (axis, step) in [(0, 1e-4), (1, 1e-2), (2, 1e-2)] {
                let at = |sign: f64| {
                    let mut vector = twist.to_vector();
                    vector[axis] += sign * step;
                    Twist::from_vector(vector).after(0.04).apply(x)
                };
                let difference = (at(1.0) - at(-1.0)) / (2.0 * step);
                let error = (jacobian.column(axis) - difference).norm();
                assert!(error < 1e-6, "{twist:?}, axis {axis}: {error}");
            }
        }
    }

    #[test]
    fn the_inverse_goes_back() {
        let motion = Twist::new(0.3, 40.0, -10.0).after(0.7);
        let x = Vector2::new(-200.0, 77.0);
        assert!((motion.apply_inverse(motion.apply(x)) - x).norm() < 1e-10);
    }
}
