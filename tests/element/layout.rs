// SPDX-License-Identifier: MIT OR Apache-2.0

//! How frames lie in memory: what is between the rows, and rows that lie upside down.

use crate::common::*;
use gst::prelude::*;
use gst_video::{VideoInfo, VideoMeta};

/// Formats without bytes that no pixel has.
const FORMATS: [&str; 10] =
    ["GRAY8", "I420", "NV12", "Y42B", "YUY2", "RGB", "BGRA", "v308", "P010_10LE", "GBR_10LE"];
const OLD: u8 = 0xab;

/// A byte that makes a valid sample of the format when all its bytes are so.
fn value(format: &str) -> u8 {
    if format == "GBR_10LE" { 0x02 } else { 0x40 }
}

/// Samples of a frame in bytes.
fn sample_bytes(info: &VideoInfo) -> usize {
    let bytes = |c: u8| info.comp_width(c) * info.comp_height(c) * info.comp_depth(c).div_ceil(8);
    (0..info.n_components() as u8).map(|c| bytes(c) as usize).sum()
}

/// A harness whose sink offers a pool, and takes strides of any kind or none.
fn harness_with_pool(
    caps: &gst::Caps,
    reads_strides: bool,
) -> (gst_check::Harness, gst_video::VideoBufferPool) {
    init();
    let mut h = gst_check::Harness::new("rsrectify");
    let pool = gst_video::VideoBufferPool::new();
    let (offered, size) = (pool.clone(), VideoInfo::from_caps(caps).unwrap().size() as u32);
    h.sinkpad().unwrap().add_probe(gst::PadProbeType::QUERY_DOWNSTREAM, move |_, info| {
        if let Some(gst::QueryViewMut::Allocation(query)) = info.query_mut().map(|query| query.view_mut()) {
            query.add_allocation_pool(Some(&offered), size, 0, 0);
            if reads_strides {
                query.add_allocation_meta::<VideoMeta>(None);
            }
            return gst::PadProbeReturn::Handled;
        }
        gst::PadProbeReturn::Ok
    });
    h.element().unwrap().set_property("lookahead", 1u32);
    h.set_src_caps(caps.clone());
    (h, pool)
}

/// Leaves frames in a pool in which every byte is `OLD`.
fn use_pool(pool: &gst_video::VideoBufferPool) {
    let mut buffers: Vec<_> = (0..8).map(|_| pool.acquire_buffer(None).unwrap()).collect();
    for buffer in &mut buffers {
        buffer.get_mut().unwrap().map_writable().unwrap().fill(OLD);
    }
}

/// A frame in which every byte is `value` and rows are longer than they need be.
fn padded(info: &VideoInfo, value: u8, number: usize) -> gst::Buffer {
    let strides: Vec<i32> = info.stride().iter().map(|stride| stride + 16).collect();
    let planes = info.n_planes() as usize;
    // Planes of four hundred rows each, whatever they need.
    let offsets: Vec<usize> = (0..planes).map(|plane| 400 * 400 * plane).collect();
    let mut buffer = gst::Buffer::from_mut_slice(vec![value; 400 * 400 * planes]);
    let inner = buffer.get_mut().unwrap();
    let flags = gst_video::VideoFrameFlags::empty();
    VideoMeta::add_full(inner, flags, info.format(), info.width(), info.height(), &offsets, &strides)
        .unwrap();
    inner.set_pts(time(number));
    buffer
}

#[test]
fn what_was_in_memory_before_is_not_given_out() {
    for format in FORMATS {
        for (width, height) in [(33, 17), (35, 18), (64, 48)] {
            for (reads_strides, crops) in [(true, true), (false, true), (false, false)] {
                let caps = caps(format, width, height, gst::Fraction::new(30, 1));
                let info = VideoInfo::from_caps(&caps).unwrap();
                let value = value(format);
                let (mut h, pool) = harness_with_pool(&caps, reads_strides);
                if crops {
                    warp_always(&h);
                }
                // The pool becomes active with the first frame that goes out.
                (0..2).for_each(|number| assert!(h.push(padded(&info, value, number)).is_ok()));
                use_pool(&pool);
                arrived(&mut h);
                (2..5).for_each(|number| assert!(h.push(padded(&info, value, number)).is_ok()));
                let out = arrived(&mut h);
                assert_eq!(out.len(), 3);
                for buffer in out {
                    let map = buffer.map_readable().unwrap();
                    let of = |value: u8| map.iter().filter(|byte| **byte == value).count();
                    let samples = sample_bytes(&info);
                    // The sample that a row of odd width lacks in packed 4:2:2 may be that of the frame that came.
                    assert_eq!(
                        (of(OLD), of(0) + of(value)),
                        (0, map.len()),
                        "{format} {width}x{height} {crops}"
                    );
                    assert!(
                        (samples..=samples + height as usize).contains(&of(value)),
                        "{format} {width}x{height}"
                    );
                }
            }
        }
    }
}

