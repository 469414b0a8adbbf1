// SPDX-License-Identifier: MIT OR Apache-2.0

//! The command line of the evaluation.

use anyhow::Result;
use clap::{Args, Parser, Subcommand};
use eval::blind::{self, Blind, Extent};
use eval::clip;
use eval::dense;
use eval::effort;
use eval::metrics::{displacement, floor, ripple};
use eval::pairs;
use eval::readout;
use eval::report::{self, quick};
use eval::shutter::Shutter;
use eval::speed;
use eval::steady;
use eval::systems::product::{self, Delay};
use eval::two_frames;
use render::cache::Cache;
use render::changes::Changes;
use render::footage::{Footage, Truth};
use render::media;
use render::sequence::{self, Sequence, Settings};
use render::stats::{self, Stats, distances};
use rsrectify::rectifier::{Effort, Estimator, FrameSolution};
use std::path::PathBuf;

/// Judges rsrectify on rendered sequences, whose truth is exact, and on clips.
#[derive(Parser)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Measures the displacement the library leaves, and what no 2D rotation for each frame can remove.
    Measure {
        /// Frames the library may look ahead.
        #[arg(long, default_value_t = 4)]
        lookahead: usize,
        /// Prints the displacement left of each frame instead: readout given, readout unknown.
        #[arg(long, hide = true)]
        by_frame: bool,
        #[command(flatten)]
        chosen: Chosen,
    },
    /// Measures what each effort leaves of the distortion, readout unknown, and what its analysis takes.
    Effort {
        /// Frames the library may look ahead.
        #[arg(long, default_value_t = 4)]
        lookahead: usize,
        #[command(flatten)]
        chosen: Chosen,
    },
    /// Rectifies the second of two frames by these alone, readout given, and judges it; also the whole sequence, and its
    /// worst frame.
    TwoFrames {
        /// A folder with displacement fields of another program, as `scripts/dense-flow --fields` writes them, to be
        /// judged beside.
        #[arg(long)]
        against: Option<PathBuf>,
        #[command(flatten)]
        chosen: Chosen,
    },
    /// Finds the readout from the picture alone, and compares it with the truth.
    Readout {
        /// A real clip instead of sequences.
        #[arg(long, conflicts_with = "sequence")]
        clip: Option<PathBuf>,
        #[command(flatten)]
        chosen: Chosen,
    },
    /// Runs the library without a word about the camera, from several frames on and with several lookaheads, and counts
    /// the wrong readouts. Without names, of all sequences that a rolling shutter distorts; the next report then has
    /// the table.
    Blind {
        /// Measures each sequence once and runs only the estimator: quicker, and on the same data whatever estimates. Not
        /// where frames are repeated, which the estimator never sees.
        #[arg(long)]
        recorded: bool,
        /// Does 9 of the 30 runs of each sequence.
        #[arg(long)]
        few: bool,
        /// Does 3 runs of each sequence, with so many frames looked ahead.
        #[arg(long, conflicts_with = "few")]
        lookahead: Option<usize>,
        #[command(flatten)]
        chosen: Chosen,
    },
    /// Measures the library's dense flow against the exact one, and its time.
    Flow {
        /// Measures correspondences sampled from it instead.
        #[arg(long)]
        points: bool,
        /// Writes frames and exact flow into this folder instead, for other programs.
        #[arg(long, conflicts_with = "points")]
        export: Option<PathBuf>,
        #[command(flatten)]
        chosen: Chosen,
    },
    /// Measures the time that the library takes for a frame of a YUV4MPEG2 file (8-bit 4:2:0).
    Speed {
        /// The file.
        file: PathBuf,
        /// Frames the library may look ahead.
        #[arg(long, default_value_t = 4)]
        lookahead: usize,
        /// Before the figures of all, the milliseconds of each frame.
        #[arg(long)]
        by_frame: bool,
        /// Analyses frames with the least effort.
        #[arg(long)]
        fast: bool,
    },
    /// Runs all systems on all sequences and writes docs/accuracy.md, charts and stills to target/eval/figures; all to
    /// folders below target/eval where a sequence, a number of frames or textures are given.
    Report {
        /// How many scenes: seeds 1, 2, and so on.
        #[arg(long, default_value_t = 3)]
        scenes: u64,
        /// Names of sequences, beginnings as `eis_*`, or `processed`; all without it.
        #[arg(long)]
        sequence: Vec<String>,
        /// Number of frames of each.
        #[arg(long)]
        frames: Option<usize>,
        /// Writes the document of the last run anew, without another run; only the stills are made afresh.
        #[arg(long)]
        redraw: bool,
        #[command(flatten)]
        place: Place,
    },
    /// Checks in a few minutes that no figure of the library is worse than recorded.
    Quick {
        /// Records the figures instead.
        #[arg(long)]
        record: bool,
        /// A folder in which rendered footage is kept; rendered anew without it.
        #[arg(long)]
        cache: Option<PathBuf>,
    },
    /// Scores the library on two-frame clips with a global-shutter truth: folders as Carla-RS,
    /// Fastec-RS and BS-RSC have them, or rs_0, rs_1 and gs_1_m.
    Pairs {
        /// The folder that is searched, with the folders below it.
        folder: PathBuf,
        #[command(flatten)]
        shutter: Shutter,
    },
    /// Judges the library on a real clip without truth: wobble and jitter, before and after.
    Clip {
        /// The clip, of any kind that GStreamer decodes.
        file: PathBuf,
        /// Frames the library may look ahead.
        #[arg(long, default_value_t = 4)]
        lookahead: usize,
        /// The folder in which to write stills, before and after side by side.
        #[arg(long)]
        out: Option<PathBuf>,
        #[command(flatten)]
        shutter: Shutter,
    },
    /// Stabilises sequences or a clip beside vid.stab in two passes at its defaults (needs ffmpeg), at the same crop, and
    /// measures jitter and wobble of both.
    Steady {
        /// A real clip instead of sequences.
        #[arg(long, conflicts_with = "sequence")]
        clip: Option<PathBuf>,
        #[command(flatten)]
        gyroscope: Option<steady::Gyroscope>,
        /// Standard deviation of the smoothing in seconds.
        #[arg(long, default_value_t = 0.5)]
        deviation: f64,
        /// Standard deviation of the low-pass filters of the published stabilisers in seconds.
        #[arg(long, default_value_t = 0.1)]
        published: f64,
        /// Zoom of the library and of the published stabilisers instead of that of vid.stab.
        #[arg(long)]
        zoom: Option<f64>,
        /// The folder in which to write the pictures of all, as YUV4MPEG2.
        #[arg(long)]
        out: Option<PathBuf>,
        #[command(flatten)]
        chosen: Chosen,
    },
}

