//! Rigid objects that move on their own.

use super::camera::{CameraPath, Pose};
use super::path::Oscillations;
use nalgebra::Vector3;

/// A rigid object's motion: oscillations about a place where it would rest.
///
/// Surfaces that belong to a mover are given in its own axes, with the origin at its resting place.
#[derive(Clone, Debug, PartialEq)]
pub struct Mover {
    /// Where its origin would rest, in metres (world axes).
    pub rest: Vector3<f64>,
    /// Its turns about that origin and its shifts from it.
    pub path: Oscillations,
}

impl Mover {
    /// Takes the mover's axes to those of the world at time `t` (seconds).
    pub fn pose(&self, t: f64) -> Pose {
        let pose = self.path.pose(t);
        Pose { position: self.rest + pose.position, ..pose }
    }
}

#[cfg(test)]
mod tests {
    use super::super::path::Oscillation;
    use super::super::{Scene, Surface};
    use super::*;

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
