// SPDX-License-Identifier: MIT OR Apache-2.0

//! Formats: each is rectified as its conversion is, none is converted to less than it holds, and what is
//! not a plain frame in system memory is passed on or refused.

use crate::common::*;
use gst::prelude::*;
use gst_check::Harness;
use gst_video::prelude::*;
use gst_video::{
    VideoChromaSite, VideoConverter, VideoConverterConfig, VideoFormat, VideoFormatInfo, VideoFrameRef,
    VideoInfo,
};

/// Odd, so that chroma planes have a last column and row of their own.
const WIDTH: u32 = 61;
const HEIGHT: u32 = 47;

/// The formats that the element takes.
fn formats() -> Vec<VideoFormat> {
    let element = element();
    let caps = element.static_pad("sink").unwrap().pad_template_caps();
    let formats = caps.structure(0).unwrap().get::<gst::List>("format").unwrap();
    formats.iter().map(|format| VideoFormat::from_string(format.get().unwrap())).collect()
}

fn element() -> gst::Element {
    init();
    gst::ElementFactory::make("rsrectify").build().unwrap()
}

fn about(format: VideoFormat) -> VideoFormatInfo {
    VideoFormatInfo::from_format(format)
}

fn info(format: VideoFormat, width: u32) -> VideoInfo {
    let site = match subsampling(format) {
        (0, 0) => VideoChromaSite::empty(),
        _ => VideoChromaSite::MPEG2,
    };
    let builder = VideoInfo::builder(format, width, HEIGHT).fps(gst::Fraction::new(30, 1));
    builder.chroma_site(site).build().unwrap()
}

/// log2 of the frame's pixels to a sample of chroma, across and down.
fn subsampling(format: VideoFormat) -> (u32, u32) {
    let most = |shares: &[u32]| shares.iter().copied().max().unwrap();
    (most(about(format).w_sub()), most(about(format).h_sub()))
}

/// The format with everything at 16 bits and full resolution.
fn deepest(format: VideoFormat) -> VideoFormat {
    match about(format) {
        info if info.is_gray() => VideoFormat::Gray16Le,
        info if info.is_rgb() => VideoFormat::Argb64,
        _ => VideoFormat::Ayuv64,
    }
}

/// A smooth picture, different in each component, in a format of 16-bit words.
fn picture(info: &VideoInfo) -> gst::Buffer {
    let mut buffer = gst::Buffer::from_mut_slice(vec![0u8; info.size()]);
    let mut frame = VideoFrameRef::from_buffer_ref_writable(buffer.get_mut().unwrap(), info).unwrap();
    let (stride, words) = (frame.plane_stride()[0] as usize, info.n_components() as usize);
    let data = frame.plane_data_mut(0).unwrap();
    let row = |y: usize| (0..info.width() as usize * words).map(move |i| (y, i / words, i % words));
    for (y, x, word) in (0..HEIGHT as usize).flat_map(row) {
        let (a, b) = (0.05 + 0.02 * word as f64, 0.11 - 0.03 * word as f64);
        let phase = a * x as f64 + b * y as f64 + 1.7 * word as f64;
        let value = (65535.0 * (0.5 + 0.35 * phase.sin())) as u16;
        let at = y * stride + 2 * (x * words + word);
        data[at..at + 2].copy_from_slice(&value.to_le_bytes());
    }
    drop(frame);
    buffer
}

/// GStreamer's own conversion, without dither.
fn converted(buffer: &gst::BufferRef, from: &VideoInfo, to: &VideoInfo) -> gst::Buffer {
    let mut config = VideoConverterConfig::new();
    config.set_dither_method(gst_video::VideoDitherMethod::None);
    let converter = VideoConverter::new(from, to, Some(config)).unwrap();
    let mut out = gst::Buffer::from_mut_slice(vec![0u8; to.size()]);
    let source = VideoFrameRef::from_buffer_ref_readable(buffer, from).unwrap();
    let mut target = VideoFrameRef::from_buffer_ref_writable(out.get_mut().unwrap(), to).unwrap();
    converter.frame_ref(&source, &mut target);
    drop(target);
    out
}

