// SPDX-License-Identifier: MIT OR Apache-2.0

//! Streams and settings that nobody should make, and somebody will.

use crate::common::*;
use gst::prelude::*;
use gst_check::Harness;
use std::sync::atomic::{AtomicBool, Ordering};

/// Pushes frames with these timestamps and ends the stream; how many came out.
fn played(h: &mut Harness, caps: &gst::Caps, times: &[Option<u64>], discont: bool) -> usize {
    for (number, pts) in times.iter().enumerate() {
        let mut frame = speckled(caps, number);
        let inner = frame.get_mut().unwrap();
        inner.set_pts(pts.map(gst::ClockTime::from_nseconds));
        if discont {
            inner.set_flags(gst::BufferFlags::DISCONT);
        }
        h.push(frame).unwrap();
    }
    h.push_event(gst::event::Eos::new());
    arrived(h).len()
}

#[test]
fn every_property_at_its_extremes() {
    let caps = numbered_caps();
    let element = gst::ElementFactory::make("rsrectify").build().unwrap();
    let own = element.list_properties();
    let own = own.iter().filter(|spec| spec.owner_type() == element.type_());
    let mut tried = 0;
    for spec in own.filter(|spec| spec.flags().contains(gst::glib::ParamFlags::WRITABLE)) {
        for value in extremes(spec) {
            let mut h = harness(2, &caps);
            let bus = bus(&h);
            h.element().unwrap().set_property_from_value(spec.name(), &value);
            // `grid` and `lookahead` take effect with caps.
            h.set_src_caps(caps.clone());
            let times: Vec<_> = (0..6).map(|number| Some(time(number).nseconds())).collect();
            assert_eq!(played(&mut h, &caps, &times, false), 6, "{} = {value:?}", spec.name());
            assert!(messages(&bus, gst::MessageType::Error).is_empty());
            tried += 1;
        }
    }
    assert!(tried > 25, "{tried}");
}

/// The values at both ends of a property's range; all values of an enumeration.
fn extremes(spec: &gst::glib::ParamSpec) -> Vec<gst::glib::Value> {
    use gst::glib::*;
    if let Some(spec) = spec.downcast_ref::<ParamSpecUInt>() {
        return vec![spec.minimum().to_value(), spec.maximum().to_value()];
    }
    if let Some(spec) = spec.downcast_ref::<ParamSpecUInt64>() {
        return vec![1u64.to_value(), spec.maximum().to_value()];
    }
    if let Some(spec) = spec.downcast_ref::<ParamSpecDouble>() {
        return vec![spec.minimum().to_value(), 0.0f64.to_value(), spec.maximum().to_value()];
    }
    if let Some(spec) = spec.downcast_ref::<ParamSpecEnum>() {
        let class = spec.enum_class();
        return class.values().iter().map(|value| value.to_value(&class)).collect();
    }
    vec![true.to_value()]
}

#[test]
fn any_timestamps() {
    let ms = 1_000_000;
    let streams: [&[Option<u64>]; 8] = [
        &[None; 8],
        &[Some(5 * ms); 8],
        &[Some(300 * ms), Some(260 * ms), Some(220 * ms), Some(180 * ms), Some(140 * ms), Some(100 * ms)],
        &[Some(0), Some(10_000_000 * ms), Some(0), Some(33 * ms), Some(7), Some(u64::MAX - 1)],
        &[Some(u64::MAX - 1), Some(0), Some(u64::MAX - 2), Some(1), Some(u64::MAX / 2), Some(3)],
        &[Some(0), None, None, Some(100 * ms), None, Some(20 * ms)],
        &[Some(0), Some(1), Some(2), Some(3), Some(4), Some(5)],
        &[Some(0), Some(17 * ms), Some(50 * ms), Some(55 * ms), Some(200 * ms), Some(201 * ms)],
    ];
    for fps in [(30, 1), (0, 1), (1, i32::MAX), (i32::MAX, 1)] {
        let caps = caps("NV12", 320, 240, gst::Fraction::new(fps.0, fps.1));
        for times in streams {
            for (lookahead, discont) in [(0, false), (3, false), (3, true), (64, false)] {
                let mut h = harness(lookahead, &caps);
                let bus = bus(&h);
                let count = played(&mut h, &caps, times, discont);
                let errors = messages(&bus, gst::MessageType::Error);
                assert!(errors.is_empty(), "{fps:?} {times:?}: {errors:?}");
                assert_eq!(count, times.len(), "{fps:?} {times:?} {lookahead} {discont}");
            }
        }
    }
}

