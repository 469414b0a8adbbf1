// SPDX-License-Identifier: MIT OR Apache-2.0

//! The encoded frames of several files, one after another, with the times of the clip's frames.

use crate::colour::Colour;
use crate::elements::{named, pad, parse};
use crate::index::{Digest, FrameIndex};
use crate::interruption::Interruption;
use crate::isobmff::EncodedVideo;
use crate::packets::Packets;
use crate::streams::label;
use anyhow::{Context, Result, anyhow, bail};
use gst::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Rectified parts of a clip.
pub struct Parts {
    files: Vec<PartFile>,
    /// The times of the clip's frames.
    index: FrameIndex,
    /// What the encoded frames are.
    caps: gst::Caps,
    /// By how much decoding is ahead of showing, where a frame is told from later ones.
    reordering: gst::ClockTime,
    sha256: String,
    joined: AtomicUsize,
}

/// A part that was read once.
struct PartFile {
    path: PathBuf,
    /// The number in the clip of each frame, in the file's order.
    numbers: Vec<usize>,
    sha256: String,
}

impl Parts {
    /// Reads the parts: whether they are of one kind, and have as many frames as the clip.
    pub fn read(paths: &[PathBuf], index: FrameIndex, interruption: &Interruption) -> Result<Self> {
        let (mut files, mut whole) = (Vec::new(), Digest::new()?);
        let mut caps: Option<gst::Caps> = None;
        let mut first = 0;
        for path in paths {
            let (file, own) = PartFile::read(path, first, &mut whole, interruption)
                .with_context(|| path.display().to_string())?;
            first += file.numbers.len();
            files.push(file);
            if !caps.as_ref().is_none_or(|caps| is_alike(caps, &own)) {
                bail!("{} is encoded otherwise than the parts before it", path.display());
            }
            caps.get_or_insert(own);
        }
        if first != index.frames {
            bail!("the parts have {first} frames, the clip {}", index.frames);
        }
        let caps = caps.context("there are no parts")?;
        let decoded = files.iter().flat_map(|file| &file.numbers);
        let ahead = decoded.enumerate().filter_map(|(order, number)| {
            index.time(order).zip(index.time(*number)).map(|(due, shown)| due.saturating_sub(shown))
        });
        let reordering = ahead.max().unwrap_or_default();
        Ok(Self { reordering, files, index, caps, sha256: whole.finish()?, joined: AtomicUsize::new(0) })
    }

    /// What the encoded frames are.
    pub fn caps(&self) -> &gst::Caps {
        &self.caps
    }

    /// What their pictures stand for.
    pub fn colour(&self) -> Colour {
        let stated = Colour::of_caps(&self.caps);
        let film = self.files.first().and_then(|file| Colour::of_film(&file.path));
        stated.or(film.unwrap_or_default())
    }

    /// How many there are.
    pub fn frames(&self) -> usize {
        self.index.frames
    }

    /// How many have been given out.
    pub fn joined(&self) -> usize {
        self.joined.load(Ordering::Relaxed)
    }

    /// SHA-256 of all encoded frames.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// Each part with its number of frames and their SHA-256.
    pub fn files(&self) -> impl Iterator<Item = (&Path, usize, &str)> {
        self.files.iter().map(|file| (file.path.as_path(), file.numbers.len(), file.sha256.as_str()))
    }

    /// Gives out all frames in decoding order, each with when it is shown, in the clip, by its place; until `give` says no.
    fn each(
        &self,
        interruption: &Interruption,
        give: &mut dyn FnMut(gst::Buffer, Place) -> Result<bool>,
    ) -> Result<()> {
        for file in &self.files {
            let mut packets = Packets::open(&file.path, interruption)?;
            for number in &file.numbers {
                let packet = packets.next(interruption)?.context("a part was changed while it was read")?;
                let order = self.joined();
                let (shown, due) =
                    self.index.time(*number).zip(self.index.time(order)).context("no such frame")?;
                let next = self.index.time(number + 1);
                let last = || number.checked_sub(1).and_then(|last| Some(shown - self.index.time(last)?));
                let duration = next.map(|next| next - shown).or_else(last);
                let start = self.index.start();
                let (shown, due) = (shown.saturating_sub(start), due.saturating_sub(start));
                if !give(packet.buffer, Place { shown, due, duration })? {
                    return Ok(());
                }
                self.joined.fetch_add(1, Ordering::Relaxed);
            }
        }
        Ok(())
    }

