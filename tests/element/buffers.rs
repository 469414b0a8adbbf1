// SPDX-License-Identifier: MIT OR Apache-2.0

//! Buffers: allocation, metas, formats, strides, and those that are not what they claim.

use crate::common::*;
use crate::padded::{is_filled, padded};
use gst::prelude::*;
use gst_video::prelude::*;
use gst_video::{VideoFormat, VideoFrameRef, VideoInfo};

/// The formats promised to users.
const FORMATS: [&str; 64] = [
    "I420",
    "YV12",
    "NV12",
    "NV21",
    "NV16",
    "NV61",
    "NV24",
    "Y42B",
    "Y444",
    "Y41B",
    "YUV9",
    "YVU9",
    "A420",
    "GRAY8",
    "GRAY16_LE",
    "RGB",
    "BGR",
    "RGBx",
    "BGRx",
    "xRGB",
    "xBGR",
    "RGBA",
    "BGRA",
    "ARGB",
    "ABGR",
    "GBR",
    "GBRA",
    "RGBP",
    "BGRP",
    "AYUV",
    "VUYA",
    "v308",
    "IYU2",
    "YUY2",
    "UYVY",
    "YVYU",
    "VYUY",
    "I420_10LE",
    "P010_10LE",
    "I422_10LE",
    "Y444_10LE",
    "A420_10LE",
    "A422_10LE",
    "A444_10LE",
    "GBR_10LE",
    "GBRA_10LE",
    "Y210",
    "I420_12LE",
    "P012_LE",
    "I422_12LE",
    "Y444_12LE",
    "GBR_12LE",
    "GBRA_12LE",
    "Y212_LE",
    "Y412_LE",
    "P016_LE",
    "Y444_16LE",
    "v216",
    "AYUV64",
    "ARGB64",
    "ARGB64_LE",
    "RGBA64_LE",
    "BGRA64_LE",
    "ABGR64_LE",
];

#[test]
fn a_frame_that_does_not_move_is_the_buffer_that_came() {
    let mut h = harness(2, &numbered_caps());
    let frames: Vec<_> = (0..5).map(|_| flat(&numbered_caps(), 0)).collect();
    frames.iter().for_each(|frame| assert!(h.push(frame.clone()).is_ok()));
    h.push_event(gst::event::Eos::new());
    let same = arrived(&mut h).iter().zip(&frames).filter(|(a, b)| a.as_ptr() == b.as_ptr()).count();
    assert_eq!(same, 5);
}

#[test]
fn strength_zero_touches_nothing_and_keeps_the_latency() {
    let mut h = harness(2, &numbered_caps());
    h.element().unwrap().set_property("strength", 0.0);
    let frames: Vec<_> = (0..5).map(numbered).collect();
    frames.iter().for_each(|frame| assert!(h.push(frame.clone()).is_ok()));
    assert_eq!(h.buffers_received(), 3);
    h.push_event(gst::event::Eos::new());
    assert!(arrived(&mut h).iter().zip(&frames).all(|(a, b)| a.as_ptr() == b.as_ptr()));
}

#[test]
fn metas_are_kept_those_of_size_and_orientation_too() {
    let mut h = harness(1, &numbered_caps());
    warp_always(&h);
    for number in 0..3 {
        let mut frame = numbered(number);
        let inner = frame.get_mut().unwrap();
        gst_video::VideoRegionOfInterestMeta::add(inner, "face", (10, 20, 30, 40));
        gst_video::VideoAFDMeta::add(
            inner,
            0,
            gst_video::VideoAFDSpec::AtscA53,
            gst_video::VideoAFDValue::_43Full169Full,
        );
        gst::ReferenceTimestampMeta::add(
            inner,
            &gst::Caps::new_empty_simple("timestamp/x-unix"),
            time(number),
            gst::ClockTime::NONE,
        );
        h.push(frame).unwrap();
    }
    h.push_event(gst::event::Eos::new());
    for buffer in arrived(&mut h) {
        let region = buffer.meta::<gst_video::VideoRegionOfInterestMeta>().expect("region of interest");
        assert_eq!(region.rect(), (10, 20, 30, 40));
        assert!(buffer.meta::<gst_video::VideoAFDMeta>().is_some());
        assert_eq!(buffer.iter_meta::<gst::ReferenceTimestampMeta>().count(), 1);
    }
}

