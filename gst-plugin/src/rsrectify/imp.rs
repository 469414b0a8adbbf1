// SPDX-License-Identifier: MIT OR Apache-2.0

//! The element proper: what GStreamer asks of it.
//!
//! GStreamer's base class negotiates; the flow of frames is the element's own, see `flow`. Events that travel
//! with the frames are queued between them; those that end a stretch of the stream first drain the queue.

use super::allocation::raise_minimum;
use super::enums::{BorderMode, Effort, Estimator, Interpolation, Model, ReadoutDirection, Stabilised};
/**
 * SECTION:element-rsrectify
 *
 * Takes rolling-shutter distortion (lean, jello, wobble, stretch) out of video: no gyroscope, calibration or metadata.
 *
 * The element holds `lookahead` frames back, which is its latency. Every frame comes out once, in order, with its own
 * timestamps, flags and metas; a frame without motion is the very buffer that came in. Interlaced and multiview video
 * passes through with a warning.
 *
 * In a live pipeline a frame is given out before it is held for longer than was reported, or than the pipeline
 * was set to where that is less, with the motion that is known by then. Where the sink tells (QoS) that frames come later
 * and later, the correction fades out and frames go out as they came until there is time again, unless `qos` is off.
 *
 * The readout time and direction, and the focal length, are found from the picture while it plays, and known the better
 * the more the camera has moved; until then little is corrected. They are kept over cuts, gaps and seeks, and forgotten
 * with new caps, a new stream and a stop. `stats` tells what was found: give it as `readout-time` and
 * `readout-direction` to have it from the first frame on. Of stabilised frames less is corrected: see `stabilised`.
 *
 * Settings of the analysis (readout, `estimator`, `model`, `focal-length`, `stabilised`) that change while playing take
 * effect with the next frame: those held are given out and the analysis starts anew, without what it had found.
 * `lookahead` and the grid take effect with the next caps.
 *
 * ## Example pipelines
 * |[
 * gst-launch-1.0 filesrc location=in.mp4 ! decodebin ! videoconvert ! rsrectify ! \
 *     videoconvert ! x264enc ! mp4mux ! filesink location=out.mp4
 * ]| Rectifies a film.
 * |[
 * gst-launch-1.0 v4l2src ! videoconvert ! rsrectify lookahead=0 readout-time=28000000 ! videoconvert ! autovideosink
 * ]| Rectifies a camera whose readout takes 28 ms, without delay.
 *
 * Since: plugins-rsrectify-0.1
 */
use super::ffi;
use super::formats;
use super::latency::Latency;
use super::properties::{self, Settings};
use super::report::{Report, clock_time};
use super::shared::{Hooks, Shared, lock};
use super::state::State;
use super::timer::Timer;
use gst::glib;
use gst::prelude::*;
use gst::subclass::prelude::*;
use gst_base::prelude::*;
use gst_base::subclass::base_transform::GenerateOutputSuccess;
use gst_base::subclass::prelude::*;
use gst_video::subclass::prelude::*;
use std::sync::{LazyLock, Mutex};

pub(super) static CAT: LazyLock<gst::DebugCategory> = LazyLock::new(|| {
    gst::DebugCategory::new("rsrectify", gst::DebugColorFlags::empty(), Some("Rolling shutter rectifier"))
});

