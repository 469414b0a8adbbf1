// SPDX-License-Identifier: MIT OR Apache-2.0

//! Content-preserving warps for 3D video stabilisation, as a remover of rolling shutter.
//!
//! Source: F. Liu, M. Gleicher, H. Jin and A. Agarwala, *Content-preserving warps for 3D video stabilization*, SIGGRAPH 2009.
//! The paper reconstructs camera path and points in space, smooths the path, projects the points into the smoothed
//! cameras, and warps each frame from where its points are seen to these projections ([`mesh`](super::mesh)). A reconstructed point
//! has one place for all frames that see it, so that the warp takes out what the rolling shutter displaces it by in some frame.
//!
//! Here nothing is reconstructed. The stand-in is a camera that turns, of known focal length:
//!
//! - path: the rotations that most correspondences between successive frames follow, chained; smoothed by a
//!   low-pass filter of the rotation vectors about each frame's own ([`low_pass`](super::low_pass));
//! - points: the direction of each track in the world, low-pass filtered over the frames that see it by the same filter. A
//!   point that is far away has one direction; that of a near one changes as the camera moves, which the filter
//!   passes where it is slow. Tracks whose residual is above three times the median one are outliers.
//!
//! So it keeps what the paper's method takes rolling shutter out by: smoothed points come from a rigid camera path, and
//! the residuals of single frames are averaged over the life of a track. It does not keep the geometry of a camera that moves: there the
//! shake of near points is filtered, not computed. The method is not told the shutter.

use super::low_pass::weights;
use super::mesh::{Moved, corrections};
use super::robust::{absolute_weight, scale, tukey_weight};
use super::tracks::{Track, following, link, most_residual};
use super::{Corrections, Input, Method};
use anyhow::Result;
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use rsrectify::correspond::Correspondence;
use rsrectify::motion::image_centre;

/// Tracks that fewer frames see are not used: a line through their directions averages too little.
const LEAST_SEEN: usize = 10;
/// Reweightings of the least sum of absolute errors, from no rotation, and of Tukey's estimate from there.
const ROUNDS: [usize; 2] = [10, 10];

/// Content-preserving warps that follow a smoothed camera path.
#[derive(Clone, Copy, Debug)]
pub struct ContentPreserving {
    /// Standard deviation of the low-pass filters in seconds.
    pub deviation: f64,
}

impl Method for ContentPreserving {
    fn name(&self) -> String {
        "content-preserving-warps".into()
    }

    /// A frame pair without correspondences counts as one between which the camera does not turn.
    fn solve(&self, input: &Input) -> Result<Corrections> {
        let camera = Camera {
            focal: input.focal,
            centre: image_centre(input.readout.width(), input.readout.height()),
        };
        let deviation = self.deviation / input.period;
        let mut path = vec![Rotation3::identity()];
        for (frame, pairs) in input.pairs.iter().enumerate() {
            path.push(path[frame] * camera.rotation(pairs).inverse());
        }
        let smooth: Vec<_> = (0..path.len()).map(|at| smoothed(&path, at, deviation)).collect();
        let mut tracks = following(link(input), input.stamps.len());
        tracks.retain(|track| track.places.len() >= LEAST_SEEN);
        let smoothed: Vec<_> = tracks.iter().map(|track| camera.smoothed(track, &path, deviation)).collect();
        let most = most_residual(smoothed.iter().map(|(_, residual)| *residual).collect());
        let inliers = tracks.iter().zip(&smoothed).filter(|(_, (_, residual))| *residual <= most);
        let moved = inliers.filter_map(|(track, (directions, _))| {
            let seen = smooth[track.first..].iter().zip(directions);
            let to = seen.map(|(rotation, direction)| camera.project(rotation.inverse() * direction));
            Some(Moved { track, to: to.collect::<Option<_>>()? })
        });
        Ok(corrections(input, &moved.collect::<Vec<_>>()))
    }
}

/// A rotation of a path (camera to world) after the low-pass filter: its own, turned by the filtered rotation vectors from it to
/// all.
fn smoothed(path: &[Rotation3<f64>], at: usize, deviation: f64) -> Rotation3<f64> {
    let weights = weights(path.len(), at, deviation);
    let vector = |rotation: &Rotation3<f64>| (path[at].inverse() * rotation).scaled_axis();
    let mean: Vector3<f64> =
        weights.iter().zip(path).map(|(weight, rotation)| vector(rotation) * *weight).sum();
    path[at] * Rotation3::new(mean)
}

/// A pinhole.
struct Camera {
    /// In pixels.
    focal: f64,
    centre: Vector2<f64>,
}

impl Camera {
    fn ray(&self, place: Vector2<f64>) -> Vector3<f64> {
        ((place - self.centre) / self.focal).push(1.0)
    }

    /// `None` behind the camera.
    fn project(&self, ray: Vector3<f64>) -> Option<Vector2<f64>> {
        (ray.z > 1e-3 * ray.norm()).then(|| ray.xy() / ray.z * self.focal + self.centre)
    }

