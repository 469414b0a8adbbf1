//! The element proper.
//!
//! GStreamer's base class negotiates; the flow of frames is the element's own. A frame that comes in
//! is analysed and queued, and frames whose motion is known are rectified and pushed. Events that
//! travel with the frames are queued between them; those that end a stretch of the stream first
//! drain the queue. Three mutexes are never held together, nor while anything is pushed or posted:
//! the settings, the streaming state (streaming thread only), the report (any thread, briefly).

/**
 * SECTION:element-rsrectify
 *
 * Takes rolling-shutter distortion (lean, jello, wobble, stretch) out of video from any camera:
 * no gyroscope, no calibration, no metadata.
 *
 * The element holds `lookahead` frames back, which is its latency. Every frame comes out once, in
 * order, with its own timestamps, flags and metas; a frame without motion is the very buffer that
 * came in. Interlaced and multiview video passes through with a warning.
 *
 * A frame that the sink says it will get too late (QoS) is analysed but goes out unrectified, with
 * a QoS message: the sink will most likely drop it, and a frame lost here would leave a hole in the
 * analysis of its neighbours. The `qos` property turns this off.
 *
 * The readout time and direction, and the focal length, are found from the picture while it plays,
 * and known the better the more the camera has moved; until then little is corrected. They are
 * kept over cuts, gaps and seeks, and forgotten with new caps, a new stream and a stop. `stats` tells
 * what was found: give it as `readout-time` and `readout-direction` to have it from the first frame on.
 *
 * Settings of the analysis (readout, `estimator`, `model`, `focal-length`) that change while playing
 * take effect with the next frame: those held are given out and the analysis starts anew, without what
 * it had found. `lookahead` and the grid take effect with the next caps.
 *
 * ## Example pipelines
 * |[
 * gst-launch-1.0 filesrc location=in.mp4 ! decodebin ! videoconvert ! rsrectify ! \
 *     videoconvert ! x264enc ! mp4mux ! filesink location=out.mp4
 * ]| Rectifies a film.
 * |[
 * gst-launch-1.0 v4l2src ! videoconvert ! rsrectify lookahead=0 readout-time=28000000 ! \
 *     videoconvert ! autovideosink
 * ]| Rectifies a camera whose readout takes 28 ms, without delay.
 *
 * Since: plugins-rsrectify-0.1
 */
use super::formats;
use super::properties::{self, Settings};
use super::report::{self, FrameTime, Report};
use super::state::{Output, State};
use gst::glib;
use gst::prelude::*;
use gst::subclass::prelude::*;
use gst_base::prelude::*;
use gst_base::subclass::base_transform::{GenerateOutputSuccess, InputBuffer, PrepareOutputBufferSuccess};
use gst_base::subclass::prelude::*;
use gst_video::subclass::prelude::*;
use rsrectify::rectifier::FrameSolution;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

static CAT: LazyLock<gst::DebugCategory> = LazyLock::new(|| {
    gst::DebugCategory::new("rsrectify", gst::DebugColorFlags::empty(), Some("Rolling shutter rectifier"))
});

/// The element's instance.
#[derive(Default)]
pub struct RsRectify {
    settings: Mutex<Settings>,
    /// `None` until caps are known.
    state: Mutex<Option<State>>,
    report: Mutex<Report>,
}

