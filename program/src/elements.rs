// SPDX-License-Identifier: MIT OR Apache-2.0

//! GStreamer elements by name, and what to do where one is missing.

use anyhow::{Context, Result, anyhow};
use gst::prelude::*;
use std::sync::{Arc, Mutex, PoisonError};

/// The error of a clip without video.
pub const NO_VIDEO: &str = "there is no video in the file that could be decoded";

/// Debian's package of the elements that the program names.
fn package(element: &str) -> &'static str {
    match element {
        "x264enc" => "gstreamer1.0-plugins-ugly",
        "x265enc" | "av1enc" | "av1parse" | "h264parse" | "h265parse" | "compositor" => {
            "gstreamer1.0-plugins-bad"
        }
        "mp4mux" | "qtmux" | "matroskamux" | "videoflip" | "capssetter" => "gstreamer1.0-plugins-good",
        name if name.starts_with("av") => "gstreamer1.0-libav",
        _ => "gstreamer1.0-plugins-base",
    }
}

/// That an element is missing, and where it comes from.
fn missing(element: &str) -> anyhow::Error {
    anyhow!(
        "GStreamer lacks the element {element}; on Debian and Ubuntu it comes with the package {}",
        package(element)
    )
}

/// Refuses what cannot be done for want of an element.
pub fn require(elements: &[&str]) -> Result<()> {
    match elements.iter().find(|element| gst::ElementFactory::find(element).is_none()) {
        Some(element) => Err(missing(element)),
        None => Ok(()),
    }
}

/// An element.
pub fn make(factory: &str) -> Result<gst::Element> {
    gst::ElementFactory::make(factory).build().map_err(|_| missing(factory))
}

/// Has clips decoded by what keeps most of them: of GStreamer's first choices, that for JPEG halves the resolution of colour, and that
/// for JPEG 2000 fails where the file does not state the kind of colour.
pub fn prefer_whole_decoders() {
    for pair in [["jpegdec", "avdec_mjpeg"], ["openjpegdec", "avdec_jpeg2000"]] {
        let [own, other] = pair.map(gst::ElementFactory::find);
        if let Some((own, other)) = own.zip(other) {
            other.set_rank(own.rank() + 1);
        }
    }
}

/// A part of a pipeline from its description; what is not linked in it becomes its pads.
pub fn parse(description: &str) -> Result<gst::Bin> {
    let mut context = gst::ParseContext::new();
    let flags = gst::ParseFlags::FATAL_ERRORS;
    let bin = gst::parse::bin_from_description_full(description, true, Some(&mut context), flags);
    bin.map_err(|error| explained(&error, &context))?
        .downcast()
        .map_err(|_| anyhow!("not a bin: {description}"))
}

/// A whole pipeline from its description.
pub fn launch(description: &str) -> Result<gst::Pipeline> {
    let mut context = gst::ParseContext::new();
    let flags = gst::ParseFlags::FATAL_ERRORS;
    let pipeline = gst::parse::launch_full(description, Some(&mut context), flags);
    let pipeline = pipeline.map_err(|error| explained(&error, &context))?;
    pipeline.downcast().map_err(|_| anyhow!("not a pipeline: {description}"))
}

fn explained(error: &gst::glib::Error, context: &gst::ParseContext) -> anyhow::Error {
    match context.missing_elements().first() {
        Some(element) => missing(element),
        None => anyhow!("{}", error.message()),
    }
}

/// The element of a part that has the name.
pub fn named(bin: &impl IsA<gst::Bin>, name: &str) -> Result<gst::Element> {
    bin.by_name(name).with_context(|| format!("the pipeline has no {name}"))
}

/// The appsink of a part that has the name.
pub fn app_sink(bin: &impl IsA<gst::Bin>, name: &str) -> Result<gst_app::AppSink> {
    named(bin, name)?.downcast().map_err(|_| anyhow!("appsink is another element"))
}

/// Has `take` write all that comes to an appsink, as long as the writer is kept: something of the pipeline may outlive it, and must not
/// keep the files that the writer removes at its end.
pub fn write_samples<T: Send + 'static>(
    sink: &gst_app::AppSink,
    writer: &Arc<Mutex<T>>,
    take: impl Fn(&mut T, &gst::Sample) -> Result<()> + Send + 'static,
) {
    let writer = Arc::downgrade(writer);
    let take = move |sink: &gst_app::AppSink| {
        let sample = sink.pull_sample().map_err(|_| gst::FlowError::Eos)?;
        let writer = writer.upgrade().ok_or(gst::FlowError::Flushing)?;
        take(&mut writer.lock().unwrap_or_else(PoisonError::into_inner), &sample).map_err(|error| {
            gst::element_error!(sink, gst::ResourceError::Write, ("{error:#}"));
            gst::FlowError::Error
        })?;
        Ok(gst::FlowSuccess::Ok)
    };
    sink.set_callbacks(gst_app::AppSinkCallbacks::builder().new_sample(take).build());
}

/// The static pad of an element.
pub fn pad(element: &impl IsA<gst::Element>, name: &str) -> Result<gst::Pad> {
    let element = element.upcast_ref::<gst::Element>();
    element.static_pad(name).with_context(|| format!("{} has no pad {name}", element.name()))
}

/// Frames that wait for their rectified twins, beside those looked ahead.
const WAITING: u32 = 8;

/// Has a queue hold frames until their twins come out of a rectifier, where a tee gives them to both.
pub fn hold_for_twins(queue: &gst::Element, rectifier: &gst::Element) -> Result<()> {
    queue.set_property("max-size-buffers", rectifier.property::<u32>("lookahead") + WAITING);
    // A queue's usual bound in bytes is less than one frame of 4K.
    queue.set_property("max-size-bytes", 0u32);
    queue.set_property("max-size-time", 0u64);
    // A question for buffers would wait until the frames before it have gone on, and those wait for their rectified twins, which come from
    // the thread that asks.
    pad(queue, "sink")?.add_probe(gst::PadProbeType::QUERY_DOWNSTREAM, |_, info| {
        let is_allocation = info.query().is_some_and(|query| query.type_() == gst::QueryType::Allocation);
        if is_allocation { gst::PadProbeReturn::Drop } else { gst::PadProbeReturn::Ok }
    });
    Ok(())
}

/// Has what comes out of an element go nowhere: with no link it would be an error, and a sink would be waited for.
pub fn drop_all(source: &gst::Pad) {
    source.add_probe(gst::PadProbeType::BUFFER | gst::PadProbeType::BUFFER_LIST, |_, _| {
        gst::PadProbeReturn::Drop
    });
}

/// Puts other caps in place of those that come to a pad.
pub fn replace_caps(info: &mut gst::PadProbeInfo<'_>, caps: &gst::Caps) {
    let Some(old) = info.event() else { return };
    let new = gst::event::Caps::builder(caps).seqnum(old.seqnum()).build();
    info.data = Some(gst::PadProbeData::Event(new));
}

/// Whether what gives a stream to the decoder's pad is an element of this class.
pub fn comes_from(pad: &gst::Pad, class: &str) -> bool {
    // The decoder's pads stand for those inside.
    let inner = pad.downcast_ref::<gst::GhostPad>().and_then(|pad| pad.target());
    inner.and_then(|pad| pad.parent_element()).is_some_and(|element| is_of_class(&element, class))
}

/// Whether an element is of a class, such as `Decoder`.
pub fn is_of_class(element: &gst::Element, class: &str) -> bool {
    let factory = element.factory();
    factory.is_some_and(|factory| factory.metadata("klass").is_some_and(|klass| klass.contains(class)))
}
