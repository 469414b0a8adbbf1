//! The readout of the clip's camera, found before the first frame is rectified.
//!
//! The element finds it while it plays, but a file is there as a whole: some stretches of it, spread over
//! its length, are analysed first. The element keeps what it knows of the camera over the seeks between
//! them.

use crate::options::Options;
use crate::{explained, named};
use anyhow::{Context, Result, anyhow, bail};
use gst::prelude::*;
use indicatif::{ProgressBar, ProgressStyle};
use std::cell::Cell;
use std::fmt;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How many stretches are looked at.
const STRETCHES: u64 = 5;
/// How long each one is.
const LENGTH: gst::ClockTime = gst::ClockTime::from_seconds(4);
/// Standard deviation, in frame durations, from which on a readout is taken as found.
const SURE: f64 = 0.1;
/// Frames that must have followed one motion, with at least half the confidence there is: what a lone thing
/// before a blank wall does says nothing of the camera.
const FOLLOWED: u32 = 15;
/// A readout of fewer milliseconds bends nothing that could be seen.
const NONE: f64 = 1.0;

/// What the picture says of the readout.
pub struct Readout {
    /// From the first row to the last.
    pub milliseconds: f64,
    /// The edge that is read first, as the element's property names it.
    pub direction: String,
    /// Standard deviation of the time, in frame durations.
    deviation: f64,
    /// Frames in which the picture as a whole followed what was found.
    followed: u32,
}

impl Readout {
    /// What the rectifier has found so far.
    fn of(rectifier: &gst::Element, followed: u32) -> Option<Self> {
        let stats = rectifier.property::<gst::Structure>("stats");
        Some(Self {
            milliseconds: stats.get::<u64>("readout-time").ok()?.max(1) as f64 * 1e-6,
            direction: stats.value("readout-direction").ok()?.serialize().ok()?.into(),
            deviation: stats.get("readout-deviation").ok()?,
            followed,
        })
    }

    /// Whether it may be relied upon from the first frame to the last.
    pub fn is_sure(&self) -> bool {
        self.deviation <= SURE && self.followed >= FOLLOWED
    }
}

impl fmt::Display for Readout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (time, share) = (self.milliseconds, 100.0 * self.deviation);
        if !self.is_sure() {
            return write!(
                f,
                "not certain from this clip; sought while it is rectified (or give --readout-time)"
            );
        }
        if time < NONE {
            return write!(f, "{time:.1} ms: as good as a global shutter");
        }
        write!(f, "{time:.1} ms, {}, give or take {share:.0} % of the frame duration", self.direction)
    }
}

/// Analyses stretches of the input; `None` where it cannot be played, which playing it will explain.
pub fn find(options: &Options, interruptions: &AtomicUsize) -> Result<Option<Readout>> {
    let scout = Scout::new(options)?;
    let bar = ProgressBar::no_length().with_style(ProgressStyle::with_template("{spinner} {msg}")?);
    bar.set_message("finding the readout time");
    let found = scout.run(&bar, interruptions);
    scout.pipeline.set_state(gst::State::Null)?;
    bar.finish_and_clear();
    Ok(found?.then(|| Readout::of(&scout.rectifier, scout.followed.get())).flatten())
}

/// A pipeline that analyses and shows nothing.
struct Scout {
    pipeline: gst::Pipeline,
    rectifier: gst::Element,
    followed: Cell<u32>,
}

impl Scout {
    fn new(options: &Options) -> Result<Self> {
        let description =
            "filesrc name=source ! decodebin ! videoconvert ! rsrectify name=rectifier ! fakesink sync=false";
        let pipeline = gst::parse::launch(description).map_err(explained)?;
        let pipeline = pipeline.downcast::<gst::Pipeline>().map_err(|_| anyhow!("not a pipeline"))?;
        let rectifier = named(pipeline.upcast_ref(), "rectifier")?;
        options.rectifier.apply(&rectifier)?;
        rectifier.set_property("strength", 0.0);
        rectifier.set_property("post-messages", true);
        named(pipeline.upcast_ref(), "source")?.set_property("location", &options.input);
        Ok(Self { pipeline, rectifier, followed: Cell::new(0) })
    }

    /// Plays the stretches; `false` if there was an error.
    fn run(&self, bar: &ProgressBar, interruptions: &AtomicUsize) -> Result<bool> {
        let wait = |kind, until| self.wait(kind, until, interruptions);
        // Errors that hinder the start come by the bus too.
        let _ = self.pipeline.set_state(gst::State::Paused);
        if !wait(gst::MessageType::AsyncDone, None)? {
            return Ok(false);
        }
        self.pipeline.set_state(gst::State::Playing)?;
        let whole = LENGTH * STRETCHES;
        let duration = self.pipeline.query_duration::<gst::ClockTime>().unwrap_or(whole);
        if duration <= whole {
            return wait(gst::MessageType::Eos, Some(whole));
        }
        for stretch in 0..STRETCHES {
            bar.set_message(format!("finding the readout time, {} of {STRETCHES}", stretch + 1));
            let start = (duration - LENGTH) * stretch / (STRETCHES - 1);
            let flags = gst::SeekFlags::FLUSH | gst::SeekFlags::KEY_UNIT;
            if self
                .pipeline
                .seek(1.0, flags, gst::SeekType::Set, start, gst::SeekType::Set, start + LENGTH)
                .is_err()
            {
                // Not every container can: the beginning will do.
                return wait(gst::MessageType::Eos, Some(whole));
            }
            if !wait(gst::MessageType::Eos, None)? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Waits for a message or a position; `false` if there was an error.
    fn wait(
        &self,
        kind: gst::MessageType,
        until: Option<gst::ClockTime>,
        interruptions: &AtomicUsize,
    ) -> Result<bool> {
        let bus = self.pipeline.bus().context("the pipeline has no bus")?;
        loop {
            if interruptions.load(Ordering::Relaxed) > 0 {
                bail!("interrupted");
            }
            let here = until.and_then(|_| self.rectifier.query_position::<gst::ClockTime>());
            if here.zip(until).is_some_and(|(here, until)| here >= until) {
                return Ok(true);
            }
            let kinds = [kind, gst::MessageType::Error, gst::MessageType::Element];
            match bus.timed_pop_filtered(gst::ClockTime::from_mseconds(100), &kinds) {
                Some(message) if message.type_() == kind => return Ok(true),
                Some(message) if message.type_() == gst::MessageType::Error => return Ok(false),
                Some(message) => {
                    let confidence =
                        message.structure().and_then(|frame| frame.get::<f64>("confidence").ok());
                    self.followed.set(self.followed.get() + u32::from(confidence.is_some_and(|c| c >= 0.5)));
                }
                None => {}
            }
        }
    }
}