/// Locks a mutex; a panic elsewhere, which is reported there, does not make its data unreadable.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl RsRectify {
    fn settings(&self) -> Settings {
        *lock(&self.settings)
    }

    /// Gives out everything held; on an error the rest is dropped.
    fn drain(&self) -> Result<(), gst::FlowError> {
        let analysis = lock(&self.state).as_mut().map(|state| {
            state.drain();
            state.take_timings()
        });
        lock(&self.report).count_analysis(analysis.unwrap_or_default());
        self.push_ready().inspect_err(|error| {
            gst::debug!(CAT, imp = self, "Drain ended early: {error}");
            self.flush();
        })
    }

    /// Drops the frames held. Sticky events between them still hold for what comes next.
    fn flush(&self) {
        let events = lock(&self.state).as_mut().map(State::flush).unwrap_or_default();
        for event in events.iter().filter(|event| event.is_sticky()) {
            if let Err(error) = self.obj().src_pad().store_sticky_event(event) {
                gst::debug!(CAT, imp = self, "Cannot keep {event:?}: {error}");
            }
        }
    }

    /// Gives out the frames whose motion is known, and the events between them.
    fn push_ready(&self) -> Result<(), gst::FlowError> {
        loop {
            let next = lock(&self.state).as_mut().and_then(State::next);
            match next {
                Some(Output::Event(event)) => {
                    gst::debug!(CAT, imp = self, "Releasing {event:?}");
                    self.parent_sink_event(event);
                }
                Some(Output::Frame(buffer, solution)) => self.push_frame(buffer, solution)?,
                None => return Ok(()),
            }
        }
    }

    /// Gives out one frame.
    fn push_frame(&self, input: gst::Buffer, solution: Option<FrameSolution>) -> Result<(), gst::FlowError> {
        let obj = self.obj();
        let time = FrameTime::new(&obj.segment(), &input);
        if let Some(stream_time) = time.stream
            && let Err(error) = obj.sync_values(stream_time)
        {
            gst::warning!(CAT, imp = self, "Cannot synchronise properties: {error}");
        }
        let settings = self.settings();
        let motion = solution.as_ref().filter(|solution| !settings.leaves_untouched(&solution.path));
        let output = match motion {
            Some(motion) if !self.is_late(&time) => self.rectify(&input, motion, &settings)?,
            _ => input,
        };
        lock(&self.report).count_frame(&time, solution.as_ref());
        if let Some(solution) = solution.filter(|_| settings.post_messages) {
            let structure = report::frame_message(&time, &solution);
            self.post(gst::message::Element::builder(structure).src(&*obj).build());
        }
        gst::log!(CAT, imp = self, "Pushing {output:?}");
        obj.src_pad().push(output).map(|_| ())
    }

    /// Whether rectifying the frame would be in vain; says so on the bus.
    fn is_late(&self, time: &FrameTime) -> bool {
        if !self.obj().is_qos() {
            return false;
        }
        let message = lock(&self.report).late_message(&*self.obj(), time);
        message.map(|message| self.post(message)).is_some()
    }

    /// The rectified frame, in a buffer of the negotiated pool.
    fn rectify(
        &self,
        input: &gst::Buffer,
        solution: &FrameSolution,
        settings: &Settings,
    ) -> Result<gst::Buffer, gst::FlowError> {
        let mut output = match self.parent_prepare_output_buffer(InputBuffer::Readable(input))? {
            PrepareOutputBufferSuccess::Buffer(output) => output,
            PrepareOutputBufferSuccess::InputBuffer => return Ok(input.clone()),
        };
        let start = Instant::now();
        // The lock must be gone before an error is posted.
        let rectified = match lock(&self.state).as_mut() {
            Some(state) => state.rectify(input, output.make_mut(), solution, settings),
            None => return Err(gst::FlowError::Flushing),
        };
        rectified.map_err(|reason| self.stream_error(reason))?;
        lock(&self.report).count_warp(start.elapsed());
        Ok(output)
    }

    /// Adds a frame to the queue.
    fn take_frame(&self, input: gst::Buffer, settings: &Settings) -> Result<(), gst::FlowError> {
        let (workers, taken, analysis) = match lock(&self.state).as_mut() {
            Some(state) => (state.configure(settings), state.push_frame(input), state.take_timings()),
            None => return Err(gst::FlowError::NotNegotiated),
        };
        if let Err(error) = workers {
            gst::warning!(CAT, imp = self, "No threads of its own, using the shared ones: {error}");
        }
        lock(&self.report).count_input(analysis);
        taken.map_err(|reason| self.stream_error(reason))
    }

    fn stream_error(&self, reason: &str) -> gst::FlowError {
        gst::element_imp_error!(self, gst::StreamError::Format, ("Cannot process a frame: {reason}"));
        gst::FlowError::Error
    }

    fn post(&self, message: gst::Message) {
        if self.obj().post_message(message).is_err() {
            gst::trace!(CAT, imp = self, "No bus to post to");
        }
    }

    /// Notes the latency and announces a change.
    fn announce_latency(&self, latency: gst::ClockTime) {
        let before = std::mem::replace(&mut lock(&self.report).latency, latency);
        if before != latency {
            gst::info!(CAT, imp = self, "Latency is {latency}");
            self.post(gst::message::Latency::builder().src(&*self.obj()).build());
        }
    }

    /// Queues an event that travels with the frames; without frames it goes on at once.
    fn queue_event(&self, event: gst::Event) -> bool {
        let event = match lock(&self.state).as_mut() {
            Some(state) => state.push_event(event),
            None => Some(event),
        };
        event.is_none_or(|event| self.parent_sink_event(event))
    }

    /// Drains, then lets the event go on.
    fn drain_before(&self, event: gst::Event) -> bool {
        // A failed drain is no reason to hold the event back: the next push meets the same failure.
        let _ = self.drain();
        self.parent_sink_event(event)
    }

    /// Whether this is not the stream that was given out last: another file, perhaps another camera.
    fn is_other_stream(&self, id: &str) -> bool {
        let last = self.obj().src_pad().sticky_event::<gst::event::StreamStart>(0);
        last.is_some_and(|last| last.stream_id() != id)
    }

    fn is_caps_in_use(&self, caps: &gst::CapsRef) -> bool {
        lock(&self.state).as_ref().is_some_and(|state| state.has_caps(caps))
    }
}

