// SPDX-License-Identifier: MIT OR Apache-2.0

//! Textured rectangles in space. World axes: x right, y down, z ahead; metres.

use super::camera::Pose;
use super::mover::Mover;
use super::noise::mix;
use super::texture::Texture;
use nalgebra::{Matrix3, Vector2, Vector3};

/// A textured rectangle: origin + u·edge_u + v·edge_v, u and v in 0..1; seen from both sides.
#[derive(Clone, Debug)]
pub struct Surface {
    origin: Vector3<f64>,
    edge_u: Vector3<f64>,
    edge_v: Vector3<f64>,
    normal: Vector3<f64>,
    /// Index of the texture in the scene.
    pub texture: usize,
    /// Repetitions of the texture along u and v.
    pub tiling: Vector2<f32>,
    /// Where in the texture the corner lies, in repetitions.
    pub shift: Vector2<f32>,
    /// Index of the mover that carries it, in whose axes it is then given; `None`: it stands still.
    pub mover: Option<usize>,
    /// Brightness at the corners (u, v) = (0,0), (1,0), (0,1), (1,1).
    pub light: [f32; 4],
}

impl Surface {
    /// A rectangle with a corner and its two edges, at right angles; texture 0 once, full light.
    pub fn new(origin: Vector3<f64>, edge_u: Vector3<f64>, edge_v: Vector3<f64>) -> Self {
        Self {
            origin,
            edge_u,
            edge_v,
            normal: edge_u.cross(&edge_v).normalize(),
            texture: 0,
            tiling: Vector2::new(1.0, 1.0),
            shift: Vector2::new(0.0, 0.0),
            mover: None,
            light: [1.0; 4],
        }
    }

    /// The same rectangle covered with a texture of which one repetition is `metres` wide.
    pub fn covered(mut self, texture: usize, metres: f64, shift: Vector2<f32>) -> Self {
        self.texture = texture;
        self.tiling =
            Vector2::new((self.edge_u.norm() / metres) as f32, (self.edge_v.norm() / metres) as f32);
        self.shift = shift;
        self
    }

    /// The same rectangle lit by a lamp: a share of ambient light, the rest by angle and distance.
    pub fn lit(mut self, lamp: Vector3<f64>) -> Self {
        let light = |u: f64, v: f64| {
            let to_lamp = lamp - self.point(u, v);
            let distance = to_lamp.norm();
            let facing = self.normal.dot(&to_lamp).abs() / distance.max(1e-9);
            (0.55 + 0.65 * facing / (1.0 + 0.03 * distance * distance)) as f32
        };
        self.light = [light(0.0, 0.0), light(1.0, 0.0), light(0.0, 1.0), light(1.0, 1.0)];
        self
    }

    /// The same rectangle carried by a mover, in whose axes it is given.
    pub fn carried(mut self, mover: usize) -> Self {
        self.mover = Some(mover);
        self
    }

    /// Brightness at (u, v).
    pub fn light_at(&self, u: f32, v: f32) -> f32 {
        let [a, b, c, d] = self.light;
        mix(mix(a, b, u), mix(c, d, u), v)
    }

    /// The point at (u, v).
    pub fn point(&self, u: f64, v: f64) -> Vector3<f64> {
        self.origin + self.edge_u * u + self.edge_v * v
    }

    /// Distance along a ray (in lengths of `direction`) to the rectangle, if it is met nearer than
    /// `limit`.
    pub fn hit(&self, from: Vector3<f64>, direction: Vector3<f64>, limit: f64) -> Option<f64> {
        let distance = self.normal.dot(&(self.origin - from)) / self.normal.dot(&direction);
        if !(distance > 0.0 && distance < limit) {
            return None;
        }
        let local = from + direction * distance - self.origin;
        let within = |edge: &Vector3<f64>| (0.0..=edge.norm_squared()).contains(&local.dot(edge));
        (within(&self.edge_u) && within(&self.edge_v)).then_some(distance)
    }

    /// The homography from a pixel (x, y, 1) to (u·w, v·w, w) as seen from `from`, where `rays`
    /// takes (x, y, 1) to the ray's direction; w is one over the distance along the ray.
    ///
    /// With n·(o − c) = k the plane is met at distance k/(n·d), so that w = n·d/k and
    /// u·w = (a·d − w·a·(o − c))/a², all linear in the pixel.
    pub fn view(&self, from: Vector3<f64>, rays: &Matrix3<f64>) -> Matrix3<f64> {
        let corner = self.origin - from;
        let w = rays.tr_mul(&self.normal) / self.normal.dot(&corner);
        let along = |edge: &Vector3<f64>| (rays.tr_mul(edge) - w * edge.dot(&corner)) / edge.norm_squared();
        Matrix3::from_rows(&[along(&self.edge_u).transpose(), along(&self.edge_v).transpose(), w.transpose()])
    }
}

/// Where a ray meets the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in lengths of the ray's direction.
    pub distance: f64,
    /// The point met, in the axes of the surface: those of its mover or of the world. It stays on
    /// the object as that moves; [`Scene::position`] tells where it is.
    pub point: Vector3<f64>,
    /// Index of the surface.
    pub surface: usize,
}

/// Surfaces, what covers them, and what moves them.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// The rectangles.
    pub surfaces: Vec<Surface>,
    /// What they are covered with.
    pub textures: Vec<Texture>,
    /// The objects that move on their own. Surfaces of one mover stand together in the list.
    pub movers: Vec<Mover>,
}

