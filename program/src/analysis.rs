//! A clip's frames → the motion of each, without rectifying any.

use crate::elements::{NO_VIDEO, launch, named, pad};
use crate::interruption::Interruption;
use crate::part::{self, Part};
use crate::playback::{Event, Playback};
use anyhow::{Context, Result, anyhow, bail};
use gst::prelude::*;
use gst_video::prelude::*;
use rsrectify::Rectifier;
use rsrectify::plane::{Luma, Plane, PlaneLayout, SampleFormat};
use rsrectify::readout::{ReadoutPosterior, ReadoutPrior};
use rsrectify::rectifier::{Duplicate, FrameSolution, Settings};
use std::collections::VecDeque;
use std::path::Path;

/// What is analysed: formats whose first plane is the luma.
const FORMATS: &str =
    "video/x-raw,format={I420,YV12,NV12,NV21,Y42B,Y444,GRAY8,I420_10LE,I422_10LE,Y444_10LE}";
/// How long each look for a message or a frame is.
const LOOK: gst::ClockTime = gst::ClockTime::from_mseconds(100);

/// The motion of a frame of the clip.
#[derive(Debug)]
pub struct Frame {
    /// When its readout begins, in seconds of the clip.
    pub time: Option<f64>,
    /// Its motion.
    pub solution: FrameSolution,
    /// The decoded frame, where pictures are kept.
    pub picture: Option<gst::Sample>,
}

/// A clip that is analysed: all of it or stretches, with one memory of the camera.
pub struct Analysis {
    playback: Playback,
    sink: gst_app::AppSink,
    info: gst_video::VideoInfo,
    settings: Settings,
    rectifier: Rectifier,
    /// Times of the frames whose motion has not come, and the frames where they are kept.
    waiting: VecDeque<(Option<gst::ClockTime>, Option<gst::Sample>)>,
    keeps_pictures: bool,
    /// The part of the clip that is analysed, where that is not all of it.
    part: Option<Part>,
}

impl Analysis {
    /// Opens a clip.
    pub fn open(clip: &Path, settings: Settings, interruption: &Interruption) -> Result<Self> {
        let pipeline = launch(&format!(
            "filesrc name=source ! decodebin name=decoder ! videoconvert name=decoded ! {FORMATS} ! appsink name=sink sync=false max-buffers=8"
        ))?;
        named(&pipeline, "source")?.set_property("location", clip);
        let decoded = pad(&named(&pipeline, "decoded")?, "sink")?.downgrade();
        named(&pipeline, "decoder")?
            .downcast::<gst::Bin>()
            .map_err(|_| anyhow!("decodebin is no bin"))?
            .connect_no_more_pads(move |decoder| {
                if decoded.upgrade().is_some_and(|pad| !pad.is_linked()) {
                    gst::element_error!(decoder, gst::StreamError::WrongType, ("{NO_VIDEO}"));
                }
            });
        let sink = named(&pipeline, "sink")?;
        let sink = sink.downcast::<gst_app::AppSink>().map_err(|_| anyhow!("appsink is another element"))?;
        let mut playback = Playback::new(pipeline)?;
        playback.set_state(gst::State::Paused);
        while !matches!(playback.next(LOOK, interruption)?, Event::Ready | Event::End) {}
        let first = sink.try_pull_preroll(gst::ClockTime::ZERO);
        let caps = first.as_ref().and_then(|sample| sample.caps());
        let caps = caps.context("no frame could be decoded")?;
        let info = gst_video::VideoInfo::from_caps(caps)?;
        if info.interlace_mode() != gst_video::VideoInterlaceMode::Progressive {
            bail!("is interlaced: each frame holds two exposures; deinterlace it first");
        }
        let rectifier = rectifier(settings, &info)?;
        let waiting = VecDeque::new();
        Ok(Self { playback, sink, info, settings, rectifier, waiting, keeps_pictures: false, part: None })
    }

    /// Starts from what is expected of the readout; before any frame is analysed.
    pub fn expect(&mut self, prior: ReadoutPrior) -> Result<()> {
        self.settings.readout_prior = Some(prior);
        self.rectifier = rectifier(self.settings, &self.info)?;
        Ok(())
    }

    /// What the frames so far say of the readout.
    pub fn posterior(&self) -> Option<ReadoutPosterior> {
        self.rectifier.readout_posterior()
    }

    /// Gives each frame out with its motion.
    pub fn keep_pictures(&mut self) {
        self.keeps_pictures = true;
    }

    /// What the decoded frames are like.
    pub fn info(&self) -> &gst_video::VideoInfo {
        &self.info
    }