#[glib::object_subclass]
impl ObjectSubclass for RsRectify {
    const NAME: &'static str = "GstRsRectify";
    type Type = super::RsRectify;
    type ParentType = gst_video::VideoFilter;
    type Interfaces = (gst::Preset,);
}

impl ObjectImpl for RsRectify {
    fn properties() -> &'static [glib::ParamSpec] {
        properties::specs()
    }

    fn set_property(&self, _id: usize, value: &glib::Value, pspec: &glib::ParamSpec) {
        gst::debug!(CAT, imp = self, "Setting {} to {value:?}", pspec.name());
        lock(&self.settings).set(pspec.name(), value);
    }

    fn property(&self, _id: usize, pspec: &glib::ParamSpec) -> glib::Value {
        let setting = self.settings().get(pspec.name());
        setting.unwrap_or_else(|| lock(&self.report).stats().to_value())
    }

    fn constructed(&self) {
        self.parent_constructed();
        // Frames flagged GAP are repeated ones: the flag goes on.
        self.obj().set_gap_aware(true);
    }
}

impl GstObjectImpl for RsRectify {}

impl PresetImpl for RsRectify {}

impl ElementImpl for RsRectify {
    fn metadata() -> Option<&'static gst::subclass::ElementMetadata> {
        static METADATA: LazyLock<gst::subclass::ElementMetadata> = LazyLock::new(|| {
            gst::subclass::ElementMetadata::new(
                "Rolling shutter rectifier",
                "Filter/Effect/Video",
                "Takes rolling-shutter distortion (lean, jello, wobble) out of video from any camera",
                env!("CARGO_PKG_AUTHORS"),
            )
        });
        Some(&*METADATA)
    }

    fn pad_templates() -> &'static [gst::PadTemplate] {
        static TEMPLATES: LazyLock<Vec<gst::PadTemplate>> = LazyLock::new(|| {
            let sides = 1..=formats::LONGEST_SIDE;
            let caps = gst_video::VideoCapsBuilder::new().format_list(formats::FORMATS);
            let caps = caps.width_range(sides.clone()).height_range(sides).build();
            let template = |name, direction| {
                gst::PadTemplate::new(name, direction, gst::PadPresence::Always, &caps).ok()
            };
            let pads = [("src", gst::PadDirection::Src), ("sink", gst::PadDirection::Sink)];
            pads.into_iter().filter_map(|(name, direction)| template(name, direction)).collect()
        });
        TEMPLATES.as_ref()
    }
}

impl BaseTransformImpl for RsRectify {
    const MODE: gst_base::subclass::BaseTransformMode = gst_base::subclass::BaseTransformMode::NeverInPlace;
    const PASSTHROUGH_ON_SAME_CAPS: bool = false;
    const TRANSFORM_IP_ON_PASSTHROUGH: bool = false;

    fn start(&self) -> Result<(), gst::ErrorMessage> {
        *lock(&self.report) = Report::default();
        Ok(())
    }

    fn stop(&self) -> Result<(), gst::ErrorMessage> {
        *lock(&self.state) = None;
        lock(&self.report).latency = gst::ClockTime::ZERO;
        Ok(())
    }

    fn query(&self, direction: gst::PadDirection, query: &mut gst::QueryRef) -> bool {
        match (direction, query.view_mut()) {
            (gst::PadDirection::Src, gst::QueryViewMut::Latency(latency)) => {
                if !self.obj().sink_pad().peer_query(latency.query_mut()) {
                    return false;
                }
                let (live, min, max) = latency.result();
                let ours = lock(&self.report).note_source(live);
                let add = |time: gst::ClockTime| time.saturating_add(ours);
                latency.set(live, add(min), max.map(add));
                true
            }
            (gst::PadDirection::Src, gst::QueryViewMut::Position(position))
                if position.format() == gst::Format::Time =>
            {
                let time = lock(&self.report).position;
                match time {
                    Some(time) => position.set(time),
                    None => return BaseTransformImplExt::parent_query(self, direction, query),
                }
                true
            }
            (gst::PadDirection::Sink, gst::QueryViewMut::Drain(_)) => {
                let _ = self.drain();
                BaseTransformImplExt::parent_query(self, direction, query)
            }
            _ => BaseTransformImplExt::parent_query(self, direction, query),
        }
    }

