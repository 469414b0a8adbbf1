// SPDX-License-Identifier: MIT OR Apache-2.0

//! A clip's frames → the motion of each, without rectifying any.

use crate::elements::{app_sink, launch, named, pad};
use crate::frame_rate::FrameInterval;
use crate::input::{Clip, Opening};
use crate::interruption::Interruption;
use crate::part::{self, Part};
use crate::playback::Playback;
use anyhow::{Context, Result, anyhow, bail};
use gst::prelude::*;
use gst_video::prelude::*;
use rsrectify::Rectifier;
use rsrectify::plane::{Luma, Plane, PlaneLayout, SampleFormat};
use rsrectify::readout::{ReadoutPosterior, ReadoutPrior};
use rsrectify::rectifier::{Duplicate, FrameSolution, Settings};
use std::collections::VecDeque;

/// What is analysed: formats whose first plane is the luma.
const FORMATS: &str =
    "video/x-raw,format={I420,YV12,NV12,NV21,Y42B,Y444,GRAY8,I420_10LE,I422_10LE,Y444_10LE}";
/// How long each look for a frame is.
const LOOK: gst::ClockTime = gst::ClockTime::from_mseconds(100);
/// Frames that are decoded before the first is analysed: their times show the interval between frames.
const AHEAD: usize = 10;

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
    /// Seconds from frame to frame for the rectifier.
    period: Option<f64>,
    interval: FrameInterval,
    /// Decoded frames that are still to be analysed.
    ahead: VecDeque<gst::Sample>,
    /// What came instead of the frame after these.
    failure: Option<anyhow::Error>,
    /// Times of the frames whose motion has not come, and the frames where they are kept.
    waiting: VecDeque<(Option<gst::ClockTime>, Option<gst::Sample>)>,
    keeps_pictures: bool,
    /// The part of the clip that is analysed, where that is not all of it.
    part: Option<Part>,
    /// The time of the last frame that was analysed, and of the last one before it was gone to another place: what comes from
    /// the key frame before that place on may be known already.
    latest: Option<gst::ClockTime>,
    known: Option<gst::ClockTime>,
    /// Why it was not analysed to its end, where it was not.
    ended_early: Option<String>,
}

impl Analysis {
    /// Opens a clip.
    pub fn open(clip: &Clip, settings: Settings, interruption: &Interruption) -> Result<Self> {
        Self::begin(clip, Opening::Whole, settings, interruption)
    }

    /// Opens a clip to look at its first frames.
    pub fn look(clip: &Clip, settings: Settings, interruption: &Interruption) -> Result<Self> {
        Self::begin(clip, Opening::Look, settings, interruption)
    }

    fn begin(clip: &Clip, opening: Opening, settings: Settings, interruption: &Interruption) -> Result<Self> {
        let pipeline = launch(&format!(
            "videoconvert name=decoded ! {FORMATS} ! appsink name=sink sync=false max-buffers=4"
        ))?;
        clip.read_video(&pipeline, opening, &pad(&named(&pipeline, "decoded")?, "sink")?)?;
        let sink = app_sink(&pipeline, "sink")?;
        let mut playback = Playback::new(pipeline)?;
        if clip.is_pipe() {
            playback.wait_for_ever();
        }
        // Not paused first: where the video begins later than the clip, a gap is all that a paused sink is given.
        playback.set_state(gst::State::Playing);
        let (mut ahead, mut failure) = (VecDeque::new(), None);
        while ahead.len() < AHEAD {
            match pull(&sink, &mut playback, interruption) {
                Ok(Some(sample)) => ahead.push_back(sample),
                Ok(None) => break,
                Err(error) if ahead.is_empty() => return Err(error),
                Err(error) => {
                    failure = Some(error);
                    break;
                }
            }
        }
        interruption.check()?;
        let caps = ahead.front().and_then(|sample| sample.caps()).context("no frame could be decoded")?;
        let info = gst_video::VideoInfo::from_caps(caps)?;
        if info.interlace_mode() != gst_video::VideoInterlaceMode::Progressive {
            bail!("is interlaced: each frame holds two exposures; deinterlace it first");
        }
        let rate = info.fps();
        let stated = (rate.numer() > 0).then(|| f64::from(rate.denom()) / f64::from(rate.numer()));
        let mut interval = FrameInterval::new(stated);
        ahead.iter().for_each(|sample| interval.add(stream_time(sample).map(gst::ClockTime::seconds_f64)));
        let period = interval.seconds();
        // They are counted when they are analysed.
        let interval = FrameInterval::new(stated);
        Ok(Self {
            rectifier: rectifier(settings, &info, period)?,
            playback,
            sink,
            info,
            settings,
            period,
            interval,
            ahead,
            failure,
            waiting: VecDeque::new(),
            keeps_pictures: false,
            part: None,
            latest: None,
            known: None,
            ended_early: None,
        })
    }