/// The element's instance.
///
/// Its mutexes are never held together, nor while anything is pushed or posted.
#[derive(glib::Properties)]
#[properties(wrapper_type = object::RsRectify)]
pub struct RsRectify {
    /// Columns of the sampling grid.
    #[property(name = "grid-columns", get, set, type = u32, member = grid_columns,
        nick = "Grid columns",
        blurb = "Columns of the grid of points that are followed from frame to frame",
        minimum = 2, maximum = 256, default = Settings::DEFAULT.grid_columns, mutable_ready)]
    /// Rows of the sampling grid.
    #[property(name = "grid-rows", get, set, type = u32, member = grid_rows,
        nick = "Grid rows",
        blurb = "Rows of the grid of points that are followed from frame to frame",
        minimum = 2, maximum = 256, default = Settings::DEFAULT.grid_rows, mutable_ready)]
    /// Blank time between frames in rows; −1: not known.
    #[property(name = "inter-frame-delay", get, set, type = f64, member = inter_frame_delay,
        nick = "Inter-frame delay",
        blurb = "Blank time between a frame's last row and the next frame's first, in rows (columns where the sensor is read sideways); -1: not known, see readout-time",
        minimum = -1.0, maximum = 1e9, default = Settings::DEFAULT.inter_frame_delay, mutable_playing)]
    /// Readout time in nanoseconds; 0: not known.
    #[property(name = "readout-time", get, set, type = u64, member = readout_time,
        nick = "Readout time",
        blurb = "Time that the readout of all rows takes, in nanoseconds; wins over inter-frame-delay; 0: found from the picture (sequential: taken as the frame duration); 1: a global shutter",
        maximum = gst::ClockTime::SECOND.nseconds(), default = Settings::DEFAULT.readout_time, mutable_playing)]
    /// The edge that is read first.
    #[property(name = "readout-direction", get, set, type = ReadoutDirection, member = readout_direction, default,
        nick = "Readout direction",
        blurb = "Which edge of the frame, as it arrives here, the sensor reads first; auto: found from the picture (sequential: top-to-bottom)",
        mutable_playing)]
    /// Frames waited for before a frame is given out.
    #[property(name = "lookahead", get, set, type = u32, member = lookahead,
        nick = "Lookahead",
        blurb = "Frames waited for before a frame is given out: the element's latency, in frames; 8 for strong shake, 0 for none at a loss of accuracy",
        maximum = 64, default = Settings::DEFAULT.lookahead, mutable_ready)]
    /// How much time the analysis of a frame may take.
    #[property(name = "effort", get, set, type = Effort, member = effort, default,
        nick = "Effort",
        blurb = "How finely frames are analysed: fast takes half to two thirds of the time that balanced takes, and is less exact",
        mutable_playing)]
    /// How motion is estimated.
    #[property(name = "estimator", get, set, type = Estimator, member = estimator, default,
        nick = "Estimator",
        blurb = "How the motion of the frames is estimated: continuous finds the readout too; sequential gives each frame one rotation and must be told the readout",
        mutable_playing)]
    /// What motion the picture can have.
    #[property(name = "model", get, set, type = Model, member = model, default,
        nick = "Model",
        blurb = "What motion the picture can have; the sequential estimator always takes rotation, of which translation is a case",
        mutable_playing)]
    /// Focal length in frame widths; 0: not known.
    #[property(name = "focal-length", get, set, type = f64, member = focal_length,
        nick = "Focal length",
        blurb = "Focal length in frame widths, for models with perspective of the continuous estimator; 0: found from the picture",
        minimum = 0.0, maximum = 1e3, default = Settings::DEFAULT.focal_length, mutable_playing)]
    /// Share of the readout whose instant the output shows.
    #[property(name = "reference-row", get, set, type = f64, member = reference_row,
        nick = "Reference row",
        blurb = "The instant that the output shows, as a share of the readout: 0 is the row read first, 1 the last",
        minimum = 0.0, maximum = 1.0, default = Settings::DEFAULT.reference_row, mutable_playing, controllable)]
    /// How samples between pixels are made.
    #[property(name = "interpolation", get, set, type = Interpolation, member = interpolation, default,
        nick = "Interpolation",
        blurb = "How samples between pixels are made",
        mutable_playing)]
    /// What is shown where the frame saw nothing.
    #[property(name = "border-mode", get, set, type = BorderMode, member = border_mode, default,
        nick = "Border mode",
        blurb = "What is shown where the frame saw nothing",
        mutable_playing)]
    /// Colour of `border-mode=constant`, 0xAARRGGBB.
    #[property(name = "border-color", get, set, type = u32, member = border_color,
        nick = "Border colour",
        blurb = "Colour of border-mode=constant, as 0xAARRGGBB",
        default = Settings::DEFAULT.border_color, mutable_playing, controllable)]
    /// Per cent that `border-mode=crop` cuts away.
    #[property(name = "crop", get, set, type = f64, member = crop,
        nick = "Crop",
        blurb = "Share of the width and height that border-mode=crop cuts away, in per cent",
        minimum = 0.0, maximum = 50.0, default = Settings::DEFAULT.crop, mutable_playing, controllable)]
    /// Share of the correction that is applied.
    #[property(name = "strength", get, set, type = f64, member = strength,
        nick = "Strength",
        blurb = "How much of the correction is applied: 0 none (the latency stays), 1 all",
        minimum = 0.0, maximum = 1.0, default = Settings::DEFAULT.strength, mutable_playing, controllable)]
    /// Worker threads; 0: as many as there are cores.
    #[property(name = "threads", get, set, type = u32, member = threads,
        nick = "Threads",
        blurb = "Worker threads; 0: one for each core, shared with all elements of this kind",
        maximum = 256, default = Settings::DEFAULT.threads, mutable_playing)]
    /// Whether each frame's motion is posted on the bus.
    #[property(name = "post-messages", get, set, type = bool, member = post_messages,
        nick = "Post messages",
        blurb = "Post an element message \"rsrectify\" with the motion and confidence of each frame",
        default = Settings::DEFAULT.post_messages, mutable_playing)]
    /// Whether each frame's motion is attached to its buffer.
    #[property(name = "attach-meta", get, set, type = bool, member = attach_meta,
        nick = "Attach meta",
        blurb = "Attach a custom meta \"RsRectifyMeta\" with its motion, readout and confidence to each frame",
        default = Settings::DEFAULT.attach_meta, mutable_playing)]
    /// Latency that is reported for the work on a frame, in nanoseconds.
    #[property(name = "processing-deadline", get, set, type = u64, member = processing_deadline,
        nick = "Processing deadline",
        blurb = "Time in nanoseconds that the work on a frame may take in a live pipeline: latency beside that of lookahead; grows by itself where frames come late because of the work",
        maximum = gst::ClockTime::SECOND.nseconds(), default = Settings::DEFAULT.processing_deadline, mutable_ready)]
    /// Readout time that is expected, in nanoseconds; 0: none.
    #[property(name = "expected-readout-time", get, set, type = u64, member = expected_readout_time,
        nick = "Expected readout time",
        blurb = "Readout time that the camera is expected to have, in nanoseconds, as presets of known cameras state it: where the search for the readout starts, and overruled by what the picture shows; 0: none; not heeded where readout-time or inter-frame-delay is given",
        maximum = gst::ClockTime::SECOND.nseconds(), default = Settings::DEFAULT.expected_readout_time, mutable_playing)]
    /// Its standard deviation in nanoseconds; 0: a tenth of it.
    #[property(name = "expected-readout-deviation", get, set, type = u64, member = expected_readout_deviation,
        nick = "Deviation of the expected readout time",
        blurb = "Standard deviation of expected-readout-time in nanoseconds; 0: a tenth of it",
        maximum = gst::ClockTime::SECOND.nseconds(), default = Settings::DEFAULT.expected_readout_deviation, mutable_playing)]
    /// The edge that is expected to be read first.
    #[property(name = "expected-readout-direction", get, set, type = ReadoutDirection, member = expected_readout_direction, default,
        nick = "Expected readout direction",
        blurb = "Which edge of the frame, as it arrives here, is expected to be read first; auto: any; not heeded without expected-readout-time or against readout-direction",
        mutable_playing)]
    /// Whether the frames were moved after their readout.
    #[property(name = "stabilised", get, set, type = Stabilised, member = stabilised, default,
        nick = "Stabilised",
        blurb = "Whether the frames were moved after their readout, as by stabilisation in the camera; such frames are rectified by the changes of their lean alone, as far as these show it; auto: found from the picture (sequential: no)", mutable_playing)]
    /// Standard deviation of the smoothing of the virtual camera's path, in seconds.
    #[property(name = "stabilization", get, set, type = f64, member = stabilization,
        nick = "Stabilisation",
        blurb = "Steadies the picture: standard deviation of the smoothing of the camera's path, in seconds; 0: off; 0.5 takes out the shake of a hand; needs a lookahead of some 2.6 deviations, at most 64 frames, and border-mode=crop to hide the borders",
        minimum = 0.0, maximum = 10.0, default = Settings::DEFAULT.stabilization, mutable_playing, controllable)]
    pub(super) settings: Shared,
    /// Set before the element is started.
    pub(super) hooks: Mutex<Hooks>,
    /// `None` until caps are known.
    pub(super) state: Mutex<Option<State>>,
    /// For any thread, briefly.
    pub(super) report: Mutex<Report>,
    /// Runs while a live pipeline waits for frames.
    pub(super) timer: Mutex<Option<Timer>>,
}

