// SPDX-License-Identifier: MIT OR Apache-2.0

//! What a clip says of its camera: readout time and direction, focal length.
//!
//! The rectifier finds them while frames come, but a file is there as a whole: before it is rectified some stretches
//! of it, spread over its length, are analysed.

use crate::analysis::{Analysis, Frame};
use crate::camera::{CameraChoice, Known};
use crate::estimate::Estimate;
use crate::input::Clip;
use crate::interruption::Interruption;
use crate::part::Part;
use crate::progress;
use crate::property_values::{Direction, Stabilised, name_of};
use crate::rectifier_options::AnalysisOptions;
use anyhow::Result;
use rsrectify::readout::{Readout, ReadoutDirection, ReadoutPosterior, ReadoutPrior};
use rsrectify::rectifier::{FocalLength, FrameSolution, FrameTiming, Settings, Timeline};
use std::fmt;
use std::path::Path;

/// How many stretches are looked at.
const STRETCHES: u64 = 5;
/// How long each one is.
const LENGTH: gst::ClockTime = gst::ClockTime::from_seconds(4);
/// Frames that must have followed one motion, with at least half the confidence there is: what a lone thing
/// before a blank wall does says nothing of the camera.
const FOLLOWED: u32 = 15;
/// Standard deviations by which a readout must differ from the expected one to be another one.
const ANOTHER: f64 = 3.0;

/// What is said of frames that were moved after their readout.
const STABILISED: &str = "hidden: the frames were moved after they were recorded, as by stabilisation in the camera; they are \
                          rectified only as far as the changes of their lean show it (--stabilised no: by their motion)";
/// The same, where none was rectified.
const NOT_LEANED: &str = "hidden: the frames were moved or deformed after they were recorded, and nothing shows a lean of a rolling \
                          shutter: they stay as they are (--stabilised no: rectified by their motion)";

/// What is said of frames that are blends of two.
const BLENDED: &str = "hidden: the frames are blends of two exposures, as a conversion of the frame rate leaves them; they stay \
                       as they are";

/// How much of a clip is looked at.
#[derive(Clone, Debug)]
pub enum Extent {
    /// Up to 20 s, spread over its length.
    Stretches,
    /// All of it.
    Whole,
    /// A part of it.
    Part(Part),
}

/// What the picture says of the camera.
#[derive(Clone, Debug)]
pub struct Found {
    /// From the first row to the last.
    pub milliseconds: f64,
    /// The edge that is read first.
    pub direction: ReadoutDirection,
    /// Standard deviation of the time, in frame durations.
    pub deviation: f64,
    /// Milliseconds from one frame to the next, in which deviations are counted.
    pub period: f64,
    /// Frames a second; `None` where neither the file nor the times of the frames state it.
    pub frame_rate: Option<f64>,
    /// Frame width and height in pixels.
    pub size: [u32; 2],
    /// The focal length, where anything is known of it.
    pub focal_length: Option<FocalLength>,
    /// Frames that were analysed.
    pub frames: u32,
    /// Those in which the picture as a whole followed what was found.
    pub followed: u32,
    /// What was expected of the readout.
    pub expected: Option<ReadoutPrior>,
    /// What is believed of the readout, where it was sought.
    pub posterior: Option<ReadoutPosterior>,
    /// Whether frames were moved after their readout, and when they were exposed.
    pub timing: FrameTiming,
    /// Whether frames that were moved after their readout were rectified by their leans: these are seen.
    pub shows_leans: bool,
    /// Frames at which another shot begins; of stretches, frames of them.
    pub cuts: Vec<usize>,
}

/// Why a readout is not to be relied on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doubt {
    /// There are hardly any frames.
    TooFewFrames,
    /// The frames are blends of two exposures.
    Blended,
    /// The frames were moved after their readout, as by stabilisation in the camera.
    Stabilised,
    /// Hardly a frame has a motion that most of the picture follows.
    NoMotion,
    /// There is motion, but the deviation is too large.
    Uncertain,
}

impl Found {
    /// What speaks against relying on it from the first frame to the last.
    pub fn doubt(&self) -> Option<Doubt> {
        if self.frames < FOLLOWED {
            Some(Doubt::TooFewFrames)
        } else if self.timing.is_blended() {
            Some(Doubt::Blended)
        } else if self.timing.is_stabilised() {
            Some(Doubt::Stabilised)
        } else if self.followed < FOLLOWED {
            Some(Doubt::NoMotion)
        } else if self.deviation > Readout::MAX_KNOWN_DEVIATION {
            Some(Doubt::Uncertain)
        } else {
            None
        }
    }