/// Where footage comes from and is kept.
#[derive(Args)]
struct Place {
    /// A folder of photographs to be used as textures; procedural ones without it.
    #[arg(long)]
    textures: Option<PathBuf>,
    /// The folder in which rendered footage is kept, `~/.cache/rsrectify-eval` without it.
    #[arg(long)]
    cache: Option<PathBuf>,
}

/// Which sequences, and how.
#[derive(Args)]
struct Chosen {
    /// Names of sequences, beginnings as `eis_*`, or `processed`: all that were stabilised or re-timed after their
    /// readout. All of the report without it.
    #[arg(long)]
    sequence: Vec<String>,
    #[command(flatten)]
    changes: Changes,
    #[command(flatten)]
    place: Place,
}

impl Chosen {
    /// The sequences that [`sequence::chosen`] finds; those of the report without names.
    fn settings(&self) -> Result<Vec<Settings>> {
        if self.sequence.is_empty() { Ok(sequence::catalogue()) } else { sequence::chosen(&self.sequence) }
    }

    fn footage(&self, settings: Settings) -> Result<Footage> {
        self.place.footage(&self.changes.apply(settings))
    }

    /// Prints a table with a row for each sequence.
    fn print(&self, heading: &str, row: impl Fn(&Footage) -> Result<String>) -> Result<()> {
        println!("{heading}");
        for settings in self.settings()? {
            println!("{}", row(&self.footage(settings)?)?);
        }
        Ok(())
    }
}

impl Place {
    fn footage(&self, settings: &Settings) -> Result<Footage> {
        let cache =
            self.cache.as_ref().map_or_else(Cache::in_default_folder, |folder| Ok(Cache::new(folder)))?;
        cache.footage(settings, self.textures.as_deref(), Truth::Whole)
    }
}

