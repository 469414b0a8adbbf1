// SPDX-License-Identifier: MIT OR Apache-2.0

//! A clip → the rectified clip, as a GStreamer pipeline.
//!
//! Frames are rectified as the sensor delivered them and turned upright only afterwards: the rows of
//! a phone's portrait clip are read top to bottom before it is rotated.

use super::comparison::{self, SIDE_BY_SIDE};
use crate::elements::{hold_for_twins, named, pad, parse};
use crate::input::Clip;
use crate::interruption::Interruption;
use crate::isobmff::EncodedVideo;
use crate::motions::Motions;
use crate::output::container::Container;
use crate::output::encoder::Encoding;
use crate::output::encoding::EncodingOptions;
use crate::output::{self, FrameWriter, Target, Unfinished};
use crate::rectifier_options::RectifierOptions;
use crate::streams::timecode::Timecode;
use crate::streams::{Audio, Destination, Excerpt, Remux, Video, collect};
use crate::summary::Tally;
use crate::times::{self, Straightened};
use anyhow::{Context, Result};
use gst::buffer::BufferMetaForeachAction;
use gst::prelude::*;
use gst_video::VideoTimeCodeMeta;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

/// Keeps the encoded stream.
const KEPT: &str = "appsink name=encoded sync=false async=false max-buffers=8";
/// Turns frames as the clip's rotation tag says.
const UPRIGHT: &str = "videoconvert ! videoflip video-direction=auto";

/// What is to become of a clip.
#[derive(Clone, Debug)]
pub struct Recipe {
    /// How the video is to be encoded.
    pub encoding: EncodingOptions,
    /// The file around it.
    pub container: Container,
    /// What becomes of the audio.
    pub audio: Audio,
    /// Whether the clip is shown before and after, side by side.
    pub compare: bool,
    /// The rectifier's settings.
    pub rectifier: RectifierOptions,
    /// The motion, where it is known already.
    pub motions: Option<Motions>,
}

/// How far the encoder has come.
#[derive(Default)]
pub struct Progress {
    /// When each frame is shown that has come to the encoder; `None` of a frame without a time.
    times: Mutex<Vec<Option<gst::ClockTime>>>,
}

impl Progress {
    /// Frames that have come to the encoder.
    pub fn frames(&self) -> usize {
        self.times().len()
    }

    /// The time of the last of them in the clip, in milliseconds.
    pub fn milliseconds(&self) -> u64 {
        self.times().last().copied().flatten().map_or(0, |time| time.mseconds())
    }

    /// When each of them is shown.
    pub fn times(&self) -> MutexGuard<'_, Vec<Option<gst::ClockTime>>> {
        self.times.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn watch(self: &Arc<Self>, encoder_input: &gst::Pad) {
        let progress = self.clone();
        encoder_input.add_probe(gst::PadProbeType::BUFFER, move |_, info| {
            progress.times().push(info.buffer().and_then(|buffer| buffer.pts()));
            gst::PadProbeReturn::Ok
        });
    }
}

