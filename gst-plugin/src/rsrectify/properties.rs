// SPDX-License-Identifier: MIT OR Apache-2.0

//! The element's settings, and what they mean to the library. Names, types and ranges of their properties are in `imp`.
//!
//! Defaults are stored in project files and presets: never change one.

use super::enums::{BorderMode, Effort, Estimator, Interpolation, Model, ReadoutDirection, Stabilised};
use gst::glib;
use gst::prelude::*;
use rsrectify::motion::FrameMotion;
use rsrectify::readout::{ReadoutPrior, ReadoutTime};
use rsrectify::{rectifier, warp};

/// Standard deviation of an expected readout time for which none is given, as a share of it: that of values which one person
/// measured, see `program/cameras/README.md`.
const USUAL_DEVIATION: f64 = 0.1;

/// What the user has set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    pub grid_columns: u32,
    pub grid_rows: u32,
    pub inter_frame_delay: f64,
    pub readout_time: u64,
    pub readout_direction: ReadoutDirection,
    pub lookahead: u32,
    pub effort: Effort,
    pub estimator: Estimator,
    pub model: Model,
    pub focal_length: f64,
    pub reference_row: f64,
    pub interpolation: Interpolation,
    pub border_mode: BorderMode,
    pub border_color: u32,
    pub crop: f64,
    pub strength: f64,
    pub threads: u32,
    pub post_messages: bool,
    pub attach_meta: bool,
    pub processing_deadline: u64,
    pub expected_readout_time: u64,
    pub expected_readout_deviation: u64,
    pub expected_readout_direction: ReadoutDirection,
    pub stabilised: Stabilised,
    pub stabilization: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl Settings {
    /// What holds until the user sets something else.
    pub const DEFAULT: Self = Self {
        grid_columns: 32,
        grid_rows: 24,
        inter_frame_delay: -1.0,
        readout_time: 0,
        readout_direction: ReadoutDirection::Auto,
        lookahead: 4,
        effort: Effort::Balanced,
        estimator: Estimator::Auto,
        model: Model::Auto,
        focal_length: 0.0,
        reference_row: 0.5,
        interpolation: Interpolation::Cubic,
        border_mode: BorderMode::Replicate,
        border_color: 0xff00_0000,
        crop: 5.0,
        strength: 1.0,
        threads: 0,
        post_messages: false,
        attach_meta: false,
        processing_deadline: 0,
        expected_readout_time: 0,
        expected_readout_deviation: 0,
        expected_readout_direction: ReadoutDirection::Auto,
        stabilised: Stabilised::Auto,
        stabilization: 0.0,
    };

    /// How the stream is analysed.
    ///
    /// What is known for certain wins: a readout time, else a delay.
    pub fn analysis(&self) -> rectifier::Settings {
        let readout_time = if self.readout_time != 0 {
            ReadoutTime::Seconds(self.readout_time as f64 * 1e-9)
        } else if self.inter_frame_delay >= 0.0 {
            ReadoutTime::DelayRows(self.inter_frame_delay)
        } else {
            ReadoutTime::Unknown
        };
        let mut settings = rectifier::Settings::default();
        settings.grid_columns = self.grid_columns as usize;
        settings.grid_rows = self.grid_rows as usize;
        settings.lookahead = self.lookahead as usize;
        settings.effort = self.effort.into();
        settings.estimator = self.estimator.into();
        settings.model = self.model.into();
        settings.focal_length = (self.focal_length > 0.0).then_some(self.focal_length);
        settings.direction = self.readout_direction.into();
        settings.readout_time = readout_time;
        settings.readout_prior = self.readout_prior();
        settings.stabilised = self.stabilised.into();
        settings.stabilization = self.stabilization;
        if self.border_mode == BorderMode::Crop {
            settings.margin = self.crop / 200.0;
        }
        settings
    }

    /// What is expected of the readout; `None` where nothing is.
    fn readout_prior(&self) -> Option<ReadoutPrior> {
        let time = self.expected_readout_time as f64 * 1e-9;
        let deviation = match self.expected_readout_deviation {
            0 => USUAL_DEVIATION * time,
            nanoseconds => nanoseconds as f64 * 1e-9,
        };
        let prior = ReadoutPrior::new(time, deviation, self.expected_readout_direction.into());
        prior.ok().filter(|_| self.expected_readout_time != 0)
    }

    /// How a frame is rectified, apart from the border, whose samples depend on the format.
    pub fn warp(&self) -> warp::WarpSettings {
        let zoom = match self.border_mode {
            BorderMode::Crop => 1.0 / (1.0 - self.crop / 100.0),
            _ => 1.0,
        };
        let mut settings = warp::WarpSettings::default();
        settings.interpolation = self.interpolation.into();
        settings.reference_row = self.reference_row;
        settings.strength = self.strength;
        settings.zoom = zoom;
        settings.hide_borders = zoom > 1.0;
        settings
    }

    /// Whether a frame with this motion comes out as it went in.
    pub fn leaves_untouched(&self, motion: &FrameMotion) -> bool {
        (motion.is_still() || self.strength == 0.0) && self.warp().zoom == 1.0
    }
}

/// The description of the property that is not a setting.
pub fn stats() -> glib::ParamSpec {
    glib::ParamSpecBoxed::builder::<gst::Structure>("stats")
            .nick("Statistics")
            .blurb("Frames so far, what was found in the last one (readout-time with its readout-deviation, readout-direction, confidence ...), and mean milliseconds per stage")
            .read_only()
            .build()
}

#[cfg(test)]
#[path = "properties_tests.rs"]
mod tests;