/// Minimum of the first pool proposed upstream, and whether strides of any kind are welcome.
fn proposed(lookahead: u32, caps: &gst::Caps) -> (u32, bool) {
    let h = harness(lookahead, caps);
    let mut query = gst::query::Allocation::new(Some(caps), true);
    assert!(h.element().unwrap().static_pad("sink").unwrap().query(query.query_mut()));
    let minimum = query.allocation_pools().map(|(_, _, min, _)| min).next().unwrap_or(0);
    (minimum, query.find_allocation_meta::<gst_video::VideoMeta>().is_some())
}

#[test]
fn upstream_is_asked_for_a_pool_that_survives_the_frames_held() {
    for lookahead in [0, 4, 64] {
        let (minimum, any_stride) = proposed(lookahead, &numbered_caps());
        assert!(minimum > lookahead, "{minimum}");
        assert!(any_stride);
    }
}

#[test]
fn the_pool_of_downstream_is_used() {
    init();
    let pool = gst_video::VideoBufferPool::new();
    let mut h = harness_before_caps();
    let offered = pool.clone();
    let sink = h.sinkpad().unwrap();
    sink.add_probe(gst::PadProbeType::QUERY_DOWNSTREAM, move |_, info| {
        if let Some(gst::QueryViewMut::Allocation(query)) = info.query_mut().map(|query| query.view_mut()) {
            query.add_allocation_pool(Some(&offered), SIZE.0 * SIZE.1, 3, 0);
            return gst::PadProbeReturn::Handled;
        }
        gst::PadProbeReturn::Ok
    });
    h.set_src_caps(numbered_caps());
    warp_always(&h);
    (0..6).for_each(|number| assert!(h.push(numbered(number)).is_ok()));
    assert!(pool.is_active());
    let (caps, _, minimum, _) = pool.config().params().unwrap();
    assert_eq!((caps, minimum), (Some(numbered_caps()), 3));
}

fn harness_before_caps() -> gst_check::Harness {
    gst_check::Harness::new("rsrectify")
}

/// A byte that makes a valid sample of the format when all its bytes are so.
fn grey(info: &VideoInfo) -> u8 {
    match (info.comp_depth(0), info.format_info().shift()[0]) {
        (8 | 16, _) => 0x47,
        (10, _) if info.format() == VideoFormat::Y210 => 0x40,
        (_, 0) => 0x02,
        _ => 0x40,
    }
}

#[test]
fn every_format_in_every_size_with_any_stride() {
    for format in FORMATS {
        for (width, height) in [(1, 1), (2, 1), (1, 3), (3, 2), (5, 7), (33, 17), (64, 48)] {
            let caps = caps(format, width, height, gst::Fraction::new(30, 1));
            let info = VideoInfo::from_caps(&caps).unwrap();
            for pad in [0, 6, 64] {
                let value = grey(&info);
                let mut h = harness(1, &caps);
                warp_always(&h);
                for number in 0..3 {
                    let mut frame = padded(&info, pad, value);
                    frame.get_mut().unwrap().set_pts(time(number));
                    h.push(frame).unwrap();
                }
                h.push_event(gst::event::Eos::new());
                let out = arrived(&mut h);
                assert_eq!(out.len(), 3, "{format} {width}x{height}");
                for buffer in out {
                    assert!(
                        is_filled(&buffer, &info, value),
                        "{format} {width}x{height}, {pad} bytes of padding"
                    );
                }
            }
        }
    }
}

