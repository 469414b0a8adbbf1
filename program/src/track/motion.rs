// SPDX-License-Identifier: MIT OR Apache-2.0

//! The motion of a clip as a file for filters that are given one frame at a time.
//!
//! The frames go through the element as for `fix`, at the same times, so that applying the file gives the same
//! pictures.

use crate::elements::{launch, named, pad};
use crate::input::{self, Opening};
use crate::interruption::Interruption;
use crate::isobmff::Film;
use crate::picture::Picture;
use crate::playback;
use crate::rectifier_options::RectifierOptions;
use crate::times;
use anyhow::{Context, Result, anyhow, bail};
use gst::prelude::*;
use gstrsrectify::rsrectify::RsRectify;
use rsrectify::motion::file::{Clip, MotionFileError, MotionRecord, MotionWriter};
use std::io::{Seek, Write};
use std::sync::{Arc, Mutex, PoisonError};

/// What is written, until it fails.
type Writing<W> = Arc<Mutex<Result<MotionWriter<W>, MotionFileError>>>;

/// Writes the motion of a clip, whose readout and crop have been sought as `fix` does; the number of its frames.
pub fn write<W: Write + Seek + Send + 'static>(
    clip: &input::Clip,
    options: &RectifierOptions,
    output: W,
    interruption: &Interruption,
) -> Result<(W, usize)> {
    let file = clip.only_file("--motion")?;
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let bytes = std::fs::metadata(file).context("cannot be read")?.len();
    let picture = Picture::of(clip)?;
    let mut identity = Clip::new(name, bytes);
    let film = Film::read(file);
    let video = film.as_ref().and_then(|film| film.track(film.main_video()?));
    identity.mirrored = video.is_some_and(|track| track.is_mirrored());
    let aspect = picture.info.as_ref().map(|info| [info.par().numer(), info.par().denom()]);
    let aspect = aspect.map(|aspect| aspect.map(|side| u32::try_from(side).unwrap_or(0)));
    identity.pixel_aspect = aspect.filter(|aspect| !aspect.contains(&0)).unwrap_or(identity.pixel_aspect);
    identity.zoom = options.zoom();
    let writing: Writing<W> = Arc::new(Mutex::new(MotionWriter::new(output, identity)));
    play(clip, picture.delay, options, &writing, interruption)?;
    // The pipeline is gone, and with it the other one who held this.
    let writer = Arc::into_inner(writing).context("the rectifier has not ended")?;
    let mut writer = writer.into_inner().unwrap_or_else(PoisonError::into_inner)?;
    let frames = writer.frames();
    if frames == 0 {
        bail!("no frame could be decoded");
    }
    if writer.clip_mut().mirrored {
        log::warn!(
            "players mirror the clip: `rsrectify fix` applies the file, filters leave the frames as they are"
        );
    }
    Ok((writer.finish()?, frames))
}

/// Runs the clip through the rectifier, which does not change it, to its end.
fn play<W: Write + Seek + Send + 'static>(
    clip: &input::Clip,
    delay: usize,
    options: &RectifierOptions,
    writing: &Writing<W>,
    interruption: &Interruption,
) -> Result<()> {
    let pipeline = launch(
        "queue name=frames ! videoconvert ! rsrectify name=rectifier ! fakesink sync=false async=false",
    )?;
    let frames = named(&pipeline, "frames")?;
    clip.read_video(&pipeline, Opening::Whole, &pad(&frames, "sink")?)?;
    note_orientation(&pad(&frames, "sink")?, writing.clone());
    let straightened = times::straighten(&pad(&frames, "src")?);
    times::mend(&pipeline, delay);
    let rectifier = named(&pipeline, "rectifier")?;
    RectifierOptions { strength: Some(0.0), ..options.clone() }.apply(&rectifier)?;
    let rectifier =
        rectifier.downcast::<RsRectify>().map_err(|_| anyhow!("the rectifier is another element"))?;
    let target = writing.clone();
    rectifier.observe_motions(move |time, solution| {
        let Some(time) = time.and_then(|time| i64::try_from(time.nseconds()).ok()) else { return };
        let record = MotionRecord::new(time, solution.motion.clone())
            .with_confidence(solution.confidence, solution.expected_error);
        let mut writing = target.lock().unwrap_or_else(PoisonError::into_inner);
        if let Ok(writer) = &mut *writing
            && let Err(error) = writer.push(&record)
        {
            *writing = Err(error);
        }
    });
    drop(rectifier);
    let frames = || match &*writing.lock().unwrap_or_else(PoisonError::into_inner) {
        Ok(writer) => Some(writer.frames()),
        // It is returned when the pipeline has stopped.
        Err(_) => None,
    };
    playback::play(pipeline, frames, interruption)?;
    let moved = straightened.moved();
    if moved > 0 {
        log::warn!("the times of frames contradict their order: {moved} count as a little later");
    }
    Ok(())
}

/// Notes by how much players turn frames that come to a pad, as their file states it.
fn note_orientation<W: Write + Seek + Send + 'static>(frames: &gst::Pad, writing: Writing<W>) {
    frames.add_probe(gst::PadProbeType::EVENT_DOWNSTREAM, move |_, info| {
        if let Some(gst::EventView::Tag(tags)) = info.event().map(|event| event.view())
            && let Some(orientation) = tags.tag().get::<gst::tags::ImageOrientation>()
        {
            let orientation = orientation.get();
            let turned = match orientation.strip_prefix("flip-").unwrap_or(orientation) {
                "rotate-90" => 90,
                "rotate-180" => 180,
                "rotate-270" => 270,
                _ => 0,
            };
            if let Ok(writer) = &mut *writing.lock().unwrap_or_else(PoisonError::into_inner) {
                writer.clip_mut().turned = turned;
                writer.clip_mut().mirrored |= orientation.starts_with("flip-");
            }
        }
        gst::PadProbeReturn::Ok
    });
}
