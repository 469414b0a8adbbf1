//! Rectifies any video file into an MP4 file: H.264, the audio copied.
//!
//! ```text
//! cargo run --release -p gst-plugin-rsrectify --example rectify -- IN.mov OUT.mp4
//! ```
//!
//! Where the readout time of the camera is not given, parts of the film are analysed first to find it, so
//! that it is known from the first frame on.
//!
//! Frames are rectified as the sensor delivered them and turned upright only afterwards: the rows of
//! a phone's portrait clip are read top to bottom before it is rotated.

mod options;
mod readout;

use anyhow::{Context, Result, anyhow, bail};
use clap::Parser;
use gst::prelude::*;
use indicatif::{ProgressBar, ProgressStyle};
use options::{Audio, Options};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

/// Turns frames as the clip's rotation tag says.
const UPRIGHT: &str = "videoconvert ! videoflip video-direction=auto";
/// What MP4 players show: 4:2:0, at 8 or 10 bits as the clip has it.
const ENCODED_FORMATS: &str = "video/x-raw,format={I420,YV12,NV12,I420_10LE}";
/// The encoder holds back dozens of frames; audio that waits for them must not fill its queue,
/// or the demuxer stops and with it the video.
const BOUNDLESS_QUEUE: &str = "queue max-size-buffers=0 max-size-bytes=0 max-size-time=0";

/// Decoded video → H.264.
fn video_branch(options: &Options) -> Result<gst::Bin> {
    let rectified = format!("rsrectify name=rectifier ! queue ! {UPRIGHT}");
    let shown = if options.compare {
        format!(
            "tee name=both  both. ! queue name=original ! {UPRIGHT} ! side.  both. ! {rectified} ! side. \
             compositor name=side background=black"
        )
    } else {
        rectified
    };
    let bin = parse(&format!(
        "queue ! videoconvert ! {shown} ! videoconvert ! {ENCODED_FORMATS} ! x264enc name=encoder ! h264parse"
    ))?;
    let rectifier = named(&bin, "rectifier")?;
    options.rectifier.apply(&rectifier)?;
    if options.compare {
        // Frames that wait for their rectified twins: a queue's usual bound in bytes is less than
        // one frame of 4K.
        let original = named(&bin, "original")?;
        original.set_property("max-size-buffers", rectifier.property::<u32>("lookahead") + 8);
        original.set_property("max-size-bytes", 0u32);
        original.set_property("max-size-time", 0u64);
        place_side_by_side(&named(&bin, "side")?)?;
    }
    let encoder = named(&bin, "encoder")?;
    match options.bitrate {
        Some(rate) => encoder.set_property("bitrate", rate),
        None => {
            encoder.set_property_from_str("pass", "qual");
            encoder.set_property("quantizer", options.quality);
            // Else the default bit rate would cap the quality.
            encoder.set_property("vbv-buf-capacity", 0u32);
        }
    }
    Ok(bin)
}

/// Puts the second picture to the right of the first, as soon as its width is known.
fn place_side_by_side(compositor: &gst::Element) -> Result<()> {
    let pad = compositor.static_pad("sink_1").context("compositor has no second pad")?;
    pad.add_probe(gst::PadProbeType::EVENT_DOWNSTREAM, |pad, info| {
        if let Some(gst::EventView::Caps(caps)) = info.event().map(|event| event.view())
            && let Some(width) = caps.caps().structure(0).and_then(|s| s.get::<i32>("width").ok())
        {
            pad.set_property("xpos", width);
        }
        gst::PadProbeReturn::Ok
    });
    Ok(())
}

/// The parser of audio that MP4 holds as it is; `None` for audio that must be encoded anew.
fn audio_parser(caps: &gst::CapsRef) -> Option<&'static str> {
    let format = caps.structure(0)?;
    let number = |field| format.get::<i32>(field).ok();
    match format.name().as_str() {
        "audio/mpeg" if number("mpegversion") == Some(4) => {
            let framing = format.get::<&str>("stream-format").unwrap_or("raw");
            ["raw", "adts"].contains(&framing).then_some("aacparse")
        }
        "audio/mpeg" if number("mpegversion") == Some(1) && number("layer") == Some(3) => {
            Some("mpegaudioparse")
        }
        "audio/x-ac3" => Some("ac3parse"),
        "audio/x-opus" => Some("opusparse"),
        "audio/x-alac" => Some("identity"),
        _ => None,
    }
}

/// Audio, decoded or to be copied → what MP4 holds.
fn audio_branch(caps: &gst::CapsRef) -> Result<gst::Bin> {
    match audio_parser(caps) {
        Some(parser) => parse(&format!("{BOUNDLESS_QUEUE} ! {parser}")),
        None => parse(&format!(
            "{BOUNDLESS_QUEUE} ! audioconvert ! audioresample ! avenc_aac bitrate=192000 ! aacparse"
        )),
    }
}

