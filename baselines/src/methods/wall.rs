// SPDX-License-Identifier: MIT OR Apache-2.0

//! A wall filmed by a camera whose motion is known in closed form: what the methods are tested on.

use super::{Input, Method};
use crate::correspondences;
use nalgebra::{Rotation3, Vector3};
use render::footage::direction;
use render::scene::{
    CameraPath, FirstEdge, Lens, Pose, RollingCamera, Scene, Shutter, Surface, path::uniform,
};
use render::sequence::{Take, Warp};
use render::truth::Capture;
use rsrectify::correspond::Correspondence;
use rsrectify::readout::{Readout, ReadoutTime};
use std::sync::Arc;

/// Focal length in pixels.
pub const FOCAL: f64 = 300.0;
/// Frame period in seconds.
pub const PERIOD: f64 = 0.04;
/// The camera's distance from the wall in metres.
pub const DEPTH: f64 = 3.0;

/// A camera of 320×240 that looks at a wall far wider than it sees.
pub struct Wall {
    first: FirstEdge,
    readout: f64,
    take: Take,
}

impl Wall {
    /// A wall filmed along a path with a readout of `ratio` frame periods.
    pub fn new(first: FirstEdge, ratio: f64, path: impl CameraPath + 'static) -> Self {
        let surface = Surface::new(
            Vector3::new(-30.0, -30.0, DEPTH),
            Vector3::new(60.0, 0.0, 0.0),
            Vector3::new(0.0, 60.0, 0.0),
        );
        let readout = ratio * PERIOD;
        let camera = RollingCamera {
            lens: Lens { width: 320, height: 240, focal: FOCAL, distortion: [0.0; 2] },
            shutter: Shutter { first, readout, open: 0.0 },
            path: Box::new(path),
        };
        let scene = Arc::new(Scene { surfaces: vec![surface], ..Scene::default() });
        Self { first, readout, take: Take { scene, camera } }
    }

    /// A camera that turns at a constant angular velocity in radians a second.
    pub fn turning(first: FirstEdge, ratio: f64, velocity: Vector3<f64>) -> Self {
        let pose = move |t: f64| Pose { rotation: Rotation3::new(velocity * t), position: Vector3::zeros() };
        Self::new(first, ratio, pose)
    }

    /// A camera that moves straight on at a constant velocity in metres a second.
    pub fn moving(first: FirstEdge, ratio: f64, velocity: Vector3<f64>) -> Self {
        Self::new(first, ratio, uniform(0.0, velocity))
    }

    fn capture(&self, k: usize) -> Capture<'_> {
        Capture { take: &self.take, start: k as f64 * PERIOD, warp: Warp::default() }
    }

    /// Correspondences between the frames of a run of `count`, without error.
    pub fn pairs(&self, count: usize) -> Vec<Vec<Correspondence>> {
        let pair = |k| correspondences::exact(&self.capture(k), &self.capture(k + 1), [20, 15]);
        (0..count - 1).map(pair).collect()
    }

    /// The largest displacement in pixels that a method leaves in each frame of a run, and the
    /// largest that there was.
    pub fn left(&self, method: &dyn Method, pairs: &[Vec<Correspondence>]) -> (Vec<f64>, f64) {
        let time = ReadoutTime::Seconds(self.readout);
        let input = Input {
            readout: Readout::new(320, 240, direction(self.first), time, PERIOD).unwrap(),
            focal: FOCAL,
            period: PERIOD,
            stamps: (0..=pairs.len()).map(|k| k as f64 * PERIOD).collect(),
            pairs,
        };
        let corrections = method.solve(&input).unwrap();
        assert_eq!(corrections.len(), pairs.len() + 1);
        let mut uncorrected = 0.0f64;
        let largest = corrections.iter().enumerate().map(|(k, correction)| {
            let samples = self.capture(k).samples(16);
            assert!(samples.len() > 200);
            samples.iter().fold(0.0f64, |largest, sample| {
                uncorrected = uncorrected.max((sample.seen - sample.truth).norm());
                let left = (correction.correct(sample.seen) - sample.truth).norm();
                assert!(left.is_finite(), "frame {k}: {}", sample.seen);
                largest.max(left)
            })
        });
        (largest.collect(), uncorrected)
    }

    /// The largest displacement that a method leaves in any of `count` frames, given exact
    /// correspondences; there is at least 1 px to be corrected.
    pub fn most_left(&self, method: &dyn Method, count: usize) -> f64 {
        let (left, uncorrected) = self.left(method, &self.pairs(count));
        assert!(uncorrected > 1.0, "only {uncorrected} px to be corrected");
        left.into_iter().fold(0.0, f64::max)
    }
}
