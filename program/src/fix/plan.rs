// SPDX-License-Identifier: MIT OR Apache-2.0

//! Arguments → jobs: which clip becomes which file.

use super::options::FixOptions;
use super::pipeline::Recipe;
use crate::clips;
use crate::input::{Clip, Numbered};
use crate::interruption::Interruption;
use crate::motions::Motions;
use crate::output::codec::Codec;
use crate::output::container::Container;
use crate::output::encoding::CodecChoice;
use crate::output::{self, Target, choice};
use crate::picture::Picture;
use anyhow::{Context, Result, bail};
use serde::Serialize;
use std::path::Path;

/// One clip to be rectified.
#[derive(Debug)]
pub struct Job {
    /// The clip.
    pub input: Clip,
    /// Where it goes.
    pub output: Target,
    /// Whether the user named the folder only.
    pub is_in_folder: bool,
    /// How.
    pub recipe: Recipe,
}

impl Job {
    /// The codec that the clip would get; it is opened where that depends on it.
    pub fn codec(&self) -> Result<Codec> {
        let Recipe { encoding, container, .. } = &self.recipe;
        if let CodecChoice::Of(codec) = encoding.codec {
            return Ok(codec);
        }
        let chosen = choice::choose(encoding, &Picture::of(&self.input)?, *container)?;
        Ok(chosen.encoding.codec())
    }
}

/// A job as it is printed.
#[derive(Debug, Serialize)]
pub struct Listing {
    clip: String,
    output: String,
    /// `None` of a clip that cannot be opened.
    codec: Option<String>,
    container: String,
}

impl Listing {
    /// What each of the jobs would do; an error where that cannot be written.
    pub fn of(jobs: &[Job], interruption: &Interruption) -> Result<Vec<Self>> {
        let listed = |job: &Job| {
            interruption.check()?;
            let Recipe { encoding, container, .. } = &job.recipe;
            encoding.check(*container)?;
            Ok(Self {
                clip: job.input.display().to_string(),
                output: job.output.to_string(),
                codec: job.codec().ok().map(|codec| codec.name().to_owned()),
                container: container.extension().to_owned(),
            })
        };
        jobs.iter().map(listed).collect()
    }
}

/// What is to be done; refuses what would write two clips to one file.
pub fn jobs(options: &FixOptions, interruption: &Interruption) -> Result<Vec<Job>> {
    let clips = clips::expand(&options.clips, options.recursive, &options.input, interruption)?;
    if options.motion.is_some() && clips.len() > 1 {
        bail!("--motion is of one clip, not of {}", clips.len());
    }
    let motions = options.motion.as_deref().map(Motions::open).transpose()?;
    let output = options.output.as_deref();
    if output == Some(Path::new("-")) && clips.len() > 1 {
        bail!("--output - takes one clip, not {}", clips.len());
    }
    let folder = output.filter(|output| clips.len() > 1 || output::is_folder(output));
    let mut jobs: Vec<Job> = Vec::new();
    for clips::Named { clip, below } in clips {
        let file = output.filter(|_| folder.is_none());
        let (container, output) = match file {
            Some(file) if file.as_os_str() == "-" => {
                let container = options.encoding.container.unwrap_or(Container::Y4m);
                if container.is_isobmff() {
                    bail!("{container} files cannot be written to a pipe: give --container y4m or mkv");
                }
                (container, Target::Pipe)
            }
            file => {
                let container = options.encoding.container(&clip, file)?;
                let folder = folder.map(|folder| folder.join(below));
                (container, target(&clip, file, folder.as_deref(), container)?)
            }
        };
        if let Some(other) = jobs.iter().find(|job| job.output == output) {
            bail!(
                "{} and {} would both be written to {output}; rectify them one by one",
                other.input.display(),
                clip.display(),
            );
        }
        let recipe = Recipe {
            encoding: options.encoding.clone(),
            container,
            audio: options.audio,
            compare: options.compare,
            rectifier: options.rectifier.clone(),
            motions: motions.clone(),
        };
        let is_named = file.is_none() && options.output.is_some();
        jobs.push(Job { input: clip, output, is_in_folder: is_named, recipe });
    }
    Ok(jobs)
}

/// Where a clip goes: to the file that is named, or into a folder, or beside itself.
fn target(clip: &Clip, file: Option<&Path>, folder: Option<&Path>, container: Container) -> Result<Target> {
    let images = |path: &Path| {
        let pattern = Numbered::of(path).context("is no pattern")?;
        Ok(Target::images(pattern, clip))
    };
    if let Some(file) = file {
        return if container == Container::Images { images(file) } else { Ok(Target::File(file.to_owned())) };
    }
    let beside = |ending: &str| {
        let output = output::beside(&clip.namesake()?, folder, ending);
        output.with_context(|| clip.display().to_string())
    };
    let Some(own) = clip.as_images().filter(|_| container == Container::Images) else {
        return beside(&format!("{}.{}", clips::RECTIFIED, container.extension())).map(Target::File);
    };
    let name = Path::new(&own.pattern.name()).with_extension(container.extension());
    images(&beside(clips::RECTIFIED)?.join(name))
}
