//! What the user may ask of `fix`.

use super::streams::Audio;
use crate::output::codec::{Codec, Container};
use crate::rectifier_options::RectifierOptions;
use clap::Args;
use std::path::PathBuf;

/// What the user may ask of `fix`.
#[derive(Args, Debug)]
pub struct FixOptions {
    /// Clips, folders of clips, or patterns such as 'card/*.MP4'.
    #[arg(required = true, value_name = "CLIP")]
    pub clips: Vec<PathBuf>,
    /// The file to write, or the folder for all; without it each clip goes beside its original, its name ending in
    /// -rectified. A folder is one that is there already, ends in a slash, or is meant for several clips.
    #[arg(long, short, value_name = "FILE|FOLDER")]
    pub output: Option<PathBuf>,
    /// Replaces files that are there.
    #[arg(long)]
    pub overwrite: bool,
    /// Says which file each clip would become, without opening it.
    #[arg(long)]
    pub dry_run: bool,
    /// Shows each clip before and after, side by side.
    #[arg(long)]
    pub compare: bool,
    /// How the video is encoded.
    #[arg(long, value_enum, default_value = "h264")]
    pub codec: Codec,
    /// The kind of file; without it the one that the output's name says, else the clip's own, else the codec's usual one.
    #[arg(long, value_enum)]
    pub container: Option<Container>,
    /// Constant quality on the encoder's scale, 0 the best: H.264 to 50 and HEVC to 51 (18 unless given), AV1
    /// to 63 (20); ProRes and FFV1 have none.
    #[arg(long)]
    pub quality: Option<u32>,
    /// Bit rate in kbit/s instead of a constant quality.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=100_000), conflicts_with = "quality")]
    pub bitrate: Option<u32>,
    /// What becomes of the audio.
    #[arg(long, value_enum, default_value = "copy")]
    pub audio: Audio,
    #[command(flatten)]
    pub rectifier: RectifierOptions,
}