#[test]
fn other_formats_are_not_taken() {
    init();
    let element = gst::ElementFactory::make("rsrectify").build().unwrap();
    let sink = element.static_pad("sink").unwrap();
    for format in FORMATS {
        assert!(sink.query_accept_caps(&caps(format, 8, 8, gst::Fraction::new(30, 1))), "{format}");
    }
    for format in
        ["GRAY16_BE", "I420_10BE", "v210", "Y410", "RGB10A2_LE", "RGB16", "IYU1", "NV12_64Z32", "RGB8P"]
    {
        assert!(!sink.query_accept_caps(&caps(format, 8, 8, gst::Fraction::new(30, 1))), "{format}");
    }
    for (width, height) in [(32_769, 8), (8, 32_769), (i32::MAX as u32, 1)] {
        let huge = caps("GRAY8", width, height, gst::Fraction::new(30, 1));
        assert!(!sink.query_accept_caps(&huge), "{huge}");
    }
    let gl =
        caps("RGBA", 8, 8, gst::Fraction::new(30, 1)).to_string().replace("raw,", "raw(memory:GLMemory),");
    assert!(!sink.query_accept_caps(&gl.parse().unwrap()));
}

#[test]
fn colorimetry_and_the_like_go_on_unchanged() {
    let caps: gst::Caps = "video/x-raw,format=I420,width=64,height=48,framerate=30/1,chroma-site=jpeg,\
        colorimetry=bt709,pixel-aspect-ratio=4/3,max-cll=(string)\"1000:400\""
        .parse()
        .unwrap_or_else(|_| unreachable!());
    let mut h = harness(0, &caps);
    h.push(flat(&caps, 0)).unwrap();
    assert_eq!(h.element().unwrap().static_pad("src").unwrap().current_caps(), Some(caps));
}

#[test]
fn a_buffer_that_is_too_small_is_an_error_not_a_panic() {
    let caps = numbered_caps();
    let claims_more = {
        let mut buffer = gst::Buffer::from_mut_slice(vec![0u8; 1000]);
        let inner = buffer.get_mut().unwrap();
        let flags = gst_video::VideoFrameFlags::empty();
        gst_video::VideoMeta::add(inner, flags, VideoFormat::Gray8, SIZE.0, SIZE.1).ok();
        buffer
    };
    for bad in [gst::Buffer::from_mut_slice(vec![0u8; 1000]), gst::Buffer::new(), claims_more] {
        let mut h = harness(1, &caps);
        let bus = bus(&h);
        h.push(numbered(0)).unwrap();
        assert_eq!(h.push(bad), Err(gst::FlowError::Error));
        let errors = messages(&bus, gst::MessageType::Error);
        assert_eq!(errors.len(), 1);
        let gst::MessageView::Error(error) = errors[0].view() else { unreachable!() };
        assert!(error.error().is::<gst::StreamError>(), "{error:?}");
    }
}

#[test]
fn what_is_not_one_exposure_a_frame_passes_with_one_warning() {
    init();
    for (feature, field) in [
        ("", "interlace-mode=interleaved"),
        ("", "interlace-mode=mixed"),
        ("(format:Interlaced)", "interlace-mode=alternate"),
        ("", "multiview-mode=side-by-side"),
    ] {
        let size = "width=320,height=240,framerate=30/1";
        let caps: gst::Caps = format!("video/x-raw{feature},format=GRAY8,{size},{field}").parse().unwrap();
        let mut h = harness_before_caps();
        let bus = bus(&h);
        warp_always(&h);
        h.set_src_caps(caps);
        let frames: Vec<_> = (0..5).map(numbered).collect();
        for (number, frame) in frames.iter().enumerate() {
            h.push(frame.clone()).unwrap();
            assert_eq!(h.buffers_received() as usize, number + 1, "{field}");
        }
        assert!(arrived(&mut h).iter().zip(&frames).all(|(a, b)| a.as_ptr() == b.as_ptr()));
        assert_eq!(messages(&bus, gst::MessageType::Warning).len(), 1, "{field}");
        assert_eq!(h.query_latency(), Some(gst::ClockTime::ZERO));
        // Progressive frames after them are rectified again.
        h.push_event(gst::event::Caps::new(&numbered_caps()));
        h.push(numbered(5)).unwrap();
        assert_eq!(h.buffers_received(), 5);
        assert!(h.query_latency() > Some(gst::ClockTime::ZERO));
    }
}

