// SPDX-License-Identifier: MIT OR Apache-2.0

//! Footage that was stabilised in the camera, by one homography a frame or by a turn of each row.

use crate::scene::{Picture, Pose, RollingCamera, Scene};
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use rayon::prelude::*;
use serde::Serialize;

/// Electronic stabilisation: each frame is moved from where the camera was in the middle of the readout to
/// where a smoothed path is, and enlarged so that the frame's border stays out of sight.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Stabilisation {
    /// How a frame is moved.
    pub kind: Move,
    /// Standard deviation, in frames, of the Gaussian that smooths the path.
    pub smoothing: f64,
    /// Enlargement; 1.2 leaves a margin of a twelfth of the frame at each side.
    pub zoom: f64,
}

/// How a stabiliser moves a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Move {
    /// By shift, roll and zoom, as a stabiliser does that follows the picture.
    Similarity,
    /// By a turn about the camera's centre, as one does that has a gyroscope but does not correct rows.
    Turn,
    /// Each row by its own turn, as one does that knows the shutter: no turn of the camera displaces rows any more.
    TurnByRow,
}

impl Stabilisation {
    /// What is done to the frame whose readout has its middle at the instant `t`, in seconds.
    ///
    /// With the turn R of the camera, the smoothed turn S, the lens K and the enlargement Z about the
    /// image centre this is the homography Z·K·Sᵀ·R·K⁻¹, or Z times a similarity.
    pub fn warp(&self, scene: &Scene, camera: &RollingCamera, t: f64, fps: f64) -> Warp {
        let centre = camera.lens.centre();
        let smooth = self.smoothed(camera, t, fps);
        let lens = Matrix3::new_translation(&centre)
            * Matrix3::new_nonuniform_scaling(&Vector2::repeat(camera.lens_at(t).focal));
        let enlarge = Matrix3::new_translation(&centre)
            * Matrix3::new_scaling(self.zoom)
            * Matrix3::new_translation(&-centre);
        let turn = smooth.rotation.inverse() * camera.path.pose(t).rotation;
        let moved = match self.kind {
            Move::Similarity => similarity(scene, camera, t, &smooth),
            _ => lens * turn.matrix() * lens.try_inverse().expect("a focal length above 0"),
        };
        let rows_turned_to = (self.kind == Move::TurnByRow).then_some(t);
        Warp { zoom: self.zoom, rows_turned_to, ..Warp::new(enlarge * moved) }
    }

    /// The smoothed pose: weighted means of the rotation vectors and the positions of the frames around.
    fn smoothed(&self, camera: &RollingCamera, t: f64, fps: f64) -> Pose {
        let reach = (3.0 * self.smoothing).ceil() as i32;
        let (mut turn, mut position, mut weights) = (Vector3::zeros(), Vector3::zeros(), 0.0);
        for frame in (-reach..=reach).map(f64::from) {
            let weight = (-0.5 * (frame / self.smoothing).powi(2)).exp();
            let pose = camera.path.pose(t + frame / fps);
            turn += pose.rotation.scaled_axis() * weight;
            position += pose.position * weight;
            weights += weight;
        }
        Pose { rotation: Rotation3::new(turn / weights), position: position / weights }
    }
}

/// The similarity that best takes points of the scene from where the camera sees them at the instant `t` to where it
/// would see them from another pose.
fn similarity(scene: &Scene, camera: &RollingCamera, t: f64, pose: &Pose) -> Matrix3<f64> {
    let (lens, centre) = (camera.lens_at(t), camera.lens.centre());
    let grid = (0..63)
        .map(|i| centre.component_mul(&Vector2::new(0.25 * f64::from(i % 9), 0.33 * f64::from(i / 9))));
    let pairs: Vec<[Vector2<f64>; 2]> = grid
        .filter_map(|from| {
            let (eye, direction) = camera.ray(t, from);
            let point = scene.position(t, &scene.hit(t, eye, direction)?);
            Some([from, lens.project(pose.to_own(point))?])
        })
        .collect();
    let mean =
        |end: usize| pairs.iter().map(|pair| pair[end]).sum::<Vector2<f64>>() / pairs.len().max(1) as f64;
    let means = [mean(0), mean(1)];
    // Sums of the squares, dot and cross products about the means: scale times cosine and sine of the roll.
    let mut sums = Vector3::zeros();
    for [from, to] in pairs {
        let (a, b) = (from - means[0], to - means[1]);
        sums += Vector3::new(a.norm_squared(), a.dot(&b), a.perp(&b));
    }
    let (cos, sin) = if sums.x > 0.0 { (sums.y / sums.x, sums.z / sums.x) } else { (1.0, 0.0) };
    let roll = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
    Matrix3::new_translation(&means[1]) * roll * Matrix3::new_translation(&-means[0])
}

