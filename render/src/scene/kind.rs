// SPDX-License-Identifier: MIT OR Apache-2.0

//! The scenes that sequences are filmed in.

use super::deep;
use super::geometry::Scene;
use super::photographs;
use super::procedural::bake_all;
use super::room::{Builder, furnished};
use super::special;
use super::texture::Texture;
use anyhow::Result;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What is left of the contrast of textures in a scene of low texture.
const LOW_CONTRAST: f32 = 0.05;

/// What there is to be seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum SceneKind {
    /// A room with clutter and texture everywhere.
    #[default]
    Room,
    /// The same, and a block before the camera that swings on its own and covers about a third of
    /// the picture.
    Foreground,
    /// Walls and furniture that are nearly flat: what is left are the edges.
    LowTexture,
    /// The room behind a face that goes with a camera on [`Motion::Pan`](super::path::Motion::Pan).
    Selfie,
    /// A street between near walls; road and sky have no texture.
    Street,
    /// Railings, branches and wires before the far wall of the room.
    Thin,
    /// The room behind a thing that goes with a camera on [`Motion::Follow`](super::path::Motion::Follow).
    Followed,
    /// The room and ten things with motions of their own.
    Crowd,
    /// The room; a third of the picture moves as water does, each part on its own.
    Water,
    /// The room; a third of the picture are stripes.
    Blinds,
    /// The room and a caption that is fixed to the frame of a camera on
    /// [`Motion::Pan`](super::path::Motion::Pan).
    Caption,
    /// Walls one before the other, the nearer ones lower, as the layers of a game.
    Layers,
    /// The same behind the frame of a window that is at rest in the picture of a camera on
    /// [`Motion::Scroll`](super::path::Motion::Scroll) between 0.02 and 0.3 cycles a frame.
    Window,
    /// A plain from below the camera to the horizon, and a sky.
    Ground,
    /// A wall behind a cylinder across the picture that rolls to and fro.
    Roller,
}

impl SceneKind {
    /// Builds the scene of a seed with the photographs of a folder as textures, the first for the
    /// first pattern and so on, all over again where they are fewer; procedural textures without
    /// a folder. The seed chooses textures, colours and small turns, not the layout.
    ///
    /// # Errors
    /// Those of [`photographs::load`].
    pub fn build(self, seed: u64, folder: Option<&Path>) -> Result<Scene> {
        let textures = match folder {
            Some(folder) => photographs::load(folder)?,
            None => bake_all(seed),
        };
        Ok(self.covered(seed, textures))
    }

    /// Builds the scene of a seed with these textures.
    ///
    /// # Panics
    /// If there are none.
    pub fn covered(self, seed: u64, mut textures: Vec<Texture>) -> Scene {
        let random = ChaCha8Rng::seed_from_u64(seed);
        let mut builder = Builder { surfaces: Vec::new(), random, textures: textures.len() };
        let mut movers = Vec::new();
        match self {
            Self::Room => furnished(&mut builder, false),
            Self::Foreground => {
                furnished(&mut builder, false);
                movers.push(builder.foreground());
            }
            Self::LowTexture => {
                furnished(&mut builder, true);
                textures = textures.iter().map(|texture| texture.faded(LOW_CONTRAST)).collect();
            }
            Self::Selfie => movers.push(special::face(&mut builder, seed)),
            Self::Street => textures.push(special::street(&mut builder, &textures)),
            Self::Thin => special::thin(&mut builder),
            Self::Followed => movers.push(special::followed(&mut builder, seed)),
            Self::Crowd => movers = special::crowd(&mut builder),
            Self::Water => movers = special::water(&mut builder),
            Self::Blinds => textures.push(special::blinds(&mut builder)),
            Self::Caption => movers.push(special::caption(&mut builder, seed)),
            Self::Layers => deep::layers(&mut builder),
            Self::Window => movers.push(deep::window(&mut builder, seed)),
            Self::Ground => deep::ground(&mut builder),
            Self::Roller => movers.push(deep::roller(&mut builder)),
        }
        Scene { surfaces: builder.surfaces, textures, movers }
    }
}

