// SPDX-License-Identifier: MIT OR Apache-2.0

//! What applications, sinks and editors do to an element while it works.

use super::setup::Setup;
use super::stage::Stage;
use gst::glib;
use gst::prelude::*;
use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;
use std::sync::LazyLock;

/// One disturbance, of any kind.
pub fn disturb(stage: &Stage, rng: &mut ChaCha8Rng) {
    match rng.random_range(0..30) {
        0 => {
            let start = rng.random_range(0..60_000_000_000);
            stage.trace.step(format!("seeks with a flush to {start}"));
            seek(stage, rng, gst::SeekFlags::FLUSH | gst::SeekFlags::ACCURATE, start);
        }
        1 => {
            let start = rng.random_range(0..60_000_000_000);
            stage.trace.step(format!("seeks without a flush to {start}"));
            seek(stage, rng, gst::SeekFlags::empty(), start);
        }
        2 => {
            let state = if rng.random() { gst::State::Ready } else { gst::State::Null };
            stage.trace.step(format!("stops: {state:?}"));
            stage.restart(state);
        }
        3 => {
            stage.trace.step("pauses");
            stage.pause(gst::State::Paused);
            stage.pause(gst::State::Playing);
        }
        4 => {
            stage.trace.step("flushes");
            stage.flush(rng.random_range(0..60_000_000_000));
        }
        5 => send_upstream(stage, gst::event::Reconfigure::new()),
        6 => send_upstream(
            stage,
            gst::event::Latency::new(gst::ClockTime::from_mseconds(rng.random_range(0..2000))),
        ),
        7 => {
            let structure =
                gst::Structure::builder("application/x-gst-navigation").field("event", "key-press");
            send_upstream(stage, gst::event::Navigation::new(structure.build()));
        }
        8 => send_upstream(stage, gst::event::CustomUpstream::new(gst::Structure::new_empty("unheard-of"))),
        9..12 => quality(stage, rng),
        12 => caps_queries(stage, rng),
        _ => call(stage, rng),
    }
}

/// What may be called at any time and from any thread, callbacks of the element among them.
pub fn call(stage: &Stage, rng: &mut ChaCha8Rng) {
    match rng.random_range(0..10) {
        0..5 => set_property(stage, rng),
        5 => {
            stage.trace.step("reads all properties");
            for spec in own_properties() {
                let _ = stage.element.property_value(spec.name());
            }
        }
        6..8 => latency(stage),
        8 => position(stage),
        _ => quality(stage, rng),
    }
}

fn seek(stage: &Stage, rng: &mut ChaCha8Rng, flags: gst::SeekFlags, start: u64) {
    let rate = *[1.0, 1.0, -1.0, 2.0].choose(rng).unwrap_or(&1.0);
    let start = gst::ClockTime::from_nseconds(start);
    let stop = start + gst::ClockTime::from_seconds(20);
    let event = gst::event::Seek::new(rate, flags, gst::SeekType::Set, start, gst::SeekType::Set, stop);
    stage.downstream.push_event(event);
}

fn send_upstream(stage: &Stage, event: gst::Event) {
    stage.trace.step(format!("sends {} upstream", event.type_().name()));
    stage.downstream.push_event(event);
}

/// A sink's judgement of its punctuality.
fn quality(stage: &Stage, rng: &mut ChaCha8Rng) {
    let kind = *[gst::QOSType::Underflow, gst::QOSType::Overflow, gst::QOSType::Throttle]
        .choose(rng)
        .unwrap_or(&gst::QOSType::Underflow);
    let timestamp = gst::ClockTime::from_nseconds(match rng.random_range(0..10) {
        0 => u64::MAX - 1,
        1 => 0,
        _ => rng.random_range(0..10_000_000_000),
    });
    let diff = match rng.random_range(0..10) {
        0 => i64::MAX,
        1 => 0,
        2 => 1,
        // GStreamer refuses a frame that was early by more than its time.
        3 => -(timestamp.nseconds().min(i64::MAX as u64) as i64),
        _ => rng.random_range(0..100_000_000),
    };
    let proportion = *[0.0, 0.5, 0.99, 1.0, 1.2, 3.0, f64::MAX].choose(rng).unwrap_or(&1.0);
    send_upstream(stage, gst::event::Qos::new(kind, proportion, diff, timestamp));
}

