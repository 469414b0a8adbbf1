//! A clip → the rectified clip, as a GStreamer pipeline.
//!
//! Frames are rectified as the sensor delivered them and turned upright only afterwards: the rows of
//! a phone's portrait clip are read top to bottom before it is rotated.

use crate::elements::{named, pad, parse};
use crate::output::codec::{Codec, Container, Rate};
use crate::rectifier_options::RectifierOptions;
use crate::interruption::Interruption;
use crate::isobmff::EncodedVideo;
use crate::output::Unfinished;
use crate::streams::{Audio, Destination, Excerpt, Remux, Video, collect};
use anyhow::Result;
use gst::prelude::*;
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

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
    is_turned: bool,
    excerpt: Option<&Excerpt>,
) -> Result<gst::Bin> {
    let turned = if is_turned { UPRIGHT } else { "identity" };
    let rectified = format!("rsrectify name=rectifier ! queue ! {turned}");
    let shown = if recipe.compare {
        format!(
            "tee name=both  both. ! queue name=original ! {UPRIGHT} ! side.  both. ! {rectified} ! side. \
             compositor name=side background=black"
        )
    } else {
        rectified
    };
    let encoded = match recipe.container.is_isobmff() {
        true => format!("{} ! {}", recipe.codec.description(), recipe.codec.kept()),
        false => recipe.codec.description(),
    };
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
    recipe.codec.configure(&encoder, recipe.rate);
    warn_of_fewer_bits(&encoder, &named(&bin, "decoded")?)?;
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

/// Says so where the encoder takes fewer bits than the clip has.
fn warn_of_fewer_bits(encoder: &gst::Element, decoded: &gst::Element) -> Result<()> {
    let bits = |caps: &gst::CapsRef| {
        let info = gst_video::VideoInfo::from_caps(caps).ok()?;
        info.format_info().depth().first().copied()
    };
    // A pad has its caps only once all that follows has taken them.
    let bits_before = Arc::new(AtomicU32::new(0));
    let noted = bits_before.clone();
    on_caps(&pad(decoded, "sink")?, move |_, caps| noted.store(bits(caps).unwrap_or(0), Ordering::Relaxed));
    let owner = encoder.downgrade();
    on_caps(&pad(encoder, "sink")?, move |_, caps| {
        let before = bits_before.load(Ordering::Relaxed);
        if let Some(after) = bits(caps).filter(|after| *after < before)
            && let Some(encoder) = owner.upgrade()
        {
            gst::element_warning!(
                encoder,
                gst::StreamError::Format,
                ("the encoder takes {after} bits, the clip has {before}; another --codec keeps them")
            );
        }
    });
    Ok(())
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
    /// What is encoded, where this program writes the file.
    encoded: Option<Arc<Mutex<EncodedVideo>>>,
    is_turned: bool,
    file: Unfinished,
}

impl Rectification {
    /// Of a clip whose rectified twin is called `output` in the end.
    pub fn new(
        recipe: &Recipe,
        excerpt: Option<Arc<Excerpt>>,
        clip: &Path,
        output: &Path,
        progress: &Arc<Progress>,
    ) -> Result<Self> {
        let (container, audio) = (recipe.container, recipe.audio);
        let (mut encoded, mut is_turned) = (None, true);
        let part = Unfinished::beside(output).path().to_owned();
        let destination = Destination { output: &part, container, audio, excerpt: excerpt.clone() };
        let remux = Remux::new(clip, destination, |keeps_orientation| {
            // Parts of a clip are alike in all containers, so that they can be joined in any.
            is_turned = recipe.compare || excerpt.is_some() || !keeps_orientation;
            let video = video_branch(recipe, is_turned, excerpt.as_deref())?;
            progress.watch(&pad(&named(&video, "encoder")?, "sink")?);
            if container.is_isobmff() {
                encoded = Some(collect(&video, part.clone())?);
            }
            Ok(Video::Decoded(video))
        })?;
        let file = Unfinished::with_ending(output, if encoded.is_some() { ".whole" } else { ".part" });
        Ok(Self { remux, encoded, is_turned, file })
    }

    /// Once the pipeline has come to its end: writes the file, where the pipeline has not.
    pub fn finish(&self, interruption: &Interruption) -> Result<&Unfinished> {
        if let Some(encoded) = &self.encoded {
            let mut encoded = encoded.lock().unwrap_or_else(PoisonError::into_inner);
            encoded.finish()?;
            self.remux.write(&encoded, self.is_turned, self.file.path(), interruption)?;
        }
        Ok(&self.file)
    }
}