/// A homography from a frame as it was captured to the frame as it is delivered, and its inverse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warp {
    /// Enlargement: a delivered frame shows 1 / zoom of the captured rows.
    pub zoom: f64,
    /// The instant to whose pose every row was turned before the homography, if it was.
    pub rows_turned_to: Option<f64>,
    forward: Matrix3<f64>,
    backward: Matrix3<f64>,
}

impl Default for Warp {
    /// Frames are delivered as they were captured.
    fn default() -> Self {
        Self::new(Matrix3::identity())
    }
}

impl Warp {
    /// # Panics
    /// If the homography cannot be inverted.
    fn new(forward: Matrix3<f64>) -> Self {
        let backward = forward.try_inverse().expect("turns and enlargements can be undone");
        Self { zoom: 1.0, rows_turned_to: None, forward, backward }
    }

    /// Where a place of the captured frame is in the delivered one, in pixels.
    pub fn delivered(&self, captured: Vector2<f64>) -> Vector2<f64> {
        apply(&self.forward, captured)
    }

    /// Where a place of the delivered frame was in the captured one, in pixels.
    pub fn captured(&self, delivered: Vector2<f64>) -> Vector2<f64> {
        apply(&self.backward, delivered)
    }
}

/// A captured picture as it is delivered, given where each delivered pixel was captured, resampled bicubically;
/// beyond the border the nearest pixel is repeated.
pub fn resample(picture: &Picture, captured: impl Fn(Vector2<f64>) -> Vector2<f64> + Sync) -> Picture {
    let mut colours = vec![[0.0; 3]; picture.colours.len()];
    colours.par_chunks_mut(picture.width).enumerate().for_each(|(y, row)| {
        for (x, colour) in row.iter_mut().enumerate() {
            *colour = cubic(picture, captured(Vector2::new(x as f64, y as f64)));
        }
    });
    Picture::new(picture.width, picture.height, colours)
}

fn apply(homography: &Matrix3<f64>, pixel: Vector2<f64>) -> Vector2<f64> {
    let place = homography * pixel.push(1.0);
    place.xy() / place.z
}

/// Catmull–Rom interpolation.
fn cubic(picture: &Picture, place: Vector2<f64>) -> [f32; 3] {
    let corner = place.map(f64::floor);
    let [across, down] = [place.x - corner.x, place.y - corner.y].map(|share| cubic_weights(share as f32));
    let index = |start: f64, tap: usize, length: usize| {
        (start + tap as f64 - 1.0).clamp(0.0, length as f64 - 1.0) as usize
    };
    let columns: [usize; 4] = std::array::from_fn(|tap| index(corner.x, tap, picture.width));
    let mut sum = [0.0; 3];
    for (tap, weight_down) in down.into_iter().enumerate() {
        let row = &picture.colours[index(corner.y, tap, picture.height) * picture.width..][..picture.width];
        for (column, weight) in columns.into_iter().zip(across) {
            let colour = row[column];
            sum = std::array::from_fn(|channel| sum[channel] + weight_down * weight * colour[channel]);
        }
    }
    sum
}

