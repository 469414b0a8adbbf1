// SPDX-License-Identifier: MIT OR Apache-2.0

//! The command line of the renderer.

use anyhow::Result;
use clap::{Parser, Subcommand};
use render::changes::Changes;
use render::sequence::{self, Sequence, Settings};
use render::video;
use std::path::{Path, PathBuf};

/// Renders rolling-shutter sequences.
#[derive(Parser)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Renders a named sequence.
    Sequence {
        /// Its name, one of those that `list` prints.
        name: String,
        /// The YUV4MPEG2 file to write; `-` is the standard output.
        #[arg(long)]
        out: PathBuf,
        #[command(flatten)]
        changes: Changes,
    },
    /// Renders a strongly shaken clip in colour.
    Demo {
        /// The YUV4MPEG2 file to write; `-` is the standard output.
        #[arg(long)]
        out: PathBuf,
        #[command(flatten)]
        changes: Changes,
    },
    /// Prints the names of the sequences.
    List,
}

fn main() -> Result<()> {
    match Cli::parse().command {
        Command::Sequence { name, out, changes } => write(changes.apply(sequence::named(&name)?), &out),
        Command::Demo { out, changes } => write(changes.apply(sequence::demo()), &out),
        Command::List => {
            sequence::all().for_each(|settings| println!("{}", settings.name));
            Ok(())
        }
    }
}

fn write(settings: Settings, out: &Path) -> Result<()> {
    let (size, fps) = ([settings.width, settings.height], settings.delivered_fps());
    video::write(out, size, fps, Sequence::new(settings).frames()?)
}
