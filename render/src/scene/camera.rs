// SPDX-License-Identifier: MIT OR Apache-2.0

//! A camera on a path: its lens and its shutter.

use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2, Vector3};
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

    /// A point of the pose's own axes in those of the world.
    pub fn to_world(&self, point: Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.position
    }

    /// A point of the world in the pose's own axes.
    pub fn to_own(&self, point: Vector3<f64>) -> Vector3<f64> {
        self.rotation.inverse_transform_vector(&(point - self.position))
    }

    /// The same pose in the axes of another one.
    pub fn seen_from(&self, other: &Self) -> Self {
        Self { rotation: other.rotation.inverse() * self.rotation, position: other.to_own(self.position) }
    }
}

/// A camera's pose as a function of time in seconds.
pub trait CameraPath: Send + Sync {
    /// The pose at time `t`.
    fn pose(&self, t: f64) -> Pose;

    /// The factor on the lens's focal length at time `t`.
    fn zoom(&self, _t: f64) -> f64 {
        1.0
    }
}

impl<F: Fn(f64) -> Pose + Send + Sync> CameraPath for F {
    fn pose(&self, t: f64) -> Pose {
        self(t)
    }
}

/// The lens and its frame: square pixels, centres at integers, principal point in the middle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal length in pixels.
    pub focal: f64,
    /// Radial distortion k₁, k₂: a direction (x, y, 1) with r² = x² + y² is seen where a pinhole
    /// would see (x, y)·(1 + k₁r² + k₂r⁴). Barrels have k₁ < 0; 0, 0 is a pinhole.
    ///
    /// D. C. Brown, *Close-range camera calibration*, Photogrammetric Engineering 37, 1971.
    pub distortion: [f64; 2],
}

impl Lens {
    /// A pinhole.
    pub fn pinhole(width: usize, height: usize, focal: f64) -> Self {
        Self { width, height, focal, distortion: [0.0; 2] }
    }

    /// Whether lines of space are lines of the picture.
    pub fn is_pinhole(&self) -> bool {
        self.distortion == [0.0; 2]
    }

    /// The principal point.
    pub fn centre(&self) -> Vector2<f64> {
        Vector2::new((self.width as f64 - 1.0) / 2.0, (self.height as f64 - 1.0) / 2.0)
    }

    /// The direction of a pixel's ray in the camera; its z is 1. Where a strong barrel shows nothing,
    /// which should be outside the frame, it is that of the horizon.
    pub fn ray(&self, pixel: Vector2<f64>) -> Vector3<f64> {
        self.straightened((pixel - self.centre()) / self.focal).push(1.0)
    }

    /// The linear map from a pixel (x, y, 1) to the direction of its ray that is exact at `pixel`,
    /// there also in its derivatives; for a pinhole it is exact everywhere.
    pub fn rays_near(&self, pixel: Vector2<f64>) -> Matrix3<f64> {
        let x = self.ray(pixel).xy();
        let [k1, k2] = self.distortion;
        let q = x.norm_squared();
        // The derivative of the distortion, s·I + p·x·xᵀ, is inverted by Sherman and Morrison.
        let (s, p) = (1.0 + k1 * q + k2 * q * q, 2.0 * k1 + 4.0 * k2 * q);
        let slope = (Matrix2::identity() - x * x.transpose() * (p / (s + p * q))) / (s * self.focal);
        let start = x - slope * pixel;
        Matrix3::new(
            slope.m11, slope.m12, start.x, //
            slope.m21, slope.m22, start.y, //
            0.0, 0.0, 1.0,
        )
    }

    /// The pixel in which a point (camera axes) is seen; `None` behind the camera or beyond the
    /// horizon.
    pub fn project(&self, point: Vector3<f64>) -> Option<Vector2<f64>> {
        if point.z <= 1e-9 {
            return None;
        }
        let x = point.xy() / point.z;
        let [k1, k2] = self.distortion;
        let q = x.norm_squared();
        let seen = x * (1.0 + k1 * q + k2 * q * q);
        (q <= self.horizon()).then(|| self.centre() + seen * self.focal)
    }

    /// Whether a position lies on one of the frame's pixels (pixel centres at the border count, to
    /// a millionth of a pixel: they may come from a projection).
    pub fn contains(&self, pixel: Vector2<f64>) -> bool {
        let within = |x: f64, length: usize| x >= -1e-6 && x <= length as f64 - 1.0 + 1e-6;
        within(pixel.x, self.width) && within(pixel.y, self.height)
    }

