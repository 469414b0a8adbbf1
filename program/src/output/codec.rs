// SPDX-License-Identifier: MIT OR Apache-2.0

//! What clips can be encoded to, and which files hold it.

use super::container::Container;
use crate::elements;
use anyhow::{Result, bail};
use clap::ValueEnum;
use gst::prelude::*;
use std::fmt;

/// How the video is encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Codec {
    /// H.264, 8 or 10 bits
    H264,
    /// HEVC (H.265), 8, 10 or 12 bits
    Hevc,
    /// AV1, 8 bits
    Av1,
    /// ProRes 422 HQ, or 4444 for clips that have 4:4:4 or transparency; 10 bits
    Prores,
    /// FFV1, lossless, bits and chroma as the clip has them
    Ffv1,
    /// As it is, for Y4M.
    #[value(skip)]
    Raw,
    /// PNG, for images.
    #[value(skip)]
    Png,
}

/// How much work the encoder takes for the size of the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Preset {
    /// Larger files, sooner
    Fast,
    /// The encoder's usual balance
    #[default]
    Medium,
    /// Smaller files, later
    Slow,
}

/// How much the encoder may lose.
#[derive(Clone, Copy, Debug)]
pub enum Rate {
    /// The encoder's own scale; `None` for the codec's default.
    Quality(Option<u32>),
    /// kbit/s.
    Bits(u32),
}

impl fmt::Display for Codec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::H264 => "H.264",
            Self::Hevc => "HEVC",
            Self::Av1 => "AV1",
            Self::Prores => "ProRes",
            Self::Ffv1 => "FFV1",
            Self::Raw => "raw video",
            Self::Png => "PNG",
        })
    }
}

