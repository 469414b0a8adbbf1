// SPDX-License-Identifier: MIT OR Apache-2.0

//! What a command line may change of a sequence.

use crate::sequence::Settings;
use clap::Args;

/// What may be changed of a sequence.
#[derive(Args)]
pub struct Changes {
    /// Number of frames.
    #[arg(long)]
    pub frames: Option<usize>,
    /// Frame width in pixels.
    #[arg(long)]
    pub width: Option<usize>,
    /// Frame height in pixels.
    #[arg(long)]
    pub height: Option<usize>,
    /// Seed of path, textures and noise.
    #[arg(long)]
    pub seed: Option<u64>,
}

impl Changes {
    /// The settings with these changes.
    pub fn apply(&self, mut settings: Settings) -> Settings {
        settings.frames = self.frames.unwrap_or(settings.frames);
        settings.width = self.width.unwrap_or(settings.width);
        settings.height = self.height.unwrap_or(settings.height);
        settings.seed = self.seed.unwrap_or(settings.seed);
        settings
    }
}