/// The weights of the four neighbours at −1, 0, 1, 2 for a place at `t` in 0..1.
///
/// R. G. Keys, *Cubic convolution interpolation for digital image processing*, IEEE Transactions on
/// Acoustics, Speech, and Signal Processing 29(6), 1981, with a = −½.
fn cubic_weights(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1.0, -1.5 * t3 + 2.0 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::path::uniform;
    use crate::scene::{CameraPath, FirstEdge, Lens, Shutter, Surface};
    use std::f64::consts::TAU;

    const LENS: Lens = Lens { width: 64, height: 48, focal: 60.0, distortion: [0.0; 2] };

    fn camera(path: impl CameraPath + 'static) -> RollingCamera {
        let shutter = Shutter { first: FirstEdge::Top, readout: 0.02, open: 0.0 };
        RollingCamera { lens: LENS, shutter, path: Box::new(path) }
    }

    fn turned(smoothing: f64, zoom: f64) -> Stabilisation {
        Stabilisation { kind: Move::Turn, smoothing, zoom }
    }

    #[test]
    fn a_similarity_undoes_roll_and_shift_before_a_wall() {
        // A rolling and shifting swing at a third of a cycle a frame, which 3 frames of smoothing take out, before a
        // wall at 3 m: what is seen is the wall from the origin.
        let swing = |t: f64| 0.05 * (TAU * 10.0 * t).sin();
        let camera = camera(move |t: f64| Pose {
            rotation: Rotation3::from_axis_angle(&Vector3::z_axis(), swing(t)),
            position: Vector3::new(swing(t), -swing(t), 0.0),
        });
        let corner = Vector3::new(-30.0, -30.0, 3.0);
        let wall = Surface::new(corner, Vector3::x() * 60.0, Vector3::y() * 60.0);
        let scene = Scene { surfaces: vec![wall], ..Scene::default() };
        let placed = Stabilisation { kind: Move::Similarity, ..turned(3.0, 1.0) };
        let t = 0.02;
        let warp = placed.warp(&scene, &camera, t, 30.0);
        for point in [[-0.8, 0.6, 3.0], [0.0, 0.3, 3.0], [1.0, -0.5, 3.0]].map(Vector3::from) {
            let captured = camera.project(t, point).unwrap();
            let steady = LENS.project(point).unwrap();
            assert!((captured - steady).norm() > 0.5);
            assert!((warp.delivered(captured) - steady).norm() < 0.01, "{point}");
        }
    }

    #[test]
    fn a_steady_turn_is_only_enlarged() {
        // The mean of a steady turn over a window is the turn in its middle.
        let camera = camera(uniform(0.7, Vector3::zeros()));
        let warp = turned(4.0, 1.25).warp(&Scene::default(), &camera, 0.3, 30.0);
        let corner = warp.delivered(Vector2::new(31.5 + 8.0, 23.5 - 4.0));
        assert!((corner - Vector2::new(41.5, 18.5)).norm() < 1e-9, "{corner}");
    }

    #[test]
    fn a_fast_swing_is_taken_out() {
        // At a third of a cycle a frame a Gaussian of 3 frames leaves nothing, but for its cut tails:
        // 0.3 % of the swing's 3 px.
        let swing = |t: f64| 0.05 * (TAU * 10.0 * t).sin();
        let camera = camera(move |t: f64| Pose {
            rotation: Rotation3::from_axis_angle(&Vector3::y_axis(), swing(t)),
            ..Pose::identity()
        });
        let t = 0.02;
        let warp = turned(3.0, 1.0).warp(&Scene::default(), &camera, t, 30.0);
        // A direction straight ahead is seen left of the centre by the camera that turned right.
        let captured = Vector2::new(31.5 - 60.0 * swing(t).tan(), 23.5);
        assert!((warp.delivered(captured) - LENS.centre()).norm() < 0.01);
        assert!((warp.captured(LENS.centre()) - captured).norm() < 0.01);
    }

    #[test]
    fn resampling_reproduces_a_parabola() {
        // Keys' kernel is exact for polynomials of the second degree.
        let value = |x: f64, y: f64| (0.1 + 0.01 * x - 1e-4 * x * x + 2e-4 * x * y + 3e-4 * y * y) as f32;
        let colours = (0..64 * 48).map(|i| [value(f64::from(i % 64), f64::from(i / 64)); 3]);
        let picture = Picture::new(64, 48, colours.collect());
        let shift = Matrix3::new_translation(&Vector2::new(-2.3, 1.6));
        let warp = Warp::new(shift);
        let moved = resample(&picture, |pixel| warp.captured(pixel));
        for (x, y) in [(10.0, 10.0), (40.0, 30.0), (31.0, 5.0)] {
            let colour = moved.colours[y as usize * 64 + x as usize][1];
            assert!((colour - value(x + 2.3, y - 1.6)).abs() < 1e-5);
        }
    }
}