    /// Goes on with what was found where it can be relied on, and with what was expected.
    pub fn apply(&self, analysis: &mut AnalysisOptions) {
        analysis.expected = self.expected;
        // Given frames are rectified from the first one on, without asking whether they are leaned at all.
        if self.doubt() == Some(Doubt::Stabilised) && self.shows_leans && analysis.stabilised.is_none() {
            analysis.stabilised = Some(Stabilised::Yes);
        }
        if let Some(frames) = self.frames_ahead() {
            analysis.lookahead.get_or_insert(frames);
        }
        if self.doubt().is_none() {
            // 0 would leave it to the rectifier again.
            analysis.readout_time = Some(self.milliseconds.max(1e-6));
            analysis.readout_direction = Some(self.direction.into());
        }
    }

    /// Frames to look ahead so that what was found of their timing is known again when the first one is rectified; `None` where they
    /// are as they should be.
    fn frames_ahead(&self) -> Option<u32> {
        let interval = match self.timing.timeline {
            Timeline::Stated if !self.timing.is_stabilised() => return None,
            // Repetitions, which are left out, take places in the file.
            Timeline::Even { interval } => interval,
            _ => 1.0,
        };
        Some((FrameTiming::FRAMES as f64 * interval).ceil() as u32)
    }

    /// Standard deviation of the time in milliseconds.
    pub fn deviation_ms(&self) -> f64 {
        self.deviation * self.period
    }

    /// The signed readout time in milliseconds, negative where the bottom row or the right column is read first.
    pub fn estimate(&self) -> Estimate {
        let sign = if self.direction.is_reversed() { -1.0 } else { 1.0 };
        Estimate { value: sign * self.milliseconds, deviation: self.deviation_ms() }
    }

    /// Whether the picture shows clearly another readout than the expected one.
    pub fn overrules(&self, expected: &ReadoutPrior) -> bool {
        let edge = expected.direction().unwrap_or(self.direction);
        let sign = |direction: ReadoutDirection| if direction.is_reversed() { -1.0 } else { 1.0 };
        let difference = self.estimate().value - sign(edge) * expected.time() * 1e3;
        let deviation = self.deviation_ms().hypot(expected.deviation() * 1e3);
        let is_other_axis = edge.is_by_rows() != self.direction.is_by_rows() && !self.is_global();
        self.doubt().is_none() && (is_other_axis || difference.abs() > ANOTHER * deviation)
    }

    /// Whether the rows are as good as exposed at once.
    pub fn is_global(&self) -> bool {
        self.milliseconds * 1e-3 < Readout::MIN_VISIBLE_TIME
    }
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (time, share) = (self.milliseconds, 100.0 * self.deviation);
        match self.doubt() {
            Some(Doubt::Stabilised) if self.shows_leans => return write!(f, "{STABILISED}"),
            Some(Doubt::Stabilised) => return write!(f, "{NOT_LEANED}"),
            Some(Doubt::Blended) => return write!(f, "{BLENDED}"),
            _ => {}
        }
        if self.doubt().is_some() {
            let from = self.expected.map(|expected| format!(" from {:.1} ms on", expected.time() * 1e3));
            return write!(
                f,
                "not certain from this clip; sought{} while it is rectified (or give --readout-time)",
                from.unwrap_or_default()
            );
        }
        if self.is_global() {
            write!(f, "{time:.1} ms: as good as a global shutter")?;
        } else {
            let direction = name_of(&Direction::from(self.direction));
            write!(f, "{time:.1} ms, {direction}, give or take {share:.0} % of the frame duration")?;
        }
        match self.expected.filter(|expected| self.overrules(expected)) {
            Some(expected) => {
                let [time, deviation] = [expected.time(), expected.deviation()].map(|seconds| seconds * 1e3);
                write!(f, "; the picture overrules the {time:.1} ± {deviation:.1} ms that were expected")
            }
            None => Ok(()),
        }
    }
}

/// Collects what is found in each frame.
#[derive(Debug, Default)]
struct Collector {
    last: Option<FrameSolution>,
    /// The last that is known of the focal length.
    focal_length: Option<FocalLength>,
    frames: u32,
    followed: u32,
    /// Frames that were found to be stabilised, and not to be.
    stabilised: [u32; 2],
    /// Whether any of the former was rectified, which is done by its lean.
    shows_leans: bool,
    /// The last timeline other than the stated one.
    timeline: Timeline,
    cuts: Vec<usize>,
}