#[test]
fn an_upstream_of_any_latency() {
    let mut h = harness(4, &numbered_caps());
    for latency in [gst::ClockTime::ZERO, gst::ClockTime::from_nseconds(u64::MAX - 1)] {
        h.set_upstream_latency(latency);
        assert!(h.query_latency().is_some(), "{latency}");
    }
}

#[test]
fn moving_pictures_of_odd_sizes() {
    for (width, height) in [(1, 1), (3, 2), (16, 16), (17, 33), (8, 2000), (2000, 8), (1, 500), (500, 1)] {
        for format in ["I420", "YUY2", "P010_10LE", "RGB"] {
            let caps = caps(format, width, height, gst::Fraction::new(30, 1));
            for border in ["mirror", "constant", "crop"] {
                let mut h = harness(2, &caps);
                let bus = bus(&h);
                h.element().unwrap().set_property_from_str("border-mode", border);
                let times: Vec<_> = (0..5).map(|number| Some(time(number).nseconds())).collect();
                let count = played(&mut h, &caps, &times, false);
                assert_eq!(count, 5, "{format} {width}x{height}");
                assert!(messages(&bus, gst::MessageType::Error).is_empty(), "{format} {width}x{height}");
            }
        }
    }
}

#[test]
fn other_caps_with_each_frame() {
    let all: Vec<_> = [("I420", 64, 48), ("NV12", 65, 49), ("RGB", 320, 240), ("GRAY8", 1, 1)]
        .map(|(format, width, height)| caps(format, width, height, gst::Fraction::new(25, 1)))
        .into();
    let mut h = harness(4, &all[0]);
    for number in 0..80 {
        let caps = &all[number % all.len()];
        h.push_event(gst::event::Caps::new(caps));
        h.push(speckled(caps, number)).unwrap();
    }
    h.push_event(gst::event::Eos::new());
    let sizes: Vec<_> = arrived(&mut h).iter().map(|buffer| buffer.size()).collect();
    let size = |number: usize| gst_video::VideoInfo::from_caps(&all[number % all.len()]).unwrap().size();
    assert_eq!(sizes, (0..80).map(size).collect::<Vec<_>>());
}

#[test]
fn settings_change_while_frames_flow() {
    let caps = numbered_caps();
    let mut h = harness(3, &caps);
    let element = h.element().unwrap();
    let bus = bus(&h);
    let done = AtomicBool::new(false);
    let count = std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut round = 0u32;
            while !done.load(Ordering::Relaxed) {
                round += 1;
                element.set_property("threads", round % 4);
                element.set_property("readout-time", u64::from(round % 3) * 10_000_000);
                element.set_property("lookahead", round % 65);
                element.set_property("grid-columns", 2 + round % 60);
                element.set_property("strength", f64::from(round % 5) / 4.0);
                element.set_property_from_str("border-mode", ["replicate", "crop"][round as usize % 2]);
                element.set_property_from_str(
                    "readout-direction",
                    ["auto", "left-to-right"][round as usize % 2],
                );
                let _ = element.property::<gst::Structure>("stats");
                std::thread::yield_now();
            }
        });
        let times: Vec<_> = (0..60).map(|number| Some(time(number).nseconds())).collect();
        let count = played(&mut h, &caps, &times, false);
        done.store(true, Ordering::Relaxed);
        count
    });
    assert_eq!(count, 60);
    assert!(messages(&bus, gst::MessageType::Error).is_empty());
}