    fn sink_event(&self, event: gst::Event) -> bool {
        use gst::EventView;
        gst::debug!(CAT, imp = self, "Event {event:?}");
        match event.view() {
            // Editors announce the same caps twice: nothing changes.
            EventView::Caps(caps) if self.is_caps_in_use(caps.caps()) => self.parent_sink_event(event),
            EventView::Segment(_) => {
                let _ = self.drain();
                lock(&self.report).start_segment();
                self.parent_sink_event(event)
            }
            EventView::StreamStart(start) => {
                let _ = self.drain();
                if self.is_other_stream(start.stream_id())
                    && let Some(state) = lock(&self.state).as_mut()
                {
                    state.forget_camera();
                }
                self.parent_sink_event(event)
            }
            EventView::Caps(_) | EventView::SegmentDone(_) | EventView::Gap(_) | EventView::Eos(_) => {
                self.drain_before(event)
            }
            EventView::FlushStop(_) => {
                self.flush();
                lock(&self.report).start_segment();
                self.parent_sink_event(event)
            }
            _ if event.is_serialized() => self.queue_event(event),
            _ => self.parent_sink_event(event),
        }
    }

    fn src_event(&self, event: gst::Event) -> bool {
        if let gst::EventView::Qos(qos) = event.view() {
            lock(&self.report).note_quality(qos);
        }
        self.parent_src_event(event)
    }

    fn propose_allocation(
        &self,
        decide_query: Option<&gst::query::Allocation>,
        query: &mut gst::query::Allocation,
    ) -> Result<(), gst::LoggableError> {
        self.parent_propose_allocation(decide_query, query)?;
        // Frames held are missing from the pool they come from.
        let held = lock(&self.state).as_ref().map_or(0, State::frames_held);
        if decide_query.is_some() {
            raise_minimum(query, held + 1);
        }
        Ok(())
    }

    /// The frame keeps its size and orientation, so every meta that can be copied stays true.
    fn transform_meta<'a>(
        &self,
        _outbuf: &mut gst::BufferRef,
        _meta: gst::MetaRef<'a, gst::Meta>,
        _inbuf: &'a gst::BufferRef,
    ) -> bool {
        true
    }

    /// `_is_discont` stays set until the base class itself has pushed a buffer, which it never does
    /// here: the buffer's own flag counts.
    fn submit_input_buffer(
        &self,
        _is_discont: bool,
        input: gst::Buffer,
    ) -> Result<gst::FlowSuccess, gst::FlowError> {
        gst::log!(CAT, imp = self, "Frame {input:?}");
        if !self.obj().reconfigure() {
            let flushing = self.obj().src_pad().pad_flags().contains(gst::PadFlags::FLUSHING);
            return Err(if flushing { gst::FlowError::Flushing } else { gst::FlowError::NotNegotiated });
        }
        let settings = self.settings();
        let drain = match lock(&self.state).as_ref() {
            Some(state) => state.must_drain(&input, &settings),
            None => return Err(gst::FlowError::NotNegotiated),
        };
        if drain {
            self.drain()?;
        }
        self.take_frame(input, &settings)?;
        Ok(gst::FlowSuccess::Ok)
    }

    /// Pushes what is ready itself, since events go out between the frames.
    fn generate_output(&self) -> Result<GenerateOutputSuccess, gst::FlowError> {
        self.push_ready()?;
        Ok(GenerateOutputSuccess::NoOutput)
    }
}

/// Asks the pools in an allocation query for at least `more` buffers than before.
fn raise_minimum(query: &mut gst::query::Allocation, more: u32) {
    let pools: Vec<_> = query.allocation_pools().collect();
    for (index, (pool, size, min, max)) in (0..).zip(pools) {
        let min = min.saturating_add(more);
        let max = if max == 0 { 0 } else { max.max(min) };
        query.set_nth_allocation_pool(index, pool.as_ref(), size, min, max);
    }
}

impl VideoFilterImpl for RsRectify {
    fn set_info(
        &self,
        caps: &gst::Caps,
        info: &gst_video::VideoInfo,
        _outcaps: &gst::Caps,
        _out_info: &gst_video::VideoInfo,
    ) -> Result<(), gst::LoggableError> {
        let state = State::new(caps, info, &self.settings())
            .ok_or_else(|| gst::loggable_error!(CAT, "No luma in {caps}"))?;
        let (latency, passthrough, period) = (state.latency(), state.is_passthrough(), state.period());
        gst::info!(CAT, imp = self, "Caps {caps}");
        *lock(&self.state) = Some(state);
        lock(&self.report).period = period;
        self.obj().set_passthrough(passthrough);
        if passthrough {
            gst::element_imp_warning!(
                self,
                gst::StreamError::Format,
                ("Interlaced and multiview video is not rectified: it passes through unchanged")
            );
        }
        self.announce_latency(latency);
        Ok(())
    }
}