impl Scene {
    /// The nearest surface on a ray at time `t` (seconds).
    pub fn hit(&self, t: f64, from: Vector3<f64>, direction: Vector3<f64>) -> Option<Hit> {
        let mut nearest: Option<Hit> = None;
        let (mut mover, mut own_from, mut own_direction) = (None, from, direction);
        for (surface, rectangle) in self.surfaces.iter().enumerate() {
            // Neighbours mostly share their axes, so that the ray is seldom taken to other ones.
            if rectangle.mover != mover {
                mover = rectangle.mover;
                let pose = self.axes(mover, t);
                own_from = pose.to_own(from);
                own_direction = pose.rotation.inverse() * direction;
            }
            let limit = nearest.map_or(f64::INFINITY, |hit| hit.distance);
            if let Some(distance) = rectangle.hit(own_from, own_direction, limit) {
                nearest = Some(Hit { distance, point: own_from + own_direction * distance, surface });
            }
        }
        nearest
    }

    /// Where a point that a ray has met is at time `t`, in the world.
    pub fn position(&self, t: f64, hit: &Hit) -> Vector3<f64> {
        match self.surfaces[hit.surface].mover {
            None => hit.point,
            mover => self.axes(mover, t).to_world(hit.point),
        }
    }

    /// The pose of a mover at time `t`; of the world itself for none.
    pub fn axes(&self, mover: Option<usize>, t: f64) -> Pose {
        mover.map_or_else(Pose::identity, |index| self.movers[index].pose(t))
    }
}

#[cfg(test)]
mod tests {
    use super::super::path::{Oscillation, Oscillations};
    use super::*;

    fn tilted() -> Surface {
        let (sin, cos) = 0.4f64.sin_cos();
        Surface::new(
            Vector3::new(-1.0, -0.5, 3.0),
            Vector3::new(2.0 * cos, 0.0, 2.0 * sin),
            Vector3::new(0.0, 1.5, 0.0),
        )
    }

    #[test]
    fn view_and_hit_agree_on_a_known_point() {
        let surface = tilted();
        let from = Vector3::new(0.2, -0.1, 0.3);
        let point = surface.point(0.3, 0.8);
        let direction = point - from;
        let rays = Matrix3::identity();
        let pixel = direction / direction.z;
        let seen = surface.view(from, &rays) * pixel;
        assert!((seen.x / seen.z - 0.3).abs() < 1e-12 && (seen.y / seen.z - 0.8).abs() < 1e-12);
        assert!((1.0 / seen.z - direction.z).abs() < 1e-12);
        assert!((surface.hit(from, direction, 9.0).unwrap() - 1.0).abs() < 1e-12);
        assert_eq!(surface.hit(from, direction, 0.9), None);
    }

    #[test]
    fn a_ray_beside_or_behind_misses() {
        let surface = tilted();
        assert_eq!(surface.hit(Vector3::zeros(), Vector3::new(0.0, 0.0, -1.0), 9.0), None);
        assert_eq!(surface.hit(Vector3::zeros(), Vector3::new(2.0, 0.0, 1.0), 9.0), None);
    }

    #[test]
    fn the_nearest_surface_wins() {
        let far = Surface::new(
            Vector3::new(-1.0, -1.0, 5.0),
            Vector3::new(2.0, 0.0, 0.0),
            Vector3::new(0.0, 2.0, 0.0),
        );
        let scene = Scene { surfaces: vec![far, tilted()], ..Scene::default() };
        let hit = scene.hit(0.0, Vector3::zeros(), Vector3::new(0.0, 0.0, 1.0)).unwrap();
        assert_eq!(hit.surface, 1);
        assert!(hit.point.z < 5.0 && (hit.point.z - hit.distance).abs() < 1e-12);
    }

    /// A quarter of a turn about z and half a metre to the right, both reached after one second.
    fn mover() -> Mover {
        let reached = |amplitude| vec![Oscillation { amplitude, frequency: 0.25, phase: 0.0 }];
        let rotation = [vec![], vec![], reached(std::f64::consts::FRAC_PI_2)];
        let path =
            Oscillations { fps: 1.0, rotation, position: [reached(0.5), vec![], vec![]], zoom: vec![] };
        Mover { rest: Vector3::new(0.0, 0.0, 4.0), path }
    }

    #[test]
    fn a_point_met_stays_on_the_object() {
        let square = Surface::new(Vector3::new(-1.0, -1.0, 0.0), Vector3::x() * 2.0, Vector3::y() * 2.0);
        let surfaces = vec![square.carried(0)];
        let scene = Scene { surfaces, movers: vec![mover()], ..Scene::default() };
        let hit = scene.hit(0.0, Vector3::zeros(), Vector3::new(0.2, 0.0, 1.0)).unwrap();
        assert!((scene.position(0.0, &hit) - Vector3::new(0.8, 0.0, 4.0)).norm() < 1e-12);
        let later = Vector3::new(0.5, 0.8, 4.0);
        assert!((scene.position(1.0, &hit) - later).norm() < 1e-12, "x turns to y, then moves right");
        let again = scene.hit(1.0, Vector3::zeros(), later).unwrap();
        assert!((again.point - hit.point).norm() < 1e-12 && (again.distance - 1.0).abs() < 1e-12);
    }

    #[test]
    fn what_has_moved_away_is_not_met() {
        let strip = Surface::new(Vector3::new(-0.2, -1.0, 0.0), Vector3::x() * 0.4, Vector3::y() * 2.0);
        let surfaces = vec![strip.carried(0)];
        let scene = Scene { surfaces, movers: vec![mover()], ..Scene::default() };
        // Upright at first, lying after a quarter of a turn.
        let above = Vector3::new(0.0, 0.2, 1.0);
        assert!(scene.hit(0.0, Vector3::zeros(), above).is_some());
        assert!(scene.hit(1.0, Vector3::zeros(), above).is_none());
    }
}
