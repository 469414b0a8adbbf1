// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the user may ask of `fix`.

use crate::input::InputOptions;
use crate::output::encoding::EncodingOptions;
use crate::part::PartOptions;
use crate::rectifier_options::RectifierOptions;
use crate::streams::Audio;
use clap::Args;
use std::path::PathBuf;

/// Options of the analysis, of which there is none with a motion that is given.
const MOTION_IS_GIVEN: [&str; 12] = [
    "readout_time",
    "inter_frame_delay",
    "readout_direction",
    "stabilised",
    "effort",
    "estimator",
    "model",
    "focal_length",
    "lookahead",
    "grid_columns",
    "grid_rows",
    "stabilize",
];

/// What the user may ask of `fix`.
#[derive(Args, Debug)]
pub struct FixOptions {
    /// Clips, folders of clips, or patterns such as 'card/*.MP4'; numbered images such as frames/%06d.png, or a folder of them; -
    /// for Y4M or Matroska on the standard input.
    #[arg(required = true, value_name = "CLIP")]
    pub clips: Vec<PathBuf>,
    #[command(flatten)]
    pub input: InputOptions,
    /// The file to write, or the folder for all; without it each clip goes beside its original, its name ending in
    /// -rectified. A folder is one that is there already, ends in a slash, or is meant for several clips. A pattern such as
    /// frames/%06d.png writes numbered images; - writes Y4M, or MKV with --container mkv, to the standard output.
    #[arg(long, short, value_name = "FILE|FOLDER")]
    pub output: Option<PathBuf>,
    /// Takes the clips of folders in folders, too; below the output folder they keep their folders.
    #[arg(long, short)]
    pub recursive: bool,
    /// Replaces files that are there.
    #[arg(long)]
    pub overwrite: bool,
    /// Says which file each clip would become; with --codec same it is opened for its codec.
    #[arg(long)]
    pub dry_run: bool,
    /// Prints what was done with each clip as JSON, one object a line, and everything else to the standard error; with --dry-run
    /// an array of what would be done.
    #[arg(long)]
    pub json: bool,
    /// Adds all messages to this file, too, with the time.
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// Shows each clip before and after, side by side.
    #[arg(long)]
    pub compare: bool,
    #[command(flatten)]
    pub encoding: EncodingOptions,
    /// What becomes of the audio.
    #[arg(long, value_enum, default_value = "copy")]
    pub audio: Audio,
    /// Applies the motion that `rsrectify track --motion` has written instead of looking for it: of the clip, of a trimmed one
    /// that keeps its times, or of one of another size.
    #[arg(long, value_name = "FILE", conflicts_with_all = MOTION_IS_GIVEN)]
    pub motion: Option<PathBuf>,
    #[command(flatten)]
    pub part: PartOptions,
    #[command(flatten)]
    pub rectifier: RectifierOptions,
}