impl Collector {
    /// Adds a frame.
    fn add(&mut self, frame: &Frame) {
        if frame.solution.begins_shot {
            self.cuts.push(self.frames as usize);
        }
        self.frames += 1;
        self.followed += u32::from(frame.solution.confidence >= 0.5);
        if let Some(is_stabilised) = frame.solution.timing.stabilised {
            self.stabilised[usize::from(!is_stabilised)] += 1;
            self.shows_leans |= is_stabilised && frame.solution.confidence > 0.0;
        }
        let timeline = frame.solution.timing.timeline;
        if timeline != Timeline::Stated {
            self.timeline = timeline;
        }
        self.focal_length = frame.solution.focal_length.or(self.focal_length);
        self.last = Some(frame.solution.clone());
    }

    /// The timing of the clip. It is stabilised if some frames were found to be and none as recorded: shots of several
    /// cameras may be joined in it.
    fn timing(&self) -> FrameTiming {
        let [stabilised, recorded] = self.stabilised.map(|frames| frames > 0);
        let stabilised = (stabilised != recorded).then_some(stabilised);
        FrameTiming::new(stabilised, self.timeline)
    }

    /// What was found; `None` of a clip without frames.
    fn found(&self, analysis: &Analysis) -> Option<Found> {
        let last = self.last.as_ref()?;
        let readout = last.motion.readout();
        Some(Found {
            milliseconds: readout.time() * 1e3,
            direction: readout.direction(),
            deviation: last.readout_deviation,
            size: analysis.size(),
            period: 1e3 * analysis.period().unwrap_or(0.0),
            frame_rate: analysis.frame_rate(),
            focal_length: self.focal_length,
            frames: self.frames,
            followed: self.followed,
            expected: None,
            posterior: analysis.posterior(),
            timing: self.timing(),
            shows_leans: self.shows_leans,
            cuts: self.cuts.clone(),
        })
    }
}

/// Looks for the readout of a clip where it is to be found first, and goes on with it; what was found.
pub fn find_first(
    clip: &Clip,
    analysis: &mut AnalysisOptions,
    interruption: &Interruption,
) -> Result<Option<Found>> {
    if !analysis.wants_readout() {
        return Ok(None);
    }
    let (camera, settings) = (analysis.camera.of(clip.path())?, analysis.settings());
    let found = find(clip, settings, camera.as_ref(), Extent::Stretches, interruption)?;
    settle(found.as_ref(), analysis);
    Ok(found)
}

/// Goes on with the readout that was found, where it is to be found first; says which one it is.
pub fn settle(found: Option<&Found>, analysis: &mut AnalysisOptions) {
    if !analysis.wants_readout() {
        return;
    }
    match found {
        Some(found) if matches!(found.doubt(), None | Some(Doubt::Stabilised | Doubt::Blended)) => {
            log::info!("readout: {found}");
        }
        _ => log::warn!("the readout is not certain from this clip; give --readout-time if you know it"),
    }
    if let Some(found) = found {
        found.apply(analysis);
    }
}

/// Analyses a clip for what it says of its camera, starting from what is known of it; `None` where it has no frames.
pub fn find(
    clip: &Clip,
    settings: Settings,
    camera: Option<&Known>,
    extent: Extent,
    interruption: &Interruption,
) -> Result<Option<Found>> {
    let mut analysis = Analysis::open(clip, settings, interruption)?;
    let expected = expect(&mut analysis, camera)?;
    let bar = progress::spinner()?;
    let mut collector = Collector::default();
    let mut note = |frame: Frame| {
        collector.add(&frame);
        bar.set_message(format!("looking for the readout time, {} frames", collector.frames));
        bar.tick();
        Ok(())
    };
    let whole = LENGTH * STRETCHES;
    match (&extent, analysis.duration()) {
        (Extent::Stretches, Some(duration)) if duration > whole => {
            for stretch in 0..STRETCHES {
                let start = (duration - LENGTH) * stretch / (STRETCHES - 1);
                if !analysis.seek(start, start + LENGTH, interruption)? {
                    // Not every container can: the beginning will do.
                    analysis.run(Some(whole), interruption, &mut note)?;
                    break;
                }
                analysis.run(None, interruption, &mut note)?;
            }
        }
        (Extent::Stretches, None) => analysis.run(Some(whole), interruption, &mut note)?,
        (Extent::Part(part), _) => {
            analysis.go_to(part.clone(), interruption)?;
            analysis.run(None, interruption, &mut note)?;
        }
        _ => analysis.run(None, interruption, &mut note)?,
    }
    bar.finish_and_clear();
    if let Some(reason) = analysis.ended_early() {
        let frames = collector.frames;
        log::warn!("{}: {reason}; the readout is that of the {frames} frames before", clip.display());
    }
    let found = collector.found(&analysis);
    Ok(found.map(|found| Found { expected, ..found }))
}

