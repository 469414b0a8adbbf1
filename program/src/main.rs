// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify`: takes rolling-shutter distortion out of video files, and measures it.
//!
//! The GStreamer element is part of the program; nothing else has to be installed for it to be found.
//!
//! | task | modules |
//! |---|---|
//! | the commands, each with its options | `fix`, `measure`, `track`, `index`, `join`, `plot`, `show` |
//! | clips by name, files, images, pipes, parts of a clip | `clips`, `input`, `part` |
//! | decoding and analysis of the frames | `decoder`, `analysis`, `playback`, `elements` |
//! | readout, camera and focal length, before a clip is rectified | `readout`, `camera`, `estimate` |
//! | lookahead and crop for stabilisation, before a clip is rectified | `steady` |
//! | motion of a clip from a motion file | `motions` |
//! | what was done with a clip, and why frames keep their picture | `summary`, `as_recorded` |
//! | codecs, encoders, containers, the finished file | `output` |
//! | audio, subtitles, timecode and other streams of the clip | `streams` |
//! | containers read without GStreamer | `isobmff`, `boxes`, `corrections`, `matroska`, `packets`, `times` |
//! | options of the rectifier and their values | `rectifier_options`, `property_values` |

mod analysis;
mod as_recorded;
mod boxes;
mod camera;
mod clips;
mod colour;
mod corrections;
mod damage;
mod decoder;
mod drawing;
mod elements;
mod estimate;
mod fix;
mod frame_rate;
mod index;
mod input;
mod interruption;
mod isobmff;
mod join;
mod matroska;
mod measure;
mod messages;
mod motions;
mod output;
mod packets;
mod part;
mod picture;
mod playback;
mod plot;
mod progress;
mod property_values;
mod readout;
mod rectifier_options;
mod show;
mod steady;
mod streams;
mod summary;
mod times;
mod track;

use anyhow::{Context, Result};
use clap::{CommandFactory, Parser, Subcommand};
use interruption::{Interrupted, Interruption};
use std::path::PathBuf;
use std::process::ExitCode;

const EXIT_CODES: &str = "Exit codes:
  0    everything was done
  1    a clip failed or is damaged; the others were done
  2    the command line cannot be carried out
  130  interrupted; no half file is left";

/// Takes rolling-shutter distortion out of video files.
#[derive(Parser)]
#[command(name = "rsrectify", version, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Rectifies clips. Audio, subtitles, timecode, chapters and colour metadata are kept as far as the container
    /// can hold them.
    #[command(after_help = EXIT_CODES)]
    Fix(Box<fix::FixOptions>),
    /// Measures the readout time of the clips' cameras, its direction, and the focal length.
    #[command(after_help = EXIT_CODES)]
    Measure(measure::MeasureOptions),
    /// Writes the motion of each frame and row, and a virtual gyroscope for Gyroflow.
    #[command(after_help = EXIT_CODES)]
    Track(Box<track::TrackOptions>),
    /// Lists when the frames of a clip are shown, for --index of the commands that take --frames.
    #[command(after_help = EXIT_CODES)]
    Index(index::IndexOptions),
    /// Puts rectified parts of a clip together, without encoding them again, beside the clip's other streams.
    #[command(after_help = EXIT_CODES)]
    Join(join::JoinOptions),
    /// Draws the motion of a clip, its readout and its confidence over time, as SVG or PNG.
    #[command(after_help = EXIT_CODES)]
    Plot(plot::PlotOptions),
    /// Draws correspondences, the correction and the confidence over a clip.
    #[command(after_help = EXIT_CODES)]
    Show(Box<show::ShowOptions>),
    /// Lists the cameras whose readout is known.
    #[command(after_help = EXIT_CODES)]
    Cameras(camera::CamerasOptions),
    /// Prints what a shell needs to complete the command line.
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
    /// Writes the manual pages: rsrectify.1, rsrectify-fix.1 and so on.
    Man {
        /// The folder, such as ~/.local/share/man/man1.
        folder: PathBuf,
    },
}

/// What the commands that play clips need.
fn start() -> Result<Interruption> {
    gst::init()?;
    gstrsrectify::plugin_register_static()?;
    elements::prefer_whole_decoders();
    Interruption::catch()
}

fn run(cli: &Cli) -> Result<bool> {
    match &cli.command {
        Command::Fix(options) => fix::run(options, &start()?),
        Command::Measure(options) => measure::run(options, &start()?),
        Command::Track(options) => track::run(options, &start()?),
        Command::Index(options) => index::run(options, &start()?),
        Command::Join(options) => join::run(options, &start()?),
        Command::Plot(options) => plot::run(options, &start()?),
        Command::Show(options) => show::run(options, &start()?),
        Command::Cameras(options) => camera::run(options),
        Command::Completions { shell } => {
            let mut text = Vec::new();
            clap_complete::generate(*shell, &mut Cli::command(), "rsrectify", &mut text);
            progress::print(&text)?;
            Ok(true)
        }
        Command::Man { folder } => {
            std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
            clap_mangen::generate_to(Cli::command(), folder)
                .with_context(|| format!("cannot write to {}", folder.display()))?;
            Ok(true)
        }
    }
}

fn main() -> ExitCode {
    if let Err(error) = messages::start() {
        eprintln!("error: {error:#}");
        return ExitCode::from(2);
    }
    match run(&Cli::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) if error.is::<Interrupted>() => {
            log::info!("interrupted");
            ExitCode::from(130)
        }
        Err(error) => {
            log::error!("{error:#}");
            ExitCode::from(2)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
