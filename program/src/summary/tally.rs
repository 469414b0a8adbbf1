// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the element reports of each frame that it gives out.

use crate::as_recorded::AsRecorded;
use crate::rectifier_options::RectifierOptions;
use crate::streams::Excerpt;
use anyhow::{Context, Result};
use gst::prelude::*;
use gstrsrectify::rsrectify::RsRectify;
use rsrectify::motion::FrameMotion;
use rsrectify::readout::Readout;
use rsrectify::rectifier::{FrameSolution, FrameTiming};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A frame that was given out.
#[derive(Clone, Debug)]
pub struct Entry {
    /// When it is shown in the clip, in seconds.
    pub time: Option<f64>,
    /// The largest displacement within the picture, in pixels; 0 of a frame that is not corrected.
    pub pixels: f64,
    /// 0 to 1; `None` where the motion was given.
    pub confidence: Option<f64>,
    /// Why a frame is not corrected.
    pub as_recorded: Option<AsRecorded>,
}

/// The readout with which the last frame was rectified.
#[derive(Clone, Copy, Debug)]
pub struct LastReadout {
    pub readout: Readout,
    /// Standard deviation as a share of the frame duration; 0 where it was given.
    pub deviation: f64,
    pub timing: FrameTiming,
}

#[derive(Default)]
struct Frames {
    entries: Vec<Entry>,
    last: Option<LastReadout>,
    /// The part of which frames are counted, where that is not the whole clip.
    excerpt: Option<Arc<Excerpt>>,
    /// The instant that is shown, as a share of the readout, and the share of the correction that is applied.
    reference: f64,
    strength: f64,
}

/// What the element reports of the frames of a clip.
#[derive(Clone, Default)]
pub struct Tally(Arc<Mutex<Frames>>);

impl Tally {
    /// Listens to a rectifier with these options, of which only the frames of a part are wanted; forgets what was before. `note` is
    /// given the motion of each frame, and its time.
    pub fn listen(
        &self,
        rectifier: &gst::Element,
        options: &RectifierOptions,
        excerpt: Option<Arc<Excerpt>>,
        note: impl Fn(Option<gst::ClockTime>, &FrameSolution) + Send + Sync + 'static,
    ) -> Result<()> {
        let (reference, strength) = (options.reference_row.unwrap_or(0.5), options.strength.unwrap_or(1.0));
        *self.lock() = Frames { excerpt, reference, strength, ..Frames::default() };
        let rectifier = rectifier.downcast_ref::<RsRectify>().context("the rectifier is another element")?;
        let tally = self.clone();
        rectifier.observe_motions(move |time, solution| {
            tally.add(time, solution);
            note(time, solution);
        });
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, Frames> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn add(&self, time: Option<gst::ClockTime>, solution: &FrameSolution) {
        let motion = &solution.motion;
        let mut frames = self.lock();
        let Some(pixels) = frames.pixels(time, Some(motion)) else { return };
        let readout = motion.readout();
        frames.entries.push(Entry {
            time: time.map(gst::ClockTime::seconds_f64),
            pixels,
            confidence: Some(solution.confidence),
            as_recorded: (pixels == 0.0).then(|| AsRecorded::analysed(solution)),
        });
        let (deviation, timing) = (solution.readout_deviation, solution.timing);
        frames.last = Some(LastReadout { readout: *readout, deviation, timing });
    }

    /// Adds a frame whose motion was given, if there is one.
    pub fn add_given(&self, time: Option<gst::ClockTime>, motion: Option<&FrameMotion>) {
        let mut frames = self.lock();
        let Some(pixels) = frames.pixels(time, motion) else { return };
        let as_recorded = (pixels == 0.0).then_some(AsRecorded::Given { has_motion: motion.is_some() });
        let time = time.map(gst::ClockTime::seconds_f64);
        frames.entries.push(Entry { time, pixels, confidence: None, as_recorded });
        if let Some(motion) = motion {
            let (readout, timing) = (*motion.readout(), FrameTiming::default());
            frames.last = Some(LastReadout { readout, deviation: 0.0, timing });
        }
    }

    /// The frames in the order in which they were given out.
    pub fn entries(&self) -> Vec<Entry> {
        self.lock().entries.clone()
    }

    /// How many frames were given out.
    pub fn frames(&self) -> usize {
        self.lock().entries.len()
    }

    pub fn last_readout(&self) -> Option<LastReadout> {
        self.lock().last
    }
}

impl Frames {
    /// The largest displacement in a frame, 0 without a motion; `None` of one that is not wanted.
    fn pixels(&self, time: Option<gst::ClockTime>, motion: Option<&FrameMotion>) -> Option<f64> {
        let is_wanted = |excerpt: &Arc<Excerpt>| time.is_some_and(|time| excerpt.is_wanted(time));
        let largest = |motion| FrameMotion::largest_displacement(motion, self.reference) * self.strength;
        let is_counted = self.excerpt.as_ref().is_none_or(is_wanted);
        let pixels = is_counted.then(|| motion.map_or(0.0, largest))?;
        Some(if pixels < FrameMotion::MIN_DISPLACEMENT { 0.0 } else { pixels })
    }
}
