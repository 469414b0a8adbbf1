// SPDX-License-Identifier: MIT OR Apache-2.0

//! Which encoder a clip gets.

use super::codec::Codec;
use super::container::Container;
use super::encoder::{Encoder, Encoding};
use super::encoding::EncodingOptions;
use super::hardware;
use crate::picture::Picture;
use anyhow::{Context, Result};

/// Frames that are not encoded, as caps call them.
const RAW: &str = "video/x-raw";
/// Codecs that lose nothing.
const LOSSLESS: [&str; 6] =
    [RAW, "video/x-huffyuv", "video/x-lagarith", "video/x-rle", "image/png", "image/tiff"];
/// Codecs of cameras and editing programs that encode each frame by itself and lose little.
const FOR_EDITING: [&str; 5] =
    ["video/x-dnxhd", "video/x-cineform", "image/x-j2c", "image/x-jpc", "image/jp2"];

/// How a clip is encoded, and what is to be said of it.
pub struct Chosen {
    pub encoding: Encoding,
    pub notes: Vec<String>,
}

/// The codecs for a clip, the first that serves before the others.
fn codecs(picture: &Picture) -> Vec<Codec> {
    use Codec::{Ffv1, H264, Hevc, Prores};
    let own = picture.coded.as_ref().and_then(|caps| Codec::of(caps));
    match (own, name_of(picture).unwrap_or(RAW)) {
        (Some(Prores), _) => vec![Prores, H264],
        (Some(Ffv1), _) => vec![Ffv1, Prores, H264],
        (Some(own), _) => vec![own, Hevc, H264],
        (None, name) if LOSSLESS.contains(&name) => vec![Ffv1, Prores, H264],
        (None, name) if FOR_EDITING.contains(&name) => vec![Prores, H264],
        (None, _) => vec![H264, Hevc],
    }
}

/// Chooses.
///
/// # Errors
/// If what the user asked for cannot be written.
pub fn choose(options: &EncodingOptions, picture: &Picture, container: Container) -> Result<Chosen> {
    let mut notes = Vec::new();
    let codec = match options.settled_codec(container) {
        Some(codec) => codec,
        None => {
            let all = codecs(picture);
            let is_possible = |codec: &&Codec| options.check_codec(**codec, container).is_ok();
            let possible: Vec<Codec> = all.iter().filter(is_possible).copied().collect();
            let keeps_all = |codec: &&Codec| in_software(**codec, options, picture).lost_samples().is_none();
            let first = all.first().context("no codec")?;
            let chosen = possible.iter().find(keeps_all).or(possible.first()).unwrap_or(first);
            notes.extend(reason(options, picture, container, [*first, *chosen]));
            *chosen
        }
    };
    options.check_codec(codec, container)?;
    let mut encoding = in_software(codec, options, picture);
    if options.hardware {
        notes.push(match hardware::encoder(codec) {
            None => {
                format!(
                    "hardware: there is no encoder of {codec} in hardware here; it is encoded in software"
                )
            }
            Some(element) => {
                let encoder = Encoder::in_hardware(codec, options.rate(), &element);
                let other = Encoding::new(encoder, picture.clone());
                match other.lost_samples().filter(|_| encoding.lost_samples().is_none()) {
                    Some(lost) => {
                        format!("hardware: {element} is not used: {lost}; it is encoded in software")
                    }
                    None => {
                        encoding = other;
                        format!("hardware: {element} encodes")
                    }
                }
            }
        });
    }
    Ok(Chosen { encoding, notes })
}

fn in_software(codec: Codec, options: &EncodingOptions, picture: &Picture) -> Encoding {
    let encoder = Encoder::new(codec, options.rate(), options.preset.unwrap_or_default());
    Encoding::new(encoder, picture.clone())
}

/// The codec of the clip, as caps call it; `None` of raw video.
fn name_of(picture: &Picture) -> Option<&str> {
    let name = picture.coded.as_ref()?.structure(0)?.name().as_str();
    Some(name).filter(|name| *name != RAW)
}