#[cfg(test)]
mod tests {
    use super::super::camera::CameraPath;
    use super::super::path::{Motion, Oscillations};
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn every_ray_meets_the_room_and_nothing_is_too_near() {
        let scene = SceneKind::Room.covered(1, bake_all(1));
        let from = Vector3::new(0.1, -0.05, 0.2);
        for i in 0..2000 {
            let (turn, height) = (f64::from(i) * 2.399_963, f64::from(i) / 1000.0 - 0.999);
            let radius = (1.0 - height * height).sqrt();
            let direction = Vector3::new(radius * turn.cos(), height, radius * turn.sin());
            let hit = scene.hit(0.0, from, direction).expect("the room is closed");
            assert!(hit.distance > 1.0, "{}", hit.distance);
        }
    }

    #[test]
    fn the_foreground_covers_a_third_of_the_picture_and_moves() {
        let scene = SceneKind::Foreground.covered(1, bake_all(1));
        let seen = |t: f64| -> Vec<bool> {
            let rays =
                (0..1200).map(|i| (f64::from(i % 40) / 40.0 - 0.4875, f64::from(i / 40) / 40.0 - 0.3625));
            let hits = rays.map(|(x, y)| scene.hit(t, Vector3::zeros(), Vector3::new(x, y, 1.0)).unwrap());
            hits.map(|hit| scene.surfaces[hit.surface].mover.is_some()).collect()
        };
        let first = seen(0.0);
        for frame in [0.0, 8.0, 16.0, 24.0, 40.0] {
            let share = seen(frame / 30.0).iter().filter(|own| **own).count() as f64 / 1200.0;
            assert!((0.25..0.45).contains(&share), "{share}");
        }
        assert_ne!(first, seen(0.2));
    }

    #[test]
    fn the_view_ahead_holds_many_depths() {
        let scene = SceneKind::Room.covered(1, bake_all(1));
        let depths: Vec<f64> = (0..400)
            .map(|i| {
                let (x, y) = (f64::from(i % 20) / 19.0 - 0.5, f64::from(i / 20) / 19.0 - 0.5);
                scene.hit(0.0, Vector3::zeros(), Vector3::new(1.1 * x, 0.85 * y, 1.0)).unwrap().distance
            })
            .collect();
        let share = |low: f64, high: f64| {
            depths.iter().filter(|d| (low..high).contains(*d)).count() as f64 / depths.len() as f64
        };
        assert!(share(0.0, 2.4) > 0.05 && share(2.4, 4.0) > 0.2 && share(4.0, 6.1) > 0.2);
    }

    /// The share of a frame of 40 × 30 rays that shows movers, seen from a camera on a path.
    fn moving_share(scene: &Scene, motion: Motion, t: f64) -> f64 {
        let pose = Oscillations::new(motion, 1.0, 30.0, 1).pose(t);
        let rays = (0..1200).map(|i| (f64::from(i % 40) / 40.0 - 0.4875, f64::from(i / 40) / 40.0 - 0.3625));
        let hits = rays.map(|(x, y)| scene.hit(t, pose.position, pose.rotation * Vector3::new(x, y, 1.0)));
        hits.filter(|hit| scene.surfaces[hit.expect("the scene is closed").surface].mover.is_some()).count()
            as f64
            / 1200.0
    }

    fn scene(kind: SceneKind) -> Scene {
        kind.covered(1, vec![Texture::new(1, vec![[0.5; 3]])])
    }

    #[test]
    fn what_goes_with_the_camera_keeps_its_share_of_the_picture() {
        for (kind, motion, share) in [
            (SceneKind::Selfie, Motion::Pan, 0.25..0.4),
            (SceneKind::Followed, Motion::Follow, 0.33..0.47),
            (SceneKind::Caption, Motion::Pan, 0.02..0.1),
        ] {
            let scene = scene(kind);
            for frame in [0.0, 7.0, 15.0, 23.0, 39.0] {
                let seen = moving_share(&scene, motion, frame / 30.0);
                assert!(share.contains(&seen), "{kind:?} at {frame}: {seen}");
            }
        }
    }

    #[test]
    fn water_covers_a_third() {
        let scene = scene(SceneKind::Water);
        let share = moving_share(&scene, Motion::Still, 0.3);
        assert!(scene.movers.len() == 24 && (0.27..0.4).contains(&share), "{share}");
    }

    #[test]
    fn ten_things_move() {
        let scene = scene(SceneKind::Crowd);
        let share = moving_share(&scene, Motion::Still, 0.3);
        assert!(scene.movers.len() == 10 && (0.1..0.5).contains(&share), "{share}");
    }
}
