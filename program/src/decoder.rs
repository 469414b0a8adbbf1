// SPDX-License-Identifier: MIT OR Apache-2.0

//! The decoder of the program's pipelines: GStreamer's decodebin, which chooses demuxers, parsers and decoders, and the choices
//! of it that are corrected.

use crate::elements::{NO_VIDEO, drop_all, make, pad};
use crate::{corrections, matroska};
use anyhow::{Context, Result};
use gst::glib;
use gst::prelude::*;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Decoders that also want the transparency of each frame, and fail where a stream only announces it, as those of browsers do.
/// The plain decoders give out the same picture without it.
const OF_TRANSPARENCY: [&str; 2] = ["vp8alphadecodebin", "vp9alphadecodebin"];
/// Bytes from the beginning of a program stream in which the start codes of its video are sought.
const SEARCHED: u64 = 1 << 20;
/// What gives a stream another name.
const RENAMING: &str = "capssetter";

/// A decodebin for a clip, which is a file or is read elsewhere.
pub fn of(clip: &Path) -> Result<gst::Element> {
    let decoder = make("decodebin")?;
    correct(&decoder, clip)?;
    Ok(decoder)
}

/// Corrects what a decodebin or a parsebin chooses for a clip that a `filesrc` reads.
pub fn correct(decoder: &gst::Element, clip: &Path) -> Result<()> {
    // What is read of a pipe is gone.
    let file = Some(clip).filter(|clip| clip.is_file());
    if let Some(file) = file {
        corrections::keep(file, &pad(decoder, "sink")?);
    }
    let unnamed = file.and_then(unnamed_video);
    let is_unnamed = unnamed.is_some();
    decoder.connect("autoplug-sort", false, move |values| {
        let pad = values.get(1).and_then(|value| value.get::<gst::Pad>().ok());
        let caps = values.get(2).and_then(|value| value.get::<gst::Caps>().ok());
        let factories = values.get(3).and_then(|value| value.get::<glib::ValueArray>().ok());
        let chosen = pad.zip(caps).zip(factories).and_then(|((pad, caps), factories)| {
            let is_renamed = is_unnamed && is_named_by_demuxer_alone(&pad, &caps);
            if is_renamed { renaming() } else { without_transparency(&factories) }
        });
        Some(chosen.to_value())
    });
    if let Some(name) = unnamed {
        let caps = gst::Caps::builder(name).field("stream-format", "byte-stream").build();
        let bin = decoder.clone().downcast::<gst::Bin>().ok().context("the decoder is no bin")?;
        bin.connect_element_added(move |_, element| {
            if element.factory().is_some_and(|factory| factory.name() == RENAMING) {
                element.set_property("join", false);
                element.set_property("replace", true);
                element.set_property("caps", &caps);
            }
        });
    }
    Ok(())
}

/// Links the first stream of raw video that a decoder finds, and has the others go nowhere.
pub fn link_video(decoder: &gst::Element, is_matroska: bool, input: &gst::Pad) -> Result<()> {
    if is_matroska {
        matroska::keep_first_time(input);
    }
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
            gst::element_error!(decoder, gst::StreamError::Failed, ("the video cannot be read: {error}"));
        }
    });
    let video = input.downgrade();
    let bin = decoder.clone().downcast::<gst::Bin>().ok().context("decodebin is no bin")?;
    bin.connect_no_more_pads(move |bin| {
        if video.upgrade().is_some_and(|pad| !pad.is_linked()) {
            gst::element_error!(bin, gst::StreamError::WrongType, ("{NO_VIDEO}"));
        }
    });
    Ok(())
}

/// Whether a stream is of a kind that is never video, and so need not be decoded to find the video.
pub fn is_beside_video(caps: &gst::CapsRef) -> bool {
    let name = caps.structure(0).map_or("", |format| format.name().as_str());
    ["audio/", "text/", "subtitle/", "subpicture/", "closedcaption/", "meta/"]
        .iter()
        .any(|kind| name.starts_with(kind))
}

