// SPDX-License-Identifier: MIT OR Apache-2.0

//! Smooth camera paths: each of the six degrees of freedom, and the zoom, is a sum of oscillations.
//!
//! Frequencies are in cycles a frame, because what a method can follow depends on how much of an
//! oscillation fits between two frames, not on seconds.

use super::camera::{CameraPath, Pose};
use nalgebra::{Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use std::f64::consts::TAU;

/// amplitude · sin(2π·(frequency·t + phase)).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Oscillation {
    /// Peak, in radians, metres or, of a zoom, its natural logarithm.
    pub amplitude: f64,
    /// Cycles a frame.
    pub frequency: f64,
    /// Share of a cycle at time 0.
    pub phase: f64,
}

impl Oscillation {
    fn at(&self, frames: f64) -> f64 {
        self.amplitude * (TAU * (self.frequency * frames + self.phase)).sin()
    }
}

/// What kind of motion a camera makes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Motion {
    /// None.
    Still,
    /// The optical axis goes round in a spiral that narrows and widens.
    SpiralRotation,
    /// Turns about all three axes.
    Rotation,
    /// Translations along all three axes, mostly sideways.
    Translation,
    /// [`Rotation`](Self::Rotation) and [`Translation`](Self::Translation) at once.
    RotationAndTranslation,
    /// A hand's shake: turns in a band of frequencies, and translation in the lower half of it.
    Shake {
        /// The lowest frequency in cycles a frame.
        lowest: f64,
        /// The highest frequency in cycles a frame.
        highest: f64,
        /// Peak of the translation in metres, where turns reach 0.03 radians; 0 for a camera that only turns.
        sway: f64,
    },
    /// Turns at 1 to 2.5 cycles a frame, with a little slow shake.
    Vibration,
    /// Turns in a band of frequencies, as of an engine, with a hand's slow shake.
    Rattle {
        /// The lowest frequency in cycles a frame.
        lowest: f64,
        /// The highest frequency in cycles a frame.
        highest: f64,
    },
    /// A hand-held pan to and fro by up to a quarter of a radian a frame, with shake.
    Pan,
    /// Forward at 0.4 metres a frame, with a little shake.
    Drive,
    /// To and fro sideways by up to 0.15 metres a frame, with a little shake.
    Follow,
    /// Sideways, and a little up and down, in a band of frequencies, without a turn: as a game scrolls.
    Scroll {
        /// The lowest frequency in cycles a frame.
        lowest: f64,
        /// The highest frequency in cycles a frame.
        highest: f64,
    },
    /// Forward at 0.2 metres a frame and steered to and fro, otherwise level: as a vehicle in a game.
    Steer,
    /// A hand's shake while the focal length grows from 1/√`factor` to √`factor` of the lens's over 24 frames, and
    /// goes back over the next 24. A sequence's strength does not change the zoom.
    Zoom {
        /// The longest focal length as a multiple of the shortest.
        factor: f64,
    },
}

/// A camera path of sums of oscillations.
#[derive(Clone, Debug, PartialEq)]
pub struct Oscillations {
    /// Frames a second.
    pub fps: f64,
    /// Rotation vector in radians: pitch (about x), yaw (y), roll (z).
    pub rotation: [Vec<Oscillation>; 3],
    /// Position in metres: x, y, z.
    pub position: [Vec<Oscillation>; 3],
    /// Natural logarithm of the factor on the focal length.
    pub zoom: Vec<Oscillation>,
}

impl CameraPath for Oscillations {
    fn pose(&self, t: f64) -> Pose {
        let frames = t * self.fps;
        let sum = |axis: &Vec<Oscillation>| axis.iter().map(|o| o.at(frames)).sum::<f64>();
        Pose {
            rotation: Rotation3::new(Vector3::from(self.rotation.each_ref().map(sum))),
            position: Vector3::from(self.position.each_ref().map(sum)),
        }
    }

    fn zoom(&self, t: f64) -> f64 {
        self.zoom.iter().map(|oscillation| oscillation.at(t * self.fps)).sum::<f64>().exp()
    }
}

