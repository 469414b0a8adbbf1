//! A clip → the rectified clip, as a GStreamer pipeline.
//!
//! Frames are rectified as the sensor delivered them and turned upright only afterwards: the rows of
//! a phone's portrait clip are read top to bottom before it is rotated.

use super::streams::{self, Audio, Kind, Route};
use super::timecode::Timecode;
use crate::elements::{NO_VIDEO, make, named, pad, parse};
use crate::output::codec::{Codec, Container, Rate};
use crate::rectifier_options::RectifierOptions;
use anyhow::{Context, Result, anyhow};
use gst::prelude::*;
use std::collections::HashSet;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

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
fn video_branch(recipe: &Recipe, timecode: Option<gst_video::VideoTimeCode>) -> Result<gst::Bin> {
    let rectified = format!("rsrectify name=rectifier ! queue ! {UPRIGHT}");
    let shown = if recipe.compare {
        format!(
            "tee name=both  both. ! queue name=original ! {UPRIGHT} ! side.  both. ! {rectified} ! side. \
             compositor name=side background=black"
        )
    } else {
        rectified
    };
    let stamped = if timecode.is_some() { "timecodestamper name=stamper set=always ! " } else { "" };
    let encoded = recipe.codec.description();
    let bin = parse(&format!("queue ! videoconvert name=decoded ! {shown} ! {stamped}{encoded}"))?;
    if let Some(timecode) = timecode {
        let stamper = named(&bin, "stamper")?;
        let drops = timecode.flags().contains(gst_video::VideoTimeCodeFlags::DROP_FRAME);
        stamper.set_property("drop-frame", drops);
        stamper.set_property("set-internal-timecode", timecode);
    }
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

fn pad_of(bin: &gst::Bin, element: &str) -> Result<gst::Pad> {
    pad(&named(bin, element)?, "sink")
}

/// Makes plain text of the Pango markup that comes to a pad.
fn strip_markup(pad: &gst::Pad) {
    pad.add_probe(gst::PadProbeType::BUFFER, |_, info| {
        if let Some(gst::PadProbeData::Buffer(buffer)) = &mut info.data {
            let text = buffer.map_readable().map(|bytes| plain_text(&String::from_utf8_lossy(&bytes)));
            let mut plain = text.map(|text| gst::Buffer::from_mut_slice(text.into_bytes()));
            if let Ok(plain) = &mut plain
                && let Some(target) = plain.get_mut()
            {
                let kept = gst::BufferCopyFlags::TIMESTAMPS | gst::BufferCopyFlags::FLAGS;
                // Without times the muxer refuses the buffer, and says so.
                let _ = buffer.copy_into(target, kept, ..);
            }
            if let Ok(plain) = plain {
                *buffer = plain;
            }
        }
        gst::PadProbeReturn::Ok
    });
}

/// Text without the tags of Pango markup, its entities resolved.
fn plain_text(markup: &str) -> String {
    let mut text = String::with_capacity(markup.len());
    let mut rest = markup;
    while let Some(start) = rest.find('<') {
        text.push_str(rest.get(..start).unwrap_or_default());
        let tag = rest.get(start..).unwrap_or_default();
        rest = tag.find('>').and_then(|end| tag.get(end + 1..)).unwrap_or_default();
    }
    text.push_str(rest);
    // The ampersand last, or "&amp;lt;" would become "<".
    [("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&apos;", "'"), ("&#39;", "'"), ("&amp;", "&")]
        .iter()
        .fold(text, |text, (entity, character)| text.replace(entity, character))
}

/// Links what the decoder finds to the muxer.
struct Linker {
    pipeline: gst::glib::WeakRef<gst::Pipeline>,
    muxer: gst::Element,
    video: gst::Bin,
    container: Container,
    audio: Audio,
    has_video: AtomicBool,
    /// The streams of raw audio that the file holds as it is.
    pcm: Mutex<HashSet<String>>,
}

impl Linker {
    /// Whether the decoder goes on with a stream that has come to a pad inside it.
    fn decodes(&self, pad: &gst::Pad, caps: &gst::CapsRef) -> bool {
        let is_raw = caps.structure(0).is_some_and(|format| format.has_name("audio/x-raw"));
        // Its pads stand for those of the demuxer inside.
        let inner = pad.downcast_ref::<gst::GhostPad>().and_then(|pad| pad.target());
        let owner = inner.and_then(|pad| pad.parent_element()).and_then(|element| element.factory());
        if is_raw
            && owner.is_some_and(|factory| {
                factory.metadata("klass").is_some_and(|klass| klass.contains("Demuxer"))
            })
            && let Some(stream) = pad.stream_id()
        {
            self.pcm.lock().unwrap_or_else(PoisonError::into_inner).insert(stream.into());
        }
        !streams::is_copied(self.container, self.audio, caps)
    }

    fn link(&self, pad: &gst::Pad) -> Result<()> {
        let caps = pad.current_caps().unwrap_or_else(|| pad.query_caps(None));
        let kind = Kind::of(&caps);
        if kind == Kind::Video && !self.has_video.swap(true, Ordering::Relaxed) {
            return self.join(pad, &self.video, kind);
        }
        let is_pcm = pad.stream_id().is_some_and(|stream| {
            self.pcm.lock().unwrap_or_else(PoisonError::into_inner).contains(stream.as_str())
        });
        match streams::route(self.container, self.audio, &caps, is_pcm) {
            Route::Copied(branch) | Route::Encoded(branch) => self.join(pad, &parse(&branch)?, kind),
            Route::Stripped(branch) => {
                let branch = parse(&branch)?;
                strip_markup(&pad_of(&branch, "markup")?);
                self.join(pad, &branch, kind)
            }
            Route::LeftOut => {
                if !(kind == Kind::Audio && self.audio == Audio::None) {
                    self.warn_of_loss(&caps);
                }
                Ok(())
            }
        }
    }

    fn warn_of_loss(&self, caps: &gst::CapsRef) {
        let name = caps.structure(0).map_or("unknown", |format| format.name().as_str());
        if let Some(pipeline) = self.pipeline.upgrade() {
            gst::element_warning!(
                pipeline,
                gst::StreamError::Format,
                ("a stream of {name} is left out: it cannot go into {} files", self.container)
            );
        }
    }

    fn join(&self, pad: &gst::Pad, branch: &gst::Bin, kind: Kind) -> Result<()> {
        let pipeline = self.pipeline.upgrade().context("the pipeline is gone")?;
        pipeline.add(branch)?;
        branch.link_pads(Some("src"), &self.muxer, Some(kind.muxer_pad()))?;
        branch.sync_state_with_parent()?;
        let input = crate::elements::pad(branch, "sink")?;
        pad.link(&input).map_err(|e| anyhow!("the {} stream cannot be used: {e}", pad.name()))?;
        Ok(())
    }

    fn report(&self, error: &anyhow::Error) {
        if let Some(pipeline) = self.pipeline.upgrade() {
            gst::element_error!(pipeline, gst::StreamError::Failed, ("{error:#}"));
        }
    }
}

/// The pipeline that rectifies `input` into `output`; its encoder is called `encoder`.
pub fn build(
    recipe: &Recipe,
    input: &Path,
    output: &Path,
    progress: &Arc<Progress>,
) -> Result<gst::Pipeline> {
    let pipeline = gst::Pipeline::new();
    let (source, decoder) = (make("filesrc")?, make("decodebin")?);
    let (muxer, sink) = (make(recipe.container.muxer())?, make("filesink")?);
    source.set_property("location", input);
    sink.set_property("location", output);
    pipeline.add_many([&source, &decoder, &muxer, &sink])?;
    source.link(&decoder)?;
    muxer.link(&sink)?;

    let timecode = Timecode::of(input).and_then(Timecode::to_gst);
    if timecode.is_some() && muxer.has_property("force-create-timecode-trak") {
        muxer.set_property("force-create-timecode-trak", true);
    }
    if let Some(timecode) = timecode.as_ref().filter(|_| recipe.container == Container::Mkv) {
        gst::element_warning!(
            pipeline,
            gst::StreamError::Format,
            ("the timecode, from {timecode} on, is left out: it cannot go into MKV files")
        );
    }
    let video = video_branch(recipe, timecode.filter(|_| recipe.container != Container::Mkv))?;
    progress.watch(&pad(&named(&video, "encoder")?, "sink")?);

    let linker = Arc::new(Linker {
        pipeline: pipeline.downgrade(),
        muxer,
        video,
        container: recipe.container,
        audio: recipe.audio,
        has_video: AtomicBool::new(false),
        pcm: Mutex::default(),
    });
    let on_stream = linker.clone();
    decoder.connect("autoplug-continue", false, move |values| {
        let pad = values.get(1).and_then(|v| v.get::<gst::Pad>().ok());
        let caps = values.get(2).and_then(|v| v.get::<gst::Caps>().ok());
        let goes_on = pad.zip(caps).is_none_or(|(pad, caps)| on_stream.decodes(&pad, &caps));
        Some(goes_on.to_value())
    });
    let on_pad = linker.clone();
    decoder.connect_pad_added(move |_, pad| {
        if let Err(error) = on_pad.link(pad) {
            on_pad.report(&error);
        }
    });
    decoder.connect_no_more_pads(move |_| {
        if !linker.has_video.load(Ordering::Relaxed) {
            linker.report(&anyhow!(NO_VIDEO));
        }
    });
    Ok(pipeline)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_becomes_plain_text() {
        assert_eq!(plain_text("plain"), "plain");
        assert_eq!(plain_text("<span color=\"#fff\"><i>a</i> &lt;b&gt;</span> &amp;amp; c"), "a <b> &amp; c");
        assert_eq!(plain_text("an open <tag"), "an open ");
    }
}
