//! Arguments → jobs: which clip becomes which file.

use super::options::FixOptions;
use super::pipeline::Recipe;
use crate::clips;
use crate::motions::Motions;
use crate::output;
use crate::property_values::name_of;
use anyhow::{Context, Result, bail};
use serde::Serialize;
use std::path::PathBuf;

/// One clip to be rectified.
#[derive(Debug)]
pub struct Job {
    /// The clip.
    pub input: PathBuf,
    /// The file to write.
    pub output: PathBuf,
    /// Whether the user named the folder only.
    pub is_in_folder: bool,
    /// How.
    pub recipe: Recipe,
}

/// A job as it is printed.
#[derive(Debug, Serialize)]
pub struct Listing {
    clip: String,
    output: String,
    codec: String,
    container: String,
}

impl Listing {
    /// What each of the jobs would do; an error where that cannot be written.
    pub fn of(jobs: &[Job]) -> Result<Vec<Self>> {
        let listed = |job: &Job| {
            let Recipe { codec, container, rate, .. } = job.recipe;
            codec.check(container, rate)?;
            Ok(Self {
                clip: job.input.display().to_string(),
                output: job.output.display().to_string(),
                codec: name_of(&codec),
                container: name_of(&container),
            })
        };
        jobs.iter().map(listed).collect()
    }
}

/// What is to be done; refuses what would write two clips to one file.
pub fn jobs(options: &FixOptions) -> Result<Vec<Job>> {
    let clips = clips::expand(&options.clips, options.recursive)?;
    if options.motion.is_some() && clips.len() > 1 {
        bail!("--motion is of one clip, not of {}", clips.len());
    }
    let motions = options.motion.as_deref().map(Motions::open).transpose()?;
    let output = options.output.as_deref();
    let folder = output.filter(|output| clips.len() > 1 || output::is_folder(output));
    let mut jobs: Vec<Job> = Vec::new();
    for clips::Named { path: clip, below } in clips {
        let file = output.filter(|_| folder.is_none());
        let container = options.encoding.container(&clip, file)?;
        let output = match file {
            Some(file) => file.to_owned(),
            None => {
                let ending = format!("{}.{}", clips::RECTIFIED, container.extension());
                let folder = folder.map(|folder| folder.join(below));
                let output = output::beside(&clip, folder.as_deref(), &ending);
                output.with_context(|| clip.display().to_string())?
            }
        };
        if let Some(other) = jobs.iter().find(|job| job.output == output) {
            bail!(
                "{} and {} would both be written to {}; rectify them one by one",
                other.input.display(),
                clip.display(),
                output.display()
            );
        }
        let recipe = Recipe {
            codec: options.encoding.codec,
            container,
            rate: options.encoding.rate(),
            audio: options.audio,
            compare: options.compare,
            rectifier: options.rectifier.clone(),
            motions: motions.clone(),
        };
        jobs.push(Job { input: clip, output, is_in_folder: folder.is_some(), recipe });
    }
    Ok(jobs)
}
