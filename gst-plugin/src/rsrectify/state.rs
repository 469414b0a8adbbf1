// SPDX-License-Identifier: MIT OR Apache-2.0

//! What lives as long as one set of caps: the queue, the rectifier, the warper.

use super::ffi;
use super::formats::FrameViews;
use super::load::Effort;
use super::padding::Padding;
use super::picture;
use super::properties::Settings;
use super::queue::Queue;
use gst::prelude::*;
use gst_video::{VideoFrameRef, VideoInfo, VideoMeta};
use rsrectify::motion::{FrameMotion, MotionPath};
use rsrectify::readout::Readout;
use rsrectify::rectifier::{self, Duplicate, FrameSolution, Rectifier, Timings};
use rsrectify::warp::Warper;

/// Buffers of a pool that are in use elsewhere while the element holds its frames: one that is filled, one
/// that was pushed, and what sinks and mixers keep.
const OUTSIDE: u32 = 4;

/// Something that has come to the front of the queue.
pub enum Output {
    /// A frame and its motion; none where the frame was not analysed.
    Frame(Frame, Option<Box<FrameSolution>>),
    /// An event that came after the frames before it.
    Event(gst::Event),
}

/// A frame in the queue.
pub struct Frame {
    /// The buffer that came, or its copy.
    pub buffer: gst::Buffer,
    /// What is done with it.
    pub effort: Effort,
    /// Running time of its timestamp.
    pub running: Option<gst::ClockTime>,
}

/// The streaming state for one set of caps. Used by the thread that holds the sink pad's stream lock.
pub struct State {
    caps: gst::Caps,
    views: FrameViews,
    /// `None` for a stream that is passed through, or whose motions come from elsewhere.
    rectifier: Option<Rectifier>,
    has_source: bool,
    /// The time that this rectifier had spent when it was last asked.
    timed: Timings,
    analysis: rectifier::Settings,
    warper: Warper,
    queue: Queue<Frame, gst::Event>,
    workers: Workers,
    last_pts: Option<gst::ClockTime>,
    /// Whether downstream understands frames with strides of their own.
    downstream_reads_strides: bool,
    copies: Copies,
    padding: Padding,
}

impl State {
    /// The state for frames of `caps`, whose motions may come from elsewhere; `None` for a format without a luma.
    pub fn new(caps: &gst::Caps, info: &VideoInfo, settings: &Settings, has_source: bool) -> Option<Self> {
        let views = FrameViews::new(info)?;
        let analysis = settings.analysis();
        let has_source = has_source && is_progressive(info);
        let is_analysed = is_progressive(info) && !has_source;
        let rectifier = is_analysed.then(|| new_rectifier(analysis, info)).flatten();
        Some(Self {
            caps: caps.clone(),
            views,
            rectifier,
            has_source,
            timed: Timings::default(),
            analysis,
            warper: Warper::new(),
            queue: Queue::default(),
            workers: Workers::default(),
            last_pts: None,
            downstream_reads_strides: false,
            copies: Copies::default(),
            padding: Padding::default(),
        })
    }

    /// Whether frames are given out as they come.
    pub fn is_passthrough(&self) -> bool {
        self.rectifier.is_none() && !self.has_source
    }

    /// Width and height of the frames.
    pub fn size(&self) -> [usize; 2] {
        let info = self.views.info();
        [info.width() as usize, info.height() as usize]
    }

    /// Whether these are the caps in use.
    pub fn has_caps(&self, caps: &gst::CapsRef) -> bool {
        self.caps.as_ref() == caps
    }

    /// Frames that are held at most.
    pub fn frames_held(&self) -> u32 {
        if self.rectifier.is_none() { 0 } else { self.analysis.lookahead as u32 }
    }

    /// The frame rate of the caps, as a fraction; `None` where it varies.
    pub fn rate(&self) -> Option<(u64, u64)> {
        let fps = self.views.info().fps();
        let parts = [fps.numer(), fps.denom()].map(|part| u64::try_from(part).ok().filter(|&part| part > 0));
        parts[0].zip(parts[1])
    }

    /// The nominal frame duration; 0 where the rate varies.
    fn period(&self) -> gst::ClockTime {
        period(self.views.info()).map_or(gst::ClockTime::ZERO, gst::ClockTime::from_seconds_f64)
    }

