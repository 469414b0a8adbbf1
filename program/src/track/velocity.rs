// SPDX-License-Identifier: MIT OR Apache-2.0

//! How the picture moves at one instant of a readout, and what turn of the camera that is.

use rsrectify::motion::{FrameMotion, image_centre};
use rsrectify::nalgebra::{Matrix3, SMatrix, Vector2, Vector3};

/// Half the share of the readout over which differences are taken: the path is smooth over a 32nd.
const STEP: f64 = 1.0 / 128.0;
/// Columns and rows of the points to whose velocities a turn is fitted.
const GRID: [usize; 2] = [9, 7];

/// The motion of the whole picture at one instant, without what parts of it do beside that.
#[derive(Clone, Copy, Debug)]
pub struct Instant<'a> {
    motion: &'a FrameMotion,
    share: f64,
}

impl<'a> Instant<'a> {
    /// When this share of a frame's readout has elapsed.
    pub fn new(motion: &'a FrameMotion, share: f64) -> Self {
        Self { motion, share }
    }

    /// By how many pixels a point (centred pixels) moves from here to when `share` has elapsed.
    pub fn shift(&self, point: Vector2<f64>, share: f64) -> Vector2<f64> {
        let path = self.motion.path();
        let moved = path.carry(point, self.share, share);
        let beside = path.residual().map(|field| field.velocity(point) * (share - self.share));
        moved - point - beside.unwrap_or_default()
    }

    /// Pixels a second at a point (centred pixels); 0 for a global shutter.
    pub fn velocity(&self, point: Vector2<f64>) -> Vector2<f64> {
        let time = self.motion.readout().time();
        if time <= 0.0 {
            return Vector2::zeros();
        }
        let (before, after) = (self.share - STEP, self.share + STEP);
        (self.shift(point, after) - self.shift(point, before)) / (2.0 * STEP * time)
    }

    /// How fast the picture turns about a point (centred pixels), rad/s, from the x axis towards the y axis.
    pub fn rotation(&self, point: Vector2<f64>) -> f64 {
        let half = 0.5;
        let at = |x: f64, y: f64| self.velocity(point + Vector2::new(x, y));
        let down_right = at(half, 0.0) - at(-half, 0.0);
        let right_down = at(0.0, half) - at(0.0, -half);
        0.5 * (down_right.y - right_down.x)
    }

    /// The angular velocity of a camera that turns about its centre and sees the picture move like this, by least squares
    /// over the frame, in rad/s about the axes of the image: x to the right, y down, z forward. `focal` is the focal length
    /// in pixels.
    ///
    /// A camera that turns by Ω sees a ray n = (x, y, 1) of the scene move by −Ω × n.
    pub fn turn(&self, focal: f64) -> Option<Vector3<f64>> {
        let readout = self.motion.readout();
        let size = [readout.width() as f64, readout.height() as f64];
        let centre = image_centre(readout.width(), readout.height());
        let mut normal = Matrix3::zeros();
        let mut right = Vector3::zeros();
        for index in 0..GRID[0] * GRID[1] {
            let cell = [index % GRID[0], index / GRID[0]];
            let place = |axis: usize| (cell[axis] as f64 + 0.5) / GRID[axis] as f64 * size[axis] - 0.5;
            let point = Vector2::new(place(0), place(1)) - centre;
            let (x, y) = (point.x / focal, point.y / focal);
            let by_turn = SMatrix::<f64, 2, 3>::new(x * y, -1.0 - x * x, y, 1.0 + y * y, -x * y, -x);
            let velocity = self.velocity(point) / focal;
            normal += by_turn.transpose() * by_turn;
            right += by_turn.transpose() * velocity;
        }
        let turn = normal.try_inverse()? * right;
        turn.iter().all(|rate| rate.is_finite()).then_some(turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rsrectify::motion::{MotionPath, SampledPath, Twist};
    use rsrectify::nalgebra::Rotation3;
    use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};

    fn readout() -> Readout {
        Readout::new(800, 600, ReadoutDirection::TopToBottom, ReadoutTime::Seconds(0.02), 0.04).unwrap()
    }

    #[test]
    fn a_turning_camera_is_found_in_what_it_sees() {
        let (focal, time) = (600.0, 0.02);
        let turn = Vector3::new(0.3, -0.5, 0.8);
        let k = Matrix3::from_diagonal(&Vector3::new(focal, focal, 1.0));
        // From where a point is at a share to where it is at share 0: the camera turns by +Ω, the scene by −Ω.
        let back = |share: f64| {
            let scene = Rotation3::new(turn * (share * time));
            k * scene.matrix() * k.try_inverse().unwrap()
        };
        let homographies: Vec<_> = (0..=32).map(|index| back(f64::from(index) / 32.0)).collect();
        let path = MotionPath::from(SampledPath::new(&homographies, time).unwrap());
        let motion = FrameMotion::new(readout(), path);
        for share in [0.1, 0.5, 0.95] {
            // Ω turns with the camera about itself: its own axes do not change it.
            let found = Instant::new(&motion, share).turn(focal).unwrap();
            assert!((found - turn).norm() < 1e-3, "{share}: {found}");
        }
    }

    #[test]
    fn a_twist_is_its_velocity_and_rotation() {
        let motion = FrameMotion::new(readout(), MotionPath::uniform(Twist::new(0.5, 40.0, -20.0), 0.02));
        let here = Instant::new(&motion, 0.25);
        let velocity = here.velocity(Vector2::new(100.0, 0.0));
        assert!((velocity - Vector2::new(40.0, -20.0 + 50.0)).norm() < 1e-2, "{velocity}");
        assert!((here.rotation(Vector2::new(100.0, 0.0)) - 0.5).abs() < 1e-4);
        let shift = here.shift(Vector2::zeros(), 0.5);
        assert!((shift - Vector2::new(0.2, -0.1)).norm() < 1e-2, "{shift}");
        let still = FrameMotion::new(Readout::global_shutter(800, 600), MotionPath::STILL);
        assert_eq!(Instant::new(&still, 0.5).velocity(Vector2::zeros()), Vector2::zeros());
    }
}