/// Decoded video → the encoded stream.
fn video_branch(
    recipe: &Recipe,
    encoding: &Encoding,
    is_turned: bool,
    has_timecode: bool,
    excerpt: Option<&Excerpt>,
) -> Result<gst::Bin> {
    let turned = if is_turned { UPRIGHT } else { "identity" };
    let rectified = format!("rsrectify name=rectifier ! queue ! {turned}");
    let shown = if recipe.compare {
        format!(
            "tee name=both  both. ! queue name=original ! {UPRIGHT} ! side.  both. ! {rectified} ! side. \
             {SIDE_BY_SIDE}"
        )
    } else {
        rectified
    };
    let encoded = match recipe.container {
        container if container.is_isobmff() => {
            format!("{} ! {} ! {KEPT}", encoding.description(), encoding.codec().form_in_boxes())
        }
        container if container.is_of_frames_only() => format!("{} ! {KEPT}", encoding.description()),
        _ => encoding.description(),
    };
    let bin = parse(&format!("queue name=frames ! videoconvert name=decoded ! {shown} ! {encoded}"))?;
    let rectifier = named(&bin, "rectifier")?;
    recipe.rectifier.apply(&rectifier)?;
    if recipe.compare {
        hold_for_twins(&named(&bin, "original")?, &rectifier)?;
        place_side_by_side(&named(&bin, "side")?)?;
        comparison::label(&named(&bin, "labels")?);
    }
    if let Some(excerpt) = excerpt {
        excerpt.keep_analysed(&pad(&named(&bin, "frames")?, "src")?);
        let shown = if recipe.compare { "side" } else { "rectifier" };
        excerpt.keep_wanted(&pad(&named(&bin, shown)?, "src")?);
    }
    drop_empty_timecodes(&pad(&named(&bin, "frames")?, "sink")?, has_timecode);
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

/// A pipeline that rectifies a clip, or a part of it; its encoder is called `encoder`.
pub struct Rectification {
    pub remux: Remux,
    product: Product,
    is_turned: bool,
    straightened: Option<Straightened>,
    target: Target,
}

/// What comes out of a pipeline.
enum Product {
    /// A file that the pipeline writes, in the making.
    Muxed(Unfinished),
    /// What is encoded, of which this program makes a file, in the making.
    Encoded(Arc<Mutex<EncodedVideo>>, Unfinished),
    /// Frames that this program writes.
    Frames(Arc<Mutex<FrameWriter>>),
    /// Nothing that is left to be done.
    Done,
}

impl Rectification {
    /// Of a clip whose pictures are encoded so, and whose rectified twin goes to `target` in the end.
    pub fn new(
        recipe: &Recipe,
        encoding: &Encoding,
        excerpt: Option<Arc<Excerpt>>,
        clip: &Clip,
        target: &Target,
        progress: &Arc<Progress>,
        tally: &Tally,
    ) -> Result<Self> {
        let (container, audio) = (recipe.container, recipe.audio);
        let (mut product, mut is_turned, mut straightened) = (Product::Done, true, None);
        let part = target.as_file().map(|file| Unfinished::beside(file).path().to_owned());
        let destination = Destination { output: part.as_deref(), container, audio, excerpt: excerpt.clone() };
        let has_timecode = Timecode::of(clip.path()).is_some();
        let remux = Remux::new(clip, destination, |keeps_orientation, later| {
            // Parts of a clip are alike in all containers, so that they can be joined in any.
            is_turned = recipe.compare || excerpt.is_some() || !keeps_orientation;
            let video = video_branch(recipe, encoding, is_turned, has_timecode, excerpt.as_deref())?;
            if excerpt.is_none() {
                straightened = Some(times::straighten(&pad(&named(&video, "frames")?, "src")?));
            }
            let rectifier = named(&video, "rectifier")?;
            tally.listen(&rectifier, &recipe.rectifier, excerpt.clone(), |_, _| {})?;
            if let Some(motions) = &recipe.motions {
                let tally = tally.clone();
                motions
                    .apply(&rectifier, later.clone(), move |time, motion| tally.add_given(time, motion))?;
            }
            progress.watch(&pad(&named(&video, "encoder")?, "sink")?);
            if container.is_of_frames_only() {
                product = Product::Frames(FrameWriter::new(target, encoding)?.collect(&video)?);
            } else if let Some((part, file)) = part.clone().zip(target.as_file()) {
                product = match container.is_isobmff() {
                    true => {
                        let encoded = collect(&video, part, encoding.colour())?;
                        Product::Encoded(encoded, Unfinished::with_ending(file, ".whole"))
                    }
                    false => Product::Muxed(Unfinished::beside(file)),
                };
            }
            Ok(Video::Decoded(video))
        })?;
        times::mend(&remux.pipeline, encoding.delay());
        for (_, loss) in encoding.losses() {
            gst::element_warning!(remux.pipeline, gst::StreamError::Format, ("{loss}"));
        }
        Ok(Self { remux, product, is_turned, straightened, target: target.clone() })
    }

    /// How many frames are shown later than the clip says, as it shows several at once or in another order.
    pub fn moved_frames(&self) -> u64 {
        self.straightened.as_ref().map_or(0, Straightened::moved)
    }

    /// Once the pipeline has come to its end: writes what it has not, reads a file again, and gives it its name. What is to be
    /// said of it.
    pub fn finish(
        &self,
        times: &[Option<gst::ClockTime>],
        interruption: &Interruption,
    ) -> Result<Vec<String>> {
        let file = match &self.product {
            Product::Done => return Ok(Vec::new()),
            Product::Frames(frames) => {
                let mut frames = frames.lock().unwrap_or_else(PoisonError::into_inner);
                return frames.finish(&self.target, times);
            }
            Product::Muxed(file) => file,
            Product::Encoded(encoded, file) => {
                let mut encoded = encoded.lock().unwrap_or_else(PoisonError::into_inner);
                encoded.finish()?;
                self.remux.write(&encoded, self.is_turned, file.path(), interruption)?;
                file
            }
        };
        output::verify(file.path(), times, interruption)
            .context("the file that was written failed its check")?;
        file.finish(self.target.as_file().context("there is no file")?)?;
        Ok(Vec::new())
    }
}
