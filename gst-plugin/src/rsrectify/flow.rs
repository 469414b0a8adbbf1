// SPDX-License-Identifier: MIT OR Apache-2.0

//! The flow of frames: taken in, analysed, held, rectified, given out.
//!
//! Only the thread that holds the sink pad's stream lock does this: the streaming thread, or the timer that
//! gives out a frame which a live pipeline can wait for no longer.

use super::imp::{CAT, RsRectify};
use super::latency::Latency;
use super::load::Effort;
use super::properties::Settings;
use super::report::{self, FrameTime, clock_time};
use super::shared::lock;
use super::state::{Frame, Output, State};
use super::timer::Timer;
use gst::glib::property::PropertyGet;
use gst::prelude::*;
use gst::subclass::prelude::*;
use gst_base::prelude::*;
use gst_base::subclass::base_transform::{InputBuffer, PrepareOutputBufferSuccess};
use gst_base::subclass::prelude::*;
use rsrectify::motion::FrameMotion;
use rsrectify::rectifier::FrameSolution;
use std::time::Instant;

impl RsRectify {
    pub(super) fn settings(&self) -> Settings {
        PropertyGet::get(&self.settings, |settings| *settings)
    }

    /// Takes in a frame and gives out those whose motion is then known.
    pub(super) fn take(&self, input: gst::Buffer) -> Result<(), gst::FlowError> {
        match lock(&self.state).as_mut() {
            None => return Err(gst::FlowError::NotNegotiated),
            // Time without a picture: nothing to analyse, and nothing that breaks off.
            Some(state) if input.size() == 0 && input.flags().contains(gst::BufferFlags::GAP) => {
                state.push_empty(input);
                return Ok(());
            }
            Some(_) => (),
        }
        let settings = self.settings();
        if lock(&self.state).as_ref().is_some_and(|state| state.must_drain(&input, &settings)) {
            lock(&self.report).latency.interrupt();
            self.drain()?;
        }
        let input = self.own_copy(input)?;
        let running = FrameTime::new(&self.obj().segment(), &input).running;
        let effort = self.effort(running);
        self.add_frame(Frame { buffer: input, effort, running }, &settings)?;
        if lock(&self.report).latency.note_frame(running.map(gst::ClockTime::nseconds)) {
            self.post_latency();
        }
        Ok(())
    }

    /// What is to be done with the next frame, by what the sink says of its lateness.
    fn effort(&self, running: Option<gst::ClockTime>) -> Effort {
        if !self.obj().is_qos() {
            return Effort::Full(1.0);
        }
        lock(&self.report).load.next(running.map(gst::ClockTime::nseconds))
    }

    /// A copy of a frame whose pool the frames held could empty, or whose rows lie upside down; otherwise the frame.
    fn own_copy(&self, input: gst::Buffer) -> Result<gst::Buffer, gst::FlowError> {
        let copy = lock(&self.state).as_mut().and_then(|state| state.buffer_for_copy(&input));
        match copy {
            Some(copy) => self.copy_into(&input, copy),
            None => Ok(input),
        }
    }

    /// Copies picture, times, flags and metas.
    fn copy_into(&self, input: &gst::Buffer, mut copy: gst::Buffer) -> Result<gst::Buffer, gst::FlowError> {
        let output = copy.make_mut();
        self.parent_copy_metadata(input, output).map_err(|error| {
            error.log_with_imp(self);
            gst::FlowError::Error
        })?;
        // The lock must be gone before an error is posted.
        let copied = match lock(&self.state).as_mut() {
            Some(state) => state.copy(input, output),
            None => return Err(gst::FlowError::Flushing),
        };
        copied.map_err(|reason| self.stream_error(reason))?;
        Ok(copy)
    }

    fn add_frame(&self, frame: Frame, settings: &Settings) -> Result<(), gst::FlowError> {
        let is_analysed = frame.effort != Effort::None;
        let (workers, taken, analysis) = match lock(&self.state).as_mut() {
            Some(state) => (state.configure(settings), state.push_frame(frame), state.take_timings()),
            None => return Err(gst::FlowError::NotNegotiated),
        };
        if let Err(error) = workers {
            gst::warning!(CAT, imp = self, "No threads of its own, using the shared ones: {error}");
        }
        if is_analysed {
            lock(&self.report).count_analysed(analysis);
        } else {
            lock(&self.report).count_analysis(analysis);
        }
        taken.map_err(|reason| self.stream_error(reason))
    }

