//! What clips can be encoded to, and which files hold it.

use crate::elements;
use anyhow::{Result, bail};
use clap::ValueEnum;
use gst::prelude::*;
use std::fmt;
use std::path::Path;

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
}

/// The file around the streams.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Container {
    /// .mp4
    Mp4,
    /// .mov, QuickTime
    Mov,
    /// .mkv, Matroska
    Mkv,
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
        })
    }
}

impl fmt::Display for Container {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Mp4 => "MP4",
            Self::Mov => "MOV",
            Self::Mkv => "MKV",
        })
    }
}

impl Container {
    /// The container that a file's name asks for.
    pub fn of(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "mp4" | "m4v" => Some(Self::Mp4),
            "mov" | "qt" => Some(Self::Mov),
            "mkv" => Some(Self::Mkv),
            _ => None,
        }
    }

    /// The container that holds the streams of a clip best: its own kind, of MXF that of the same makers of films, else
    /// Matroska, which takes most.
    pub fn for_clip(clip: &Path) -> Self {
        let extension =
            clip.extension().and_then(|extension| extension.to_str()).map(str::to_ascii_lowercase);
        match extension.as_deref() {
            Some("mp4" | "m4v" | "3gp" | "3g2" | "f4v" | "y4m") => Self::Mp4,
            Some("mov" | "qt" | "mxf") => Self::Mov,
            _ => Self::Mkv,
        }
    }

    /// The extension of its files.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Mp4 => "mp4",
            Self::Mov => "mov",
            Self::Mkv => "mkv",
        }
    }

    /// Whether its files are made of boxes: this program writes them itself.
    pub fn is_isobmff(self) -> bool {
        matches!(self, Self::Mp4 | Self::Mov)
    }

    /// The element that writes it.
    pub fn muxer(self) -> &'static str {
        match self {
            Self::Mp4 => "mp4mux",
            Self::Mov => "qtmux",
            Self::Mkv => "matroskamux",
        }
    }

    /// Whether its muxer takes streams of these caps on pads called `name`, such as `audio_%u`.
    pub fn takes(self, name: &str, caps: &gst::Caps) -> bool {
        self.taken(name, caps).is_some()
    }

    /// These caps as its muxer takes them on such pads, with all fields that it asks for; `None` where it does not.
    pub fn taken(self, name: &str, caps: &gst::Caps) -> Option<gst::Caps> {
        let factory = gst::ElementFactory::find(self.muxer())?;
        let mut templates = factory.static_pad_templates().into_iter();
        let template = templates.find(|template| template.name_template() == name)?;
        let mut taken = caps.intersect_with_mode(&template.caps(), gst::CapsIntersectMode::First);
        (!taken.is_empty()).then(|| {
            taken.fixate();
            taken
        })
    }
}

impl Codec {
    /// The file that it usually comes in.
    pub fn usual_container(self) -> Container {
        match self {
            Self::H264 | Self::Hevc | Self::Av1 => Container::Mp4,
            Self::Prores => Container::Mov,
            Self::Ffv1 => Container::Mkv,
        }
    }

    /// The element that encodes.
    pub(super) fn encoder(self) -> &'static str {
        match self {
            Self::H264 => "x264enc",
            Self::Hevc => "x265enc",
            Self::Av1 => "av1enc",
            Self::Prores => "avenc_prores_ks",
            Self::Ffv1 => "avenc_ffv1",
        }
    }

    /// The parser that gives the stream the form that muxers want.
    pub(super) fn parser(self) -> Option<&'static str> {
        match self {
            Self::H264 => Some("h264parse"),
            Self::Hevc => Some("h265parse"),
            Self::Av1 => Some("av1parse"),
            Self::Prores | Self::Ffv1 => None,
        }
    }

    /// Caps of the encoded stream, in the words of GStreamer.
    fn media_type(self) -> &'static str {
        match self {
            Self::H264 => "video/x-h264",
            Self::Hevc => "video/x-h265",
            Self::Av1 => "video/x-av1",
            Self::Prores => "video/x-prores",
            Self::Ffv1 => "video/x-ffv",
        }
    }

    /// The best and the worst quality on the encoder's scale; none for what has no such scale.
    fn qualities(self) -> Option<[u32; 2]> {
        match self {
            Self::H264 => Some([0, 50]),
            Self::Hevc => Some([0, 51]),
            Self::Av1 => Some([0, 63]),
            Self::Prores | Self::Ffv1 => None,
        }
    }

    /// A quality that is hard to tell from the original.
    fn usual_quality(self) -> u32 {
        match self {
            Self::Av1 => 20,
            _ => 18,
        }
    }

    /// Refuses what cannot be written: by this installation, by the container, at this rate.
    pub fn check(self, container: Container, rate: Rate) -> Result<()> {
        match (self.qualities(), rate) {
            (None, Rate::Quality(Some(_)) | Rate::Bits(_)) => {
                bail!("{self} has neither --quality nor --bitrate: it keeps what it is given")
            }
            (Some([best, worst]), Rate::Quality(Some(quality))) if !(best..=worst).contains(&quality) => {
                bail!("--quality of {self} is between {best} (best) and {worst} (worst)")
            }
            _ => {}
        }
        let elements = [Some(self.encoder()), self.parser(), Some(container.muxer())];
        elements::require(&elements.into_iter().flatten().collect::<Vec<_>>())?;
        let stream = gst::Caps::new_empty_simple(self.media_type());
        if !container.takes("video_%u", &stream) {
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
            Self::Prores | Self::Ffv1 => "",
        };
        format!("{}{form}", self.media_type())
    }

    /// Sets the encoder to a rate.
    pub(super) fn configure(self, encoder: &gst::Element, rate: Rate) {
        let quality = match rate {
            Rate::Quality(quality) => Some(quality.unwrap_or(self.usual_quality())),
            Rate::Bits(_) => None,
        };
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
                // Its default speed takes seconds a frame.
                encoder.set_property("cpu-used", 6i32);
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
    fn names_ask_for_containers() {
        let of = |name: &str| Container::of(Path::new(name));
        assert_eq!(of("a/B.MP4"), Some(Container::Mp4));
        assert_eq!(of("b.m4v"), Some(Container::Mp4));
        assert_eq!(of("c.mov"), Some(Container::Mov));
        assert_eq!(of("d.mkv"), Some(Container::Mkv));
        assert_eq!((of("e.avi"), of("mp4")), (None, None));
    }

    #[test]
    fn a_container_that_does_not_hold_a_codec_is_named() {
        gst::init().unwrap();
        let check = |codec: Codec, container, rate| codec.check(container, rate).map_err(|e| e.to_string());
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