/// What is expected of the readout of a clip that is not analysed before it is rectified.
pub fn expected(
    clip: &Clip,
    options: &AnalysisOptions,
    interruption: &Interruption,
) -> Result<Option<ReadoutPrior>> {
    let Some(camera) = options.camera.of(clip.path())? else { return Ok(None) };
    expect(&mut Analysis::look(clip, options.settings(), interruption)?, Some(&camera))
}

/// Starts from what is expected of the camera that made a clip, and prints it.
pub fn expect(analysis: &mut Analysis, camera: Option<&Known>) -> Result<Option<ReadoutPrior>> {
    let Some(known) = camera else { return Ok(None) };
    print_stabilisation(known);
    let (size, rate) = (analysis.size(), analysis.frame_rate());
    if let Some(impossible) = known.impossible_readout(rate) {
        log::info!(
            "camera: a readout of {:.1} ms is stated ({}), longer than a frame lasts: not used",
            impossible.milliseconds,
            impossible.source
        );
    }
    let Some(expectation) = known.expectation(size, rate) else {
        if let Some((camera, rate)) = known.camera.as_ref().zip(rate) {
            let [width, height] = size;
            let name = camera.name();
            log::info!("camera: {name}; no readout is known at {width}x{height}, {rate:.2} frames/s");
        }
        return Ok(None);
    };
    log::info!("camera: {expectation}");
    let prior = expectation.prior()?;
    analysis.expect(prior)?;
    Ok(Some(prior))
}

/// Prints that the camera stabilised a clip whose readout is given.
pub fn report_stabilisation(clip: &Path, camera: &CameraChoice) -> Result<()> {
    if let Some(known) = camera.of(clip)? {
        print_stabilisation(&known);
    }
    Ok(())
}

fn print_stabilisation(known: &Known) {
    if let Some(stabilisation) = known.stabilisation() {
        log::info!("stabilisation: {stabilisation}");
    }
}

#[cfg(test)]
impl Found {
    /// Of 90 frames, 40 ms apart.
    pub fn example(direction: ReadoutDirection, milliseconds: f64, deviation: f64) -> Self {
        Self {
            milliseconds,
            direction,
            deviation,
            period: 40.0,
            frame_rate: Some(25.0),
            size: [640, 480],
            focal_length: None,
            frames: 90,
            followed: 80,
            expected: None,
            posterior: None,
            timing: FrameTiming::default(),
            shows_leans: false,
            cuts: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_frames_are_looked_beyond() {
        let ahead = |stabilised, timeline| {
            let found = Found::example(ReadoutDirection::TopToBottom, 20.0, 0.01);
            Found { timing: FrameTiming::new(stabilised, timeline), ..found }.frames_ahead()
        };
        assert_eq!(ahead(Some(false), Timeline::Stated), None);
        assert_eq!(ahead(Some(true), Timeline::Stated), Some(18));
        assert_eq!(ahead(None, Timeline::Missing { kept: 4, longer: 0 }), Some(18));
        assert_eq!(ahead(None, Timeline::Even { interval: 1.25 }), Some(23));
    }

    #[test]
    fn stabilised_frames_are_given_to_be_so_where_leans_are_seen() {
        let applied = |shows_leans| {
            let found = Found::example(ReadoutDirection::TopToBottom, 20.0, 0.5);
            let timing = FrameTiming::new(Some(true), Timeline::Stated);
            let mut analysis = AnalysisOptions::default();
            Found { timing, shows_leans, ..found }.apply(&mut analysis);
            (analysis.stabilised, analysis.lookahead, analysis.readout_time)
        };
        assert_eq!(applied(true), (Some(Stabilised::Yes), Some(18), None));
        assert_eq!(applied(false), (None, Some(18), None));
    }
}