    /// The low-pass filtered directions of a track in the world, and the RMS distance of its own directions, of length 1, from
    /// them.
    fn smoothed(&self, track: &Track, path: &[Rotation3<f64>], deviation: f64) -> (Vec<Vector3<f64>>, f64) {
        let places = track.places.iter().zip(&path[track.first..]);
        let own: Vec<_> = places.map(|(place, rotation)| rotation * self.ray(*place).normalize()).collect();
        let mean = |index: usize| -> Vector3<f64> {
            weights(own.len(), index, deviation).iter().zip(&own).map(|(w, direction)| direction * *w).sum()
        };
        let smooth: Vec<_> = (0..own.len()).map(mean).collect();
        let squares: f64 = own.iter().zip(&smooth).map(|(own, smooth)| (own - smooth).norm_squared()).sum();
        (smooth, (squares / own.len() as f64).sqrt())
    }

    /// The rotation from the axes of a frame to those of the next that most correspondences follow.
    fn rotation(&self, pairs: &[Correspondence]) -> Rotation3<f64> {
        let mut found = Rotation3::identity();
        for round in 0..ROUNDS.iter().sum() {
            let seen = pairs.iter().filter_map(|pair| {
                let turned = found * self.ray(pair.from);
                Some((turned, pair.to - self.project(turned)?))
            });
            let seen: Vec<_> = seen.collect();
            let scale = scale(seen.iter().map(|(_, residual)| residual.norm()).collect());
            let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
            for (turned, residual) in &seen {
                let weight = if round < ROUNDS[0] {
                    absolute_weight(residual.norm())
                } else {
                    tukey_weight(residual.norm(), scale)
                };
                let [x, y] = [turned.x / turned.z, turned.y / turned.z];
                // What a turn ω × r moves r's projection by.
                let slopes = [Vector3::new(-x * y, 1.0 + x * x, -y), Vector3::new(-1.0 - y * y, x * y, x)];
                for (slope, residual) in slopes.iter().zip(residual.iter()) {
                    let slope = slope * self.focal;
                    normal += slope * slope.transpose() * weight;
                    right += slope * (weight * residual);
                }
            }
            let Some(cholesky) = normal.cholesky() else { return found };
            found = Rotation3::new(cholesky.solve(&right)) * found;
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::tracks::closed_form::{SIZE, input, pairs};

    const FOCAL: f64 = 300.0;

    fn camera() -> Camera {
        Camera { focal: FOCAL, centre: image_centre(SIZE[0], SIZE[1]) }
    }

    /// Where a place of the first frame is once the camera has turned by a rotation vector.
    fn seen(place: Vector2<f64>, turn: Vector3<f64>) -> Vector2<f64> {
        let camera = camera();
        camera.project(Rotation3::new(turn).inverse() * camera.ray(place)).unwrap()
    }

    #[test]
    fn the_rotation_that_most_follow_is_found() {
        let turn = Vector3::new(0.02, -0.03, 0.01);
        let mut pairs = pairs(2, |p, k| seen(p, turn * k as f64), |p, k| seen(p, turn * -(k as f64)));
        pairs[0].iter_mut().step_by(4).for_each(|pair| pair.to += Vector2::new(15.0, -9.0));
        let found = camera().rotation(&pairs[0]);
        assert!((found.inverse().scaled_axis() - turn).norm() < 1e-6, "{}", found.scaled_axis());
    }

    #[test]
    fn a_steady_turn_is_kept_and_a_shake_removed() {
        for shake in [0.0, 0.01] {
            let turn = move |k: usize| {
                let by = if k.is_multiple_of(2) { shake } else { -shake };
                Vector3::new(0.5 * by, 0.001 * k as f64 + by, 0.0)
            };
            // Exact for turns about one axis; the other one is small.
            let back = |p, k| {
                let camera = camera();
                camera.project(Rotation3::new(turn(k)) * camera.ray(p)).unwrap()
            };
            let pairs = pairs(24, |p, k| seen(p, turn(k)), back);
            let corrections = ContentPreserving { deviation: 0.24 }.solve(&input(&pairs)).unwrap();
            let place = Vector2::new(170.0, 100.0);
            for (k, correction) in corrections.iter().enumerate().take(19).skip(5) {
                let shown = correction.correct(seen(place, turn(k)));
                let steady = seen(place, Vector3::new(0.0, 0.001 * k as f64, 0.0));
                assert!((shown - steady).norm() < 0.05 + 20.0 * shake, "frame {k}: {}", shown - steady);
            }
        }
    }

    #[test]
    fn what_rows_of_single_frames_are_displaced_by_is_taken_out() {
        // A lean to and fro of 3 px from the first row to the last.
        let lean = |k: usize| if k.is_multiple_of(2) { 0.0125 } else { -0.0125 };
        let flow = |p: Vector2<f64>, k: usize| Vector2::new(p.x + lean(k) * (p.y - 119.5), p.y);
        let inverse = |p: Vector2<f64>, k: usize| Vector2::new(p.x - lean(k) * (p.y - 119.5), p.y);
        let pairs = pairs(24, flow, inverse);
        let corrections = ContentPreserving { deviation: 0.24 }.solve(&input(&pairs)).unwrap();
        for (k, correction) in corrections.iter().enumerate().take(20).skip(4) {
            let [top, bottom] =
                [20.0, 220.0].map(|y| correction.correct(flow(Vector2::new(160.0, y), k)).x - 160.0);
            assert!((top - bottom).abs() < 0.5, "frame {k}: {top} {bottom}");
        }
    }

    #[test]
    fn without_correspondences_frames_stay() {
        crate::methods::timed::closed_form::assert_survives_ignorance(&ContentPreserving { deviation: 0.5 });
    }
}
