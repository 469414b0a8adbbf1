//! A pinhole camera on a path, and its shutter.

use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use serde::Serialize;

/// Where the camera is and how it is turned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Takes directions of the camera (x right, y down, z ahead) to those of the world.
    pub rotation: Rotation3<f64>,
    /// The camera's centre in metres.
    pub position: Vector3<f64>,
}

impl Pose {
    /// At the origin, looking along +z.
    pub fn identity() -> Self {
        Self { rotation: Rotation3::identity(), position: Vector3::zeros() }
    }
}

/// A camera's pose as a function of time in seconds.
pub trait CameraPath: Send + Sync {
    /// The pose at time `t`.
    fn pose(&self, t: f64) -> Pose;
}

impl<F: Fn(f64) -> Pose + Send + Sync> CameraPath for F {
    fn pose(&self, t: f64) -> Pose {
        self(t)
    }
}

/// A pinhole camera: square pixels, centres at integers, principal point in the middle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal length in pixels.
    pub focal: f64,
}

impl Pinhole {
    /// The principal point.
    pub fn centre(&self) -> Vector2<f64> {
        Vector2::new((self.width as f64 - 1.0) / 2.0, (self.height as f64 - 1.0) / 2.0)
    }

    /// Takes a pixel (x, y, 1) to the direction of its ray in the camera; its z is 1.
    pub fn rays(&self) -> Matrix3<f64> {
        let (f, c) = (self.focal, self.centre());
        Matrix3::new(1.0 / f, 0.0, -c.x / f, 0.0, 1.0 / f, -c.y / f, 0.0, 0.0, 1.0)
    }

    /// The pixel in which a point (camera axes) is seen; `None` behind the camera.
    pub fn project(&self, point: Vector3<f64>) -> Option<Vector2<f64>> {
        (point.z > 1e-9).then(|| self.centre() + point.xy() * (self.focal / point.z))
    }

    /// Whether a position lies on one of the frame's pixels (pixel centres at the border count).
    pub fn contains(&self, pixel: Vector2<f64>) -> bool {
        (0.0..=self.width as f64 - 1.0).contains(&pixel.x)
            && (0.0..=self.height as f64 - 1.0).contains(&pixel.y)
    }
}

/// Which edge of the frame is exposed first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub enum FirstEdge {
    /// Row 0.
    Top,
    /// The last row.
    Bottom,
    /// Column 0.
    Left,
    /// The last column.
    Right,
}

impl FirstEdge {
    /// Whether rows (true) or columns (false) are exposed one after another.
    pub const fn is_by_rows(self) -> bool {
        matches!(self, Self::Top | Self::Bottom)
    }
}

/// A rolling shutter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shutter {
    /// The edge exposed first.
    pub first: FirstEdge,
    /// Time in seconds from the first line to the one that would follow the last; 0 is a global
    /// shutter.
    pub readout: f64,
}

impl Shutter {
    /// Share of the readout that has elapsed when a position is exposed: ½/N in the middle of the
    /// first line, 1 − ½/N in the middle of the last.
    pub fn share(&self, lens: &Pinhole, pixel: Vector2<f64>) -> f64 {
        let (width, height) = (lens.width as f64, lens.height as f64);
        match self.first {
            FirstEdge::Top => (pixel.y + 0.5) / height,
            FirstEdge::Bottom => (height - 0.5 - pixel.y) / height,
            FirstEdge::Left => (pixel.x + 0.5) / width,
            FirstEdge::Right => (width - 0.5 - pixel.x) / width,
        }
    }
}

/// A camera on its path.
pub struct RollingCamera {
    /// The lens.
    pub lens: Pinhole,
    /// The shutter.
    pub shutter: Shutter,
    /// Where the camera is, by time.
    pub path: Box<dyn CameraPath>,
}

impl RollingCamera {
    /// When a position of the frame that starts at `start` is exposed, in seconds.
    pub fn exposure(&self, start: f64, pixel: Vector2<f64>) -> f64 {
        start + self.shutter.readout * self.shutter.share(&self.lens, pixel)
    }

    /// The camera's centre and the direction (world axes) in which a pixel looks at time `t`.
    pub fn ray(&self, t: f64, pixel: Vector2<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let pose = self.path.pose(t);
        (pose.position, pose.rotation * (self.lens.rays() * pixel.push(1.0)))
    }

    /// Where a point of the world is seen by the whole frame exposed at the instant `t`.
    pub fn project(&self, t: f64, point: Vector3<f64>) -> Option<Vector2<f64>> {
        let pose = self.path.pose(t);
        self.lens.project(pose.rotation.inverse() * (point - pose.position))
    }

    /// Where the rolling frame that starts at `start` sees a point of the world: x solves
    /// x = project(exposure(x)), found by repetition.
    ///
    /// The repetition contracts while the image moves by less than one line from line to line;
    /// `None` behind the camera or where it has not settled to 1e−9 px.
    pub fn observe(&self, start: f64, point: Vector3<f64>) -> Option<Vector2<f64>> {
        let mut pixel = self.project(start + self.shutter.readout / 2.0, point)?;
        for _ in 0..200 {
            let next = self.project(self.exposure(start, pixel), point)?;
            let step = (next - pixel).norm();
            pixel = next;
            if step < 1e-9 {
                return Some(pixel);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: Pinhole = Pinhole { width: 64, height: 48, focal: 50.0 };

    #[test]
    fn projection_undoes_rays() {
        let pixel = Vector2::new(12.25, 40.5);
        let back = LENS.project(LENS.rays() * pixel.push(1.0) * 3.7).unwrap();
        assert!((back - pixel).norm() < 1e-12);
    }

    #[test]
    fn the_share_runs_from_the_first_edge() {
        let share = |first| Shutter { first, readout: 1.0 }.share(&LENS, Vector2::new(16.0, 36.0));
        assert!((share(FirstEdge::Top) - 36.5 / 48.0).abs() < 1e-15);
        assert!((share(FirstEdge::Bottom) - 11.5 / 48.0).abs() < 1e-15);
        assert!((share(FirstEdge::Left) - 16.5 / 64.0).abs() < 1e-15);
        assert!((share(FirstEdge::Right) - 47.5 / 64.0).abs() < 1e-15);
    }

    #[test]
    fn observed_points_are_exposed_when_they_are_seen() {
        let path = |t: f64| Pose {
            rotation: Rotation3::from_euler_angles(0.4 * t, 0.3 * t, -0.6 * t),
            position: Vector3::new(0.5 * t, 0.0, 0.2 * t),
        };
        let shutter = Shutter { first: FirstEdge::Bottom, readout: 0.4 };
        let camera = RollingCamera { lens: LENS, shutter, path: Box::new(path) };
        let point = Vector3::new(0.3, -0.2, 2.0);
        let seen = camera.observe(0.1, point).unwrap();
        let (from, direction) = camera.ray(camera.exposure(0.1, seen), seen);
        assert!((point - from).cross(&direction).norm() < 1e-9);
    }
}
