//! The decoder of the program's pipelines: GStreamer's decodebin, which chooses parsers and decoders, and the two choices that
//! are corrected.

use crate::elements::{drop_all, make};
use anyhow::{Context, Result};
use gst::glib;
use gst::prelude::*;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Decoders that also want the transparency of each frame, and fail where a stream only announces it, as those of browsers do.
/// The plain decoders give out the same picture without it.
const OF_TRANSPARENCY: [&str; 2] = ["vp8alphadecodebin", "vp9alphadecodebin"];
/// Bytes from the beginning of a program stream in which the start codes of MPEG-1 and MPEG-2 video are sought: they come with
/// each picture.
const SEARCHED: u64 = 1 << 20;

/// A decodebin for a clip that a `filesrc` reads.
pub fn of(clip: &Path) -> Result<gst::Element> {
    let decoder = make("decodebin")?;
    let clip = clip.to_owned();
    decoder.connect("autoplug-sort", false, move |values| {
        let pad = values.get(1).and_then(|value| value.get::<gst::Pad>().ok());
        let caps = values.get(2).and_then(|value| value.get::<gst::Caps>().ok());
        let factories = values.get(3).and_then(|value| value.get::<glib::ValueArray>().ok());
        let chosen = pad.zip(caps).zip(factories);
        Some(chosen.and_then(|((pad, caps), factories)| choose(&clip, &pad, &caps, &factories)).to_value())
    });
    Ok(decoder)
}

/// Links the first stream of raw video that a decoder finds, and has the others go nowhere; `on_none` is called where there is
/// none.
pub fn link_video(
    decoder: &gst::Element,
    input: &gst::Pad,
    on_none: impl Fn(&gst::Element) + Send + Sync + 'static,
) -> Result<()> {
    let video = input.downgrade();
    decoder.connect("autoplug-continue", false, |values| {
        let caps = values.get(2).and_then(|value| value.get::<gst::Caps>().ok());
        Some(caps.is_none_or(|caps| !is_beside_video(&caps)).to_value())
    });
    decoder.connect_pad_added(move |decoder, pad| {
        let Some(input) = video.upgrade() else { return };
        if !is_raw_video(pad) || input.is_linked() {
            drop_all(pad);
        } else if let Err(error) = pad.link(&input) {
            gst::element_error!(
                decoder,
                gst::StreamError::Failed,
                ("the video cannot be read: {error}")
            );
        }
    });
    let video = input.downgrade();
    let bin = decoder.clone().downcast::<gst::Bin>().ok().context("decodebin is no bin")?;
    bin.connect_no_more_pads(move |bin| {
        if video.upgrade().is_some_and(|pad| !pad.is_linked()) {
            on_none(bin.upcast_ref());
        }
    });
    Ok(())
}

/// Whether a stream is of a kind that is never video, and so need not be decoded to find the video.
fn is_beside_video(caps: &gst::CapsRef) -> bool {
    let name = caps.structure(0).map_or("", |format| format.name().as_str());
    ["audio/", "text/", "subtitle/", "subpicture/", "closedcaption/", "meta/"]
        .iter()
        .any(|kind| name.starts_with(kind))
}

fn is_raw_video(pad: &gst::Pad) -> bool {
    let caps = pad.current_caps().unwrap_or_else(|| pad.query_caps(None));
    caps.structure(0).is_some_and(|format| format.has_name("video/x-raw"))
}

/// The elements that may go on with a stream, where these are not the ones that GStreamer would take.
fn choose(
    clip: &Path,
    pad: &gst::Pad,
    caps: &gst::CapsRef,
    factories: &glib::ValueArray,
) -> Option<glib::ValueArray> {
    if is_named_by_demuxer_alone(pad, caps) && is_without_mpeg_pictures(clip) {
        let typefind = gst::ElementFactory::find("typefind")?;
        return Some(glib::ValueArray::new([typefind.to_value()]));
    }
    let is_plain = |factory: &&glib::Value| {
        let factory = factory.get::<gst::ElementFactory>();
        !factory.is_ok_and(|factory| OF_TRANSPARENCY.contains(&factory.name().as_str()))
    };
    let plain: Vec<_> = factories.iter().filter(is_plain).cloned().collect();
    // Where nothing else can decode it, transparency is decoded, too.
    (!plain.is_empty() && plain.len() < factories.len()).then(|| glib::ValueArray::new(plain))
}

/// Whether it is a program stream's demuxer that calls a stream MPEG video: one without a map of its streams does not state
/// what they are, and the demuxer calls each of them that.
fn is_named_by_demuxer_alone(pad: &gst::Pad, caps: &gst::CapsRef) -> bool {
    let is_mpeg = caps.structure(0).is_some_and(|format| {
        format.has_name("video/mpeg") && format.get::<bool>("systemstream") == Ok(false)
    });
    let inner = pad.downcast_ref::<gst::GhostPad>().and_then(|pad| pad.target());
    let owner = inner.as_ref().unwrap_or(pad).parent_element().and_then(|element| element.factory());
    is_mpeg && owner.is_some_and(|factory| factory.name() == "mpegpsdemux")
}

/// Whether no picture of MPEG-1 or MPEG-2 video begins near the beginning of a program stream.
fn is_without_mpeg_pictures(clip: &Path) -> bool {
    let mut bytes = Vec::new();
    let read = File::open(clip).and_then(|file| file.take(SEARCHED).read_to_end(&mut bytes));
    // A sequence, a group or a picture: of the codes of a program stream itself none is the same, and in H.264 and H.265 the
    // bit of the first two is never set.
    read.is_ok() && !bytes.windows(4).any(|code| matches!(code, [0, 0, 1, 0xb3 | 0xb8]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transparency_is_decoded_only_where_nothing_else_can() {
        gst::init().unwrap();
        let factory = |name: &str| gst::ElementFactory::find(name).unwrap().to_value();
        let pad = gst::Pad::new(gst::PadDirection::Src);
        let caps = gst::Caps::new_empty_simple("video/x-vp9");
        let chosen = |names: &[&str]| {
            let factories = glib::ValueArray::new(names.iter().map(|name| factory(name)));
            choose(Path::new(""), &pad, &caps, &factories).map(|chosen| {
                let name = |one: &glib::Value| one.get::<gst::ElementFactory>().unwrap().name().to_string();
                chosen.iter().map(name).collect::<Vec<_>>()
            })
        };
        assert_eq!(chosen(&["vp9alphadecodebin", "identity", "queue"]).unwrap(), ["identity", "queue"]);
        assert_eq!(chosen(&["identity"]), None);
        assert_eq!(chosen(&["vp9alphadecodebin"]), None);
    }
}