/// Asks for the latency; it must contain that of upstream.
fn latency(stage: &Stage) {
    stage.trace.step("asks for the latency");
    let Some(pad) = stage.element.static_pad("src") else { return };
    let mut query = gst::query::Latency::new();
    let answered = pad.query(query.query_mut());
    let (live, least, most) = query.result();
    match stage.setup.upstream_latency {
        // A stopped element may be asked, too.
        _ if !answered => (),
        None => stage.ledger.fault("latency told though upstream knows none"),
        Some((was_live, was_least, was_most)) => {
            let right = live == was_live
                && least.nseconds() >= was_least
                && most.is_none() == was_most.is_none()
                && most.is_none_or(|most| most >= least);
            if !right {
                stage.ledger.fault(format!(
                    "latency {live} {least} {most:?} on top of {was_live} {was_least} {was_most:?}"
                ));
            }
        }
    }
}

fn position(stage: &Stage) {
    stage.trace.step("asks for the position");
    if let Some(pad) = stage.element.static_pad("src") {
        let _ = pad.query_position::<gst::ClockTime>();
        let _ = pad.query_duration::<gst::ClockTime>();
    }
}

fn caps_queries(stage: &Stage, rng: &mut ChaCha8Rng) {
    stage.trace.step("asks for caps");
    let wanted = super::setup::caps(rng, &stage.setup, &stage.formats);
    for pad in ["sink", "src"].iter().filter_map(|name| stage.element.static_pad(name)) {
        let caps = pad.query_caps(rng.random_bool(0.5).then_some(&wanted));
        let template = pad.pad_template_caps();
        if !caps.is_subset(&template) {
            stage.ledger.fault(format!("{} offers {caps}", pad.name()));
        }
        let accepted = pad.query_accept_caps(&wanted);
        if accepted && !wanted.is_subset(&template) {
            stage.ledger.fault(format!("{} accepts {wanted}", pad.name()));
        }
    }
}

/// The element's own properties, and those of its base class that change what it does.
fn own_properties() -> &'static [glib::ParamSpec] {
    static SPECS: LazyLock<Vec<glib::ParamSpec>> = LazyLock::new(|| {
        let Ok(element) = gst::ElementFactory::make("rsrectify").build() else { return Vec::new() };
        let own = |spec: &glib::ParamSpec| spec.owner_type() == element.type_() || spec.name() == "qos";
        element.list_properties().iter().filter(|spec| own(spec)).cloned().collect()
    });
    &SPECS
}

/// Sets any property to any value that it can have.
pub fn set_property(stage: &Stage, rng: &mut ChaCha8Rng) {
    let writable = |spec: &&glib::ParamSpec| spec.flags().contains(glib::ParamFlags::WRITABLE);
    let specs: Vec<_> = own_properties().iter().filter(writable).collect();
    let Some(&spec) = specs.choose(rng) else { return };
    let Some(value) = random_value(spec, rng, &stage.setup) else { return };
    stage.trace.step(format!("sets {} to {value:?}", spec.name()));
    stage.element.set_property_from_value(spec.name(), &value);
}

fn random_value(spec: &glib::ParamSpec, rng: &mut ChaCha8Rng, setup: &Setup) -> Option<glib::Value> {
    if let Some(spec) = spec.downcast_ref::<glib::ParamSpecUInt>() {
        // What only costs time is kept small.
        let most = match spec.name() {
            "lookahead" => setup.lookahead,
            "threads" => 3,
            "grid-columns" | "grid-rows" => 24,
            _ => spec.maximum(),
        };
        return Some(rng.random_range(spec.minimum()..=most).to_value());
    }
    if let Some(spec) = spec.downcast_ref::<glib::ParamSpecUInt64>() {
        let values = [0, 1, 10_000_000, 30_000_000, spec.maximum()];
        return values.choose(rng).map(ToValue::to_value);
    }
    if let Some(spec) = spec.downcast_ref::<glib::ParamSpecInt64>() {
        return Some(rng.random_range(spec.minimum()..=spec.maximum()).to_value());
    }
    if let Some(spec) = spec.downcast_ref::<glib::ParamSpecDouble>() {
        let any = rng.random_range(spec.minimum()..=spec.maximum());
        return [spec.minimum(), spec.default_value(), spec.maximum(), any]
            .choose(rng)
            .map(ToValue::to_value);
    }
    if let Some(spec) = spec.downcast_ref::<glib::ParamSpecEnum>() {
        let class = spec.enum_class();
        let values = class.values();
        // A frame is filled with a colour of its own only where the pictures are not compared.
        let value = values.choose(rng).filter(|v| setup.paints_borders || v.nick() != "constant");
        return value.map(|value| value.to_value(&class));
    }
    spec.downcast_ref::<glib::ParamSpecBoolean>().map(|_| rng.random::<bool>().to_value())
}
