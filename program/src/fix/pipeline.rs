//! A clip → the rectified clip, as a GStreamer pipeline.
//!
//! Frames are rectified as the sensor delivered them and turned upright only afterwards: the rows of
//! a phone's portrait clip are read top to bottom before it is rotated.

use crate::elements::{named, pad, parse};
use crate::output::codec::{Codec, Container, Rate};
use crate::output::encoder::Encoding;
use crate::picture::Picture;
use crate::rectifier_options::RectifierOptions;
use crate::streams::{Audio, Destination, Excerpt, Remux, Video, timecode};
use crate::times;
use anyhow::Result;
use gst::buffer::BufferMetaForeachAction;
use gst::prelude::*;
use gst_video::VideoTimeCodeMeta;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

/// Turns frames as the clip's rotation tag says.
const UPRIGHT: &str = "videoconvert ! videoflip video-direction=auto";

/// What is to become of a clip.
#[derive(Clone, Debug)]
pub struct Recipe {
    /// How the video is encoded.
    pub codec: Codec,
    /// The file around it.
    pub container: Container,
    /// How much may be lost.
    pub rate: Rate,
    /// What becomes of the audio.
    pub audio: Audio,
    /// Whether the clip is shown before and after, side by side.
    pub compare: bool,
    /// The rectifier's settings.
    pub rectifier: RectifierOptions,
}

/// How far the encoder has come.
#[derive(Default)]
pub struct Progress {
    frames: AtomicU64,
    milliseconds: AtomicU64,
}

impl Progress {
    /// Frames that have come to the encoder.
    pub fn frames(&self) -> u64 {
        self.frames.load(Ordering::Relaxed)
    }

    /// The time of the last of them in the clip.
    pub fn milliseconds(&self) -> u64 {
        self.milliseconds.load(Ordering::Relaxed)
    }

    fn watch(self: &Arc<Self>, encoder_input: &gst::Pad) {
        let progress = self.clone();
        encoder_input.add_probe(gst::PadProbeType::BUFFER, move |_, info| {
            progress.frames.fetch_add(1, Ordering::Relaxed);
            if let Some(time) = info.buffer().and_then(|buffer| buffer.pts()) {
                progress.milliseconds.store(time.mseconds(), Ordering::Relaxed);
            }
            gst::PadProbeReturn::Ok
        });
    }
}

/// Decoded video → the encoded stream.
fn video_branch(
    recipe: &Recipe,
    encoding: &Encoding,
    timecode: Option<gst_video::ValidVideoTimeCode>,
    excerpt: Option<&Excerpt>,
) -> Result<gst::Bin> {
    let rectified = format!("rsrectify name=rectifier ! queue ! {UPRIGHT}");
    let shown = if recipe.compare {
        format!(
            "tee name=both  both. ! queue name=original ! {UPRIGHT} ! side.  both. ! {rectified} ! side. \
             compositor name=side background=black"
        )
    } else {
        rectified
    };
    let encoded = encoding.description();
    let bin = parse(&format!("queue name=frames ! videoconvert name=decoded ! {shown} ! {encoded}"))?;
    let rectifier = named(&bin, "rectifier")?;
    recipe.rectifier.apply(&rectifier)?;
    if recipe.compare {
        // Frames that wait for their rectified twins: a queue's usual bound in bytes is less than
        // one frame of 4K.
        let original = named(&bin, "original")?;
        original.set_property("max-size-buffers", rectifier.property::<u32>("lookahead") + 8);
        original.set_property("max-size-bytes", 0u32);
        original.set_property("max-size-time", 0u64);
        place_side_by_side(&named(&bin, "side")?)?;
    }
    if let Some(excerpt) = excerpt {
        excerpt.keep_analysed(&pad(&named(&bin, "frames")?, "src")?);
        let shown = if recipe.compare { "side" } else { "rectifier" };
        excerpt.keep_wanted(&pad(&named(&bin, shown)?, "src")?);
    }
    let encoder = named(&bin, "encoder")?;
    drop_empty_timecodes(&pad(&named(&bin, "frames")?, "sink")?, timecode.is_some());
    if let Some(timecode) = timecode {
        timecode::stamp_first(&pad(&encoder, "sink")?, timecode);
    }
    encoding.label(&pad(&named(&bin, "frames")?, "sink")?);
    encoding.configure(&bin)?;
    Ok(bin)
}

/// Puts the second picture to the right of the first, as soon as its width is known.
fn place_side_by_side(compositor: &gst::Element) -> Result<()> {
    on_caps(&pad(compositor, "sink_1")?, |pad, caps| {
        if let Some(width) = caps.structure(0).and_then(|s| s.get::<i32>("width").ok()) {
            pad.set_property("xpos", width);
        }
    });
    Ok(())
}

/// Drops the timecodes that decoders find in the stream where the file has one of its own, or where they begin at zero: encoders fill
/// in zeros where they know no other, and muxers would take them for the clip's.
fn drop_empty_timecodes(frames: &gst::Pad, has_other: bool) {
    let is_empty = OnceLock::new();
    frames.add_probe(gst::PadProbeType::BUFFER, move |_, info| {
        let Some(buffer) = info.buffer() else { return gst::PadProbeReturn::Ok };
        let Some(first) = buffer.meta::<VideoTimeCodeMeta>() else { return gst::PadProbeReturn::Ok };
        let time = first.tc();
        let is_zero = || [time.hours(), time.minutes(), time.seconds(), time.frames()] == [0; 4];
        if (has_other || *is_empty.get_or_init(is_zero))
            && let Some(buffer) = info.buffer_mut()
        {
            buffer.make_mut().foreach_meta_mut(|mut meta| {
                let is_timecode = meta.downcast_ref::<VideoTimeCodeMeta>().is_some();
                let action =
                    if is_timecode { BufferMetaForeachAction::Remove } else { BufferMetaForeachAction::Keep };
                ControlFlow::Continue(action)
            });
        }
        gst::PadProbeReturn::Ok
    });
}

/// Calls back with the caps that come to a pad.
fn on_caps(pad: &gst::Pad, call: impl Fn(&gst::Pad, &gst::CapsRef) + Send + Sync + 'static) {
    pad.add_probe(gst::PadProbeType::EVENT_DOWNSTREAM, move |pad, info| {
        if let Some(gst::EventView::Caps(event)) = info.event().map(|event| event.view()) {
            call(pad, event.caps());
        }
        gst::PadProbeReturn::Ok
    });
}

/// The pipeline that rectifies a clip, or a part of it; its encoder is called `encoder`.
pub fn build(
    recipe: &Recipe,
    excerpt: Option<Arc<Excerpt>>,
    clip: &Path,
    output: &Path,
    progress: &Arc<Progress>,
) -> Result<Remux> {
    let (container, audio) = (recipe.container, recipe.audio);
    let destination = Destination { output, container, audio, excerpt: excerpt.clone() };
    let picture = Picture::of(clip)?;
    let delay = picture.delay;
    let encoding = Encoding::new(recipe.codec, recipe.rate, picture);
    let remux = Remux::new(clip, destination, |timecode| {
        let video = video_branch(recipe, &encoding, timecode, excerpt.as_deref())?;
        progress.watch(&pad(&named(&video, "encoder")?, "sink")?);
        Ok(Video::Decoded(video))
    })?;
    times::mend(&remux.pipeline, delay);
    for loss in encoding.losses() {
        gst::element_warning!(remux.pipeline, gst::StreamError::Format, ("{loss}"));
    }
    Ok(remux)
}
