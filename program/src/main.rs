//! `rsrectify`: takes rolling-shutter distortion out of video files, and measures it.
//!
//! The GStreamer element is part of the program; nothing else has to be installed for it to be found.

mod analysis;
mod clips;
mod elements;
mod fix;
mod interruption;
mod measure;
mod playback;
mod readout;
mod rectifier_options;
mod track;

use anyhow::Result;
use clap::{Parser, Subcommand};
use interruption::{Interrupted, Interruption};
use std::process::ExitCode;

const EXIT_CODES: &str = "Exit codes:
  0    everything was done
  1    a clip failed, the others were done
  2    the command line asks for something that cannot be
  130  interrupted; no half file is left";

/// Takes rolling-shutter distortion out of video files.
#[derive(Parser)]
#[command(version, after_help = EXIT_CODES)]
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
}

fn run(cli: &Cli) -> Result<bool> {
    gst::init()?;
    gstrsrectify::plugin_register_static()?;
    let interruption = Interruption::catch()?;
    match &cli.command {
        Command::Fix(options) => fix::run(options, &interruption),
        Command::Measure(options) => measure::run(options, &interruption),
        Command::Track(options) => track::run(options, &interruption),
    }
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) if error.is::<Interrupted>() => {
            eprintln!("interrupted");
            ExitCode::from(130)
        }
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(2)
        }
    }
}