    /// Undoes the distortion: Newton's method on r·(1 + k₁r² + k₂r⁴), which rises up to the horizon.
    fn straightened(&self, seen: Vector2<f64>) -> Vector2<f64> {
        let radius = seen.norm();
        if self.is_pinhole() || radius == 0.0 {
            return seen;
        }
        let [k1, k2] = self.distortion;
        let limit = self.horizon().sqrt();
        let mut r = radius.min(limit);
        for _ in 0..50 {
            let q = r * r;
            let excess = r * (1.0 + k1 * q + k2 * q * q) - radius;
            let next = (r - excess / (1.0 + 3.0 * k1 * q + 5.0 * k2 * q * q)).clamp(0.0, limit);
            let step = (next - r).abs();
            r = next;
            if step < 1e-15 {
                break;
            }
        }
        seen * (r / radius)
    }

    /// The r² up to which the distorted radius rises: the smallest positive root of its derivative
    /// 1 + 3k₁r² + 5k₂r⁴. What lies beyond would be seen a second time, nearer to the centre.
    fn horizon(&self) -> f64 {
        let [linear, square] = [3.0 * self.distortion[0], 5.0 * self.distortion[1]];
        let root = (linear * linear - 4.0 * square).sqrt();
        let roots = [2.0 / (root - linear), 2.0 / (-root - linear)];
        roots.into_iter().filter(|q| *q > 0.0).fold(f64::INFINITY, f64::min)
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
    /// Time in seconds for which each line collects light, half of it before the instant that
    /// [`RollingCamera::exposure`] gives; 0 is without motion blur.
    pub open: f64,
}

impl Shutter {
    /// Share of the readout that has elapsed when a position is exposed: ½/N in the middle of the
    /// first line, 1 − ½/N in the middle of the last.
    pub fn share(&self, lens: &Lens, pixel: Vector2<f64>) -> f64 {
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
    /// The lens, at zoom 1.
    pub lens: Lens,
    /// The shutter.
    pub shutter: Shutter,
    /// Where the camera is and how far it zooms, by time.
    pub path: Box<dyn CameraPath>,
}

impl RollingCamera {
    /// When a position of the frame that starts at `start` is exposed (the middle of its exposure), in
    /// seconds.
    pub fn exposure(&self, start: f64, pixel: Vector2<f64>) -> f64 {
        start + self.shutter.readout * self.shutter.share(&self.lens, pixel)
    }

    /// The lens as it is zoomed at time `t`.
    pub fn lens_at(&self, t: f64) -> Lens {
        Lens { focal: self.lens.focal * self.path.zoom(t), ..self.lens }
    }

    /// The camera's centre and the direction (world axes) in which a pixel looks at time `t`.
    pub fn ray(&self, t: f64, pixel: Vector2<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let pose = self.path.pose(t);
        (pose.position, pose.rotation * self.lens_at(t).ray(pixel))
    }

    /// Where a point of the world is seen by the whole frame exposed at the instant `t`.
    pub fn project(&self, t: f64, point: Vector3<f64>) -> Option<Vector2<f64>> {
        self.lens_at(t).project(self.path.pose(t).to_own(point))
    }