impl Oscillations {
    /// The path of a motion for a seed; `amplitude` 1 has peaks of some hundredths of a radian and
    /// some tenths of a metre.
    pub fn new(motion: Motion, amplitude: f64, fps: f64, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut path =
            Self { fps, rotation: Default::default(), position: Default::default(), zoom: Vec::new() };
        match motion {
            Motion::Still => {}
            Motion::SpiralRotation => path.spiral(&mut random),
            Motion::Rotation => path.rotate(&mut random),
            Motion::Translation => path.translate(&mut random),
            Motion::RotationAndTranslation => {
                path.rotate(&mut random);
                path.translate(&mut random);
            }
            Motion::Shake { lowest, highest, sway } => path.shake(&mut random, [lowest, highest], sway),
            Motion::Vibration => path.vibrate(&mut random),
            Motion::Rattle { lowest, highest } => path.rattle(&mut random, [lowest, highest]),
            Motion::Pan => path.pan(&mut random),
            Motion::Drive => path.drive(&mut random),
            Motion::Follow => path.follow(&mut random),
            Motion::Scroll { lowest, highest } => path.scroll(&mut random, [lowest, highest]),
            Motion::Steer => path.steer(&mut random),
            Motion::Zoom { factor } => {
                path.shake(&mut random, [0.015, 0.15], 0.01);
                // From the trough at frame 0 to the crest at frame 24.
                path.zoom.push(Oscillation {
                    amplitude: 0.5 * factor.ln(),
                    frequency: 1.0 / 48.0,
                    phase: -0.25,
                });
            }
        }
        for axis in path.rotation.iter_mut().chain(&mut path.position) {
            axis.iter_mut().for_each(|oscillation| oscillation.amplitude *= amplitude);
        }
        path
    }

    /// Two circles at neighbouring frequencies: their sum is a spiral, inwards and outwards.
    fn spiral(&mut self, random: &mut ChaCha8Rng) {
        let phase: f64 = random.random();
        for (axis, quarter) in [(0, 0.25), (1, 0.0)] {
            let circle = |amplitude, frequency| Oscillation { amplitude, frequency, phase: phase + quarter };
            self.rotation[axis] = vec![circle(0.1, 0.048), circle(0.04, 0.032)];
        }
        self.rotation[2] = vec![Oscillation { amplitude: 0.05, frequency: 0.03, phase }];
    }

    fn rotate(&mut self, random: &mut ChaCha8Rng) {
        for (axis, amplitude) in [(0, 0.05), (1, 0.07), (2, 0.08)] {
            self.rotation[axis] = band(random, amplitude, [0.015, 0.06], 3);
        }
    }

    fn translate(&mut self, random: &mut ChaCha8Rng) {
        for (axis, amplitude) in [(0, 0.3), (1, 0.18), (2, 0.15)] {
            self.position[axis] = band(random, amplitude, [0.015, 0.045], 2);
        }
    }

    fn shake(&mut self, random: &mut ChaCha8Rng, [lowest, highest]: [f64; 2], sway: f64) {
        for (turn, shift) in self.rotation.iter_mut().zip(&mut self.position) {
            *turn = band(random, 0.03, [lowest, highest], 8);
            *shift = band(random, sway, [lowest, 0.5 * (lowest + highest)], 4);
        }
    }

    fn rattle(&mut self, random: &mut ChaCha8Rng, limits: [f64; 2]) {
        self.shake(random, [0.015, 0.15], 0.01);
        for (axis, amplitude) in [0.006, 0.006, 0.004].into_iter().enumerate() {
            self.rotation[axis].extend(band(random, amplitude, limits, 4));
        }
    }

    fn pan(&mut self, random: &mut ChaCha8Rng) {
        self.shake(random, [0.02, 0.15], 0.01);
        self.rotation.iter_mut().flatten().for_each(|oscillation| oscillation.amplitude *= 0.7);
        // 2π · 0.04 · 0.9 = 0.226 rad a frame where it is fastest.
        self.rotation[1].push(Oscillation { amplitude: 0.9, frequency: 0.04, phase: random.random() });
    }

    fn drive(&mut self, random: &mut ChaCha8Rng) {
        self.shake(random, [0.04, 0.25], 0.01);
        self.rotation.iter_mut().flatten().for_each(|oscillation| oscillation.amplitude *= 0.7);
        // The steep part of a wave of a thousand frames: 2π · 0.001 · 64 = 0.4 m a frame.
        self.position[2].push(Oscillation { amplitude: 64.0, frequency: 0.001, phase: 0.0 });
    }

    fn follow(&mut self, random: &mut ChaCha8Rng) {
        self.shake(random, [0.02, 0.15], 0.01);
        self.rotation.iter_mut().flatten().for_each(|oscillation| oscillation.amplitude *= 0.5);
        self.position[0].push(Oscillation { amplitude: 1.2, frequency: 0.02, phase: random.random() });
    }

    fn scroll(&mut self, random: &mut ChaCha8Rng, limits: [f64; 2]) {
        for (axis, amplitude) in [(0, 0.5), (1, 0.05)] {
            self.position[axis] = band(random, amplitude, limits, 6);
        }
    }

    fn steer(&mut self, random: &mut ChaCha8Rng) {
        self.rotation[1] = band(random, 0.3, [0.02, 0.12], 4);
        self.position[0] = band(random, 0.3, [0.02, 0.12], 4);
        // The steep part of a wave of a thousand frames: 2π · 0.001 · 32 = 0.2 m a frame.
        self.position[2].push(Oscillation { amplitude: 32.0, frequency: 0.001, phase: 0.0 });
    }

