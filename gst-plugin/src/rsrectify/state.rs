//! What lives as long as one set of caps: the queue, the rectifier, the warper.

use super::formats::FrameLayout;
use super::properties::Settings;
use super::queue::Queue;
use gst::prelude::*;
use gst_video::{VideoFrameRef, VideoInfo};
use rsrectify::rectifier::{self, FrameSolution, Rectifier, Timings};
use rsrectify::warp::Warper;

/// Something that has come to the front of the queue.
pub enum Output {
    /// A frame; its motion, unless the stream is passed through.
    Frame(gst::Buffer, Option<FrameSolution>),
    /// An event that came after the frames before it.
    Event(gst::Event),
}

/// The streaming state for one set of caps. Used by the streaming thread alone.
pub struct State {
    caps: gst::Caps,
    layout: FrameLayout,
    /// `None` for a stream that is passed through.
    rectifier: Option<Rectifier>,
    /// The time that this rectifier had spent when it was last asked.
    timed: Timings,
    analysis: rectifier::Settings,
    warper: Warper,
    queue: Queue<gst::Buffer, gst::Event>,
    workers: Workers,
    last_pts: Option<gst::ClockTime>,
}

impl State {
    /// The state for frames of `caps`; `None` for a format without a luma.
    pub fn new(caps: &gst::Caps, info: &VideoInfo, settings: &Settings) -> Option<Self> {
        let layout = FrameLayout::new(info)?;
        let analysis = settings.analysis();
        let rectifier = is_progressive(info).then(|| new_rectifier(analysis, info));
        Some(Self {
            caps: caps.clone(),
            layout,
            rectifier,
            timed: Timings::default(),
            analysis,
            warper: Warper::new(),
            queue: Queue::default(),
            workers: Workers::default(),
            last_pts: None,
        })
    }

    /// Whether frames are given out as they come.
    pub fn is_passthrough(&self) -> bool {
        self.rectifier.is_none()
    }

    /// Whether these are the caps in use.
    pub fn has_caps(&self, caps: &gst::CapsRef) -> bool {
        self.caps.as_ref() == caps
    }

    /// The longest time that a frame is held.
    pub fn latency(&self) -> gst::ClockTime {
        if self.is_passthrough() {
            return gst::ClockTime::ZERO;
        }
        let fps = self.layout.info().fps();
        match (u64::try_from(fps.numer()), u64::try_from(fps.denom())) {
            (Ok(num), Ok(den)) if num > 0 => {
                let frames = self.analysis.lookahead as u64;
                let time = (frames * den).mul_div_ceil(gst::ClockTime::SECOND.nseconds(), num);
                gst::ClockTime::from_nseconds(time.unwrap_or(0))
            }
            // The frame rate varies, nothing is known.
            _ => gst::ClockTime::ZERO,
        }
    }

    /// Frames that are held at most.
    pub fn frames_held(&self) -> u32 {
        if self.is_passthrough() { 0 } else { self.analysis.lookahead as u32 }
    }

