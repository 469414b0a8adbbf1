// SPDX-License-Identifier: MIT OR Apache-2.0

//! The streaming thread of a sequence: caps, frames, events, queries, in an order that nobody planned.

use super::control;
use super::frames::{self, Defect, Timing};
use super::ledger::FrameFacts;
use super::setup;
use super::stage::{Flow, PANIC, Stage};
use gst::prelude::*;
use gst_video::VideoInfo;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::sync::atomic::Ordering;

/// Plays the sequence up to the end of its stream, at which the frames are counted.
pub fn play(stage: &Stage) {
    let mut rng = setup::rng(stage.setup.seed, 2);
    let rng = &mut rng;
    for _ in 0..rng.random_range(0..6) {
        control::set_property(stage, rng);
    }
    for _ in 0..stage.setup.steps {
        if stage.setup.disturbers == 0 && rng.random_bool(stage.setup.disturbance) {
            control::disturb(stage, rng);
        }
        step(stage, rng);
    }
}

/// Ends the stream; all that has not been flushed must be out. To be called when nobody disturbs.
pub fn finish(stage: &Stage) {
    let mut flow = stage.flow();
    let mut rng = setup::rng(stage.setup.seed, 4);
    // Caps that were refused are in the way of the end, too.
    for _ in 0..100 {
        if flow.started && flow.caps.is_none() {
            new_caps(stage, &mut flow, &mut rng);
        }
    }
    if flow.started && !flow.ended {
        stage.trace.step("eos, the last");
        stage.downstream_failed.store(false, Ordering::SeqCst);
        stage.upstream.push_event(gst::event::Eos::new());
        stage.ledger.all_is_out("the end");
    }
    let unexplained = unexplained(stage, flow.tainted);
    unexplained.into_iter().for_each(|error| stage.ledger.fault(format!("error: {error}")));
}

/// The errors posted for which no defect of a frame is the reason.
fn unexplained(stage: &Stage, tainted: bool) -> Vec<String> {
    let mut errors = stage.take_errors();
    errors.retain(|error| !tainted || error.contains(PANIC));
    errors
}

fn step(stage: &Stage, rng: &mut ChaCha8Rng) {
    let mut flow = stage.flow();
    let flow = &mut *flow;
    if !prepare(stage, flow, rng) {
        return;
    }
    if rng.random_bool(stage.setup.caps_changes) {
        new_caps(stage, flow, rng);
        return;
    }
    match rng.random_range(0..100) {
        0..70 => push_frame(stage, flow, rng),
        70..75 => push_list(stage, flow, rng),
        75..85 => push_event(stage, rng),
        85..88 => out_of_band(stage),
        88..90 => new_segment(stage, flow, rng),
        90..92 => gap(stage, rng),
        92..94 => new_stream(stage, flow, rng),
        94 => end(stage, flow),
        95 => segment_done(stage, rng),
        96 => again(stage, flow),
        97 => drain_query(stage),
        98 => allocation_query(stage, flow),
        _ => new_caps(stage, flow, rng),
    }
}

/// Tells the element what it must know before a frame; whether it knows.
fn prepare(stage: &Stage, flow: &mut Flow, rng: &mut ChaCha8Rng) -> bool {
    if flow.ended {
        new_stream(stage, flow, rng);
    }
    if !flow.started {
        stage.trace.step("stream-start");
        stage.upstream.push_event(gst::event::StreamStart::new(&flow.stream));
        flow.started = true;
    }
    if flow.caps.is_none() {
        new_caps(stage, flow, rng);
    }
    if flow.caps.is_none() {
        // Nothing that comes after them gets past caps that are refused.
        return false;
    }
    if flow.segment.is_none() || flow.sought.is_some() {
        new_segment(stage, flow, rng);
    }
    true
}

/// Sends an event that everything before it must have left the element for.
fn drained_by(stage: &Stage, event: gst::Event) -> bool {
    let (before, name) = (stage.interruptions(), event.type_().name().to_string());
    stage.trace.step(name.as_str());
    stage.downstream_failed.store(false, Ordering::SeqCst);
    let taken = stage.upstream.push_event(event);
    if stage.undisturbed(before) {
        stage.ledger.all_is_out(&name);
    }
    taken
}