    fn vibrate(&mut self, random: &mut ChaCha8Rng) {
        // Off whole numbers: what makes a whole number of cycles a frame hardly shows between frames
        // to any method, for all rows come back to where they were.
        let bands = [(0.01, [1.1, 2.3]), (0.01, [1.2, 2.45]), (0.008, [1.3, 2.4])];
        for (axis, (amplitude, limits)) in bands.into_iter().enumerate() {
            self.rotation[axis] = band(random, amplitude, limits, 4);
            self.rotation[axis].extend(band(random, 0.5 * amplitude, [0.01, 0.05], 2));
        }
    }
}

/// `count` oscillations spread over a band of frequencies, the ends included, with random phases.
///
/// Peaks fall as one over the frequency, so that each has about the same peak velocity and the
/// highest ones matter as much to the shutter as the lowest; all peaks together reach `peak`.
fn band(random: &mut ChaCha8Rng, peak: f64, [low, high]: [f64; 2], count: usize) -> Vec<Oscillation> {
    let frequency = |index: usize| low + (high - low) * index as f64 / (count.max(2) - 1) as f64;
    let total: f64 = (0..count).map(|index| low / frequency(index)).sum();
    (0..count)
        .map(|index| Oscillation {
            amplitude: peak * low / frequency(index) / total,
            frequency: frequency(index),
            phase: random.random(),
        })
        .collect()
}

/// Two oscillations, each with its share of an amplitude, its frequency and a random phase.
pub(super) fn two(random: &mut ChaCha8Rng, amplitude: f64, parts: [(f64, f64); 2]) -> Vec<Oscillation> {
    let oscillation = |(share, frequency): (f64, f64)| Oscillation {
        amplitude: share * amplitude,
        frequency,
        phase: random.random(),
    };
    parts.map(oscillation).to_vec()
}

/// A path that turns about the optical axis at a constant rate (rad/s) and moves at a constant
/// velocity (m/s): the one with closed forms.
pub fn uniform(roll: f64, velocity: Vector3<f64>) -> impl CameraPath {
    move |t: f64| Pose {
        rotation: Rotation3::from_axis_angle(&Vector3::z_axis(), roll * t),
        position: velocity * t,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spiral_goes_round_with_a_changing_radius() {
        let path = Oscillations::new(Motion::SpiralRotation, 1.0, 30.0, 3);
        let radii: Vec<f64> =
            (0..2000).map(|i| path.pose(f64::from(i) / 60.0).rotation.scaled_axis().xy().norm()).collect();
        let (low, high) = radii.iter().fold((1.0f64, 0.0f64), |(l, h), r| (l.min(*r), h.max(*r)));
        assert!((low - 0.06).abs() < 2e-3 && (high - 0.14).abs() < 2e-3, "{low} {high}");
    }

    #[test]
    fn motions_keep_to_their_band_and_peak() {
        let limits = [
            (Motion::Rotation, 0.06, 0.08),
            (Motion::Translation, 0.045, 0.3),
            (Motion::Shake { lowest: 0.04, highest: 0.4, sway: 0.01 }, 0.4, 0.03),
            (Motion::Vibration, 2.5, 0.015),
        ];
        for (motion, highest, peak) in limits {
            let path = Oscillations::new(motion, 1.0, 30.0, 9);
            for axis in path.rotation.iter().chain(&path.position) {
                let reached = axis.iter().map(|o| o.frequency).fold(0.0, f64::max);
                assert!(axis.is_empty() || reached <= highest + 1e-12, "{motion:?}: {reached}");
                let sum: f64 = axis.iter().map(|o| o.amplitude).sum();
                assert!(sum <= peak + 1e-12, "{motion:?}: {sum}");
            }
        }
    }

    #[test]
    fn the_zoom_rises_by_its_factor_whatever_the_amplitude() {
        for amplitude in [0.0, 3.0] {
            let path = Oscillations::new(Motion::Zoom { factor: 1.4 }, amplitude, 30.0, 9);
            let zooms: Vec<f64> = (0..=24).map(|k| path.zoom(f64::from(k) / 30.0)).collect();
            assert!(zooms.is_sorted());
            assert!((zooms[24] / zooms[0] - 1.4).abs() < 1e-12 && (zooms[12] - 1.0).abs() < 1e-12);
        }
        assert_eq!(Oscillations::new(Motion::Pan, 1.0, 30.0, 9).zoom(0.3), 1.0);
    }

    #[test]
    fn the_seed_and_nothing_else_decides() {
        let motion = Motion::Shake { lowest: 0.04, highest: 0.4, sway: 0.01 };
        let path = |seed| Oscillations::new(motion, 1.0, 30.0, seed);
        assert_eq!(path(5), path(5));
        assert_ne!(path(5), path(6));
    }

    #[test]
    fn frequencies_count_in_frames() {
        let pose = |fps: f64| Oscillations::new(Motion::Rotation, 1.0, fps, 2).pose(7.0 / fps);
        assert!((pose(30.0).rotation.inverse() * pose(60.0).rotation).angle() < 1e-7);
    }
}
