// SPDX-License-Identifier: MIT OR Apache-2.0

//! Frames whose rows are longer than they need be, of any format.

use crate::common::laid_out;
use gst_video::prelude::*;
use gst_video::{VideoFrameRef, VideoInfo};

/// A buffer whose rows are `pad` bytes longer than they need be; all samples are `value`, and the
/// padding is not.
pub fn padded(info: &VideoInfo, pad: usize, value: u8) -> gst::Buffer {
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
    let mut buffer = laid_out(vec![value ^ 0xff; size], info, &offsets, &strides);
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
    let (offset, step) = (offset(info, component), info.comp_pstride(component) as usize);
    let (width, height) = (info.comp_width(component) as usize, info.comp_height(component) as usize);
    (0..height)
        .map(move |row| (row, (0..width).flat_map(move |x| (0..bytes).map(move |b| offset + x * step + b))))
}

/// Byte of a component in its plane, where GStreamer 1.22 does not tell it right.
fn offset(info: &VideoInfo, component: u8) -> usize {
    let component = usize::from(component);
    match info.format_info().name().as_str() {
        "Y210" | "Y212_LE" => [0, 2, 6][component],
        "Y412_LE" => [2, 0, 4, 6][component],
        "P010_10LE" | "P012_LE" | "P016_LE" => [0, 0, 2][component],
        _ => info.comp_poffset(component as u8) as usize,
    }
}

/// Whether every sample of a frame is `value` in all its bytes.
pub fn is_filled(buffer: &gst::BufferRef, info: &VideoInfo, value: u8) -> bool {
    let frame = VideoFrameRef::from_buffer_ref_readable(buffer, info).unwrap();
    (0..info.n_components() as u8).all(|component| {
        let plane = info.comp_plane(component);
        let stride = frame.plane_stride()[plane as usize] as usize;
        let data = frame.plane_data(plane).unwrap();
        component_rows(info, component).all(|(row, mut bytes)| bytes.all(|b| data[row * stride + b] == value))
    })
}