fn is_raw_video(pad: &gst::Pad) -> bool {
    let caps = pad.current_caps().unwrap_or_else(|| pad.query_caps(None));
    caps.structure(0).is_some_and(|format| format.has_name("video/x-raw"))
}

/// The decoders without those of transparency, where some are left; `None` where all stay.
fn without_transparency(factories: &glib::ValueArray) -> Option<glib::ValueArray> {
    let is_plain = |factory: &&glib::Value| {
        let factory = factory.get::<gst::ElementFactory>();
        !factory.is_ok_and(|factory| OF_TRANSPARENCY.contains(&factory.name().as_str()))
    };
    let plain: Vec<_> = factories.iter().filter(is_plain).cloned().collect();
    (!plain.is_empty() && plain.len() < factories.len()).then(|| glib::ValueArray::new(plain))
}

/// The element that gives a stream another name, as the only one that may go on with it.
fn renaming() -> Option<glib::ValueArray> {
    Some(glib::ValueArray::new([gst::ElementFactory::find(RENAMING)?.to_value()]))
}

/// Whether it is a program stream's demuxer that calls a stream MPEG video: one without a map of its streams does not state
/// what they are, and the demuxer calls each of them that.
fn is_named_by_demuxer_alone(pad: &gst::Pad, caps: &gst::CapsRef) -> bool {
    let is_mpeg = caps.structure(0).is_some_and(|format| {
        format.has_name("video/mpeg") && format.get::<bool>("systemstream") == Ok(false)
    });
    // The decoder's pads stand for those inside; a queue comes between the demuxer and what follows.
    let inner = pad.downcast_ref::<gst::GhostPad>().and_then(|pad| pad.target());
    let inner = inner.unwrap_or_else(|| pad.clone());
    let queued = inner.iterate_internal_links().into_iter().flatten().next().and_then(|input| input.peer());
    let is_demuxer = |pad: &gst::Pad| {
        let factory = pad.parent_element().and_then(|element| element.factory());
        factory.is_some_and(|factory| factory.name() == "mpegpsdemux")
    };
    is_mpeg && (is_demuxer(&inner) || queued.is_some_and(|pad| is_demuxer(&pad)))
}

/// What the video of a program stream is where its demuxer takes it for MPEG-1 or MPEG-2 and it is not; `None` of other files.
fn unnamed_video(clip: &Path) -> Option<&'static str> {
    let mut bytes = Vec::new();
    File::open(clip).and_then(|file| file.take(SEARCHED).read_to_end(&mut bytes)).ok()?;
    let codes =
        || bytes.windows(5).filter(|code| code.starts_with(&[0, 0, 1])).map(|code| (code[3], code[4]));
    // A pack header begins it; a sequence or a group are only in MPEG video: in H.264 and H.265 the highest bit is never set.
    if !bytes.starts_with(&[0, 0, 1, 0xba]) || codes().any(|(code, _)| matches!(code, 0xb3 | 0xb8)) {
        return None;
    }
    // A set of parameters begins each stream: of H.265 its type is 32, of H.264 it is 7.
    if codes().any(|code| code == (32 << 1, 1)) {
        return Some("video/x-h265");
    }
    codes().any(|(code, _)| code & 0x9f == 7).then_some("video/x-h264")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transparency_is_decoded_only_where_nothing_else_can() {
        gst::init().unwrap();
        let factory = |name: &&str| gst::ElementFactory::find(name).unwrap().to_value();
        let chosen = |names: &[&str]| {
            let chosen = without_transparency(&glib::ValueArray::new(names.iter().map(factory)))?;
            let name = |one: &glib::Value| one.get::<gst::ElementFactory>().unwrap().name().to_string();
            Some(chosen.iter().map(name).collect::<Vec<_>>())
        };
        assert_eq!(chosen(&["vp9alphadecodebin", "identity", "queue"]).unwrap(), ["identity", "queue"]);
        assert_eq!(chosen(&["identity"]), None);
        assert_eq!(chosen(&["vp9alphadecodebin"]), None);
    }
}
