// SPDX-License-Identifier: MIT OR Apache-2.0

//! A clip → two videos that browsers play: as it was recorded, and rectified.

use crate::elements::{NO_VIDEO, hold_for_twins, launch, named, pad};
use crate::input::{Clip, Opening};
use crate::interruption::Interruption;
use crate::picture::Picture;
use crate::playback;
use crate::plot::series::Series;
use crate::rectifier_options::{AnalysisOptions, RectifierOptions};
use crate::summary::Tally;
use crate::times;
use anyhow::{Context, Result, bail};
use gst::prelude::*;
use gst_video::VideoInterlaceMode;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// Pixels along the longer side, at most.
const LONGEST: f64 = 1280.0;
/// Frames from one key frame to the next: players decode half as many to go to a frame.
const KEY_INTERVAL: u32 = 15;
/// Quantizer of the encoder: hardly a difference to the clip is seen.
const QUANTIZER: u32 = 20;

/// The frames of videos that were written: their number, their motions, their corrections.
pub struct Written {
    pub frames: usize,
    pub series: Series,
    pub tally: Tally,
}

/// Writes both videos, without audio, upright, with all frames at their times.
pub fn write(
    clip: &Clip,
    analysis: &AnalysisOptions,
    [before, after]: [&Path; 2],
    interruption: &Interruption,
) -> Result<Written> {
    let picture = Picture::of(clip)?;
    let info = picture.info.as_ref().context(NO_VIDEO)?;
    if info.interlace_mode() != VideoInterlaceMode::Progressive {
        bail!("is interlaced: each frame holds two exposures; deinterlace it first");
    }
    let [width, height] = size(info);
    // B-frames would shift the times.
    let encoded = format!(
        "videoscale ! video/x-raw,width={width},height={height},pixel-aspect-ratio=1/1 ! videoconvert ! \
         videoflip video-direction=auto ! videoconvert ! video/x-raw,format=I420 ! x264enc pass=qual \
         quantizer={QUANTIZER} speed-preset=veryfast bframes=0 key-int-max={KEY_INTERVAL} ! h264parse ! mp4mux"
    );
    let pipeline = launch(&format!(
        "queue name=frames ! videoconvert ! tee name=both  \
         both. ! queue name=original ! {encoded} ! filesink name=before  \
         both. ! rsrectify name=rectifier ! queue ! {encoded} ! filesink name=after"
    ))?;
    for (name, file) in [("before", before), ("after", after)] {
        named(&pipeline, name)?.set_property("location", file);
    }
    let frames = named(&pipeline, "frames")?;
    clip.read_video(&pipeline, Opening::Whole, &pad(&frames, "sink")?)?;
    let straightened = times::straighten(&pad(&frames, "src")?);
    times::mend(&pipeline, picture.delay);
    let rectifier = named(&pipeline, "rectifier")?;
    let options = RectifierOptions { analysis: analysis.clone(), ..Default::default() };
    options.apply(&rectifier)?;
    hold_for_twins(&named(&pipeline, "original")?, &rectifier)?;
    let (series, tally) = (Arc::new(Mutex::new(Series::default())), Tally::default());
    let target = series.clone();
    tally.listen(&rectifier, &options, None, move |time, solution| {
        let time = time.map(gst::ClockTime::seconds_f64);
        target.lock().unwrap_or_else(PoisonError::into_inner).add(time, solution);
    })?;
    drop(rectifier);
    playback::play(pipeline, || Some(tally.frames()), interruption)?;
    let moved = straightened.moved();
    if moved > 0 {
        log::warn!("the times of frames contradict their order: {moved} are shown a little later");
    }
    let series = std::mem::take(&mut *series.lock().unwrap_or_else(PoisonError::into_inner));
    let frames = tally.frames();
    if frames == 0 {
        bail!("no frame could be decoded");
    }
    Ok(Written { frames, series, tally })
}

/// Width and height of the videos before they are turned upright: even, as H.264 has them, with square pixels.
fn size(info: &gst_video::VideoInfo) -> [u32; 2] {
    let [numerator, denominator] =
        [info.par().numer(), info.par().denom()].map(|side| f64::from(side.max(1)));
    let [width, height] = [f64::from(info.width()) * numerator / denominator, f64::from(info.height())];
    let scale = (LONGEST / width.max(height)).min(1.0);
    [width, height].map(|side| (2.0 * (side * scale / 2.0).round()).max(2.0) as u32)
}