    /// Where the rolling frame that starts at `start` sees a point, given by its place in the world
    /// at each time: x solves x = project(exposure(x)), found by repetition.
    ///
    /// The repetition contracts while the image moves by less than one line from line to line;
    /// `None` behind the camera or where it has not settled to 1e−9 px.
    pub fn observe(&self, start: f64, point: impl Fn(f64) -> Vector3<f64>) -> Option<Vector2<f64>> {
        let seen_at = |t: f64| self.project(t, point(t));
        let mut pixel = seen_at(start + self.shutter.readout / 2.0)?;
        for _ in 0..200 {
            let next = seen_at(self.exposure(start, pixel))?;
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

    const LENS: Lens = Lens { width: 64, height: 48, focal: 50.0, distortion: [0.0; 2] };
    const BARREL: Lens = Lens { distortion: [-0.3, 0.07], ..LENS };

    #[test]
    fn projection_undoes_rays() {
        for lens in [LENS, BARREL, Lens { distortion: [0.2, -0.01], ..LENS }] {
            for pixel in [[12.25, 40.5], [0.0, 0.0], [63.0, 20.0], [31.5, 23.5]].map(Vector2::from) {
                let back = lens.project(lens.ray(pixel) * 3.7).unwrap();
                assert!((back - pixel).norm() < 1e-12, "{lens:?} {pixel}");
            }
        }
    }

    #[test]
    fn a_barrel_pulls_to_the_centre_as_its_polynomial_says() {
        // r = 0.5: 0.5·(1 − 0.3·0.25 + 0.07·0.0625) = 0.4646875.
        let seen = BARREL.project(Vector3::new(0.3, 0.4, 1.0)).unwrap();
        let expected = BARREL.centre() + Vector2::new(0.6, 0.8) * (0.464_687_5 * 50.0);
        assert!((seen - expected).norm() < 1e-12);
    }

    #[test]
    fn nothing_is_seen_beyond_the_horizon() {
        // r − ⅓r³ rises up to r = 1.
        let lens = Lens { distortion: [-1.0 / 3.0, 0.0], ..LENS };
        assert!(lens.project(Vector3::new(0.999, 0.0, 1.0)).is_some());
        assert!(lens.project(Vector3::new(1.001, 0.0, 1.0)).is_none());
    }

    #[test]
    fn rays_near_a_pixel_touch_the_true_ones() {
        for lens in [LENS, BARREL] {
            let pixel = Vector2::new(60.0, 5.0);
            let rays = lens.rays_near(pixel);
            assert!((rays * pixel.push(1.0) - lens.ray(pixel)).norm() < 1e-14);
            for step in [Vector2::x(), Vector2::y()].map(|axis| axis * 1e-4) {
                let slope = (lens.ray(pixel + step) - lens.ray(pixel - step)) / 2.0;
                assert!((rays * step.push(0.0) - slope).norm() < 1e-11);
            }
        }
        let far = Vector2::new(-5.0, 70.0);
        let rays = LENS.rays_near(Vector2::new(60.0, 5.0));
        assert!((rays * far.push(1.0) - LENS.ray(far)).norm() < 1e-14);
    }

    #[test]
    fn the_share_runs_from_the_first_edge() {
        let share = |first| Shutter { first, readout: 1.0, open: 0.0 }.share(&LENS, Vector2::new(16.0, 36.0));
        assert!((share(FirstEdge::Top) - 36.5 / 48.0).abs() < 1e-15);
        assert!((share(FirstEdge::Bottom) - 11.5 / 48.0).abs() < 1e-15);
        assert!((share(FirstEdge::Left) - 16.5 / 64.0).abs() < 1e-15);
        assert!((share(FirstEdge::Right) - 47.5 / 64.0).abs() < 1e-15);
    }

    /// A camera at rest that zooms by e^(rate·t).
    struct Zooming(f64);

    impl CameraPath for Zooming {
        fn pose(&self, _t: f64) -> Pose {
            Pose::identity()
        }

        fn zoom(&self, t: f64) -> f64 {
            (self.0 * t).exp()
        }
    }

    #[test]
    fn each_row_is_seen_with_the_focal_length_of_its_exposure() {
        let (rate, start) = (0.7, 0.3);
        let shutter = Shutter { first: FirstEdge::Top, readout: 0.4, open: 0.0 };
        let camera = RollingCamera { lens: LENS, shutter, path: Box::new(Zooming(rate)) };
        let point = Vector3::new(0.4, -0.2, 2.0);
        let seen = camera.observe(start, |_| point).unwrap();
        let t = start + 0.4 * (seen.y + 0.5) / 48.0;
        let expected = LENS.centre() + point.xy() / point.z * (50.0 * (rate * t).exp());
        assert!((seen - expected).norm() < 1e-8, "{seen} {expected}");
        let (from, direction) = camera.ray(t, seen);
        assert!((point - from).cross(&direction).norm() < 1e-9);
    }

    #[test]
    fn observed_points_are_exposed_when_they_are_seen() {
        let path = |t: f64| Pose {
            rotation: Rotation3::from_euler_angles(0.4 * t, 0.3 * t, -0.6 * t),
            position: Vector3::new(0.5 * t, 0.0, 0.2 * t),
        };
        let shutter = Shutter { first: FirstEdge::Bottom, readout: 0.4, open: 0.0 };
        let camera = RollingCamera { lens: LENS, shutter, path: Box::new(path) };
        let point = Vector3::new(0.3, -0.2, 2.0);
        let seen = camera.observe(0.1, |_| point).unwrap();
        let (from, direction) = camera.ray(camera.exposure(0.1, seen), seen);
        assert!((point - from).cross(&direction).norm() < 1e-9);
    }
}