#[test]
fn any_quality_of_service() {
    let mut h = harness(0, &numbered_caps());
    warp_always(&h);
    let far = gst::ClockTime::from_nseconds(u64::MAX - 1);
    let mut number = 0;
    for diff in [i64::MIN, -1, 0, 1, i64::MAX] {
        for timestamp in [gst::ClockTime::ZERO, time(3), far] {
            for proportion in [0.0, f64::MAX] {
                // A sink may be early by no more than the time itself: GStreamer refuses the rest.
                if diff >= 0 || diff.unsigned_abs() <= timestamp.nseconds() {
                    let kind = gst::QOSType::Underflow;
                    h.push_upstream_event(gst::event::Qos::new(kind, proportion, diff, timestamp));
                }
                h.push(speckled(&numbered_caps(), number)).unwrap();
                number += 1;
            }
        }
    }
    assert_eq!(arrived(&mut h).len(), number);
}

#[test]
fn a_renegotiation_loses_no_frame() {
    let mut h = harness(4, &numbered_caps());
    warp_always(&h);
    for number in 0..20 {
        if number % 3 == 1 {
            h.push_upstream_event(gst::event::Reconfigure::new());
        }
        h.push(numbered(number)).unwrap();
    }
    h.push_event(gst::event::Eos::new());
    assert_eq!(numbers(&arrived(&mut h)), (0..20).collect::<Vec<_>>());
}

#[test]
fn segments_of_other_formats() {
    for format in [gst::Format::Bytes, gst::Format::Default] {
        let mut h = harness(2, &numbered_caps());
        h.element().unwrap().set_property("post-messages", true);
        let mut segment = gst::Segment::new();
        segment.set_format(format);
        h.push_event(gst::event::Segment::new(&segment));
        let times: Vec<_> = (0..6).map(|number| Some(time(number).nseconds())).collect();
        assert_eq!(played(&mut h, &numbered_caps(), &times, false), 6, "{format:?}");
    }
}

#[test]
fn a_stream_that_starts_again_after_its_end() {
    let mut h = harness(4, &numbered_caps());
    for round in 0..3 {
        h.push_event(gst::event::StreamStart::new(&format!("stream {round}")));
        h.push_event(gst::event::Caps::new(&numbered_caps()));
        h.push_event(gst::event::Segment::new(&gst::FormattedSegment::<gst::ClockTime>::new()));
        let times: Vec<_> = (0..6).map(|number| Some(time(number).nseconds())).collect();
        assert_eq!(played(&mut h, &numbered_caps(), &times, false), 6);
        assert!(
            h.push_event(gst::event::FlushStart::new()) && h.push_event(gst::event::FlushStop::new(true))
        );
    }
}

#[test]
fn metas_that_claim_another_frame() {
    let formats = [("I420", 320, 240), ("I420", 320, 4000), ("YUY2", 320, 240), ("RGB", 320, 240)];
    for (format, width, height) in formats {
        let caps = caps("I420", 320, 240, gst::Fraction::new(30, 1));
        let mut h = harness(1, &caps);
        warp_always(&h);
        for number in 0..3 {
            let mut frame = speckled(&caps, number);
            let format = gst_video::VideoFormat::from_string(format);
            let flags = gst_video::VideoFrameFlags::empty();
            let inner = frame.get_mut().unwrap();
            // What GStreamer itself refuses to attach is no danger.
            gst_video::VideoMeta::add(inner, flags, format, width, height).ok();
            let pushed = h.push(frame);
            assert!(matches!(pushed, Ok(_) | Err(gst::FlowError::Error)), "{format:?} {width}x{height}");
        }
    }
}