    /// Notes whether downstream understands frames with strides of their own.
    pub fn set_downstream_reads_strides(&mut self, reads: bool) {
        self.downstream_reads_strides = reads;
    }

    /// Whether the frames held must be given out before `buffer` can be added: it does not follow
    /// them, or it is to be analysed in another way.
    pub fn must_drain(&self, buffer: &gst::BufferRef, settings: &Settings) -> bool {
        self.breaks_off(buffer) || self.analysis != self.fixed(settings.analysis())
    }

    /// Whether `buffer` is the first after a hole.
    ///
    /// In reverse playback decoders mark every group of pictures as discontinuous although the
    /// timestamps fall evenly: such a mark is no hole.
    fn breaks_off(&self, buffer: &gst::BufferRef) -> bool {
        let follows = || {
            let (last, pts) = (self.last_pts?, buffer.pts()?);
            let step = pts.max(last) - pts.min(last);
            Some(step > gst::ClockTime::ZERO && step <= self.period() + self.period() / 2)
        };
        buffer.flags().contains(gst::BufferFlags::DISCONT) && !follows().unwrap_or(false)
    }

    /// Grid and lookahead stay as they were when the caps came: latency and buffers depend on them. Stabilisation changes
    /// gradually, without a new analysis.
    fn fixed(&self, mut analysis: rectifier::Settings) -> rectifier::Settings {
        analysis.grid_columns = self.analysis.grid_columns;
        analysis.grid_rows = self.analysis.grid_rows;
        analysis.lookahead = self.analysis.lookahead;
        analysis.stabilization = self.analysis.stabilization;
        analysis.margin = self.analysis.margin;
        analysis
    }

    /// Takes over the settings; the queue has been drained where they change the analysis.
    pub fn configure(&mut self, settings: &Settings) -> Result<(), rayon::ThreadPoolBuildError> {
        let wanted = settings.analysis();
        let (stabilization, margin) = (wanted.stabilization, wanted.margin);
        if (stabilization, margin) != (self.analysis.stabilization, self.analysis.margin) {
            (self.analysis.stabilization, self.analysis.margin) = (stabilization, margin);
            if let Some(rectifier) = &mut self.rectifier {
                rectifier.set_stabilization(stabilization, margin);
            }
        }
        let analysis = self.fixed(wanted);
        if analysis != self.analysis {
            self.analysis = analysis;
            self.forget_camera();
        }
        self.workers.resize(settings.threads)
    }

    /// Starts the analysis anew without anything that was learnt of the camera; the queue has been
    /// drained.
    pub fn forget_camera(&mut self) {
        if let Some(rectifier) = &mut self.rectifier
            && let Some(new) = new_rectifier(self.analysis, self.views.info())
        {
            *rectifier = new;
            self.timed = Timings::default();
        }
    }

