// SPDX-License-Identifier: MIT OR Apache-2.0

//! The way of each stream from the decoder to the muxer.

use crate::output::container::Container;
use clap::ValueEnum;

/// The encoder holds back dozens of frames; audio that waits for them must not fill its queue,
/// or the demuxer stops and with it the video.
const BOUNDLESS_QUEUE: &str = "queue name=waiting max-size-buffers=0 max-size-bytes=0 max-size-time=0";

/// What becomes of the audio.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Audio {
    /// As it is, where the container can hold it; else as AAC
    Copy,
    /// Encoded to AAC
    Aac,
    /// Left out
    None,
}

/// A kind of stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Video,
    Audio,
    Subtitles,
    Other,
}

impl Kind {
    /// The kind of a stream with these caps.
    pub fn of(caps: &gst::CapsRef) -> Self {
        let name = caps.structure(0).map_or("", |structure| structure.name().as_str());
        match name.split('/').next() {
            Some("video" | "image") => Self::Video,
            Some("audio") => Self::Audio,
            Some("text" | "subtitle" | "subpicture") => Self::Subtitles,
            _ if ["application/x-ssa", "application/x-ass", "application/x-usf"].contains(&name) => {
                Self::Subtitles
            }
            _ => Self::Other,
        }
    }

    /// The muxers' pads for it.
    pub fn muxer_pad(self) -> &'static str {
        match self {
            Self::Video => "video_%u",
            Self::Audio => "audio_%u",
            Self::Subtitles | Self::Other => "subtitle_%u",
        }
    }
}

/// How a stream goes from the decoder to the muxer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Route {
    /// By elements that leave its content as it is.
    Copied(String),
    /// Encoded anew.
    Encoded(String),
    /// As plain text: `markup` is the element whose input is to be stripped of it.
    Stripped(String),
    /// Not at all.
    LeftOut,
}

/// The parser of audio that can be copied, by what it is; none for what only a decoder understands.
fn audio_parser(caps: &gst::CapsRef) -> Option<&'static str> {
    let format = caps.structure(0)?;
    let number = |field| format.get::<i32>(field).ok();
    match format.name().as_str() {
        "audio/mpeg" if number("mpegversion") == Some(4) => {
            let framing = format.get::<&str>("stream-format").unwrap_or("raw");
            ["raw", "adts"].contains(&framing).then_some("aacparse")
        }
        "audio/mpeg" if number("mpegversion") == Some(1) => Some("mpegaudioparse"),
        "audio/x-ac3" | "audio/x-eac3" => Some("ac3parse"),
        "audio/x-dts" => Some("dcaparse"),
        "audio/x-opus" => Some("opusparse"),
        "audio/x-flac" => Some("flacparse"),
        // Its parser wants the headers before the data, which do not come again where it was gone to a part.
        "audio/x-vorbis" if format.has_field("streamheader") => Some("identity"),
        "audio/x-vorbis" => Some("vorbisparse"),
        "audio/x-alac" | "audio/x-alaw" | "audio/x-mulaw" | "audio/x-wma" | "audio/x-adpcm"
        | "audio/x-tta" | "audio/x-speex" => Some("identity"),
        _ => None,
    }
}

/// The parser of video that can be copied, by what it is; none for what a muxer could not describe.
fn video_parser(caps: &gst::CapsRef) -> Option<&'static str> {
    match caps.structure(0)?.name().as_str() {
        "video/x-h264" => Some("h264parse"),
        "video/x-h265" => Some("h265parse"),
        "video/x-av1" => Some("av1parse"),
        "video/mpeg" => {
            let is_early = caps.structure(0)?.get::<i32>("mpegversion").is_ok_and(|version| version < 4);
            Some(if is_early { "mpegvideoparse" } else { "mpeg4videoparse" })
        }
        "video/x-vp8" | "video/x-vp9" | "image/jpeg" | "video/x-theora" | "video/x-prores"
        | "video/x-h263" | "video/x-ffv" => Some("identity"),
        _ => None,
    }
}

/// The way to the muxer of a video stream beside the one that is encoded anew; `None` where the container cannot hold it.
pub fn beside_video(container: Container, caps: &gst::CapsRef) -> Option<String> {
    let parser = video_parser(caps)?;
    let essence = essence(caps)?;
    container.takes(Kind::Video.muxer_pad(), &essence).then(|| format!("{BOUNDLESS_QUEUE} ! {parser}"))
}

/// Caps of a stream without what a parser can change: a muxer takes it or not by these.
fn essence(caps: &gst::CapsRef) -> Option<gst::Caps> {
    let format = caps.structure(0)?;
    let mut essence = gst::Structure::new_empty(format.name());
    for field in ["mpegversion", "layer", "channels", "format", "layout"] {
        if let Ok(value) = format.value(field) {
            essence.set_value(field, value.clone());
        }
    }
    Some(gst::Caps::builder_full().structure(essence).build())
}