    /// The nominal frame duration; 0 where the rate varies.
    pub fn period(&self) -> gst::ClockTime {
        period(self.layout.info()).map_or(gst::ClockTime::ZERO, gst::ClockTime::from_seconds_f64)
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

    /// Grid and lookahead stay as they were when the caps came: latency and buffers depend on them.
    fn fixed(&self, analysis: rectifier::Settings) -> rectifier::Settings {
        rectifier::Settings {
            grid_columns: self.analysis.grid_columns,
            grid_rows: self.analysis.grid_rows,
            lookahead: self.analysis.lookahead,
            ..analysis
        }
    }

    /// Takes over the settings; the queue has been drained where they change the analysis.
    pub fn configure(&mut self, settings: &Settings) -> Result<(), rayon::ThreadPoolBuildError> {
        let analysis = self.fixed(settings.analysis());
        if analysis != self.analysis {
            self.analysis = analysis;
            self.forget_camera();
        }
        self.workers.resize(settings.threads)
    }

    /// Starts the analysis anew without anything that was learnt of the camera; the queue has been
    /// drained.
    pub fn forget_camera(&mut self) {
        if let Some(rectifier) = &mut self.rectifier {
            *rectifier = new_rectifier(self.analysis, self.layout.info());
            self.timed = Timings::default();
        }
    }

    /// Adds a frame; `Err` says why it cannot be read.
    pub fn push_frame(&mut self, buffer: gst::Buffer) -> Result<(), &'static str> {
        self.last_pts = buffer.pts();
        if let Some(rectifier) = &mut self.rectifier {
            let frame = VideoFrameRef::from_buffer_ref_readable(&buffer, self.layout.info())
                .map_err(|_| "cannot map the frame for reading")?;
            let luma = self.layout.luma(&frame).ok_or("the buffer does not hold a whole frame")?;
            let time = buffer.pts().map(gst::ClockTime::seconds_f64);
            // Frame-rate converters flag the frames that they repeat.
            let duplicate = buffer.flags().contains(gst::BufferFlags::GAP);
            self.workers.run(|| rectifier.push(&luma, time, duplicate));
        }
        self.queue.push_frame(buffer);
        Ok(())
    }

    /// Puts a serialised event behind the frames held; gives it back if there are none.
    pub fn push_event(&mut self, event: gst::Event) -> Option<gst::Event> {
        if self.queue.frames() == 0 {
            return Some(event);
        }
        self.queue.push_event(event);
        None
    }

    /// What can be given out now.
    pub fn next(&mut self) -> Option<Output> {
        if let Some(event) = self.queue.pop_event() {
            return Some(Output::Event(event));
        }
        let solution = match &mut self.rectifier {
            Some(rectifier) => Some(rectifier.pop()?),
            None => None,
        };
        self.queue.pop_frame().map(|buffer| Output::Frame(buffer, solution))
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
        let now = self.rectifier.as_ref().map(Rectifier::timings).unwrap_or_default();
        let before = std::mem::replace(&mut self.timed, now);
        Timings {
            correspond: now.correspond.saturating_sub(before.correspond),
            solve: now.solve.saturating_sub(before.solve),
        }
    }

    /// Drops the frames held and gives back the events between them; the camera stays the same.
    pub fn flush(&mut self) -> Vec<gst::Event> {
        if let Some(rectifier) = &mut self.rectifier {
            rectifier.reset();
        }
        self.last_pts = None;
        self.queue.clear()
    }

    /// Rectifies `input` into `output`; `Err` says why it cannot be done.
    pub fn rectify(
        &mut self,
        input: &gst::BufferRef,
        output: &mut gst::BufferRef,
        solution: &FrameSolution,
        settings: &Settings,
    ) -> Result<(), &'static str> {
        let info = self.layout.info();
        let input = VideoFrameRef::from_buffer_ref_readable(input, info)
            .map_err(|_| "cannot map the frame for reading")?;
        let mut output = VideoFrameRef::from_buffer_ref_writable(output, info)
            .map_err(|_| "cannot map the output frame for writing")?;
        let fill = self.layout.fill(settings.border_color);
        let mut warp = settings.warp();
        warp.strength *= solution.weight;
        self.workers.run(|| self.warper.prepare(&solution.readout, &solution.path, &warp));
        for view in self.layout.views() {
            let source = view.plane(&input).ok_or("the buffer does not hold a whole frame")?;
            let mut target = view.plane_mut(&mut output).ok_or("the output buffer is too small")?;
            self.workers
                .run(|| self.warper.warp(&source, &mut target, view.placement, view.fill(&fill)))
                .map_err(|_| "input and output frames differ")?;
        }
        Ok(())
    }
}

fn new_rectifier(analysis: rectifier::Settings, info: &VideoInfo) -> Rectifier {
    Rectifier::new(analysis, info.width() as usize, info.height() as usize, period(info))
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
            None => work(),
        }
    }
}