    /// Adds a frame, analysed if `frame.effort` asks for it; `Err` says why it cannot be read.
    pub fn push_frame(&mut self, frame: Frame) -> Result<(), &'static str> {
        let buffer = &frame.buffer;
        self.last_pts = buffer.pts();
        if let Some(rectifier) = &mut self.rectifier {
            // All of it, so that no frame that was taken in can fail later, with others behind it.
            let mapped = picture::map_readable(buffer, self.views.info())?;
            let luma = self.views.luma(&mapped).filter(|_| self.views.is_whole(&mapped));
            let luma = luma.ok_or("the buffer does not hold a whole frame")?;
            match frame.effort {
                Effort::Full(_) => {
                    let time = buffer.pts().map(gst::ClockTime::seconds_f64);
                    // Frame-rate converters flag the frames that they repeat.
                    let is_flagged = buffer.flags().contains(gst::BufferFlags::GAP);
                    let duplicate = if is_flagged { Duplicate::Known } else { Duplicate::Detect };
                    self.workers
                        .run(|| rectifier.push(&luma, time, duplicate))
                        .map_err(|_| "the buffer is not of the negotiated size")?;
                }
                // The frames before it wait for nothing more, and the next one does not follow them.
                Effort::None => self.workers.run(|| rectifier.drain()),
            }
        }
        self.queue.push_frame(frame);
        Ok(())
    }

    /// Adds a buffer without a picture, which goes out as it came.
    pub fn push_empty(&mut self, buffer: gst::Buffer) {
        self.queue.push_frame(Frame { buffer, effort: Effort::None, running: None });
    }

    /// Puts a serialised event behind the frames held; gives it back if there are none.
    pub fn push_event(&mut self, event: gst::Event) -> Option<gst::Event> {
        if self.queue.frames() == 0 {
            return Some(event);
        }
        self.queue.push_event(event);
        None
    }

    /// What can be given out now: an event, a frame that is not analysed, one whose motion is known, or one behind which
    /// so many wait as come in time.
    pub fn next(&mut self, in_time: Option<u64>) -> Option<Output> {
        if in_time.is_some_and(|frames| self.queue.frames() as u64 > frames) {
            return self.next_at_once();
        }
        self.next_with(|rectifier, _| rectifier.pop())
    }

    /// The same without waiting for the frames that follow.
    pub fn next_at_once(&mut self) -> Option<Output> {
        self.next_with(|rectifier, workers| workers.run(|| rectifier.pop_early()))
    }

    fn next_with(
        &mut self,
        pop: impl FnOnce(&mut Rectifier, &Workers) -> Option<FrameSolution>,
    ) -> Option<Output> {
        if let Some(event) = self.queue.pop_event() {
            return Some(Output::Event(event));
        }
        let solution = match (&mut self.rectifier, self.queue.front()?.effort) {
            (Some(rectifier), Effort::Full(_)) => Some(pop(rectifier, &self.workers)?),
            _ => None,
        };
        self.queue.pop_frame().map(|frame| Output::Frame(frame, solution.map(Box::new)))
    }

    /// Running time of the frame at the front.
    pub fn front_running(&self) -> Option<gst::ClockTime> {
        self.queue.front().and_then(|frame| frame.running)
    }

    /// Makes all frames held ready to be given out; the next one starts anew, with the same camera.
    pub fn drain(&mut self) {
        if let Some(rectifier) = &mut self.rectifier {
            self.workers.run(|| rectifier.drain());
        }
        self.last_pts = None;
    }

    /// Time that the analysis has taken since this was last asked.
    pub fn take_timings(&mut self) -> Timings {
        let mut spent = self.rectifier.as_ref().map(Rectifier::timings).unwrap_or_default();
        let before = std::mem::replace(&mut self.timed, spent);
        spent.correspond = spent.correspond.saturating_sub(before.correspond);
        spent.solve = spent.solve.saturating_sub(before.solve);
        spent
    }

    /// Drops the frames held and gives back the events between them; the camera stays the same.
    pub fn flush(&mut self) -> Vec<gst::Event> {
        if let Some(rectifier) = &mut self.rectifier {
            rectifier.reset();
        }
        self.last_pts = None;
        self.queue.clear()
    }

    /// A buffer for a copy of a frame that must be given back at once, as it comes from a pool that the
    /// frames held could empty, or that is read from the bottom row up; `None` where there is no need.
    pub fn buffer_for_copy(&mut self, frame: &gst::BufferRef) -> Option<gst::Buffer> {
        let could_empty_pool = || {
            let frames = self.frames_held();
            let config = ffi::pool_of(frame).and_then(|pool| pool.config().params());
            config.is_some_and(|(_, _, _, most)| frames > 0 && most > 0 && most <= frames + OUTSIDE)
        };
        let is_needed = could_empty_pool() || !self.is_passthrough() && picture::is_bottom_up(frame);
        if is_needed { self.copies.buffer(&self.caps, self.views.info()) } else { None }
    }

    /// The motion of a frame that is not analysed.
    pub fn still(&self) -> FrameMotion {
        let [width, height] = self.size();
        FrameMotion::new(Readout::global_shutter(width, height), MotionPath::STILL)
    }

    /// Whether downstream would take the padding of a frame for picture.
    pub fn must_repack(&self, frame: &gst::BufferRef) -> bool {
        let info = self.views.info();
        let is_padded = |meta: gst::MetaRef<'_, VideoMeta>| {
            let planes = info.n_planes() as usize;
            meta.n_planes() as usize != planes
                || meta.stride()[..] != info.stride()[..planes]
                || meta.offset()[..] != info.offset()[..planes]
        };
        !self.is_passthrough()
            && !self.downstream_reads_strides
            && frame.meta::<VideoMeta>().is_some_and(is_padded)
    }

    /// Copies the picture of one buffer into another; `Err` says why it cannot be done.
    pub fn copy(&mut self, input: &gst::BufferRef, output: &mut gst::BufferRef) -> Result<(), &'static str> {
        self.padding.clear(&self.views, output)?;
        picture::copy(&self.views, input, output)
    }

    /// Rectifies `input` into `output`, applying a `share` of the correction; `Err` says why it cannot be done.
    pub fn rectify(
        &mut self,
        input: &gst::BufferRef,
        output: &mut gst::BufferRef,
        motion: &FrameMotion,
        share: f64,
        settings: &Settings,
    ) -> Result<(), &'static str> {
        let info = self.views.info();
        let input = picture::map_readable(input, info)?;
        self.padding.clear(&self.views, output)?;
        let mut output = VideoFrameRef::from_buffer_ref_writable(output, info)
            .map_err(|_| "cannot map the output frame for writing")?;
        let mut warp = settings.warp();
        warp.border = settings.border_mode.filled_with(self.views.fill(settings.border_color));
        warp.strength *= share;
        let frame = self.workers.run(|| self.warper.prepare(motion, &warp));
        for (index, view) in self.views.all().iter().enumerate() {
            let source = view.plane(&input).ok_or("the buffer does not hold a whole frame")?;
            let mut target = view.plane_mut(&mut output).ok_or("the output buffer is too small")?;
            self.workers
                .run(|| frame.warp_plane(index, &source, &mut target, view.grid))
                .map_err(|_| "input and output frames differ")?;
        }
        Ok(())
    }
}