/// Whether a stream that is not decoded can go into the container.
pub fn is_copied(container: Container, audio: Audio, caps: &gst::CapsRef) -> bool {
    let kind = Kind::of(caps);
    let taken = || essence(caps).is_some_and(|caps| container.takes(kind.muxer_pad(), &caps));
    match kind {
        Kind::Audio => audio == Audio::Copy && audio_parser(caps).is_some() && taken(),
        Kind::Subtitles => taken(),
        Kind::Video | Kind::Other => false,
    }
}

/// The way of a stream, as the decoder gives it out, to the muxer. `is_pcm` of raw audio that the file holds as it is.
pub fn route(container: Container, audio: Audio, caps: &gst::CapsRef, is_pcm: bool) -> Route {
    if is_copied(container, audio, caps) {
        let parser = match Kind::of(caps) {
            Kind::Audio => audio_parser(caps).unwrap_or("identity"),
            _ => "identity",
        };
        return Route::Copied(format!("{BOUNDLESS_QUEUE} ! {parser}"));
    }
    match (Kind::of(caps), audio) {
        (Kind::Audio, Audio::Copy)
            if is_pcm && essence(caps).is_some_and(|c| container.takes("audio_%u", &c)) =>
        {
            Route::Copied(format!("{BOUNDLESS_QUEUE} ! audioconvert"))
        }
        (Kind::Audio, Audio::Copy | Audio::Aac) => Route::Encoded(format!(
            "{BOUNDLESS_QUEUE} ! audioconvert ! audioresample ! avenc_aac bitrate=192000 ! aacparse"
        )),
        (Kind::Subtitles, _) if is_markup(caps) && container.takes("subtitle_%u", &plain_text()) => {
            Route::Stripped(format!(
                "{BOUNDLESS_QUEUE} ! capssetter name=markup replace=true caps=text/x-raw,format=utf8"
            ))
        }
        _ => Route::LeftOut,
    }
}

fn is_markup(caps: &gst::CapsRef) -> bool {
    let format = caps.structure(0).filter(|format| format.has_name("text/x-raw"));
    format.and_then(|format| format.get::<&str>("format").ok()) == Some("pango-markup")
}

fn plain_text() -> gst::Caps {
    gst::Caps::builder("text/x-raw").field("format", "utf8").build()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::str::FromStr;

    fn way(container: Container, caps: &str) -> Route {
        gst::init().unwrap();
        route(container, Audio::Copy, &gst::Caps::from_str(caps).unwrap(), true)
    }

    #[test]
    fn streams_are_copied_where_the_container_holds_them() {
        let is_copied = |container, caps| matches!(way(container, caps), Route::Copied(_));
        let aac = "audio/mpeg,mpegversion=4,stream-format=adts,channels=2,rate=48000";
        for container in [Container::Mp4, Container::Mov, Container::Mkv] {
            assert!(is_copied(container, aac));
            assert!(is_copied(container, "text/x-raw,format=utf8"));
        }
        for (caps, mp4, mov) in [
            ("audio/x-flac,channels=2,rate=44100", false, false),
            ("audio/x-dts,channels=6,rate=48000", false, false),
            ("audio/x-raw,format=S16LE,channels=2,rate=48000,layout=interleaved", false, true),
            ("application/x-ass", false, false),
        ] {
            assert_eq!(is_copied(Container::Mp4, caps), mp4, "{caps}");
            assert_eq!(is_copied(Container::Mov, caps), mov, "{caps}");
            assert!(is_copied(Container::Mkv, caps), "{caps}");
        }
    }

    #[test]
    fn audio_that_cannot_be_copied_is_encoded_and_subtitles_are_left_out() {
        assert!(matches!(way(Container::Mp4, "audio/x-flac,channels=2,rate=44100"), Route::Encoded(_)));
        assert_eq!(way(Container::Mp4, "application/x-ass"), Route::LeftOut);
        assert!(matches!(way(Container::Mkv, "text/x-raw,format=pango-markup"), Route::Stripped(_)));
        assert_eq!(way(Container::Mkv, "application/x-gopro"), Route::LeftOut);
        let caps = gst::Caps::from_str("audio/mpeg,mpegversion=4,channels=2").unwrap();
        assert_eq!(route(Container::Mp4, Audio::None, &caps, false), Route::LeftOut);
        assert!(matches!(route(Container::Mp4, Audio::Aac, &caps, false), Route::Encoded(_)));
    }
}