/// The same frame in rows that are `pad` bytes longer than they need be.
fn padded(buffer: &gst::BufferRef, info: &VideoInfo, pad: usize) -> gst::Buffer {
    let source = VideoFrameRef::from_buffer_ref_readable(buffer, info).unwrap();
    let (mut data, mut offsets, mut strides) = (vec![0x5a; pad], Vec::new(), Vec::new());
    for plane in 0..info.n_planes() {
        offsets.push(data.len());
        strides.push(source.plane_stride()[plane as usize] + pad as i32);
        let component = (0..info.n_components() as u8).find(|&c| info.comp_plane(c) == plane).unwrap();
        let rows = source.plane_data(plane).unwrap().chunks(source.plane_stride()[plane as usize] as usize);
        for row in rows.take(info.comp_height(component) as usize) {
            data.extend_from_slice(row);
            data.extend(std::iter::repeat_n(0xa5, pad));
        }
    }
    laid_out(data, info, &offsets, &strides)
}

/// The frame as the element gives it out: enlarged, so that every sample lies between others, and by the
/// same in every format, whatever is found in the picture.
fn enlarged(buffer: gst::Buffer, info: &VideoInfo) -> gst::Buffer {
    let mut h = harness(0, &info.to_caps().unwrap());
    h.element().unwrap().set_property_from_str("border-mode", "crop");
    h.element().unwrap().set_property("crop", 12.0);
    h.push(buffer).unwrap();
    h.pull().unwrap()
}

/// The samples of a component of little-endian words.
fn words(buffer: &gst::BufferRef, info: &VideoInfo, component: u8) -> Vec<f64> {
    let frame = VideoFrameRef::from_buffer_ref_readable(buffer, info).unwrap();
    let plane = info.comp_plane(component);
    let data = frame.plane_data(plane).unwrap();
    let (stride, step) =
        (frame.plane_stride()[plane as usize] as usize, info.comp_pstride(component) as usize);
    let (columns, first) = (info.comp_width(component) as usize, info.comp_poffset(component) as usize);
    let row = |y: usize| (0..columns).map(move |x| y * stride + first + x * step);
    let starts = (0..info.comp_height(component) as usize).flat_map(row);
    starts.map(|at| f64::from(u16::from_le_bytes([data[at], data[at + 1]]))).collect()
}

/// What is compared: a format, components in it, the largest difference in its values.
type Reference = (VideoFormat, Vec<u8>, f64);

fn references(format: VideoFormat) -> Vec<Reference> {
    // Half a step of rounding and what the fixed point of 8-bit samples adds, then the reference's own.
    let depth = about(format).depth()[0];
    let rounding = |bits: u32| match bits.saturating_sub(depth) {
        _ if bits == depth => 0.0,
        // GStreamer 1.22 itself leaves the low bits of every second luma zero.
        more if matches!(format, VideoFormat::Y210 | VideoFormat::Y212Le) => {
            1.65 * f64::from(1u32 << more) + 1.6
        }
        more => 0.65 * f64::from(1u32 << more) + 1.6,
    };
    let full = deepest(format);
    let all = (0..about(full).n_components() as u8).collect::<Vec<_>>();
    match subsampling(format) {
        (0, 0) => vec![(full, all, rounding(16))],
        (1, 1) => {
            vec![(full, vec![0, 3], rounding(16)), (VideoFormat::I42012le, vec![0, 1, 2], rounding(12))]
        }
        (1, 0) => {
            vec![(full, vec![0, 3], rounding(16)), (VideoFormat::I42212le, vec![0, 1, 2], rounding(12))]
        }
        // Chroma is compared after it has been made larger: a smooth one differs by some steps.
        _ => vec![(full, vec![0, 3], rounding(16)), (full, vec![1, 2], 6.0 * 256.0)],
    }
}