/// Makes the sink answer allocation queries, offering `GstVideoMeta` or not.
fn answer_allocation(h: &gst_check::Harness, reads_strides: bool) {
    h.sinkpad().unwrap().add_probe(gst::PadProbeType::QUERY_DOWNSTREAM, move |_, info| {
        if let Some(gst::QueryViewMut::Allocation(query)) = info.query_mut().map(|query| query.view_mut()) {
            if reads_strides {
                query.add_allocation_meta::<gst_video::VideoMeta>(None);
            }
            return gst::PadProbeReturn::Handled;
        }
        gst::PadProbeReturn::Ok
    });
}

#[test]
fn a_sink_that_reads_no_strides_gets_packed_rows() {
    let caps = caps("I420", 322, 242, gst::Fraction::new(30, 1));
    let info = VideoInfo::from_caps(&caps).unwrap();
    for (reads_strides, strength) in [(false, 1.0), (false, 0.0), (true, 1.0)] {
        let mut h = harness_before_caps();
        answer_allocation(&h, reads_strides);
        h.set_src_caps(caps.clone());
        h.element().unwrap().set_property("strength", strength);
        let frames: Vec<_> = (0..9).map(|number| timed(padded(&info, 30, 77), number)).collect();
        frames.iter().for_each(|frame| assert!(h.push(frame.clone()).is_ok()));
        h.push_event(gst::event::Eos::new());
        let out = arrived(&mut h);
        assert_eq!(numbers(&out), (0..9).collect::<Vec<_>>());
        for (input, output) in frames.iter().zip(&out) {
            if reads_strides {
                assert_eq!(input.as_ptr(), output.as_ptr());
            } else {
                let map = output.map_readable().unwrap();
                assert_eq!(map.len(), info.size());
                let frame = VideoFrameRef::from_buffer_ref_readable(output, &info).unwrap();
                for plane in 0..3 {
                    let (width, height) = (info.comp_width(plane as u8), info.comp_height(plane as u8));
                    let (data, stride) =
                        (frame.plane_data(plane).unwrap(), frame.plane_stride()[plane as usize]);
                    let rows = data.chunks(stride as usize).take(height as usize);
                    assert!(rows.flat_map(|row| &row[..width as usize]).all(|&sample| sample == 77));
                }
                assert_eq!((output.pts(), output.duration()), (input.pts(), input.duration()));
            }
        }
    }
}

fn timed(mut buffer: gst::Buffer, number: usize) -> gst::Buffer {
    buffer.get_mut().unwrap().set_pts(time(number));
    buffer.get_mut().unwrap().set_duration(FRAME);
    buffer
}

#[test]
fn a_file_of_raw_frames_is_what_identity_writes() {
    init();
    let written = |element: &str, width: usize| {
        let name = format!("rsrectify-{}-raw-{element}-{width}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let pipeline = gst::parse::launch(&format!(
            "videotestsrc pattern=black num-buffers=20 ! video/x-raw,format=I420,width={width},height=242 ! x264enc \
             ! avdec_h264 ! {element} ! filesink location={}",
            path.display()
        ));
        let pipeline = pipeline.unwrap().downcast::<gst::Pipeline>().unwrap();
        run_to_eos(&pipeline);
        pipeline.set_state(gst::State::Null).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        bytes
    };
    // Rows of 328 bytes need no padding, those of 322 are padded: by a decoder with whatever was there.
    assert!(written("rsrectify", 328) == written("identity", 328));
    let padded = written("rsrectify", 322);
    assert_eq!(padded.len(), written("identity", 322).len());
    assert!(padded.chunks(324).take(242).all(|row| row[322..] == [0, 0]));
}