fn parse(description: &str) -> Result<gst::Bin> {
    gst::parse::bin_from_description(description, true).map_err(explained)
}

/// What a user can do about a description that cannot be parsed.
fn explained(error: gst::glib::Error) -> anyhow::Error {
    match error.kind() {
        Some(gst::ParseError::NoSuchElement) => anyhow!(
            "GStreamer lacks a plugin: {} (Debian and Ubuntu: gstreamer1.0-plugins-{{base,good,ugly}}, gstreamer1.0-libav)",
            error.message()
        ),
        _ => error.into(),
    }
}

fn named(bin: &gst::Bin, name: &str) -> Result<gst::Element> {
    bin.by_name(name).with_context(|| format!("the pipeline has no {name}"))
}

fn make(factory: &str) -> Result<gst::Element> {
    gst::ElementFactory::make(factory).build().map_err(|_| anyhow!("GStreamer lacks the element {factory}"))
}

/// How far the encoder has come.
#[derive(Default)]
struct Progress {
    frames: AtomicU64,
    milliseconds: AtomicU64,
}

impl Progress {
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

/// Links what the decoder finds to the muxer.
struct Linker {
    pipeline: gst::glib::WeakRef<gst::Pipeline>,
    muxer: gst::Element,
    video: gst::Bin,
    has_video: AtomicBool,
    audio: Audio,
}

impl Linker {
    fn link(&self, pad: &gst::Pad) -> Result<()> {
        let caps = pad.current_caps().unwrap_or_else(|| pad.query_caps(None));
        let kind = caps.structure(0).map_or("", |s| s.name().as_str());
        let is_video = kind.starts_with("video/") || kind.starts_with("image/");
        if is_video && !self.has_video.swap(true, Ordering::Relaxed) {
            self.join(pad, &self.video, "video_%u")
        } else if kind.starts_with("audio/") && self.audio != Audio::None {
            self.join(pad, &audio_branch(&caps)?, "audio_%u")
        } else {
            Ok(())
        }
    }

    fn join(&self, pad: &gst::Pad, branch: &gst::Bin, muxer_pad: &str) -> Result<()> {
        let pipeline = self.pipeline.upgrade().context("the pipeline is gone")?;
        pipeline.add(branch)?;
        branch.link_pads(Some("src"), &self.muxer, Some(muxer_pad))?;
        branch.sync_state_with_parent()?;
        let input = branch.static_pad("sink").context("the branch has no input")?;
        pad.link(&input).map_err(|e| anyhow!("the {} stream cannot be used: {e}", pad.name()))?;
        Ok(())
    }

