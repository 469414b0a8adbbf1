// SPDX-License-Identifier: MIT OR Apache-2.0

//! Plays a pipeline to its end.

use crate::decoder;
use crate::elements::is_of_class;
use crate::interruption::Interruption;
use crate::progress;
use anyhow::{Context, Result, bail};
use gst::prelude::*;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// How often in succession something is waited for, a tenth of a second each time, while no element gives out data, before the
/// pipeline is given up: no frame takes as long to decode, to rectify or to encode. (Encoders hold back dozens of frames, which
/// may take longer on a busy machine.) Some broken files stop
/// demuxers without an error, and streams that lie far apart fill all queues.
const PATIENCE: u32 = 450;

/// What plays, and stops when it is dropped.
pub struct Playback {
    pipeline: gst::Pipeline,
    bus: gst::Bus,
    /// Buffers that elements have given out.
    moved: Arc<AtomicU64>,
    /// Their number when it was last looked at, and how often it has been the same since.
    waited: (u64, u32),
    /// What the decoder lacks, once it has said so.
    missing: Option<String>,
    waits_for_ever: bool,
}

/// The error of a decoder of audio.
#[derive(Debug)]
pub struct UndecodableAudio(String);

impl fmt::Display for UndecodableAudio {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the audio cannot be decoded: {}", self.0)
    }
}

impl std::error::Error for UndecodableAudio {}

/// What has happened.
pub enum Event {
    /// The end of all streams.
    End,
    /// Something the user should know.
    Warning(String),
    /// The streams are known and held until it was gone to a place in them.
    Held,
    /// The clip has chapters.
    Chapters,
    /// The pipeline is paused, or has reached the place that it was sent to.
    Ready,
    /// Nothing for a tenth of a second.
    Nothing,
}

/// Plays a pipeline to its end, and shows how many frames there were so far; ends before that where there is no number any more.
pub fn play(
    pipeline: gst::Pipeline,
    frames: impl Fn() -> Option<usize>,
    interruption: &Interruption,
) -> Result<()> {
    let bar = progress::spinner()?;
    let mut playback = Playback::new(pipeline)?;
    playback.set_state(gst::State::Playing);
    loop {
        match playback.next(gst::ClockTime::from_mseconds(100), interruption)? {
            Event::End => break,
            Event::Warning(warning) => bar.suspend(|| log::warn!("{warning}")),
            _ => {}
        }
        let Some(frames) = frames() else { break };
        bar.set_message(format!("{frames} frames"));
        bar.tick();
    }
    bar.finish_and_clear();
    Ok(())
}

impl Playback {
    /// Of a pipeline that has not been started.
    pub fn new(pipeline: gst::Pipeline) -> Result<Self> {
        let bus = pipeline.bus().context("the pipeline has no bus")?;
        let moved = Arc::new(AtomicU64::new(0));
        for element in pipeline.iterate_recurse().into_iter().flatten() {
            count_buffers(&element, &moved);
        }
        let counted = moved.clone();
        pipeline.connect_deep_element_added(move |_, _, element| count_buffers(element, &counted));
        Ok(Self { pipeline, bus, moved, waited: (0, 0), missing: None, waits_for_ever: false })
    }

    /// Does not give up where nothing moves: another program that writes or reads a pipe may take its time.
    pub fn wait_for_ever(&mut self) {
        self.waits_for_ever = true;
    }

    /// The pipeline.
    pub fn pipeline(&self) -> &gst::Pipeline {
        &self.pipeline
    }

    /// Starts it, or pauses it.
    pub fn set_state(&self, state: gst::State) {
        // Errors that hinder the start come by the bus too, with their reason.
        let _ = self.pipeline.set_state(state);
    }