    /// Starts from what is expected of the readout; before any frame is analysed.
    pub fn expect(&mut self, prior: ReadoutPrior) -> Result<()> {
        self.settings.readout_prior = Some(prior);
        self.rectifier = rectifier(self.settings, &self.info, self.period)?;
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

    /// Seconds from frame to frame, as the first frames show it; what is measured in frame durations counts in these.
    /// `None` where neither timestamps nor file state it.
    pub fn period(&self) -> Option<f64> {
        self.period
    }

    /// Frames a second, by the times of all frames so far.
    pub fn frame_rate(&self) -> Option<f64> {
        self.interval.seconds().or(self.period).map(f64::recip)
    }

    /// Why the clip was not analysed to its end, where it was not: it is damaged, or its frames change.
    pub fn ended_early(&self) -> Option<&str> {
        self.ended_early.as_deref()
    }

    /// An error where the clip was not analysed to its end.
    pub fn check_whole(&self) -> Result<()> {
        self.ended_early().map_or(Ok(()), |reason| Err(anyhow!("{reason}")))
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
        interruption.check()?;
        if self.playback.pipeline().seek(1.0, flags, to, start, to, end).is_err() {
            return Ok(false);
        }
        self.ahead.clear();
        self.known = self.latest;
        self.interval.interrupt();
        Ok(true)
    }

    /// Analyses up to the end, or the first frame later than `until`; `note` is given the motion of each frame, in order.
    pub fn run(
        &mut self,
        until: Option<gst::ClockTime>,
        interruption: &Interruption,
        note: &mut dyn FnMut(Frame) -> Result<()>,
    ) -> Result<()> {
        while self.ended_early.is_none()
            && let Some(sample) = self.next(interruption)?
        {
            let time = stream_time(&sample);
            if until.zip(time).is_some_and(|(until, time)| time > until) {
                break;
            }
            let is_outside = |part: &Part| !time.is_some_and(|time| part.analysed.contains(time));
            let is_known = time.zip(self.known).is_some_and(|(time, known)| time <= known);
            if is_known || self.part.as_ref().is_some_and(is_outside) {
                continue;
            }
            self.latest = time.or(self.latest);
            self.ended_early = self.change(&sample, time);
            if self.ended_early.is_none() {
                self.push(&sample, time)?;
                self.pop(note)?;
            }
        }
        self.rectifier.drain();
        self.pop(note)
    }

    /// The next decoded frame; `None` at the end, and where the clip cannot be read further.
    fn next(&mut self, interruption: &Interruption) -> Result<Option<gst::Sample>> {
        if let Some(sample) = self.ahead.pop_front() {
            return Ok(Some(sample));
        }
        let failure = self.failure.take().map(Err);
        match failure.unwrap_or_else(|| pull(&self.sink, &mut self.playback, interruption)) {
            Ok(sample) => Ok(sample),
            Err(error) => {
                interruption.check()?;
                self.ended_early = Some(format!("it cannot be read to its end: {error:#}"));
                Ok(None)
            }
        }
    }

    /// That a frame is of another kind than the first, if it is.
    ///
    /// Neither colours nor the aspect of pixels matter, which encoded streams and containers state at different times.
    fn change(&self, sample: &gst::Sample, time: Option<gst::ClockTime>) -> Option<String> {
        let info = gst_video::VideoInfo::from_caps(sample.caps()?).ok()?;
        let kind =
            |info: &gst_video::VideoInfo| (info.width(), info.height(), info.format(), info.interlace_mode());
        (kind(&info) != kind(&self.info)).then(|| {
            let text = |info: &gst_video::VideoInfo| {
                let (width, height, format, interlacing) = kind(info);
                let interlaced = match interlacing {
                    gst_video::VideoInterlaceMode::Progressive => "",
                    _ => " interlaced",
                };
                format!("{width}x{height} {format}{interlaced}")
            };
            let at = time.map_or(String::new(), |time| format!(" at {:.2} s", time.seconds_f64()));
            format!("its frames change from {} to {}{at}", text(&self.info), text(&info))
        })
    }

    fn push(&mut self, sample: &gst::Sample, time: Option<gst::ClockTime>) -> Result<()> {
        let buffer = sample.buffer().context("a frame without data")?;
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
        // In seconds as the element has them: it would find other motions by a rounding.
        let seconds = time.map(gst::ClockTime::seconds_f64);
        self.rectifier.push(&Luma::from(plane), seconds, duplicate)?;
        self.interval.add(seconds);
        self.waiting.push_back((time, self.keeps_pictures.then(|| sample.clone())));
        Ok(())
    }

    fn pop(&mut self, note: &mut dyn FnMut(Frame) -> Result<()>) -> Result<()> {
        while let Some(solution) = self.rectifier.pop() {
            let (time, picture) = self.waiting.pop_front().unwrap_or_default();
            let is_wanted = |part: &Part| time.is_some_and(|time| part.wanted.contains(time));
            if self.part.as_ref().is_none_or(is_wanted) {
                note(Frame { time: time.map(gst::ClockTime::seconds_f64), solution, picture })?;
            }
        }
        Ok(())
    }
}

fn rectifier(settings: Settings, info: &gst_video::VideoInfo, period: Option<f64>) -> Result<Rectifier> {
    Ok(Rectifier::new(settings, info.width() as usize, info.height() as usize, period)?)
}

/// The next decoded frame; `None` at the end.
fn pull(
    sink: &gst_app::AppSink,
    playback: &mut Playback,
    interruption: &Interruption,
) -> Result<Option<gst::Sample>> {
    loop {
        // An error before the end has been reported when the end is.
        let at_end = sink.is_eos();
        playback.check(interruption)?;
        if at_end {
            return Ok(None);
        }
        if let Some(sample) = sink.try_pull_sample(LOOK) {
            return Ok(Some(sample));
        }
        playback.waited()?;
    }
}

/// The time of a frame in its clip.
fn stream_time(sample: &gst::Sample) -> Option<gst::ClockTime> {
    let segment = sample.segment()?.downcast_ref::<gst::ClockTime>()?;
    segment.to_stream_time(sample.buffer()?.pts())
}