fn main() -> Result<()> {
    match Cli::parse().command {
        Command::Measure { lookahead, by_frame: true, chosen } => frames(&chosen, lookahead),
        Command::Measure { lookahead, by_frame: false, chosen } => {
            chosen.print(MEASURED_HEADING, |footage| measured_row(footage, lookahead))
        }
        Command::Effort { lookahead, chosen } => {
            chosen.print(effort::HEADING, |footage| effort::row(footage, lookahead))
        }
        Command::TwoFrames { against, chosen } => {
            chosen.print(two_frames::HEADING, |footage| two_frames::row(footage, against.as_deref()))
        }
        Command::Readout { clip: Some(file), .. } => readout_of_clip(&file),
        Command::Readout { clip: None, chosen } => chosen.print(readout::HEADING, readout::row),
        Command::Blind { recorded, few, lookahead, chosen } => {
            let usual = if few { Extent::Few } else { Extent::All };
            blind(&chosen, recorded, lookahead.map_or(usual, Extent::Ahead))
        }
        Command::Flow { export: Some(folder), chosen, .. } => {
            let export = |settings| dense::export(&chosen.footage(settings)?, &folder);
            chosen.settings()?.into_iter().try_for_each(export)
        }
        Command::Flow { points: true, export: None, chosen } => {
            chosen.print(dense::POINTS_HEADING, dense::points_row)
        }
        Command::Flow { points: false, export: None, chosen } => chosen.print(dense::HEADING, dense::row),
        Command::Speed { file, lookahead, by_frame, fast } => speed(&file, lookahead, by_frame, fast),
        Command::Report { scenes, sequence: sequences, frames, redraw, place } => {
            let photographs = place.textures.is_some();
            let options = report::Options { scenes, sequences, frames, photographs, redraw };
            report::run(&options, &|settings| place.footage(settings))
        }
        Command::Quick { record, cache } => {
            let cache = cache.map(Cache::new);
            quick::run(record, &|settings| match &cache {
                Some(cache) => cache.footage(settings, None, Truth::Displacements),
                None => Footage::render(Sequence::new(settings.clone()), Truth::Displacements),
            })
        }
        Command::Pairs { folder, shutter } => {
            print!("{}", pairs::table(&pairs::score(&pairs::find(&folder)?, &shutter)?));
            Ok(())
        }
        Command::Clip { file, lookahead, out, shutter } => {
            print!("{}", clip::judge(&media::decode(&file)?, &shutter, lookahead, out.as_deref())?);
            Ok(())
        }
        Command::Steady { clip, gyroscope, deviation, published, zoom, out, chosen } => {
            let asked = steady::Asked { deviation, published, zoom };
            match clip {
                Some(file) => {
                    let row = steady::row_of_clip(&file, gyroscope.as_ref(), asked, out.as_deref())?;
                    println!("{}\n{row}", steady::HEADING);
                    Ok(())
                }
                None => chosen.print(steady::HEADING, |footage| steady::row(footage, asked, out.as_deref())),
            }
        }
    }
}

fn blind(chosen: &Chosen, recorded: bool, extent: Extent) -> Result<()> {
    let all = || sequence::catalogue().into_iter().chain(sequence::hard());
    let distorted =
        || all().filter(|settings| settings.readout_ratio > 0.0 && settings.width < 1000).collect();
    println!("{}", blind::HEADING);
    let mut table = format!("{}\n", blind::HEADING);
    for settings in if chosen.sequence.is_empty() { distorted() } else { chosen.settings()? } {
        let frames = settings.timeline.captures(blind::NEEDED_FRAMES, settings.fps).max(settings.frames);
        let recorded = recorded && !settings.timeline.repeats_frames();
        let footage = chosen.footage(Settings { frames, ..settings })?;
        let blind = if recorded { Blind::recorded(&footage, extent)? } else { Blind::of(&footage, extent)? };
        let row = blind.row();
        println!("{row}");
        table += &format!("{row}\n");
        blind.wrong().for_each(|line| eprintln!("{line}"));
    }
    if chosen.sequence.is_empty() { report::keep_blind(&table) } else { Ok(()) }
}

fn readout_of_clip(file: &std::path::Path) -> Result<()> {
    let clip = media::decode(file)?;
    let found = readout::of_clip(&clip)?;
    println!("{}", readout::cells(&found, clip.fps));
    Ok(())
}

fn solve(
    footage: &Footage,
    delay: Delay,
    estimator: Estimator,
    lookahead: usize,
) -> Result<Vec<FrameSolution>> {
    product::solve(footage, product::settings(footage.settings(), delay, estimator, lookahead))
}

