//! A clip → two videos that browsers play: as it was recorded, and rectified.

use crate::decoder;
use crate::elements::{NO_VIDEO, launch, make, named, pad};
use crate::interruption::Interruption;
use crate::picture::Picture;
use crate::playback::{Event, Playback};
use crate::plot::series::Series;
use crate::progress;
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
/// Frames that wait for their rectified twins, beside those looked ahead.
const WAITING: u32 = 8;

/// What is known of the frames when the videos are written.
pub struct Written {
    pub frames: usize,
    pub series: Series,
    pub tally: Tally,
}

/// Writes both videos, without audio, upright, with all frames at their times.
pub fn write(
    clip: &Path,
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
    let (source, decoder) = (make("filesrc")?, decoder::of(clip)?);
    source.set_property("location", clip);
    pipeline.add_many([&source, &decoder])?;
    source.link(&decoder)?;
    let frames = named(&pipeline, "frames")?;
    decoder::link_video(clip, &decoder, &pad(&frames, "sink")?, |decoder| {
        gst::element_error!(decoder, gst::StreamError::WrongType, ("{NO_VIDEO}"));
    })?;
    let straightened = times::straighten(&pad(&frames, "src")?);
    times::mend(&pipeline, picture.delay);
    let rectifier = named(&pipeline, "rectifier")?;
    let options = RectifierOptions { analysis: analysis.clone(), ..Default::default() };
    options.apply(&rectifier)?;
    let original = named(&pipeline, "original")?;
    original.set_property("max-size-buffers", rectifier.property::<u32>("lookahead") + WAITING);
    original.set_property("max-size-bytes", 0u32);
    original.set_property("max-size-time", 0u64);
    answer_no_allocation(&pad(&original, "sink")?);
    let (series, tally) = (Arc::new(Mutex::new(Series::default())), Tally::default());
    let target = series.clone();
    tally.listen(&rectifier, &options, None, move |time, solution| {
        let time = time.map(gst::ClockTime::seconds_f64);
        target.lock().unwrap_or_else(PoisonError::into_inner).add(time, solution);
    })?;
    drop(rectifier);
    play(pipeline, &tally, interruption)?;
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

/// A question for buffers would wait until the frames before it have gone on, and those wait for their rectified twins, which come from
/// the thread that asks.
fn answer_no_allocation(pad: &gst::Pad) {
    pad.add_probe(gst::PadProbeType::QUERY_DOWNSTREAM, |_, info| {
        let is_allocation = info.query().is_some_and(|query| query.type_() == gst::QueryType::Allocation);
        if is_allocation { gst::PadProbeReturn::Drop } else { gst::PadProbeReturn::Ok }
    });
}

/// Runs the pipeline to its end.
fn play(pipeline: gst::Pipeline, tally: &Tally, interruption: &Interruption) -> Result<()> {
    let bar = progress::spinner()?;
    let mut playback = Playback::new(pipeline)?;
    playback.set_state(gst::State::Playing);
    loop {
        match playback.next(gst::ClockTime::from_mseconds(100), interruption)? {
            Event::End => break,
            Event::Warning(warning) => bar.suspend(|| log::warn!("{warning}")),
            _ => {}
        }
        bar.set_message(format!("{} frames", tally.frames()));
        bar.tick();
    }
    bar.finish_and_clear();
    Ok(())
}
