//! Buffers: allocation, metas, formats, strides, and those that are not what they claim.

mod common;

use common::*;
use gst::prelude::*;
use gst_video::prelude::*;
use gst_video::{VideoFormat, VideoFrameRef, VideoInfo};

/// The formats promised to users.
const FORMATS: [&str; 28] = [
    "I420",
    "YV12",
    "NV12",
    "NV21",
    "NV16",
    "Y42B",
    "Y444",
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
    "AYUV",
    "YUY2",
    "UYVY",
    "I420_10LE",
    "P010_10LE",
    "I422_10LE",
    "Y444_10LE",
    "I420_12LE",
    "VUYA",
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

/// A buffer whose rows are `pad` bytes longer than they need be; all samples are `value`, and the
/// padding is not.
fn padded(info: &VideoInfo, pad: usize, value: u8) -> gst::Buffer {
    let heights = |plane: usize| (0..info.n_components() as u8).find(|&c| info.comp_plane(c) == plane as u32);
    let mut offsets = Vec::new();
    let mut strides = Vec::new();
    let mut size = pad;
    for plane in 0..info.n_planes() as usize {
        let stride = info.stride()[plane] + pad as i32;
        offsets.push(size);
        strides.push(stride);
        size += stride as usize * info.comp_height(heights(plane).unwrap()) as usize;
    }
    let mut buffer = gst::Buffer::from_mut_slice(vec![value ^ 0xff; size]);
    gst_video::VideoMeta::add_full(
        buffer.get_mut().unwrap(),
        gst_video::VideoFrameFlags::empty(),
        info.format(),
        info.width(),
        info.height(),
        &offsets,
        &strides,
    )
    .unwrap();
    fill(&mut buffer, info, value);
    buffer
}

/// Sets every byte of every pixel.
fn fill(buffer: &mut gst::Buffer, info: &VideoInfo, value: u8) {
    let mut frame = VideoFrameRef::from_buffer_ref_writable(buffer.get_mut().unwrap(), info).unwrap();
    for component in 0..info.n_components() as u8 {
        for (row, bytes) in component_rows(info, component) {
            let start = row * frame.plane_stride()[info.comp_plane(component) as usize] as usize;
            let data = frame.plane_data_mut(info.comp_plane(component)).unwrap();
            bytes.for_each(|byte| data[start + byte] = value);
        }
    }
}

/// The bytes of a component's samples, row by row, from the row's start.
fn component_rows(
    info: &VideoInfo,
    component: u8,
) -> impl Iterator<Item = (usize, impl Iterator<Item = usize> + use<>)> + use<> {
    let bytes = info.comp_depth(component).div_ceil(8) as usize;
    let (offset, step) = (info.comp_poffset(component) as usize, info.comp_pstride(component) as usize);
    let (width, height) = (info.comp_width(component) as usize, info.comp_height(component) as usize);
    (0..height)
        .map(move |row| (row, (0..width).flat_map(move |x| (0..bytes).map(move |b| offset + x * step + b))))
}

/// Whether every sample of a frame is `value` in all its bytes.
fn is_filled(buffer: &gst::BufferRef, info: &VideoInfo, value: u8) -> bool {
    let frame = VideoFrameRef::from_buffer_ref_readable(buffer, info).unwrap();
    (0..info.n_components() as u8).all(|component| {
        let plane = info.comp_plane(component);
        let stride = frame.plane_stride()[plane as usize] as usize;
        let data = frame.plane_data(plane).unwrap();
        component_rows(info, component).all(|(row, mut bytes)| bytes.all(|b| data[row * stride + b] == value))
    })
}

/// A byte that makes a valid sample of the format when all its bytes are so.
fn grey(info: &VideoInfo) -> u8 {
    match (info.comp_depth(0), info.format_info().shift()[0]) {
        (8 | 16, _) => 0x47,
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
    for format in ["GRAY16_BE", "v210", "NV12_64Z32", "RGB8P"] {
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
    for field in ["interlace-mode=interleaved", "interlace-mode=mixed", "multiview-mode=side-by-side"] {
        let caps: gst::Caps =
            format!("video/x-raw,format=GRAY8,width=320,height=240,framerate=30/1,{field}").parse().unwrap();
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