    /// Frame width and height in pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.info.width(), self.info.height()]
    }

    /// Frames a second by the file; `None` if it does not say.
    pub fn frame_rate(&self) -> Option<f64> {
        frame_rate(&self.info)
    }

    /// How long the clip is, if it says so.
    pub fn duration(&self) -> Option<gst::ClockTime> {
        self.playback.pipeline().query_duration::<gst::ClockTime>()
    }

    /// Goes to `start`, up to a key frame before it, to play from there to `end`; `false` where the file does not allow it.
    pub fn seek(
        &mut self,
        start: gst::ClockTime,
        end: gst::ClockTime,
        interruption: &Interruption,
    ) -> Result<bool> {
        self.seek_to(gst::SeekFlags::KEY_UNIT, start, Some(end), interruption)
    }

    /// Goes to a part of the clip: only its frames are given out, and those around it analysed.
    pub fn go_to(&mut self, part: Part, interruption: &Interruption) -> Result<()> {
        if !self.seek_to(gst::SeekFlags::ACCURATE, part.seek_start, part.seek_end, interruption)? {
            bail!("{}", part::NO_SEEK);
        }
        self.part = Some(part);
        Ok(())
    }

    fn seek_to(
        &mut self,
        kind: gst::SeekFlags,
        start: gst::ClockTime,
        end: Option<gst::ClockTime>,
        interruption: &Interruption,
    ) -> Result<bool> {
        let (flags, to) = (gst::SeekFlags::FLUSH | kind, gst::SeekType::Set);
        if self.playback.pipeline().seek(1.0, flags, to, start, to, end).is_err() {
            return Ok(false);
        }
        while !matches!(self.playback.next(LOOK, interruption)?, Event::Ready | Event::End) {}
        Ok(true)
    }

    /// Analyses up to the end, or the first frame later than `until`; `note` is given the motion of each frame, in order.
    pub fn run(
        &mut self,
        until: Option<gst::ClockTime>,
        interruption: &Interruption,
        note: &mut dyn FnMut(Frame) -> Result<()>,
    ) -> Result<()> {
        self.playback.set_state(gst::State::Playing);
        while !self.sink.is_eos() {
            // Errors of the decoder come as messages.
            self.playback.next(gst::ClockTime::ZERO, interruption)?;
            let Some(sample) = self.sink.try_pull_sample(LOOK) else { continue };
            let time = stream_time(&sample);
            if until.zip(time).is_some_and(|(until, time)| time > until) {
                break;
            }
            let is_outside = |part: &Part| !time.is_some_and(|time| part.analysed.contains(time));
            if self.part.as_ref().is_some_and(is_outside) {
                continue;
            }
            self.push(&sample, time)?;
            self.pop(note)?;
        }
        self.rectifier.drain();
        self.pop(note)
    }

    fn push(&mut self, sample: &gst::Sample, time: Option<gst::ClockTime>) -> Result<()> {
        let buffer = sample.buffer().context("a frame without data")?;
        if sample.caps().is_some_and(|caps| !self.info.to_caps().is_ok_and(|own| own.can_intersect(caps))) {
            bail!("the frames change their size or format midway; cut the clip there");
        }
        let frame = gst_video::VideoFrameRef::from_buffer_ref_readable(buffer, &self.info)
            .map_err(|_| anyhow!("a frame cannot be read"))?;
        let stride = frame.plane_stride().first().and_then(|stride| usize::try_from(*stride).ok());
        let format = match self.info.comp_depth(0) {
            10 => SampleFormat::U10,
            _ => SampleFormat::U8,
        };
        let layout = PlaneLayout::packed(self.info.width() as usize, self.info.height() as usize, format);
        let layout = PlaneLayout { stride: stride.unwrap_or(layout.stride), ..layout };
        let plane = Plane::new(frame.plane_data(0)?, layout)?;
        let duplicate =
            if buffer.flags().contains(gst::BufferFlags::GAP) { Duplicate::Known } else { Duplicate::Detect };
        self.rectifier.push(&Luma::from(plane), time.map(seconds), duplicate)?;
        self.waiting.push_back((time, self.keeps_pictures.then(|| sample.clone())));
        Ok(())
    }

    fn pop(&mut self, note: &mut dyn FnMut(Frame) -> Result<()>) -> Result<()> {
        while let Some(solution) = self.rectifier.pop() {
            let (time, picture) = self.waiting.pop_front().unwrap_or_default();
            let is_wanted = |part: &Part| time.is_some_and(|time| part.wanted.contains(time));
            if self.part.as_ref().is_none_or(is_wanted) {
                note(Frame { time: time.map(seconds), solution, picture })?;
            }
        }
        Ok(())
    }
}

fn seconds(time: gst::ClockTime) -> f64 {
    time.nseconds() as f64 * 1e-9
}

fn frame_rate(info: &gst_video::VideoInfo) -> Option<f64> {
    let rate = info.fps();
    (rate.numer() > 0).then(|| f64::from(rate.numer()) / f64::from(rate.denom()))
}

fn rectifier(settings: Settings, info: &gst_video::VideoInfo) -> Result<Rectifier> {
    let period = frame_rate(info).map(f64::recip);
    Ok(Rectifier::new(settings, info.width() as usize, info.height() as usize, period)?)
}

/// The time of a frame in its clip.
fn stream_time(sample: &gst::Sample) -> Option<gst::ClockTime> {
    let segment = sample.segment()?.downcast_ref::<gst::ClockTime>()?;
    segment.to_stream_time(sample.buffer()?.pts())
}