/// Why the codec is not that of the clip, where it is not.
fn reason(
    options: &EncodingOptions,
    picture: &Picture,
    container: Container,
    [first, chosen]: [Codec; 2],
) -> Option<String> {
    let own = picture.coded.as_ref().and_then(|caps| Codec::of(caps));
    if own == Some(chosen) {
        return None;
    }
    if first == chosen {
        return Some(match name_of(picture) {
            None => format!("codec: {chosen}, as the clip is raw video"),
            Some(name) if LOSSLESS.contains(&name) => {
                format!("codec: {chosen}, as the clip is lossless ({name})")
            }
            Some(name) => format!("codec: {chosen}, as {name} is not written here"),
        });
    }
    let why = match options.check_codec(first, container) {
        Err(error) => format!("{error:#}"),
        Ok(()) => in_software(first, options, picture).lost_samples().unwrap_or_default(),
    };
    Some(format!("codec: {chosen} instead of {first}: {why}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::codec::Preset;
    use crate::output::encoding::CodecChoice;
    use gst_video::{VideoFormat, VideoInfo};

    fn chosen(coded: &str, format: VideoFormat, container: Container) -> (Codec, String) {
        gst::init().unwrap();
        let picture = Picture {
            info: Some(VideoInfo::builder(format, 320, 240).build().unwrap()),
            coded: Some(gst::Caps::new_empty_simple(coded)),
            ..Picture::default()
        };
        let options = EncodingOptions {
            codec: CodecChoice::Same,
            container: None,
            quality: None,
            bitrate: None,
            preset: None,
            hardware: false,
        };
        let chosen = choose(&options, &picture, container).unwrap();
        (chosen.encoding.codec(), chosen.notes.join("\n"))
    }

    #[test]
    fn the_codec_of_the_clip_is_kept_where_nothing_is_lost_by_it() {
        use VideoFormat::{Bgra, I420, I42010le, I42210le, I42212le, Y42b};
        for (coded, format, container, codec) in [
            ("video/x-h264", I420, Container::Mp4, Codec::H264),
            ("video/x-h264", I42210le, Container::Mkv, Codec::H264),
            ("video/x-h265", I42010le, Container::Mov, Codec::Hevc),
            ("video/x-av1", I420, Container::Mp4, Codec::Av1),
            ("video/x-av1", I420, Container::Mov, Codec::Av1),
            ("video/x-prores", I42210le, Container::Mov, Codec::Prores),
            ("video/x-ffv", Bgra, Container::Mkv, Codec::Ffv1),
        ] {
            assert_eq!(chosen(coded, format, container), (codec, String::new()), "{coded}");
        }
        for (coded, format, container, codec, why) in [
            ("video/x-av1", I42010le, Container::Mkv, Codec::Hevc, "8 bits"),
            ("video/x-prores", I42210le, Container::Mp4, Codec::H264, "cannot hold ProRes"),
            ("image/jpeg", Y42b, Container::Mkv, Codec::H264, "image/jpeg"),
            ("video/x-vp9", I42212le, Container::Mkv, Codec::Hevc, "bits"),
            ("video/x-huffyuv", Y42b, Container::Mkv, Codec::Ffv1, "lossless"),
            ("video/x-raw", I42210le, Container::Mov, Codec::Prores, "cannot hold FFV1"),
            ("video/x-dnxhd", I42210le, Container::Mov, Codec::Prores, "dnxhd"),
            ("image/png", Bgra, Container::Mkv, Codec::Ffv1, "lossless"),
        ] {
            let (chosen, note) = chosen(coded, format, container);
            assert_eq!(chosen, codec, "{coded}: {note}");
            assert!(note.contains(why) && note.starts_with("codec: "), "{note}");
        }
        assert_eq!(chosen("image/png", Bgra, Container::Images), (Codec::Png, String::new()));
    }

    #[test]
    fn presets_are_of_encoders_that_have_them() {
        gst::init().unwrap();
        for (codec, container, has_presets) in [
            (Codec::Hevc, Container::Mp4, true),
            (Codec::Prores, Container::Mov, false),
            (Codec::Raw, Container::Y4m, false),
        ] {
            let checked =
                codec.check(container, crate::output::codec::Rate::Quality(None), Some(Preset::Slow));
            assert_eq!(checked.is_ok(), has_presets, "{codec}");
        }
    }
}