/// `None` for frames too large to be analysed: the settings are valid whatever the properties are.
fn new_rectifier(analysis: rectifier::Settings, info: &VideoInfo) -> Option<Rectifier> {
    Rectifier::new(analysis, info.width() as usize, info.height() as usize, period(info)).ok()
}

/// Seconds from frame to frame; `None` where the rate varies.
fn period(info: &VideoInfo) -> Option<f64> {
    let fps = info.fps();
    (fps.numer() > 0 && fps.denom() > 0).then(|| f64::from(fps.denom()) / f64::from(fps.numer()))
}

/// Whether a buffer is one exposure of one view. Interlaced frames are two, at two times.
fn is_progressive(info: &VideoInfo) -> bool {
    use gst_video::VideoMultiviewMode as Mode;
    !info.is_interlaced() && info.views() <= 1 && matches!(info.multiview_mode(), Mode::None | Mode::Mono)
}

/// The threads that do the work: rayon's global ones, or some of our own.
#[derive(Default)]
struct Workers {
    threads: u32,
    pool: Option<rayon::ThreadPool>,
}

impl Workers {
    fn resize(&mut self, threads: u32) -> Result<(), rayon::ThreadPoolBuildError> {
        if threads != self.threads {
            self.threads = threads;
            self.pool = None;
            if threads > 0 {
                let builder = rayon::ThreadPoolBuilder::new().num_threads(threads as usize);
                self.pool = Some(builder.thread_name(|i| format!("rsrectify-{i}")).build()?);
            }
        }
        Ok(())
    }

    fn run<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        match &self.pool {
            Some(pool) => pool.install(work),
            // On a thread of the common pool: what it hands out is then done without waking others up first.
            None => rayon::scope(|_| work()),
        }
    }
}

/// Buffers for copies of frames that come from a pool that cannot grow.
#[derive(Default)]
struct Copies {
    pool: Option<gst_video::VideoBufferPool>,
}

impl Copies {
    /// A buffer for one frame; `None` if there is no memory for it.
    fn buffer(&mut self, caps: &gst::Caps, info: &VideoInfo) -> Option<gst::Buffer> {
        if self.pool.is_none() {
            let pool = gst_video::VideoBufferPool::new();
            let mut config = pool.config();
            config.set_params(Some(caps), u32::try_from(info.size()).ok()?, 0, 0);
            pool.set_config(config).ok()?;
            pool.set_active(true).ok()?;
            self.pool = Some(pool);
        }
        self.pool.as_ref()?.acquire_buffer(None).ok()
    }
}

impl Drop for Copies {
    fn drop(&mut self) {
        if let Some(pool) = self.pool.take() {
            // Buffers still in use are freed when they are given back.
            let _ = pool.set_active(false);
        }
    }
}
