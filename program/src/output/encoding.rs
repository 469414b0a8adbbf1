//! What the user may ask of the video that is written.

use super::codec::{Codec, Container, Rate};
use anyhow::{Result, bail};
use clap::Args;
use std::path::Path;

/// How the video is encoded, and in which kind of file.
#[derive(Args, Clone, Debug)]
pub struct EncodingOptions {
    /// How the video is encoded.
    #[arg(long, value_enum, default_value = "h264")]
    pub codec: Codec,
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
}

impl EncodingOptions {
    /// How much may be lost.
    pub fn rate(&self) -> Rate {
        self.bitrate.map_or(Rate::Quality(self.quality), Rate::Bits)
    }

    /// The kind of file that a clip becomes; `output` is the file that the user named, if any.
    pub fn container(&self, clip: &Path, output: Option<&Path>) -> Result<Container> {
        let named = output.map(Container::of);
        if named == Some(None) && self.container.is_none() {
            bail!("--output must end in .mp4, .mov or .mkv, or --container be given");
        }
        // What suits the clip, where that can hold the codec.
        let suited = || {
            let suited = Container::for_clip(clip);
            let is_held = self.codec.check(suited, self.rate()).is_ok();
            if is_held { suited } else { self.codec.usual_container() }
        };
        Ok(self.container.or(named.flatten()).unwrap_or_else(suited))
    }
}