    fn report(&self, error: &anyhow::Error) {
        if let Some(pipeline) = self.pipeline.upgrade() {
            gst::element_error!(pipeline, gst::StreamError::Failed, ("{error:#}"));
        }
    }
}

fn build(options: &Options, output: &Path, progress: &Arc<Progress>) -> Result<gst::Pipeline> {
    let pipeline = gst::Pipeline::new();
    let (source, decoder) = (make("filesrc")?, make("decodebin")?);
    let (muxer, sink) = (make("mp4mux")?, make("filesink")?);
    source.set_property("location", &options.input);
    sink.set_property("location", output);
    pipeline.add_many([&source, &decoder, &muxer, &sink])?;
    source.link(&decoder)?;
    muxer.link(&sink)?;

    let video = video_branch(options)?;
    progress.watch(&named(&video, "encoder")?.static_pad("sink").context("the encoder has no input")?);

    let is_copied = options.audio == Audio::Copy;
    decoder.connect("autoplug-continue", false, move |values| {
        let caps = values.get(2).and_then(|v| v.get::<gst::Caps>().ok());
        let goes_on = !(is_copied && caps.is_some_and(|caps| audio_parser(&caps).is_some()));
        Some(goes_on.to_value())
    });
    let linker = Arc::new(Linker {
        pipeline: pipeline.downgrade(),
        muxer,
        video,
        has_video: AtomicBool::new(false),
        audio: options.audio,
    });
    let on_pad = linker.clone();
    decoder.connect_pad_added(move |_, pad| {
        if let Err(error) = on_pad.link(pad) {
            on_pad.report(&error);
        }
    });
    decoder.connect_no_more_pads(move |_| {
        if !linker.has_video.load(Ordering::Relaxed) {
            linker.report(&anyhow!("there is no video in the file that could be decoded"));
        }
    });
    Ok(pipeline)
}

#[derive(PartialEq)]
enum Ending {
    Complete,
    Interrupted,
}

/// Runs the pipeline to its end; the first interruption ends the file early, the second gives up.
fn play(pipeline: &gst::Pipeline, progress: &Progress, interruptions: &AtomicUsize) -> Result<Ending> {
    let bus = pipeline.bus().context("the pipeline has no bus")?;
    let bar = ProgressBar::no_length().with_style(ProgressStyle::with_template("{spinner} {msg}")?);
    let mut missing = None;
    let mut ending = Ending::Complete;
    // Errors that hinder the start come by the bus too, with their reason.
    let _ = pipeline.set_state(gst::State::Playing);
    loop {
        match interruptions.load(Ordering::Relaxed) {
            0 => {}
            1 if ending == Ending::Complete => {
                ending = Ending::Interrupted;
                pipeline.send_event(gst::event::Eos::new());
            }
            1 => {}
            _ => bail!("interrupted"),
        }
        show(&bar, pipeline, progress)?;
        let Some(message) = bus.timed_pop(gst::ClockTime::from_mseconds(100)) else { continue };
        match message.view() {
            gst::MessageView::Eos(_) => break,
            gst::MessageView::Error(error) => {
                bail!("{}", missing.unwrap_or_else(|| one_line(error.error().message())))
            }
            gst::MessageView::Warning(warning) => {
                bar.suspend(|| eprintln!("warning: {}", one_line(warning.error().message())));
            }
            gst::MessageView::Element(element) => {
                missing = missing_plugin(element).or(missing);
            }
            _ => {}
        }
    }
    bar.finish_and_clear();
    Ok(ending)
}

fn missing_plugin(message: &gst::message::Element) -> Option<String> {
    let structure = message.structure().filter(|s| s.has_name("missing-plugin"))?;
    let name = structure.get::<&str>("name").ok()?;
    Some(format!("GStreamer lacks a plugin: {}", one_line(name)))
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn show(bar: &ProgressBar, pipeline: &gst::Pipeline, progress: &Progress) -> Result<()> {
    if bar.length().is_none()
        && let Some(encoder) = pipeline.by_name("encoder")
        && let Some(input) = encoder.static_pad("sink")
        && let Some(duration) = input.peer_query_duration::<gst::ClockTime>()
    {
        bar.set_length(duration.mseconds());
        bar.set_style(ProgressStyle::with_template("{wide_bar} {percent:>3} % {msg}, {eta} left")?);
    }
    bar.set_position(progress.milliseconds.load(Ordering::Relaxed));
    bar.set_message(format!("{} frames", progress.frames.load(Ordering::Relaxed)));
    Ok(())
}

/// A file in the making: removed unless it is finished.
struct Unfinished(PathBuf);

impl Unfinished {
    fn beside(output: &Path) -> Self {
        let mut name = output.as_os_str().to_owned();
        name.push(".part");
        Self(name.into())
    }

    fn finish(&self, output: &Path) -> Result<()> {
        std::fs::rename(&self.0, output).with_context(|| format!("cannot write {}", output.display()))
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        // After `finish` there is nothing of that name.
        let _ = std::fs::remove_file(&self.0);
    }
}

fn check_files(options: &Options) -> Result<()> {
    let input = &options.input;
    let metadata = std::fs::metadata(input).with_context(|| format!("cannot read {}", input.display()))?;
    if metadata.is_dir() {
        bail!("{} is a folder", input.display());
    }
    if options.output.canonicalize().is_ok_and(|output| input.canonicalize().is_ok_and(|i| i == output)) {
        bail!("INPUT and OUTPUT are the same file");
    }
    if options.output.exists() && !options.overwrite {
        bail!("{} is there already; --overwrite replaces it", options.output.display());
    }
    Ok(())
}

fn rectify(mut options: Options) -> Result<Ending> {
    check_files(&options)?;
    gst::init()?;
    gstrsrectify::plugin_register_static()?;
    let interruptions = Arc::new(AtomicUsize::new(0));
    let counter = interruptions.clone();
    ctrlc::set_handler(move || {
        counter.fetch_add(1, Ordering::Relaxed);
    })?;

    if options.rectifier.wants_readout()
        && let Some(found) = readout::find(&options, &interruptions)?
    {
        println!("readout: {found}");
        if found.is_sure() {
            options.rectifier.readout_time = Some(found.milliseconds);
            options.rectifier.readout_direction = Some(found.direction);
        }
    }
    let unfinished = Unfinished::beside(&options.output);
    let progress = Arc::new(Progress::default());
    let pipeline = build(&options, &unfinished.0, &progress)?;
    let ending = play(&pipeline, &progress, &interruptions);
    pipeline.set_state(gst::State::Null)?;
    let ending = ending.with_context(|| options.input.display().to_string())?;
    let frames = progress.frames.load(Ordering::Relaxed);
    if frames == 0 {
        bail!("{}: no frame could be decoded", options.input.display());
    }
    unfinished.finish(&options.output)?;
    println!("{}: {frames} frames", options.output.display());
    Ok(ending)
}

fn main() -> ExitCode {
    match rectify(Options::parse()) {
        Ok(Ending::Complete) => ExitCode::SUCCESS,
        Ok(Ending::Interrupted) => {
            eprintln!("interrupted: the file ends there");
            ExitCode::from(130)
        }
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