#[test]
fn a_pool_that_cannot_grow_is_not_emptied() {
    let caps = numbered_caps();
    let info = VideoInfo::from_caps(&caps).unwrap();
    for (buffers, lookahead) in [(1, 0), (2, 4), (4, 4), (6, 8), (8, 64), (3, 1)] {
        let pool = gst_video::VideoBufferPool::new();
        let mut config = pool.config();
        config.set_params(Some(&caps), info.size() as u32, buffers, buffers);
        pool.set_config(config).unwrap();
        pool.set_active(true).unwrap();
        let mut h = harness(lookahead, &caps);
        for number in 0..30 {
            let params = gst::BufferPoolAcquireParams::with_flags(gst::BufferPoolAcquireFlags::DONTWAIT);
            let buffer = pool.acquire_buffer(Some(&params));
            let mut buffer =
                buffer.unwrap_or_else(|_| panic!("{buffers} buffers, lookahead {lookahead}: none free"));
            let inner = buffer.get_mut().unwrap();
            inner.set_pts(time(number));
            inner.map_writable().unwrap().copy_from_slice(&numbered_pixels(number));
            gst_video::VideoAFDMeta::add(
                inner,
                0,
                gst_video::VideoAFDSpec::AtscA53,
                gst_video::VideoAFDValue::_43Full169Full,
            );
            h.push(buffer).unwrap();
            for buffer in arrived(&mut h) {
                let shown = number_of(&buffer.map_readable().unwrap(), SIZE.0 as usize);
                assert_eq!(vec![shown], numbers(std::slice::from_ref(&buffer)));
                assert!(buffer.meta::<gst_video::VideoAFDMeta>().is_some());
            }
        }
        h.push_event(gst::event::Eos::new());
        assert_eq!(h.buffers_received(), 30);
    }
}

#[test]
fn a_buffer_without_a_picture_keeps_its_place() {
    let mut h = harness(2, &numbered_caps());
    for number in 0..12 {
        let frame = if number % 3 == 1 {
            let mut gap = timed(gst::Buffer::new(), number);
            gap.get_mut().unwrap().set_flags(gst::BufferFlags::GAP | gst::BufferFlags::DROPPABLE);
            gap
        } else {
            numbered(number)
        };
        h.push(frame).unwrap();
    }
    h.push_event(gst::event::Eos::new());
    let out = arrived(&mut h);
    assert_eq!(numbers(&out), (0..12).collect::<Vec<_>>());
    let empty: Vec<_> = (0..12).filter(|&number| out[number].size() == 0).collect();
    assert_eq!(empty, [1, 4, 7, 10]);
}

#[test]
fn each_frame_brings_its_motion_along() {
    init();
    let pipeline = gst::parse::launch(
        "videotestsrc num-buffers=8 pattern=smpte ! video/x-raw,format=I420,width=160,height=120 \
         ! rsrectify attach-meta=true readout-time=20000000 ! tee ! queue ! videoconvert ! video/x-raw,format=RGB \
         ! videoscale ! video/x-raw,width=80,height=60 ! appsink name=sink sync=false",
    );
    let pipeline = pipeline.unwrap().downcast::<gst::Pipeline>().unwrap();
    let sink = pipeline.by_name("sink").unwrap().downcast::<gst_app::AppSink>().unwrap();
    pipeline.set_state(gst::State::Playing).unwrap();
    for _ in 0..8 {
        let sample = sink.pull_sample().unwrap();
        let meta = gst::meta::CustomMeta::from_buffer(sample.buffer().unwrap(), "RsRectifyMeta").unwrap();
        let motion = meta.structure();
        assert_eq!(motion.get::<u64>("readout-time").unwrap(), 20_000_000);
        assert_eq!(motion.get::<f64>("readout-deviation").unwrap(), 0.0);
        assert!(motion.get::<f64>("applied").unwrap() <= motion.get::<f64>("confidence").unwrap().max(1.0));
        for field in ["omega", "vx", "vy", "residual"] {
            assert!(motion.get::<f64>(field).unwrap().is_finite(), "{field}");
        }
    }
    pipeline.set_state(gst::State::Null).unwrap();
}
