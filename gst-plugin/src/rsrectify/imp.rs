//! The element proper: what GStreamer asks of it.
//!
//! GStreamer's base class negotiates; the flow of frames is the element's own, see `flow`. Events that travel
//! with the frames are queued between them; those that end a stretch of the stream first drain the queue.

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
 * In a live pipeline a frame is given out before it is held for longer than was reported, with the motion
 * that is known by then. Where the sink tells (QoS) that frames come later and later, the correction fades out
 * and frames go out as they came until there is time again. The `qos` property turns this off.
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
use super::ffi;
use super::formats;
use super::latency::Latency;
use super::properties::{self, Settings};
use super::report::{Report, clock_time};
use super::state::State;
use super::timer::Timer;
use gst::glib;
use gst::prelude::*;
use gst::subclass::prelude::*;
use gst_base::prelude::*;
use gst_base::subclass::base_transform::GenerateOutputSuccess;
use gst_base::subclass::prelude::*;
use gst_video::subclass::prelude::*;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};

pub(super) static CAT: LazyLock<gst::DebugCategory> = LazyLock::new(|| {
    gst::DebugCategory::new("rsrectify", gst::DebugColorFlags::empty(), Some("Rolling shutter rectifier"))
});

/// The element's instance.
///
/// Its mutexes are never held together, nor while anything is pushed or posted.
pub struct RsRectify {
    pub(super) settings: Mutex<Settings>,
    /// `None` until caps are known.
    pub(super) state: Mutex<Option<State>>,
    /// For any thread, briefly.
    pub(super) report: Mutex<Report>,
    /// Runs while a live pipeline waits for frames.
    pub(super) timer: Mutex<Option<Timer>>,
}

impl Default for RsRectify {
    fn default() -> Self {
        let latency = Latency::new(Settings::default().analysis().lookahead as u64, None, 0);
        Self {
            settings: Mutex::default(),
            state: Mutex::default(),
            report: Mutex::new(Report::new(latency)),
            timer: Mutex::default(),
        }
    }
}

/// Locks a mutex; a panic elsewhere, which is reported there, does not make its data unreadable.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl RsRectify {
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

    fn class_init(class: &mut Self::Class) {
        ffi::keep_object_properties_out_of_presets(class);
    }
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
            let caps = formats::template_caps();
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
        let latency = self.latency_before_caps();
        *lock(&self.report) = Report::new(latency);
        Ok(())
    }

    fn stop(&self) -> Result<(), gst::ErrorMessage> {
        // Waits for the timer's thread, which may need the other mutexes.
        let timer = lock(&self.timer).take();
        drop(timer);
        *lock(&self.state) = None;
        let latency = self.latency_before_caps();
        lock(&self.report).set_latency(latency);
        Ok(())
    }

    fn query(&self, direction: gst::PadDirection, query: &mut gst::QueryRef) -> bool {
        match (direction, query.view_mut()) {
            (gst::PadDirection::Src, gst::QueryViewMut::Latency(latency)) => {
                if !self.obj().sink_pad().peer_query(latency.query_mut()) {
                    return false;
                }
                let (live, min, max) = latency.result();
                let ours = lock(&self.report).latency.answer(live, min.nseconds());
                let add = |time: gst::ClockTime| time.saturating_add(clock_time(ours));
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
        let is_slow = match event.view() {
            gst::EventView::Qos(qos) => lock(&self.report).note_quality(qos),
            gst::EventView::Latency(_) => {
                lock(&self.report).latency.grant();
                false
            }
            _ => false,
        };
        if is_slow {
            self.post_latency();
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

    fn decide_allocation(&self, query: &mut gst::query::Allocation) -> Result<(), gst::LoggableError> {
        let reads_strides = query.find_allocation_meta::<gst_video::VideoMeta>().is_some();
        if let Some(state) = lock(&self.state).as_mut() {
            state.set_downstream_reads_strides(reads_strides);
        }
        formats::keep_overlay_support(query, |query| self.parent_decide_allocation(query))
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
        self.take(input)?;
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
        let (frames, rate, passthrough) = (state.frames_held(), state.rate(), state.is_passthrough());
        gst::info!(CAT, imp = self, "Caps {caps}");
        *lock(&self.state) = Some(state);
        self.obj().set_passthrough(passthrough);
        if passthrough {
            gst::element_imp_warning!(
                self,
                gst::StreamError::Format,
                ("Interlaced and multiview video is not rectified: it passes through unchanged")
            );
        }
        let work = if passthrough { 0 } else { self.settings().processing_deadline };
        self.change_latency(frames, rate, work);
        Ok(())
    }
}