fn new_caps(stage: &Stage, flow: &mut Flow, rng: &mut ChaCha8Rng) {
    let caps = setup::caps(rng, &stage.setup, &stage.formats);
    stage.trace.step(format!("caps {caps}"));
    stage.upstream.push_event(gst::event::Caps::new(&caps));
    // Pushing a sticky event comes back with success even where it is refused.
    let current = stage.element.static_pad("sink").and_then(|pad| pad.current_caps());
    let taken = current.as_ref() == Some(&caps);
    flow.caps = VideoInfo::from_caps(&caps).ok().filter(|_| taken).map(|info| (caps, info));
    flow.strides_welcome = false;
    if stage.setup.asks_allocation {
        allocation_query(stage, flow);
    }
}

fn new_segment(stage: &Stage, flow: &mut Flow, rng: &mut ChaCha8Rng) {
    let start = flow.sought.take().unwrap_or_else(|| rng.random_range(0..60_000_000_000));
    let (segment, reverse) = setup::segment(rng, start);
    let event = gst::event::Segment::new(&segment);
    flow.segment = Some(event.seqnum());
    let period = flow.caps.as_ref().map_or(0, |(_, info)| {
        let (num, den) = (info.fps().numer().max(0) as u64, info.fps().denom().max(0) as u64);
        (den * 1_000_000_000).checked_div(num).unwrap_or(33_333_333)
    });
    flow.timing = Timing::new(start + if reverse { 15_000_000_000 } else { 0 }, period, reverse);
    drained_by(stage, event);
}

fn new_stream(stage: &Stage, flow: &mut Flow, rng: &mut ChaCha8Rng) {
    if rng.random_bool(0.5) {
        flow.stream = format!("stream {}", rng.random_range(0..1000));
    }
    drained_by(stage, gst::event::StreamStart::new(&flow.stream));
    // With a stream's end its segment has ended.
    (flow.started, flow.ended, flow.segment) = (true, false, None);
}

/// The same caps again, as editors send them.
fn again(stage: &Stage, flow: &Flow) {
    if let Some((caps, _)) = &flow.caps {
        stage.trace.step("the same caps again");
        stage.upstream.push_event(gst::event::Caps::new(caps));
    }
}

fn end(stage: &Stage, flow: &mut Flow) {
    drained_by(stage, gst::event::Eos::new());
    flow.ended = true;
}

/// Events that drain and take their own place in the order.
fn ordered(stage: &Stage, event: gst::Event) {
    let before = stage.interruptions();
    stage.trace.step(event.type_().name().as_str());
    let number = stage.ledger.event_sent(&event);
    let taken = stage.upstream.push_event(event);
    if !taken {
        stage.ledger.excuse(number);
    }
    if stage.undisturbed(before) {
        stage.ledger.all_is_out("an event that drains");
    }
}

fn gap(stage: &Stage, rng: &mut ChaCha8Rng) {
    let time = gst::ClockTime::from_nseconds(rng.random_range(0..60_000_000_000));
    ordered(stage, gst::event::Gap::builder(time).duration(gst::ClockTime::SECOND).build());
}

fn segment_done(stage: &Stage, rng: &mut ChaCha8Rng) {
    ordered(
        stage,
        gst::event::SegmentDone::new(gst::ClockTime::from_nseconds(rng.random_range(0..60_000_000_000))),
    );
}

/// A serialised event that does not drain: it keeps its place between the frames.
fn push_event(stage: &Stage, rng: &mut ChaCha8Rng) {
    let structure = gst::Structure::new_empty("marker");
    let event = match rng.random_range(0..6) {
        0 => gst::event::Tag::new(gst::TagList::new()),
        1 => gst::event::CustomDownstreamSticky::new(structure),
        2 => gst::event::Toc::new(&gst::Toc::new(gst::TocScope::Global), false),
        _ => gst::event::CustomDownstream::new(structure),
    };
    stage.trace.step(event.type_().name().as_str());
    let number = stage.ledger.event_sent(&event);
    if !stage.upstream.push_event(event) {
        stage.ledger.excuse(number);
    }
}

fn out_of_band(stage: &Stage) {
    stage.trace.step("out of band");
    let structure = gst::Structure::new_empty("urgent");
    stage.upstream.push_event(gst::event::CustomDownstreamOob::new(structure));
}

fn drain_query(stage: &Stage) {
    let before = stage.interruptions();
    stage.trace.step("asks to drain");
    let _ = stage.upstream.peer_query(gst::query::Drain::new().query_mut());
    if stage.undisturbed(before) {
        stage.ledger.all_is_out("a drain query");
    }
}