/// Prints for each frame the displacement as it arrives and what is left of it, RMS in pixels, with the number of
/// correspondences and the confidence.
fn frames(chosen: &Chosen, lookahead: usize) -> Result<()> {
    for settings in chosen.settings()? {
        let footage = chosen.footage(settings)?;
        let given = solve(&footage, Delay::True, Estimator::Continuous, lookahead)?;
        let unknown = solve(&footage, Delay::Unknown, Estimator::Continuous, lookahead)?;
        println!(
            "{}: frame, uncorrected px, then given and unknown: left px, correspondences, confidence",
            footage.settings().name
        );
        for (index, truth) in footage.truth.iter().enumerate() {
            let uncorrected = stats::uncorrected(truth.samples.iter().copied()).rms;
            let cells = [&given, &unknown].map(|solutions| {
                let solution = &solutions[index];
                let corrected = |pixel| product::corrected(solution, pixel);
                let left = Stats::of(distances(&truth.samples, corrected).collect()).rms;
                format!("{left:6.2} {:4} {:4.2}", solution.correspondences, solution.confidence)
            });
            println!("{index:3} {uncorrected:6.2} | {} | {}", cells[0], cells[1]);
        }
    }
    Ok(())
}

const MEASURED_HEADING: &str = "| sequence | uncorrected px (p95) | best rotation: left px (p95) | share | sequential: left px (p95) | share \
         | continuous: left px (p95) | share | readout unknown: left px (p95) | share | second half: left px (p95) | share \
         | readout ratio found (true) | ripple, readout given, px (true) |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|---|";

fn measured_row(footage: &Footage, lookahead: usize) -> Result<String> {
    let uncorrected = footage.uncorrected();
    let mut row = format!("| {} | {} |", footage.settings().name, pixels(&uncorrected));
    row += &share_left(&floor::of_rotation(footage), &uncorrected);
    let solve = |delay, estimator| solve(footage, delay, estimator, lookahead);
    let mut ripples = [0.0; 2];
    for estimator in [Estimator::Sequential, Estimator::Continuous] {
        let corrections = product::corrections(solve(Delay::True, estimator)?);
        row += &share_left(&displacement::left(&footage.truth, &corrections), &uncorrected);
        ripples = ripple::of_sequence(footage, &corrections);
    }
    let solutions = solve(Delay::Unknown, Estimator::Continuous)?;
    let found = solutions.last().map(|last| (*last.motion.readout(), last.readout_deviation));
    let corrections = product::corrections(solutions);
    let half = corrections.len() / 2;
    row += &share_left(&displacement::left(&footage.truth, &corrections), &uncorrected);
    let late = &footage.truth[half..];
    let late_uncorrected = stats::uncorrected(late.iter().flat_map(|truth| truth.samples.iter().copied()));
    row += &share_left(&displacement::left(late, &corrections[half..]), &late_uncorrected);
    let period = 1.0 / footage.settings().delivered_fps();
    if let Some((readout, deviation)) = found {
        let truth = footage.readout();
        row += &format!(
            " {:.3} ± {deviation:.3} {:?} ({:.3} {:?}) |",
            readout.time() / period,
            readout.direction(),
            truth.time() / period,
            truth.direction()
        );
    }
    row += &format!(" {:.2} ({:.2}) |", ripples[0], ripples[1]);
    Ok(row)
}

fn share_left(left: &Stats, uncorrected: &Stats) -> String {
    let share = left.share_of(uncorrected).map_or("–".into(), |share| format!("{:.1} %", 100.0 * share));
    format!(" {} | {share} |", pixels(left))
}

/// Prints what a frame costs: see [`speed::table`].
fn speed(file: &std::path::Path, lookahead: usize, by_frame: bool, fast: bool) -> Result<()> {
    let effort = if fast { Effort::Fast } else { Effort::Balanced };
    // On a thread of the pool, as the element calls the library: no task waits for a thread to wake up.
    let costs = rayon::scope(|_| speed::of_file(file, lookahead, effort))?;
    if by_frame {
        print!("{}", speed::frames(&costs));
    }
    print!("{}", speed::table(&costs, lookahead));
    Ok(())
}

fn pixels(stats: &Stats) -> String {
    format!("{:.2} ({:.2})", stats.rms, stats.p95)
}