/// The object that applications hold; its instance is the type above, and the two name each other.
pub mod object {
    use gst::glib;

    glib::wrapper! {
        /// The element `rsrectify`: a video filter that holds `lookahead` frames back.
        pub struct RsRectify(ObjectSubclass<super::RsRectify>)
            @extends gst_video::VideoFilter, gst_base::BaseTransform, gst::Element, gst::Object,
            @implements gst::Preset;
    }
}

impl Default for RsRectify {
    fn default() -> Self {
        let latency = Latency::new(Settings::default().analysis().lookahead as u64, None, 0);
        Self {
            settings: Shared::default(),
            hooks: Mutex::default(),
            state: Mutex::default(),
            report: Mutex::new(Report::new(latency)),
            timer: Mutex::default(),
        }
    }
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
    type Type = object::RsRectify;
    type ParentType = gst_video::VideoFilter;
    type Interfaces = (gst::Preset,);

    fn class_init(class: &mut Self::Class) {
        ffi::keep_object_properties_out_of_presets(class);
    }
}

impl ObjectImpl for RsRectify {
    fn properties() -> &'static [glib::ParamSpec] {
        // The derive has no structures.
        static SPECS: LazyLock<Vec<glib::ParamSpec>> =
            LazyLock::new(|| [RsRectify::derived_properties(), &[properties::stats()]].concat());
        &SPECS
    }

    fn set_property(&self, id: usize, value: &glib::Value, pspec: &glib::ParamSpec) {
        gst::debug!(CAT, imp = self, "Setting {} to {value:?}", pspec.name());
        self.derived_set_property(id, value, pspec);
    }

    fn property(&self, id: usize, pspec: &glib::ParamSpec) -> glib::Value {
        match pspec.name() {
            "stats" => lock(&self.report).stats().to_value(),
            _ => self.derived_property(id, pspec),
        }
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
            gst::EventView::Latency(latency) => {
                lock(&self.report).latency.grant(latency.latency().nseconds());
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

impl VideoFilterImpl for RsRectify {
    fn set_info(
        &self,
        caps: &gst::Caps,
        info: &gst_video::VideoInfo,
        _outcaps: &gst::Caps,
        _out_info: &gst_video::VideoInfo,
    ) -> Result<(), gst::LoggableError> {
        let has_source = lock(&self.hooks).source.is_some();
        let state = State::new(caps, info, &self.settings(), has_source)
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