#[test]
fn a_frame_cut_off_in_its_last_plane_costs_no_other() {
    let caps = caps("I420", 64, 48, gst::Fraction::new(30, 1));
    let info = gst_video::VideoInfo::from_caps(&caps).unwrap();
    let rows = (info.offset().to_vec(), info.stride().to_vec());
    for lookahead in [0, 4] {
        let mut h = harness(lookahead, &caps);
        warp_always(&h);
        for number in 0..6 {
            let mut frame = speckled(&caps, number);
            if number == 3 {
                let bytes = frame.map_readable().unwrap()[..info.size() - 100].to_vec();
                frame = gst::Buffer::from_mut_slice(bytes);
                let inner = frame.get_mut().unwrap();
                inner.set_pts(time(number));
                let (flags, format) = (gst_video::VideoFrameFlags::empty(), info.format());
                // GStreamer itself checks the first plane only.
                gst_video::VideoMeta::add_full(inner, flags, format, 64, 48, &rows.0, &rows.1).ok();
            }
            let pushed = h.push(frame);
            assert_eq!(pushed.is_ok(), number != 3, "lookahead {lookahead}, frame {number}");
        }
        h.push_event(gst::event::Eos::new());
        assert_eq!(numbers(&arrived(&mut h)), [0, 1, 2, 4, 5], "lookahead {lookahead}");
    }
}

#[test]
fn a_plane_in_two_memories_is_read_as_far_as_it_is_mapped() {
    let caps = caps("NV12", 64, 48, gst::Fraction::new(30, 1));
    let info = gst_video::VideoInfo::from_caps(&caps).unwrap();
    // GStreamer joins the memories of a buffer without a meta, and maps each plane of one with a meta from
    // the memory that it begins in.
    let tries =
        [(1000, false, true), (info.offset()[1], true, true), (1000, true, false), (4000, true, false)];
    for (split, with_meta, is_whole) in tries {
        let mut h = harness(0, &caps);
        warp_always(&h);
        let bytes = speckled(&caps, 0).map_readable().unwrap().to_vec();
        let mut frame = gst::Buffer::new();
        for part in [&bytes[..split], &bytes[split..]] {
            frame.get_mut().unwrap().append_memory(gst::Memory::from_mut_slice(part.to_vec()));
        }
        frame.get_mut().unwrap().set_pts(time(0));
        if with_meta {
            let (format, flags) = (gst_video::VideoFormat::Nv12, gst_video::VideoFrameFlags::empty());
            gst_video::VideoMeta::add(frame.get_mut().unwrap(), flags, format, 64, 48).unwrap();
        }
        let expected = if is_whole { Ok(gst::FlowSuccess::Ok) } else { Err(gst::FlowError::Error) };
        assert_eq!(h.push(frame), expected, "split at {split}, meta {with_meta}");
    }
}