fn most_different(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn every_format_is_rectified_as_its_conversion_is() {
    for format in formats() {
        // GStreamer 1.22 itself swaps the chroma of VYUY's last pixel where the width is odd.
        let width = if format == VideoFormat::Vyuy { WIDTH + 1 } else { WIDTH };
        let (info, full) = (info(format, width), info(deepest(format), width));
        let frame = converted(&picture(&full), &full, &info);
        let outs = [frame.clone(), padded(&frame, &info, 24)].map(|frame| enlarged(frame, &info));
        for (reference, components, tolerance) in references(format) {
            let reference = self::info(reference, width);
            let source = converted(&frame, &info, &reference);
            let wanted = enlarged(source.clone(), &reference);
            for component in components {
                let wanted = words(&wanted, &reference, component);
                for out in &outs {
                    let shown = words(&converted(out, &info, &reference), &reference, component);
                    let worst = most_different(&shown, &wanted);
                    let name = reference.name();
                    println!("{format:?}: component {component} differs by {worst} of {tolerance} in {name}");
                    assert!(
                        worst <= tolerance,
                        "{format:?}: component {component} differs by {worst} in {name}"
                    );
                }
            }
        }
        let luma = |frame: &gst::BufferRef| words(&converted(frame, &info, &full), &full, 0);
        assert!(most_different(&luma(&outs[0]), &luma(&frame)) > 2000.0, "{format:?} is not enlarged");
    }
}

/// The format that `videoconvert` chooses for the element.
fn chosen(format: VideoFormat) -> VideoFormat {
    init();
    let mut h = Harness::new_parse("videoconvert ! rsrectify name=filter");
    h.set_src_caps(info(format, WIDTH).to_caps().unwrap());
    let bin = h.element().unwrap().downcast::<gst::Bin>().unwrap();
    let caps = bin.by_name("filter").unwrap().static_pad("sink").unwrap().current_caps();
    VideoInfo::from_caps(&caps.unwrap_or_else(|| panic!("{format:?} is refused"))).unwrap().format()
}

#[test]
fn a_format_that_is_taken_is_not_converted() {
    for format in formats() {
        assert_eq!(chosen(format), format);
    }
}

#[test]
fn a_format_that_is_not_taken_is_converted_to_one_that_holds_as_much() {
    let taken = formats();
    for format in VideoFormat::iter_raw().filter(|format| !taken.contains(format)) {
        let (from, to) = (about(format), about(chosen(format)));
        let (fine, coarse) = (subsampling(to.format()), subsampling(format));
        println!("{} goes on as {}", from.name(), to.name());
        // To GStreamer's conversion, 12 bits in a word are as good as 16.
        assert!(to.depth()[0] >= from.depth()[0].min(12), "{} as {}", from.name(), to.name());
        assert!(fine.0 <= coarse.0 && fine.1 <= coarse.1, "{} as {}", from.name(), to.name());
        assert!(to.has_alpha() || !from.has_alpha(), "{} as {}", from.name(), to.name());
        assert!(from.is_gray() || !to.is_gray(), "{} as {}", from.name(), to.name());
    }
}

#[test]
fn neighbours_agree_on_a_format_as_if_the_element_were_not_there() {
    init();
    let agreed = |element: &str, sink: &str| {
        let description = format!(
            "videotestsrc num-buffers=1 ! {element} ! capsfilter caps=\"{sink}\" ! fakesink name=sink"
        );
        let pipeline = crate::common::film::launch(&description);
        pipeline.set_state(gst::State::Paused).unwrap();
        wait_for(&pipeline, gst::MessageType::AsyncDone);
        let caps = pipeline.by_name("sink").unwrap().static_pad("sink").unwrap().current_caps().unwrap();
        pipeline.set_state(gst::State::Null).unwrap();
        VideoInfo::from_caps(&caps).unwrap().format()
    };
    // What video sinks and encoders take; the last one takes anything.
    for (sink, usual) in [
        ("video/x-raw,format={BGRx,RGBx,xRGB,xBGR,BGR,RGB}", true),
        ("video/x-raw,format={I420,YV12,YUY2,UYVY}", true),
        ("video/x-raw,format={I420,YV12,NV12,Y42B,NV16,NV21,I420_10LE,I422_10LE}", false),
        ("video/x-raw", false),
    ] {
        for element in ["rsrectify", "rsrectify ! videoconvert", "videoconvert ! rsrectify ! videoconvert"] {
            let format = agreed(element, sink);
            assert_eq!(format, agreed(&element.replace("rsrectify", "identity"), sink), "{element} {sink}");
            assert!(!usual || about(format).depth()[0] == 8, "{element} {sink}: {format:?}");
        }
    }
}

/// Caps of a grey frame with features.
fn with_features(features: &[&str]) -> gst::Caps {
    let mut caps = numbered_caps();
    caps.make_mut().set_features_simple(Some(gst::CapsFeatures::new(features.iter().copied())));
    caps
}

#[test]
fn memory_that_is_not_the_systems_is_refused() {
    for memory in ["memory:GLMemory", "memory:DMABuf", "memory:VAMemory", "memory:CUDAMemory"] {
        for features in [&[memory][..], &[memory, "meta:GstVideoOverlayComposition"]] {
            let caps = with_features(features);
            for pad in ["sink", "src"] {
                let element = element();
                let pad = element.static_pad(pad).unwrap();
                assert!(!pad.query_accept_caps(&caps) && pad.query_caps(Some(&caps)).is_empty(), "{caps}");
            }
        }
        // The line that gst-launch-1.0 prints.
        let refusal = gst::parse::launch(&format!("appsrc ! video/x-raw({memory}) ! rsrectify ! fakesink"));
        let line = refusal.unwrap_err().to_string();
        assert!(line.starts_with("could not link appsrc") && line.lines().count() == 1, "{line}");
        assert!(line.ends_with(&format!("can't handle caps video/x-raw({memory})")), "{line}");
    }
}

#[test]
fn overlays_beside_the_picture_are_kept() {
    use gst_video::{VideoOverlayComposition, VideoOverlayCompositionMeta};
    init();
    let mut h = Harness::new("rsrectify");
    warp_always(&h);
    h.sinkpad().unwrap().add_probe(gst::PadProbeType::QUERY_DOWNSTREAM, |_, info| {
        if let Some(gst::QueryViewMut::Allocation(query)) = info.query_mut().map(|query| query.view_mut()) {
            query.add_allocation_meta::<VideoOverlayCompositionMeta>(None);
            return gst::PadProbeReturn::Handled;
        }
        gst::PadProbeReturn::Ok
    });
    let caps = with_features(&["memory:SystemMemory", "meta:GstVideoOverlayComposition"]);
    h.set_src_caps(caps.clone());
    // Only a source that hears of somebody who draws them leaves overlays undrawn.
    let mut query = gst::query::Allocation::new(Some(&caps), true);
    assert!(h.element().unwrap().static_pad("sink").unwrap().query(query.query_mut()));
    assert!(query.find_allocation_meta::<VideoOverlayCompositionMeta>().is_some());

    let pixels = VideoInfo::builder(VideoFormat::Bgra, 4, 2).build().unwrap();
    let mut text = gst::Buffer::from_mut_slice(vec![0x77u8; pixels.size()]);
    let flags = gst_video::VideoFrameFlags::empty();
    gst_video::VideoMeta::add(text.get_mut().unwrap(), flags, VideoFormat::Bgra, 4, 2).unwrap();
    let rectangle = gst_video::VideoOverlayRectangle::new_raw(
        &text,
        10,
        20,
        4,
        2,
        gst_video::VideoOverlayFormatFlags::empty(),
    );
    let overlay = VideoOverlayComposition::new(Some(&rectangle)).unwrap();
    for number in 1..7 {
        let mut frame = numbered(number);
        VideoOverlayCompositionMeta::add(frame.get_mut().unwrap(), &overlay);
        h.push(frame).unwrap();
    }
    h.push_event(gst::event::Eos::new());
    let out = arrived(&mut h);
    assert_eq!(out.len(), 6);
    for (number, frame) in (1..).zip(&out) {
        assert!(frame.map_readable().unwrap().as_slice() != numbered_pixels(number), "not rectified");
        let meta = frame.meta::<VideoOverlayCompositionMeta>().expect("an overlay");
        assert_eq!(meta.overlay().rectangle(0).unwrap().render_rectangle(), (10, 20, 4, 2));
    }
}