    /// Waits up to `time` for something to happen.
    pub fn next(&mut self, time: gst::ClockTime, interruption: &Interruption) -> Result<Event> {
        interruption.check()?;
        let Some(message) = self.bus.timed_pop(time) else {
            if time > gst::ClockTime::ZERO {
                self.waited()?;
            }
            return Ok(Event::Nothing);
        };
        match message.view() {
            gst::MessageView::Eos(_) => return Ok(Event::End),
            gst::MessageView::AsyncDone(_) => return Ok(Event::Ready),
            gst::MessageView::Application(_) => return Ok(Event::Held),
            gst::MessageView::Toc(toc) if !toc.toc().0.entries().is_empty() => return Ok(Event::Chapters),
            gst::MessageView::Error(error) => {
                let source = message.src().and_then(|source| source.downcast_ref::<gst::Element>());
                let is_audio = |element| is_of_class(element, "Decoder") && is_of_class(element, "Audio");
                if source.is_some_and(is_audio) {
                    bail!(UndecodableAudio(
                        one_line(error.error().message()).trim_end_matches('.').to_owned()
                    ));
                }
                if source.and_then(|source| source.factory()).is_some_and(|made| made.name() == "fdsink") {
                    bail!("the standard output cannot be written; whoever read it may have closed it");
                }
                bail!("{}", self.missing.take().unwrap_or_else(|| one_line(error.error().message())))
            }
            gst::MessageView::Warning(warning) => {
                return Ok(Event::Warning(one_line(warning.error().message())));
            }
            gst::MessageView::Element(element) => {
                self.missing = missing_plugin(element).or(self.missing.take());
            }
            _ => {}
        }
        Ok(Event::Nothing)
    }

    /// A tenth of a second was waited for something in vain; an error where nothing has moved for too long.
    pub fn waited(&mut self) -> Result<()> {
        let moved = self.moved.load(Ordering::Relaxed);
        let times = if moved == self.waited.0 { self.waited.1 + 1 } else { 0 };
        self.waited = (moved, times);
        if times >= PATIENCE && !self.waits_for_ever {
            bail!("no progress for 45 s: stopped");
        }
        Ok(())
    }

    /// An error where one has been reported.
    pub fn check(&mut self, interruption: &Interruption) -> Result<()> {
        interruption.check()?;
        while self.bus.have_pending() {
            self.next(gst::ClockTime::ZERO, interruption)?;
        }
        Ok(())
    }
}

impl Drop for Playback {
    fn drop(&mut self) {
        // Whatever it was doing, it is to release its files.
        let _ = self.pipeline.set_state(gst::State::Null);
    }
}

/// Counts what an element gives out, by the pads that it has and by those that it will get.
fn count_buffers(element: &gst::Element, moved: &Arc<AtomicU64>) {
    let count = |pad: &gst::Pad, moved: &Arc<AtomicU64>| {
        let moved = moved.clone();
        pad.add_probe(gst::PadProbeType::BUFFER | gst::PadProbeType::BUFFER_LIST, move |_, _| {
            moved.fetch_add(1, Ordering::Relaxed);
            gst::PadProbeReturn::Ok
        });
    };
    for pad in element.src_pads() {
        count(&pad, moved);
    }
    let moved = moved.clone();
    element.connect_pad_added(move |_, pad| {
        if pad.direction() == gst::PadDirection::Src {
            count(pad, &moved);
        }
    });
}

/// What a file needs that GStreamer lacks. Of streams beside the video it is no error that they cannot be decoded.
fn missing_plugin(message: &gst::message::Element) -> Option<String> {
    let structure = message.structure().filter(|s| s.has_name("missing-plugin"))?;
    if structure.get::<gst::Caps>("detail").is_ok_and(|caps| decoder::is_beside_video(&caps)) {
        return None;
    }
    let name = structure.get::<&str>("name").ok()?;
    Some(format!("GStreamer lacks a plugin: {}", one_line(name)))
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pipeline_in_which_nothing_moves_is_stopped() {
        gst::init().unwrap();
        let pipeline = gst::parse::launch("fakesrc num-buffers=1 name=source ! fakesink").unwrap();
        let mut playback = Playback::new(pipeline.downcast().unwrap()).unwrap();
        for _ in 1..PATIENCE {
            playback.waited().unwrap();
        }
        // A buffer has come.
        playback.set_state(gst::State::Playing);
        let interruption = Interruption::default();
        while !matches!(playback.next(gst::ClockTime::SECOND, &interruption).unwrap(), Event::End) {}
        for _ in 0..PATIENCE {
            playback.waited().unwrap();
        }
        assert!(playback.waited().unwrap_err().to_string().contains("no progress"));
    }
}
