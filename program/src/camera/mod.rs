// SPDX-License-Identifier: MIT OR Apache-2.0

//! Cameras whose readout is known, which of them made a clip, and what it states itself.

mod catalogue;
mod known;
mod presets;
mod stated;

use crate::property_values::{Direction, name_of};
use anyhow::{Context, Result};
use catalogue::{Camera, Mode, key};
use clap::Args;
pub use known::{Expectation, Known};
use presets::Presets;
pub use stated::Stated;
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::str::FromStr;

/// Which camera's readout is expected.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum CameraChoice {
    /// The one that the file names.
    #[default]
    Auto,
    /// None.
    None,
    /// This one.
    Named(Box<Camera>),
}

impl FromStr for CameraChoice {
    type Err = anyhow::Error;

    /// # Errors
    /// If a camera is named that is not known.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "auto" => Ok(Self::Auto),
            "none" => Ok(Self::None),
            name => {
                let is_called = |camera: &Camera| {
                    [camera.name(), camera.model.clone()].iter().any(|own| key(own) == key(name))
                };
                let known = catalogue::cameras()?.into_iter().find(is_called);
                let known =
                    known.context("no such camera is known; `rsrectify cameras` lists those that are")?;
                Ok(Self::Named(Box::new(known)))
            }
        }
    }
}

impl CameraChoice {
    /// What is known of the camera of a clip; `None` where nothing is. A camera that the user names, or `none`, counts instead
    /// of the readout that the file states; stabilisation counts in any case.
    pub fn of(&self, clip: &Path) -> Result<Option<Known>> {
        let stated = stated::read(clip);
        let camera = match self {
            Self::None => None,
            Self::Auto => match (&stated.maker, &stated.model) {
                (Some(maker), Some(model)) => {
                    let is_named = |camera: &Camera| camera.is_stated_as(maker, model);
                    catalogue::cameras()?.into_iter().find(is_named)
                }
                _ => None,
            },
            Self::Named(camera) => Some(camera.as_ref().clone()),
        };
        let is_known = camera.is_some() || stated != Stated::default();
        Ok(is_known.then_some(Known { stated, camera, heeds_statement: *self == Self::Auto }))
    }
}

/// What the user may ask of `cameras`.
#[derive(Args, Debug)]
pub struct CamerasOptions {
    /// Lists the cameras whose name has this in it.
    pub name: Option<String>,
    /// Prints them as presets of the GStreamer element, for a file GstRsRectify.prs.
    #[arg(long)]
    pub presets: bool,
}

/// Lists the cameras.
pub fn run(options: &CamerasOptions) -> Result<bool> {
    let mut cameras = catalogue::cameras()?;
    if let Some(name) = &options.name {
        cameras.retain(|camera| key(&camera.name()).contains(&key(name)));
        if cameras.is_empty() {
            log::error!("no camera whose name has {name} in it is known");
            return Ok(false);
        }
    }
    let text =
        if options.presets { Presets(&cameras).to_string() } else { cameras.iter().map(list).collect() };
    match std::io::stdout().write_all(text.as_bytes()) {
        // Who reads has seen enough.
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(true),
        written => Ok(written.map(|()| true)?),
    }
}

fn list(camera: &Camera) -> String {
    let modes = camera.modes.iter().map(|mode| format!("  {}\n", line(mode)));
    format!("{}\n{}", camera.name(), modes.collect::<String>())
}

fn line(mode: &Mode) -> String {
    let direction = name_of(&Direction::from(mode.direction()));
    let (time, deviation) = (mode.milliseconds(), mode.deviation());
    format!("{:<16} {time:>5.1} ms ± {deviation:.1}, {direction}; {}", mode.name(), mode.source())
}
