// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify index`: when the frames of a clip are shown, without decoding it.
//!
//! The frames of a part of the clip are then found by their times. A clip of hours is read once, not by each of the
//! processes that rectify parts of it.

use crate::clips;
use crate::input::{Clip, InputOptions};
use crate::interruption::Interruption;
use crate::output;
use crate::packets::Packets;
use crate::progress;
use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// What the user may ask of `index`.
#[derive(Args, Debug)]
pub struct IndexOptions {
    /// The clip.
    pub clip: PathBuf,
    /// The file to write instead of the standard output; replaced if it is there.
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
}

/// When the frames of a clip are shown.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameIndex {
    pub clip: String,
    /// Size of the clip's file.
    pub bytes: u64,
    pub frames: usize,
    /// Presentation times in the clip, in order.
    pub times_ns: Vec<u64>,
    /// The time in the clip from which on it is played: transport streams do not begin at 0.
    pub start_ns: u64,
    /// SHA-256 of the encoded frames in the file's order, whatever the container.
    pub sha256: String,
}

impl FrameIndex {
    /// Reads a clip.
    ///
    /// # Errors
    /// Where the clip cannot be read, or does not state the times of its frames.
    fn of(clip: &Path, interruption: &Interruption) -> Result<Self> {
        let mut packets = Packets::open(clip, interruption)?;
        packets.caps()?;
        let start_ns = packets.start().nseconds();
        let mut digest = Digest::new()?;
        let (mut times_ns, mut hidden) = (Vec::new(), 0);
        let bar = progress::spinner()?;
        while let Some(packet) = packets.next(interruption)? {
            digest.add(&packet.buffer)?;
            match packet.time {
                Some(time) => times_ns.push(time.nseconds()),
                None if packet.buffer.pts().is_some() => hidden += 1,
                None => bail!("the file does not state when each of its frames is shown"),
            }
            bar.set_message(format!("{} frames found", times_ns.len()));
            bar.tick();
        }
        bar.finish_and_clear();
        times_ns.sort_unstable();
        if times_ns.is_empty() {
            bail!("none of {hidden} frames is shown");
        }
        if times_ns.windows(2).any(|pair| pair[0] == pair[1]) {
            bail!("several frames are shown at the same time");
        }
        let (bytes, clip) = (size(clip)?, clip.display().to_string());
        Ok(Self { clip, bytes, frames: times_ns.len(), times_ns, start_ns, sha256: digest.finish()? })
    }

    /// That of a clip: what `rsrectify index` has written, or else by reading the clip.
    ///
    /// # Errors
    /// Where the clip cannot be read, or is of another size than the one that was indexed.
    pub fn given_or_of(file: Option<&Path>, clip: &Path, interruption: &Interruption) -> Result<Self> {
        match file {
            Some(file) => {
                let index = Self::read(file)?;
                let bytes = size(clip)?;
                if bytes != index.bytes {
                    let file = file.display();
                    bail!("{file} is the index of a clip of {} bytes, but this one has {bytes}", index.bytes);
                }
                Ok(index)
            }
            None => Self::of(clip, interruption),
        }
    }

    /// Reads what `rsrectify index` has written.
    fn read(file: &Path) -> Result<Self> {
        let broken = || format!("{} is no index of frames", file.display());
        let text = std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
        let index: Self = serde_json::from_slice(&text).with_context(broken)?;
        let is_sorted = index.times_ns.windows(2).all(|pair| pair[0] < pair[1]);
        if !is_sorted || index.times_ns.len() != index.frames || index.frames == 0 {
            bail!(broken());
        }
        Ok(index)
    }

    /// From when on the clip is played.
    pub fn start(&self) -> gst::ClockTime {
        gst::ClockTime::from_nseconds(self.start_ns)
    }

    /// When a frame is shown; `None` beyond the last.
    pub fn time(&self, frame: usize) -> Option<gst::ClockTime> {
        self.times_ns.get(frame).copied().map(gst::ClockTime::from_nseconds)
    }
}

/// Bytes of a file.
fn size(file: &Path) -> Result<u64> {
    let about = std::fs::metadata(file).with_context(|| format!("cannot read {}", file.display()))?;
    Ok(about.len())
}

/// The SHA-256 of encoded frames.
pub struct Digest(gst::glib::Checksum);

impl Digest {
    pub fn new() -> Result<Self> {
        let checksum = gst::glib::Checksum::new(gst::glib::ChecksumType::Sha256);
        checksum.map(Self).context("this GLib has no SHA-256")
    }

    /// Adds a frame.
    pub fn add(&mut self, buffer: &gst::BufferRef) -> Result<()> {
        let bytes = buffer.map_readable().map_err(|_| anyhow!("a frame cannot be read"))?;
        self.0.update(&bytes);
        Ok(())
    }

    /// In hexadecimal digits.
    pub fn finish(self) -> Result<String> {
        self.0.string().context("this GLib has no SHA-256")
    }
}

/// Indexes a clip; `false` where that fails for its sake.
pub fn run(options: &IndexOptions, interruption: &Interruption) -> Result<bool> {
    let clip = Clip::named(&options.clip, &InputOptions::default(), interruption)?;
    let is_writable = options.output.as_deref().map_or(Ok(()), output::check_writable);
    let index = || FrameIndex::of(clip.only_file("rsrectify index")?, interruption);
    let written = is_writable.and_then(|()| index()).and_then(|index| {
        let text = serde_json::to_string(&index)?;
        match &options.output {
            Some(file) => {
                std::fs::write(file, text).with_context(|| format!("cannot write {}", file.display()))
            }
            None => progress::print(format!("{text}\n").as_bytes()),
        }
    });
    clips::finish(&clip, written, interruption)
}