impl Codec {
    /// What the command line and listings call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::H264 => "h264",
            Self::Hevc => "hevc",
            Self::Av1 => "av1",
            Self::Prores => "prores",
            Self::Ffv1 => "ffv1",
            Self::Raw => "raw",
            Self::Png => "png",
        }
    }

    /// The file that it usually comes in.
    pub fn usual_container(self) -> Container {
        match self {
            Self::H264 | Self::Hevc | Self::Av1 => Container::Mp4,
            Self::Prores => Container::Mov,
            Self::Ffv1 => Container::Mkv,
            Self::Raw => Container::Y4m,
            Self::Png => Container::Images,
        }
    }

    /// The codecs of streams with these caps, of which there is an encoder.
    pub fn of(caps: &gst::CapsRef) -> Option<Self> {
        let all = [Self::H264, Self::Hevc, Self::Av1, Self::Prores, Self::Ffv1];
        let name = caps.structure(0)?.name();
        all.into_iter().find(|codec| codec.media_type() == name.as_str())
    }

    /// The element that encodes in software; for what is not encoded, one that leaves it as it is.
    pub(super) fn encoder(self) -> &'static str {
        match self {
            Self::H264 => "x264enc",
            Self::Hevc => "x265enc",
            Self::Av1 => "av1enc",
            Self::Prores => "avenc_prores_ks",
            Self::Ffv1 => "avenc_ffv1",
            Self::Raw | Self::Png => "identity",
        }
    }

    /// The parser that gives the stream the form that muxers want.
    pub(super) fn parser(self) -> Option<&'static str> {
        match self {
            Self::H264 => Some("h264parse"),
            Self::Hevc => Some("h265parse"),
            Self::Av1 => Some("av1parse"),
            Self::Prores | Self::Ffv1 | Self::Raw | Self::Png => None,
        }
    }

    /// Caps of the encoded stream, in the words of GStreamer.
    pub(super) fn media_type(self) -> &'static str {
        match self {
            Self::H264 => "video/x-h264",
            Self::Hevc => "video/x-h265",
            Self::Av1 => "video/x-av1",
            Self::Prores => "video/x-prores",
            Self::Ffv1 => "video/x-ffv",
            Self::Raw | Self::Png => "video/x-raw",
        }
    }

    /// The best and the worst quality on the encoder's scale; none for what has no such scale.
    fn qualities(self) -> Option<[u32; 2]> {
        match self {
            Self::H264 => Some([0, 50]),
            Self::Hevc => Some([0, 51]),
            Self::Av1 => Some([0, 63]),
            Self::Prores | Self::Ffv1 | Self::Raw | Self::Png => None,
        }
    }

    /// Whether its encoder has presets.
    fn has_presets(self) -> bool {
        self.qualities().is_some()
    }

    /// A quality that is hard to tell from the original.
    pub(super) fn usual_quality(self) -> u32 {
        match self {
            Self::Av1 => 20,
            _ => 18,
        }
    }

    /// Refuses what cannot be written: by this installation, by the container, at this rate.
    pub fn check(self, container: Container, rate: Rate, preset: Option<Preset>) -> Result<()> {
        let is_raw = matches!(self, Self::Raw | Self::Png);
        if is_raw != container.is_of_frames_only() || (is_raw && self.usual_container() != container) {
            bail!(
                "{container} files hold {}",
                if is_raw { "no raw video" } else { "no encoded video: leave --codec out" }
            );
        }
        if preset.is_some() && !self.has_presets() {
            bail!("{self} has no --preset");
        }
        match (self.qualities(), rate) {
            (None, Rate::Quality(Some(_)) | Rate::Bits(_)) => {
                bail!("{self} has neither --quality nor --bitrate: it keeps what it is given")
            }
            (Some([best, worst]), Rate::Quality(Some(quality))) if !(best..=worst).contains(&quality) => {
                bail!("--quality of {self} is between {best} (best) and {worst} (worst)")
            }
            _ => {}
        }
        let elements = [Some(self.encoder()), self.parser(), container.muxer()];
        elements::require(&elements.into_iter().flatten().collect::<Vec<_>>())?;
        let stream = gst::Caps::new_empty_simple(self.media_type());
        if !is_raw && !container.takes("video_%u", &stream) {
            bail!(
                "{container} files cannot hold {self} here; give --container {} or another --codec",
                self.usual_container().extension()
            );
        }
        Ok(())
    }

    /// The form of the encoded stream in MP4 and MOV files, as caps.
    pub fn form_in_boxes(self) -> String {
        let form = match self {
            Self::H264 => ",stream-format=avc,alignment=au",
            Self::Hevc => ",stream-format=hvc1,alignment=au",
            Self::Av1 => ",stream-format=obu-stream,alignment=tu",
            Self::Prores | Self::Ffv1 | Self::Raw | Self::Png => "",
        };
        format!("{}{form}", self.media_type())
    }

    /// The preset as x264 and x265 call it: at the same one of theirs, x265 takes more than twice as long.
    fn preset(self, preset: Preset) -> Option<&'static str> {
        match (self, preset) {
            (Self::H264, Preset::Fast) => Some("veryfast"),
            (Self::H264, Preset::Medium) => Some("medium"),
            (Self::H264, Preset::Slow) => Some("slower"),
            (Self::Hevc, Preset::Fast) => Some("ultrafast"),
            (Self::Hevc, Preset::Medium) => Some("superfast"),
            (Self::Hevc, Preset::Slow) => Some("medium"),
            _ => None,
        }
    }

    /// Sets the encoder in software to a rate.
    pub(super) fn configure(self, encoder: &gst::Element, rate: Rate, preset: Preset) {
        let quality = match rate {
            Rate::Quality(quality) => Some(quality.unwrap_or(self.usual_quality())),
            Rate::Bits(_) => None,
        };
        if let Some(name) = self.preset(preset) {
            encoder.set_property_from_str("speed-preset", name);
        }
        match (self, quality, rate) {
            (Self::H264, Some(quality), _) => {
                encoder.set_property_from_str("pass", "qual");
                encoder.set_property("quantizer", quality);
                // Else the default bit rate would cap the quality.
                encoder.set_property("vbv-buf-capacity", 0u32);
            }
            (Self::Hevc, Some(quality), _) => {
                encoder.set_property("option-string", format!("crf={quality}:log-level=error"));
            }
            (Self::Av1, _, _) => {
                // Without what it calls real time a frame takes some ten times as long, for files that are a sixth smaller.
                let (usage, speed) = match preset {
                    Preset::Fast => ("realtime", 10i32),
                    Preset::Medium => ("realtime", 8),
                    Preset::Slow => ("good-quality", 6),
                };
                encoder.set_property_from_str("usage-profile", usage);
                encoder.set_property("cpu-used", speed);
                match (quality, rate) {
                    (Some(quality), _) => {
                        encoder.set_property_from_str("end-usage", "q");
                        encoder.set_property("min-quantizer", quality);
                        encoder.set_property("max-quantizer", quality);
                    }
                    (None, Rate::Bits(rate)) => {
                        encoder.set_property("target-bitrate", rate);
                        // By default every frame is lossless, whatever the rate.
                        encoder.set_property("max-quantizer", 63u32);
                    }
                    _ => {}
                }
            }
            (Self::H264 | Self::Hevc, None, Rate::Bits(rate)) => encoder.set_property("bitrate", rate),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_container_that_does_not_hold_a_codec_is_named() {
        gst::init().unwrap();
        let check =
            |codec: Codec, container, rate| codec.check(container, rate, None).map_err(|e| e.to_string());
        let usual = Rate::Quality(None);
        for codec in [Codec::H264, Codec::Hevc, Codec::Av1, Codec::Prores, Codec::Ffv1] {
            assert_eq!(check(codec, codec.usual_container(), usual), Ok(()), "{codec}");
        }
        let refused = check(Codec::Prores, Container::Mp4, usual).unwrap_err();
        assert!(refused.contains("MP4") && refused.contains("--container mov"), "{refused}");
        assert!(check(Codec::Ffv1, Container::Mov, usual).unwrap_err().contains("--container mkv"));
        let rate = Rate::Quality(Some(52));
        assert!(check(Codec::Hevc, Container::Mp4, rate).unwrap_err().contains("between 0"));
        assert!(check(Codec::Av1, Container::Mp4, rate).is_ok());
        assert!(check(Codec::Ffv1, Container::Mkv, Rate::Bits(100)).unwrap_err().contains("--bitrate"));
    }
}