    /// Collects all frames; `note` is told of each.
    pub fn collect(
        &self,
        video: &mut EncodedVideo,
        interruption: &Interruption,
        note: &mut dyn FnMut(),
    ) -> Result<()> {
        video.set_caps(&self.caps);
        self.each(interruption, &mut |mut buffer, place| {
            buffer.make_mut().set_duration(place.duration);
            video.push(&buffer, i64::try_from(place.shown.nseconds())?)?;
            note();
            Ok(true)
        })?;
        video.finish()
    }

    /// Gives out all frames to a pipeline.
    fn push(&self, source: &gst_app::AppSrc, interruption: &Interruption) -> Result<()> {
        let mut is_taken = true;
        self.each(interruption, &mut |mut buffer, place| {
            let timed = buffer.make_mut();
            // All is later by the reordering, so that no time is negative; the branch is offset by as much.
            timed.set_pts(place.shown + self.reordering);
            timed.set_dts(place.due);
            timed.set_duration(place.duration);
            // A pipeline that has stopped says why itself.
            is_taken = source.push_buffer(buffer).is_ok();
            Ok(is_taken)
        })?;
        if is_taken {
            source.end_of_stream()?;
        }
        Ok(())
    }
}

/// When a frame is shown and decoded, from the start of the clip, and for how long it is shown.
struct Place {
    shown: gst::ClockTime,
    due: gst::ClockTime,
    duration: Option<gst::ClockTime>,
}

impl PartFile {
    /// Reads a part whose first frame has this number in the clip; what its frames are.
    fn read(
        path: &Path,
        first: usize,
        whole: &mut Digest,
        interruption: &Interruption,
    ) -> Result<(Self, gst::Caps)> {
        let mut packets = Packets::open(path, interruption)?;
        let caps = packets.caps()?;
        let frames = packets.comments().iter().find_map(|comment| label::read(comment));
        if let Some(frames) = frames.as_ref().filter(|frames| frames.start != first) {
            bail!("begins with frame {} of the clip where frame {first} should follow", frames.start);
        }
        let (mut own, mut times) = (Digest::new()?, Vec::new());
        while let Some(packet) = packets.next(interruption)? {
            own.add(&packet.buffer)?;
            whole.add(&packet.buffer)?;
            times.push(packet.time.context("a frame has no time")?);
        }
        if let Some(frames) = frames.filter(|frames| frames.len() != times.len()) {
            bail!("has {} frames where there should be {}: it is damaged", times.len(), frames.len());
        }
        let mut shown: Vec<usize> = (0..times.len()).collect();
        shown.sort_by_key(|order| times.get(*order));
        let mut numbers = vec![0; times.len()];
        for (rank, order) in shown.into_iter().enumerate() {
            if let Some(number) = numbers.get_mut(order) {
                *number = first + rank;
            }
        }
        Ok((Self { path: path.to_owned(), numbers, sha256: own.finish()? }, caps))
    }
}

/// Whether one decoder can go on from one kind of frames to the other.
fn is_alike(one: &gst::CapsRef, other: &gst::CapsRef) -> bool {
    let essence = |caps: &gst::CapsRef| {
        let format = caps.structure(0)?;
        let fields = ["width", "height", "stream-format", "codec_data", "profile", "pixel-aspect-ratio"];
        let values = fields.map(|field| format.value(field).ok().and_then(|value| value.serialize().ok()));
        Some((format.name().to_owned(), values))
    };
    essence(one) == essence(other)
}

/// A branch of a pipeline that gives out the frames of all parts, with these caps.
pub fn branch(parts: &Arc<Parts>, caps: &gst::Caps, interruption: &Interruption) -> Result<gst::Bin> {
    let bin = parse("appsrc name=frames format=time block=true max-buffers=64 ! queue")?;
    pad(&bin, "src")?.set_offset(-i64::try_from(parts.reordering.nseconds())?);
    let source = named(&bin, "frames")?;
    let source = source.downcast::<gst_app::AppSrc>().map_err(|_| anyhow!("appsrc is another element"))?;
    source.set_caps(Some(caps));
    let (parts, interruption) = (parts.clone(), interruption.clone());
    let mut push = Some(move |source: gst_app::AppSrc| {
        if let Err(error) = parts.push(&source, &interruption) {
            gst::element_error!(source, gst::ResourceError::Read, ("{error:#}"));
        }
    });
    // Not before data is asked for: until then the caps may change, and those of frames that wait do not.
    let need_data = move |source: &gst_app::AppSrc, _: u32| {
        let Some(push) = push.take() else { return };
        let own = source.clone();
        let begun = std::thread::Builder::new().name("parts".to_owned()).spawn(move || push(own));
        if let Err(error) = begun {
            gst::element_error!(source, gst::ResourceError::Failed, ("{error}"));
        }
    };
    source.set_callbacks(gst_app::AppSrcCallbacks::builder().need_data(need_data).build());
    Ok(bin)
}
