// SPDX-License-Identifier: MIT OR Apache-2.0

//! The precision of the motions that the rectifier returns.
//!
//! They are rounded once, when they are estimated: to less than the warp resolves, and to less than the noise of
//! the flow. So a [motion file](super::file) holds exactly what was applied, in few bytes.

use nalgebra::Matrix3;

/// Step of the position, in pixels, of a point at the edge of the frame, by one element of a homography. The warp
/// rounds positions to 1/2048 px.
const POSITION_STEP: f64 = 1.0 / 4096.0;

/// Steps of a residual velocity between two nodes of the mesh: the positions of points are rounded to at most
/// 1/96 of a cell, 1/12 px for cells of 8 px, with a standard deviation of 0.03 px over the frame. That is the noise of
/// the residual velocity of a cell; the scenes with most parallax have errors of ten times as much. Of the phone clip, 64 steps
/// take 4.5 kB a frame, 24 take 2.8, and the error left of a scene with a foreground grows by less than a hundredth.
const VELOCITY_STEPS: f64 = 24.0;

/// Most steps of an element of a homography: with more, a step is less than the resolution of `f64`.
const MAX_STEPS: f64 = (1_u64 << 50) as f64;

/// Most steps of a velocity: with more, a step is less than the resolution of `f32`.
const MAX_VELOCITY_STEPS: f64 = (1 << 22) as f64;

/// Elements of a homography but the last, which is 1.
pub(super) const ELEMENTS: usize = 8;

/// The elements of a homography as numbers of steps from the identity, row by row.
pub(super) type Steps = [i64; ELEMENTS];

/// The row and column of each element but the last, and whether it is on the diagonal.
fn places() -> [(usize, usize, f64); ELEMENTS] {
    std::array::from_fn(|index| {
        let (row, column) = (index / 3, index % 3);
        (row, column, if row == column { 1.0 } else { 0.0 })
    })
}

/// The step of an element: each factor of the position and the homogeneous coordinate count with the radius.
fn step(row: usize, column: usize, radius: f64) -> f64 {
    let scaled = if column < 2 { POSITION_STEP / radius } else { POSITION_STEP };
    if row == 2 { scaled / radius } else { scaled }
}

/// Distance in pixels of the farthest edge of a frame from its centre.
pub(super) fn radius(width: usize, height: usize) -> f64 {
    width.max(height).max(2) as f64 / 2.0
}

/// The nearest numbers of steps of a homography on centred pixels; `None` if one is out of range.
pub(super) fn steps(homography: &Matrix3<f64>, radius: f64) -> Option<Steps> {
    let scaled = homography / homography[(2, 2)];
    let mut steps = Steps::default();
    for (count, (row, column, identity)) in steps.iter_mut().zip(places()) {
        let value = (scaled[(row, column)] - identity) / step(row, column, radius);
        // No for NaN.
        let is_in_range = value.abs() <= MAX_STEPS;
        *count = is_in_range.then(|| value.round() as i64)?;
    }
    Some(steps)
}

/// The homography of numbers of steps.
pub(super) fn homography(steps: &Steps, radius: f64) -> Matrix3<f64> {
    let mut homography = Matrix3::identity();
    for (count, (row, column, identity)) in steps.iter().zip(places()) {
        homography[(row, column)] = identity + *count as f64 * step(row, column, radius);
    }
    homography
}

/// A homography on centred pixels of a frame, rounded; as it is if an element is out of range.
pub(crate) fn rounded_homography(exact: &Matrix3<f64>, width: usize, height: usize) -> Matrix3<f64> {
    let radius = radius(width, height);
    steps(exact, radius).map_or(*exact, |steps| homography(&steps, radius))
}

/// The nearest number of steps of a residual velocity in pixels per readout, between nodes `spacing` pixels apart;
/// `None` if it is out of range.
pub(super) fn velocity_steps(velocity: f32, spacing: f64) -> Option<i64> {
    let steps = f64::from(velocity) * VELOCITY_STEPS / spacing;
    // No for NaN.
    (steps.abs() <= MAX_VELOCITY_STEPS).then(|| (steps + 0.5_f64.copysign(steps)) as i64)
}

/// The velocity of a number of steps.
pub(super) fn velocity(steps: i64, spacing: f64) -> f32 {
    (steps as f64 * spacing / VELOCITY_STEPS) as f32
}

/// A residual velocity, rounded; as it is if it is out of range.
pub(crate) fn rounded_velocity(value: f32, spacing: f64) -> f32 {
    velocity_steps(value, spacing).map_or(value, |steps| velocity(steps, spacing))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rounding_moves_no_point_far_and_is_done_once(
            turn in -0.2..0.2_f64, shift in -500.0..500.0_f64, tilt in -1e-5..1e-5_f64, at in prop::array::uniform2(-1.0..1.0_f64)
        ) {
            let (sin, cos) = turn.sin_cos();
            let exact = Matrix3::new(cos, -sin, shift, sin, cos, -shift / 3.0, tilt, -tilt, 1.0) * 1.7;
            let rounded = rounded_homography(&exact, 3840, 2160);
            prop_assert_eq!(rounded, rounded_homography(&rounded, 3840, 2160));
            let point = Vector2::new(at[0] * 1920.0, at[1] * 1080.0).push(1.0);
            let [a, b] = [exact * point, rounded * point];
            let moved = (a.xy() / a.z - b.xy() / b.z).norm();
            prop_assert!(moved < 1e-3, "{} px", moved);
        }

        #[test]
        fn velocities_are_rounded_once(value in -1e6..1e6_f32, spacing in 8.0..64.0_f64) {
            let rounded = rounded_velocity(value, spacing);
            prop_assert_eq!(rounded, rounded_velocity(rounded, spacing));
            // Half a step, and the resolution of `f32`.
            prop_assert!((rounded - value).abs() <= spacing as f32 / 48.0 + value.abs() * 1e-6);
        }
    }

    #[test]
    fn what_is_out_of_range_stays() {
        assert!(rounded_velocity(f32::NAN, 8.0).is_nan());
        assert_eq!(rounded_velocity(f32::MAX, 8.0), f32::MAX);
        let far = Matrix3::new(1.0, 0.0, 1e300, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        assert_eq!(rounded_homography(&far, 640, 480), far);
        assert!(rounded_homography(&Matrix3::zeros(), 640, 480) == Matrix3::zeros());
    }
}