fn allocation_query(stage: &Stage, flow: &mut Flow) {
    let Some((caps, _)) = &flow.caps else { return };
    stage.trace.step("asks for buffers");
    let mut query = gst::query::Allocation::new(Some(caps), true);
    let answered = stage.upstream.peer_query(query.query_mut());
    flow.strides_welcome = answered && query.find_allocation_meta::<gst_video::VideoMeta>().is_some();
}

/// Makes the next frame and enters it into the books.
fn next_frame(stage: &Stage, flow: &mut Flow, rng: &mut ChaCha8Rng) -> Option<(usize, gst::Buffer, Defect)> {
    let (caps, info) = flow.caps.clone()?;
    let number = stage.ledger.next_number();
    let frame =
        frames::frame(rng, &stage.setup, &info, &mut flow.timing, number, flow.strides_welcome, &stage.alive);
    let buffer = frame.buffer;
    let facts = FrameFacts {
        pts: buffer.pts(),
        dts: buffer.dts(),
        duration: buffer.duration(),
        offset_end: buffer.offset_end(),
        flags: buffer.flags(),
        caps,
        segment: flow.segment?,
        stream: flow.stream.clone(),
        shade: frame.shade,
        default_layout: frame.proper_layout && frame.defect == Defect::None,
        empty: buffer.n_memory() == 0,
    };
    stage.ledger.frame_sent(facts);
    if !matches!(frame.defect, Defect::None | Defect::EmptyGap) {
        stage.ledger.excuse(number);
        flow.tainted = true;
    }
    Some((number, buffer, frame.defect))
}

fn push_frame(stage: &Stage, flow: &mut Flow, rng: &mut ChaCha8Rng) {
    let Some((number, buffer, defect)) = next_frame(stage, flow, rng) else { return };
    stage.trace.step(format!("in {number} {defect:?} {:?} {:?}", buffer.pts(), buffer.flags()));
    let shared = rng.random_bool(0.2).then(|| (buffer.clone(), checksum(&buffer)));
    let before = stage.interruptions();
    let result = stage.upstream.push(buffer);
    judge(stage, flow, result, before);
    if let Some((buffer, sum)) = shared
        && checksum(&buffer) != sum
    {
        stage.ledger.fault(format!("frame {number}, which upstream still holds, was written to"));
    }
}

fn push_list(stage: &Stage, flow: &mut Flow, rng: &mut ChaCha8Rng) {
    let mut list = gst::BufferList::new();
    for _ in 0..rng.random_range(0..5) {
        if let Some((_, buffer, _)) = next_frame(stage, flow, rng) {
            list.make_mut().add(buffer);
        }
    }
    stage.trace.step(format!("in {} at once", list.len()));
    let before = stage.interruptions();
    let result = stage.upstream.push_list(list);
    if result.is_err() {
        // The rest of the list never reached the element.
        stage.ledger.excuse_waiting();
    }
    judge(stage, flow, result, before);
}

/// Whether there is a reason for what a push came back with.
fn judge(stage: &Stage, flow: &mut Flow, result: Result<gst::FlowSuccess, gst::FlowError>, before: u64) {
    let failed = stage.downstream_failed.swap(false, Ordering::SeqCst);
    let Err(error) = result else { return };
    stage.trace.step(format!("push came back with {error:?}"));
    // While pads are switched off one after another, an event that goes nowhere fails the push behind it.
    let disturbed = !stage.undisturbed(before);
    let explained = match error {
        gst::FlowError::Flushing => disturbed,
        gst::FlowError::NotNegotiated => stage.setup.downstream_is_choosy,
        gst::FlowError::Error => failed || flow.tainted || disturbed,
        _ => failed,
    };
    if !explained {
        stage.ledger.fault(format!("a push came back with {error:?}"));
    }
    if !(failed || disturbed) && error == gst::FlowError::Error && stage.take_errors().is_empty() {
        stage.ledger.fault("a push came back with an error of which nothing was posted");
    }
}

fn checksum(buffer: &gst::BufferRef) -> u64 {
    let map = buffer.map_readable();
    let bytes = map.as_ref().map_or(&[][..], |map| map.as_slice());
    bytes
        .iter()
        .fold(0xcbf2_9ce4_8422_2325, |hash, &byte| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3))
}