/// The same frame with its rows from the bottom one up.
fn bottom_up(buffer: &gst::Buffer, info: &VideoInfo) -> gst::Buffer {
    let map = buffer.map_readable().unwrap();
    let (mut bytes, mut offsets, mut strides) = (Vec::new(), Vec::new(), Vec::new());
    for plane in 0..info.n_planes() {
        let component = (0..info.n_components() as u8).find(|&c| info.comp_plane(c) == plane).unwrap();
        let (start, stride) = (info.offset()[plane as usize], info.stride()[plane as usize] as usize);
        let rows = map[start..].chunks_exact(stride).take(info.comp_height(component) as usize);
        bytes.extend([OLD; 5]);
        let first = bytes.len();
        rows.rev().for_each(|row| bytes.extend_from_slice(row));
        offsets.push(bytes.len() - stride);
        assert!(bytes.len() > first);
        strides.push(-(stride as i32));
    }
    let mut flipped = gst::Buffer::from_mut_slice(bytes);
    let inner = flipped.get_mut().unwrap();
    let flags = gst_video::VideoFrameFlags::empty();
    VideoMeta::add_full(inner, flags, info.format(), info.width(), info.height(), &offsets, &strides)
        .unwrap();
    inner.set_pts(buffer.pts());
    flipped
}

/// What comes out of the element: pictures and timestamps.
fn played(
    caps: &gst::Caps,
    frames: impl Iterator<Item = gst::Buffer>,
    prepare: impl Fn(&gst::Element),
) -> Vec<(Vec<u8>, Option<gst::ClockTime>)> {
    let mut h = harness(3, caps);
    prepare(&h.element().unwrap());
    frames.for_each(|frame| assert!(h.push(frame).is_ok()));
    h.push_event(gst::event::Eos::new());
    arrived(&mut h).iter().map(|buffer| (buffer.map_readable().unwrap().to_vec(), buffer.pts())).collect()
}

#[test]
fn rows_that_lie_upside_down_are_rectified_like_others() {
    let caps = numbered_caps();
    let info = VideoInfo::from_caps(&caps).unwrap();
    let known = |element: &gst::Element| {
        element.set_property("readout-time", (shake::RATIO / shake::FPS * 1e9) as u64);
        element.set_property_from_str("readout-direction", "bottom-to-top");
    };
    let frames = || (0..12).map(shake::shaken);
    let expected = played(&caps, frames(), known);
    let found = played(&caps, frames().map(|frame| bottom_up(&frame, &info)), known);
    assert!(found == expected);
    let came: Vec<_> = frames().map(|frame| (frame.map_readable().unwrap().to_vec(), frame.pts())).collect();
    let changed = found.iter().zip(&came).filter(|(found, came)| found.0 != came.0).count();
    assert!(changed > 8, "{changed} rectified");
    // Without any correction the picture is the one that came.
    let untouched = |element: &gst::Element| element.set_property("strength", 0.0);
    assert!(played(&caps, frames().map(|frame| bottom_up(&frame, &info)), untouched) == came);
}

#[test]
fn rows_that_lie_upside_down_are_read_in_every_kind_of_format() {
    for format in FORMATS {
        for (width, height) in [(33, 17), (64, 48)] {
            let caps = caps(format, width, height, gst::Fraction::new(30, 1));
            let info = VideoInfo::from_caps(&caps).unwrap();
            let frame = |number: usize| {
                let mut frame = flat(&caps, number);
                let mut map = frame.get_mut().unwrap().map_writable().unwrap();
                // No bits above the tenth.
                let set =
                    |(k, byte): (usize, &mut u8)| *byte = if k % 2 == 0 { (k * 37 % 251) as u8 } else { 2 };
                map.iter_mut().enumerate().for_each(set);
                drop(map);
                frame
            };
            let crop = |element: &gst::Element| element.set_property_from_str("border-mode", "crop");
            let expected = played(&caps, (0..5).map(frame), crop);
            let found = played(&caps, (0..5).map(|number| bottom_up(&frame(number), &info)), crop);
            assert!(found == expected, "{format} {width}x{height}");
        }
    }
}

#[test]
fn strides_below_zero_that_lead_out_of_the_buffer_are_an_error() {
    let caps = numbered_caps();
    let info = VideoInfo::from_caps(&caps).unwrap();
    let row = SIZE.0 as i32;
    for (offset, stride) in
        [(0, -row), (info.size(), -row), (info.size() - 1, -row), (info.size() - 320, i32::MIN)]
    {
        let mut h = harness(1, &caps);
        let bus = bus(&h);
        h.push(numbered(0)).unwrap();
        let mut bad = numbered(1);
        let inner = bad.get_mut().unwrap();
        let flags = gst_video::VideoFrameFlags::empty();
        let added = VideoMeta::add_full(inner, flags, info.format(), SIZE.0, SIZE.1, &[offset], &[stride]);
        added.unwrap();
        assert_eq!(h.push(bad), Err(gst::FlowError::Error), "{offset} {stride}");
        assert_eq!(messages(&bus, gst::MessageType::Error).len(), 1);
    }
}