    /// Gives out everything held; on an error the rest is dropped.
    pub(super) fn drain(&self) -> Result<(), gst::FlowError> {
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
    pub(super) fn flush(&self) {
        let events = lock(&self.state).as_mut().map(State::flush).unwrap_or_default();
        for event in events.iter().filter(|event| event.is_sticky()) {
            if let Err(error) = self.obj().src_pad().store_sticky_event(event) {
                gst::debug!(CAT, imp = self, "Cannot keep {event:?}: {error}");
            }
        }
    }

    /// Gives out the frames whose motion is known, and the events between them.
    pub(super) fn push_ready(&self) -> Result<(), gst::FlowError> {
        loop {
            let in_time = lock(&self.report).latency.frames_in_time();
            let next = lock(&self.state).as_mut().and_then(|state| state.next(in_time));
            match next {
                Some(output) => self.push_output(output)?,
                None => break,
            }
        }
        self.set_timer();
        Ok(())
    }

    fn push_output(&self, output: Output) -> Result<(), gst::FlowError> {
        match output {
            Output::Event(event) => {
                gst::debug!(CAT, imp = self, "Releasing {event:?}");
                self.parent_sink_event(event);
                Ok(())
            }
            Output::Frame(frame, solution) => self.push_frame(frame, solution.map(|solution| *solution)),
        }
    }

    /// Gives out one frame.
    fn push_frame(&self, frame: Frame, solution: Option<FrameSolution>) -> Result<(), gst::FlowError> {
        let obj = self.obj();
        let time = FrameTime::new(&obj.segment(), &frame.buffer);
        if let Some(stream_time) = time.stream
            && let Err(error) = obj.sync_values(stream_time)
        {
            gst::warning!(CAT, imp = self, "Cannot synchronise properties: {error}");
        }
        let settings = self.settings();
        let is_skipped = frame.effort == Effort::None && frame.buffer.size() > 0 && self.is_rectifying();
        let share = match frame.effort {
            Effort::Full(share) => share,
            Effort::None => 0.0,
        };
        // A frame that is skipped has no motion, but is enlarged like the others.
        let motion = match &solution {
            Some(solution) => Some(solution.motion.clone()),
            None if is_skipped => lock(&self.state).as_ref().map(State::still),
            None => self.given_motion(&time),
        };
        let motion = motion.filter(|motion| !settings.leaves_untouched(motion));
        let applied =
            motion.as_ref().map_or(0.0, |motion| share * motion.weight() * settings.warp().strength);
        let mut output = match &motion {
            Some(motion) => self.rectify(&frame.buffer, motion, share, &settings)?,
            None => self.untouched(frame.buffer)?,
        };
        if is_skipped {
            let message = lock(&self.report).overload_message(&*obj, &time);
            self.post(message);
        }
        lock(&self.report).count_frame(&time, solution.as_ref());
        if let Some(solution) = solution {
            let observer = lock(&self.hooks).observer.clone();
            if let Some(observer) = observer {
                observer(time.stream, &solution);
            }
            if settings.attach_meta
                && let Err(error) = report::attach_meta(output.make_mut(), &solution, applied)
            {
                gst::warning!(CAT, imp = self, "No meta on {output:?}: {error}");
            }
            if settings.post_messages {
                let structure = report::frame_message(&time, &solution, applied);
                self.post(gst::message::Element::builder(structure).src(&*obj).build());
            }
        }
        gst::log!(CAT, imp = self, "Pushing {output:?}");
        obj.src_pad().push(output).map(|_| ())
    }

    /// The motion of a frame from elsewhere; `None` where there is none.
    fn given_motion(&self, time: &FrameTime) -> Option<FrameMotion> {
        let source = lock(&self.hooks).source.clone()?;
        let size = lock(&self.state).as_ref().filter(|state| !state.is_passthrough()).map(State::size)?;
        source(time.stream, size)
    }

    /// A frame that goes out as it came: the buffer itself, or a copy where downstream would take the padding of
    /// its rows for picture.
    fn untouched(&self, input: gst::Buffer) -> Result<gst::Buffer, gst::FlowError> {
        if !lock(&self.state).as_ref().is_some_and(|state| state.must_repack(&input)) {
            return Ok(input);
        }
        match self.parent_prepare_output_buffer(InputBuffer::Readable(&input))? {
            PrepareOutputBufferSuccess::Buffer(output) => self.copy_into(&input, output),
            PrepareOutputBufferSuccess::InputBuffer => Ok(input),
        }
    }

    /// The rectified frame, in a buffer of the negotiated pool.
    fn rectify(
        &self,
        input: &gst::Buffer,
        motion: &FrameMotion,
        share: f64,
        settings: &Settings,
    ) -> Result<gst::Buffer, gst::FlowError> {
        let mut output = match self.parent_prepare_output_buffer(InputBuffer::Readable(input))? {
            PrepareOutputBufferSuccess::Buffer(output) => output,
            PrepareOutputBufferSuccess::InputBuffer => return Ok(input.clone()),
        };
        let start = Instant::now();
        // The lock must be gone before an error is posted.
        let rectified = match lock(&self.state).as_mut() {
            Some(state) => state.rectify(input, output.make_mut(), motion, share, settings),
            None => return Err(gst::FlowError::Flushing),
        };
        rectified.map_err(|reason| self.stream_error(reason))?;
        lock(&self.report).count_warp(start.elapsed());
        Ok(output)
    }

    fn is_rectifying(&self) -> bool {
        lock(&self.state).as_ref().is_some_and(|state| !state.is_passthrough())
    }

    fn stream_error(&self, reason: &str) -> gst::FlowError {
        gst::element_imp_error!(self, gst::StreamError::Format, ("Cannot process a frame: {reason}"));
        gst::FlowError::Error
    }

    pub(super) fn post(&self, message: gst::Message) {
        if self.obj().post_message(message).is_err() {
            gst::trace!(CAT, imp = self, "No bus to post to");
        }
    }

    /// Announces that the latency has changed.
    pub(super) fn post_latency(&self) {
        let latency = lock(&self.report).latency.own();
        gst::info!(CAT, imp = self, "Latency is {}", clock_time(latency));
        self.post(gst::message::Latency::builder().src(&*self.obj()).build());
    }

    /// Takes over the latency of new caps and announces a change.
    ///
    /// A sink answers for the latency only once it has a first frame: whether the source is live, and the first frame
    /// must not wait for long, is asked for here.
    pub(super) fn change_latency(&self, frames: u32, rate: Option<(u64, u64)>, work: u64) {
        let mut query = gst::query::Latency::new();
        let source = self.obj().sink_pad().peer_query(&mut query).then(|| query.result());
        let fixed = self.fixed_latency();
        let is_changed = {
            let mut report = lock(&self.report);
            let latency = report.latency.renewed(frames.into(), rate, work);
            let before = report.latency.own();
            report.set_latency(latency);
            if let Some((live, min, _)) = source {
                report.latency.answer(live, min.nseconds());
            }
            if let Some(fixed) = fixed {
                report.latency.grant(fixed.nseconds());
            }
            before != report.latency.own()
        };
        if is_changed {
            self.post_latency();
        }
    }

    /// The latency that the application has set the pipeline to, which its `LATENCY` event brings only after a first frame.
    fn fixed_latency(&self) -> Option<gst::ClockTime> {
        let mut top = self.obj().clone().upcast::<gst::Object>();
        while let Some(parent) = top.parent() {
            top = parent;
        }
        top.downcast::<gst::Pipeline>().ok()?.latency()
    }

    /// The latency before any caps are known.
    pub(super) fn latency_before_caps(&self) -> Latency {
        let settings = self.settings();
        Latency::new(settings.analysis().lookahead as u64, None, settings.processing_deadline)
    }

    /// The pipeline's clock, and its time at a running time.
    fn at_running(&self, running: gst::ClockTime) -> Option<(gst::Clock, gst::ClockTime)> {
        let base = self.obj().base_time()?;
        Some((self.obj().clock()?, base.checked_add(running)?))
    }

    /// When the first frame held must go out.
    fn deadline(&self) -> Option<(gst::Clock, gst::ClockTime)> {
        let running = lock(&self.state).as_ref().and_then(State::front_running)?;
        let deadline = lock(&self.report).latency.deadline(running.nseconds())?;
        self.at_running(clock_time(deadline))
    }

    /// Makes the timer wait for the first frame held; starts it when it is needed first.
    fn set_timer(&self) {
        let deadline = self.deadline();
        let mut timer = lock(&self.timer);
        if timer.is_none() && deadline.is_some() {
            let element = self.obj().downgrade();
            let release = move || {
                if let Some(element) = element.upgrade() {
                    let imp = element.imp();
                    gst::panic_to_error!(imp, (), { imp.release_overdue() });
                }
            };
            match Timer::new(release) {
                Ok(new) => *timer = Some(new),
                Err(error) => gst::warning!(CAT, imp = self, "Frames may come late, no timer: {error}"),
            }
        }
        if let Some(timer) = timer.as_ref() {
            timer.set(deadline);
        }
    }

    /// Gives out the frames that a live pipeline can wait for no longer, with the motion that is known by now.
    fn release_overdue(&self) {
        let pad = self.obj().sink_pad().clone();
        let _streaming = pad.stream_lock();
        while self.deadline().is_some_and(|(clock, time)| clock.time() >= time) {
            let next = lock(&self.state).as_mut().and_then(State::next_at_once);
            let Some(output) = next else { break };
            gst::debug!(CAT, imp = self, "Giving out a frame early");
            if let Err(error) = self.push_output(output) {
                // The streaming thread meets the same error with the next frame.
                gst::debug!(CAT, imp = self, "Push failed: {error}");
                return;
            }
        }
        // What follows may be ready now: events, frames that are not analysed.
        if let Err(error) = self.push_ready() {
            gst::debug!(CAT, imp = self, "Push failed: {error}");
        }
    }

    /// Queues an event that travels with the frames; without frames it goes on at once.
    pub(super) fn queue_event(&self, event: gst::Event) -> bool {
        let event = match lock(&self.state).as_mut() {
            Some(state) => state.push_event(event),
            None => Some(event),
        };
        event.is_none_or(|event| self.parent_sink_event(event))
    }

    /// Drains, then lets the event go on.
    pub(super) fn drain_before(&self, event: gst::Event) -> bool {
        // A failed drain is no reason to hold the event back: the next push meets the same failure.
        let _ = self.drain();
        self.parent_sink_event(event)
    }
}
