// SPDX-License-Identifier: MIT OR Apache-2.0

//! What determines a sequence.

use super::{Gain, Move, Stabilisation, Timeline};
use crate::scene::path::Motion;
use crate::scene::{FirstEdge, SceneKind};
use serde::Serialize;

/// How strong the motion is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Strength {
    /// A factor on the motion's own amplitude.
    Amplitude(f64),
    /// So strong that the frames as they are seen lie this many pixels (RMS) from their truth.
    Displacement(f64),
}

/// Everything that determines a sequence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Settings {
    /// The sequence's name.
    pub name: String,
    /// Frame width in pixels.
    pub width: usize,
    /// Frame height in pixels.
    pub height: usize,
    /// Number of frames that are captured.
    pub frames: usize,
    /// Frames captured a second.
    pub fps: f64,
    /// How the captures become the frames of the clip.
    pub timeline: Timeline,
    /// The capture from which another camera films another room.
    pub cut: Option<usize>,
    /// Readout ratio γ = T / frame period, 0 (global shutter) to 1.
    pub readout_ratio: f64,
    /// The edge exposed first.
    pub first: FirstEdge,
    /// How the camera's gain changes, if it does.
    pub gain: Option<Gain>,
    /// Standard deviation of the sensor noise in grey levels.
    pub noise: f32,
    /// What the camera does against shake, if it does.
    pub stabilisation: Option<Stabilisation>,
    /// H.264 at so many kilobits a second; `None` leaves the frames uncompressed.
    pub bitrate: Option<u32>,
    /// How the camera moves.
    pub motion: Motion,
    /// How strongly.
    pub strength: Strength,
    /// Seed of the path, the textures and the noise.
    pub seed: u64,
    /// Exposure time in seconds: how long each line collects light; 0 is without motion blur.
    pub exposure: f64,
    /// Radial distortion k₁, k₂ of the lens, as in [`Lens::distortion`](crate::scene::Lens).
    pub distortion: [f64; 2],
    /// What is seen.
    pub scene: SceneKind,
}

impl Settings {
    pub(super) fn new(name: &str, motion: Motion, strength: Strength) -> Self {
        Self {
            name: name.into(),
            width: 640,
            height: 480,
            frames: 24,
            fps: 30.0,
            timeline: Timeline::Whole,
            cut: None,
            readout_ratio: 1.0,
            first: FirstEdge::Top,
            gain: None,
            noise: 0.0,
            stabilisation: None,
            bitrate: None,
            motion,
            strength,
            seed: 1,
            exposure: 0.0,
            distortion: [0.0; 2],
            scene: SceneKind::Room,
        }
    }

    /// As clips mostly come: small, with some noise, through H.264.
    pub(super) fn compressed(name: &str, motion: Motion, strength: Strength) -> Self {
        Self {
            width: 480,
            height: 360,
            noise: 2.0,
            frames: 30,
            bitrate: Some(1000),
            ..Self::new(name, motion, strength)
        }
    }

    /// With `rows` blank rows between frames of 480: γ = 480 / (480 + rows), whatever the size.
    pub(super) fn blank_rows(mut self, rows: f64) -> Self {
        self.readout_ratio = 480.0 / (480.0 + rows);
        self
    }

    /// Frames a second of the clip.
    pub fn delivered_fps(&self) -> f64 {
        self.timeline.fps(self.fps)
    }

    /// Readout time T of the camera in seconds.
    pub fn readout_time(&self) -> f64 {
        self.readout_ratio / self.fps
    }

    /// Readout time in seconds of the rows that a delivered frame shows: a crop by the share c leaves (1 − c)·T, a
    /// stabiliser that turns each row by itself nothing.
    pub fn delivered_readout_time(&self) -> f64 {
        match self.stabilisation {
            None => self.readout_time(),
            Some(Stabilisation { kind: Move::TurnByRow, .. }) => 0.0,
            Some(Stabilisation { zoom, .. }) => self.readout_time() / zoom,
        }
    }
}
