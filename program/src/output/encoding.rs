// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the user may ask of the video that is written.

use super::codec::{Codec, Preset, Rate};
use super::container::Container;
use crate::input::Clip;
use anyhow::{Result, bail};
use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use std::path::Path;

/// Which codec the user wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CodecChoice {
    /// That of the clip, as far as there is an encoder.
    Same,
    /// This one.
    Of(Codec),
}

impl ValueEnum for CodecChoice {
    fn value_variants<'a>() -> &'a [Self] {
        use Codec::{Av1, Ffv1, H264, Hevc, Prores};
        &[Self::Same, Self::Of(H264), Self::Of(Hevc), Self::Of(Av1), Self::Of(Prores), Self::Of(Ffv1)]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        match self {
            Self::Same => {
                Some(PossibleValue::new("same").help("That of the clip, where there is an encoder for it"))
            }
            Self::Of(codec) => codec.to_possible_value(),
        }
    }
}

/// How the video is encoded, and in which kind of file.
#[derive(Args, Clone, Debug)]
pub struct EncodingOptions {
    /// How the video is encoded.
    #[arg(long, value_enum, default_value = "same")]
    pub codec: CodecChoice,
    /// The kind of file; without it the one that the output's name says, else the clip's own if it is MP4 or
    /// MOV (MOV for MXF), else MKV, which holds the streams of all others; or the codec's usual one.
    #[arg(long, value_enum)]
    pub container: Option<Container>,
    /// Constant quality on the encoder's scale, 0 the best: H.264 to 50 and HEVC to 51 (18 unless given), AV1
    /// to 63 (20); ProRes and FFV1 have none.
    #[arg(long)]
    pub quality: Option<u32>,
    /// Bit rate in kbit/s instead of a constant quality.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=100_000), conflicts_with = "quality")]
    pub bitrate: Option<u32>,
    /// How much work the encoder of H.264, HEVC or AV1 takes for the size of the file; `medium` unless given.
    #[arg(long, value_enum)]
    pub preset: Option<Preset>,
    /// Encodes H.264, HEVC or AV1 in hardware where GStreamer has an encoder there that keeps what the clip has.
    #[arg(long)]
    pub hardware: bool,
}

impl EncodingOptions {
    /// How much may be lost.
    pub fn rate(&self) -> Rate {
        self.bitrate.map_or(Rate::Quality(self.quality), Rate::Bits)
    }

    /// The codec, where it does not depend on that of the clip.
    pub fn settled_codec(&self, container: Container) -> Option<Codec> {
        match (self.codec, container) {
            (CodecChoice::Of(codec), _) => Some(codec),
            (CodecChoice::Same, Container::Y4m) => Some(Codec::Raw),
            (CodecChoice::Same, Container::Images) => Some(Codec::Png),
            (CodecChoice::Same, _) => None,
        }
    }

    /// Refuses a codec that cannot be written as it is asked for.
    pub fn check_codec(&self, codec: Codec, container: Container) -> Result<()> {
        codec.check(container, self.rate(), self.preset)
    }

    /// Refuses what cannot be written, as far as that is known before a clip is opened.
    pub fn check(&self, container: Container) -> Result<()> {
        self.settled_codec(container).map_or(Ok(()), |codec| self.check_codec(codec, container))
    }

    /// The kind of file that a clip becomes; `output` is the file that the user named, if any.
    pub fn container(&self, clip: &Clip, output: Option<&Path>) -> Result<Container> {
        let named = output.map(Container::of);
        if named == Some(None) && self.container.is_none() {
            bail!(
                "--output must end in .mp4, .mov, .mkv or .y4m, be a pattern such as frames/%06d.png, or --container be given"
            );
        }
        if named == Some(Some(Container::Images)) && self.container.is_some() {
            bail!("--output names PNG images, which are in no --container");
        }
        // What suits the clip, where that can hold the codec.
        let suited = || match self.codec {
            CodecChoice::Same if clip.as_images().is_some() => Container::Images,
            CodecChoice::Same => Container::for_clip(clip),
            CodecChoice::Of(codec) if clip.as_images().is_some() => codec.usual_container(),
            CodecChoice::Of(codec) => {
                let suited = Container::for_clip(clip);
                if self.check_codec(codec, suited).is_ok() { suited } else { codec.usual_container() }
            }
        };
        Ok(self.container.or(named.flatten()).unwrap_or_else(suited))
    }
}