#[test]
fn padding_is_taken_out_of_every_format_and_nothing_else() {
    use gst_video::prelude::*;
    for format in ["UYVY", "YUY2", "NV12", "I420", "NV21", "RGB", "GRAY8", "P010_10LE", "AYUV", "Y42B"] {
        for (width, height) in [(1, 1), (1, 2), (5, 2), (7, 5), (33, 17)] {
            let caps = caps(format, width, height, gst::Fraction::new(30, 1));
            let info = gst_video::VideoInfo::from_caps(&caps).unwrap();
            // The planes of a packed frame, each row longer by 8 bytes.
            let packed = speckled(&caps, 3).map_readable().unwrap().to_vec();
            let (mut bytes, mut offsets, mut strides) = (Vec::new(), Vec::new(), Vec::new());
            for plane in 0..info.n_planes() as usize {
                let (from, stride) = (info.offset()[plane], info.stride()[plane] as usize);
                let to = info.offset().get(plane + 1).copied().unwrap_or(info.size());
                offsets.push(bytes.len());
                strides.push(stride as i32 + 8);
                for row in packed[from..to].chunks(stride) {
                    bytes.extend_from_slice(row);
                    bytes.extend_from_slice(&[0xee; 8]);
                }
            }
            let mut frame = gst::Buffer::from_mut_slice(bytes);
            let flags = gst_video::VideoFrameFlags::empty();
            let inner = frame.get_mut().unwrap();
            inner.set_pts(time(0));
            gst_video::VideoMeta::add_full(inner, flags, info.format(), width, height, &offsets, &strides)
                .unwrap();
            // A sink that does not understand the meta gets each sample that it would get without padding.
            let mut h = harness(0, &caps);
            h.element().unwrap().set_property("strength", 0.0);
            h.push(frame).unwrap();
            let out = h.pull().unwrap();
            assert_eq!(out.size(), info.size(), "{format} {width}x{height}");
            let seen = gst_video::VideoFrameRef::from_buffer_ref_readable(&out, &info).unwrap();
            for component in 0..info.n_components() as u8 {
                let plane = info.comp_plane(component);
                for row in 0..info.comp_height(component) as usize {
                    for column in 0..info.comp_width(component) as usize {
                        let at = row * info.stride()[plane as usize] as usize
                            + info.comp_poffset(component) as usize
                            + column * info.comp_pstride(component) as usize;
                        let wanted = packed[info.offset()[plane as usize] + at];
                        assert_eq!(seen.plane_data(plane).unwrap()[at], wanted, "{format} {width}x{height}");
                    }
                }
            }
        }
    }
}

/// Frames without an end into the element, to be disturbed.
fn endless(filter: &str) -> gst::Pipeline {
    film::launch(&format!(
        "videotestsrc pattern=ball animation-mode=frames ! video/x-raw,width=320,height=240,framerate=30/1 \
         ! {filter} ! fakesink name=sink sync=false"
    ))
}

#[test]
fn a_storm_of_seeks_from_two_threads() {
    let pipeline = endless("rsrectify lookahead=8");
    pipeline.set_state(gst::State::Playing).unwrap();
    assert!(pipeline.state(gst::ClockTime::from_seconds(30)).0.is_ok());
    std::thread::scope(|scope| {
        for thread in 0..2 {
            let pipeline = &pipeline;
            scope.spawn(move || {
                for round in 0..40 {
                    let target = gst::ClockTime::from_mseconds((round * 977 + thread * 313) % 9000);
                    let _ = pipeline.seek_simple(gst::SeekFlags::FLUSH | gst::SeekFlags::ACCURATE, target);
                }
            });
        }
    });
    assert!(pipeline.state(gst::ClockTime::from_seconds(30)).0.is_ok(), "the pipeline hangs");
    let bus = pipeline.bus().unwrap();
    assert!(bus.pop_filtered(&[gst::MessageType::Error]).is_none());
    pipeline.set_state(gst::State::Null).unwrap();
}

#[test]
fn a_storm_of_states_from_three_threads() {
    let pipeline = endless("rsrectify lookahead=8");
    let states =
        [gst::State::Playing, gst::State::Paused, gst::State::Ready, gst::State::Playing, gst::State::Null];
    std::thread::scope(|scope| {
        for thread in 0..3 {
            let pipeline = &pipeline;
            scope.spawn(move || {
                for round in 0..30 {
                    let _ = pipeline.set_state(states[(round * (thread + 1) + thread) % states.len()]);
                }
            });
        }
    });
    pipeline.set_state(gst::State::Null).unwrap();
    pipeline.bus().unwrap().set_flushing(true);
    pipeline.bus().unwrap().set_flushing(false);
    pipeline.set_state(gst::State::Playing).unwrap();
    assert!(pipeline.state(gst::ClockTime::from_seconds(30)).0.is_ok(), "the pipeline hangs");
    assert!(pipeline.bus().unwrap().pop_filtered(&[gst::MessageType::Error]).is_none());
    pipeline.set_state(gst::State::Null).unwrap();
}
