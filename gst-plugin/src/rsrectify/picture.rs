// SPDX-License-Identifier: MIT OR Apache-2.0

//! The pictures in buffers: mapped and copied, whatever their metas claim.

use super::formats::FrameViews;
use gst_video::prelude::*;
use gst_video::{VideoFrameRef, VideoInfo, VideoMeta};

/// Maps a frame for reading; `Err` says why it cannot be read.
///
/// Which of a meta's claims GStreamer takes for a programming error is its own affair: a meta of another
/// format or of a smaller frame never gets there.
pub fn map_readable<'a>(
    buffer: &'a gst::BufferRef,
    info: &VideoInfo,
) -> Result<VideoFrameRef<&'a gst::BufferRef>, &'static str> {
    if buffer.meta::<VideoMeta>().is_some_and(|meta| is_other(&meta, info)) {
        return Err("its video meta describes another frame");
    }
    VideoFrameRef::from_buffer_ref_readable(buffer, info).map_err(|_| "cannot map the frame for reading")
}

/// Whether a meta describes a frame of another format or a smaller one.
fn is_other(meta: &VideoMeta, info: &VideoInfo) -> bool {
    meta.format() != info.format() || meta.width() < info.width() || meta.height() < info.height()
}

/// Whether the rows of a frame lie in memory from the bottom one up, as strides below zero state.
pub fn is_bottom_up(buffer: &gst::BufferRef) -> bool {
    buffer.meta::<VideoMeta>().is_some_and(|meta| meta.stride().iter().any(|&stride| stride < 0))
}

/// Copies the picture of one buffer into another; `Err` says why it cannot be done.
///
/// Rows are copied as a whole: `gst_video_frame_copy` leaves the last chroma sample of a packed 4:2:2 row of
/// odd width.
pub fn copy(
    views: &FrameViews,
    input: &gst::BufferRef,
    output: &mut gst::BufferRef,
) -> Result<(), &'static str> {
    const CUT: &str = "the buffer does not hold a whole frame";
    let info = views.info();
    let mut output = VideoFrameRef::from_buffer_ref_writable(output, info)
        .map_err(|_| "cannot map the output frame for writing")?;
    for view in views.all() {
        view.plane_mut(&mut output).ok_or("the output buffer is too small")?;
    }
    if is_bottom_up(input) {
        return copy_bottom_up(views, input, &mut output).ok_or(CUT);
    }
    let input = map_readable(input, info)?;
    for view in views.all() {
        view.plane(&input).ok_or(CUT)?;
    }
    for plane in 0..info.n_planes() {
        let stride =
            input.plane_stride().get(plane as usize).and_then(|&stride| usize::try_from(stride).ok());
        let stride = stride.filter(|&stride| stride > 0).ok_or(CUT)?;
        let rows = input.plane_data(plane).map_err(|_| CUT)?.chunks(stride);
        copy_rows(views, plane, rows, &mut output).ok_or("input and output frames differ")?;
    }
    Ok(())
}

/// The same of a frame with strides below zero, for which the bindings of GStreamer make no slices.
fn copy_bottom_up(
    views: &FrameViews,
    input: &gst::BufferRef,
    output: &mut VideoFrameRef<&mut gst::BufferRef>,
) -> Option<()> {
    let info = views.info();
    let meta = input.meta::<VideoMeta>().filter(|meta| !is_other(meta, info))?;
    let bytes = input.map_readable().ok()?;
    for plane in 0..info.n_planes() {
        let (&offset, &stride) = meta.offset().get(plane as usize).zip(meta.stride().get(plane as usize))?;
        let (height, (width, _)) = views.plane_height(plane).zip(views.row_bytes(plane))?;
        // An offset is that of the upper row.
        let first = i64::try_from(offset).ok()?;
        let row = |row: usize| {
            let start = i64::try_from(row).ok()?.checked_mul(stride.into())?.checked_add(first)?;
            let start = usize::try_from(start).ok()?;
            bytes.get(start..start.checked_add(width)?)
        };
        let rows: Option<Vec<&[u8]>> = (0..height).map(row).collect();
        copy_rows(views, plane, rows?.into_iter(), output)?;
    }
    Some(())
}

/// Copies the rows of a plane; the padding of the last one need not be there.
fn copy_rows<'a>(
    views: &FrameViews,
    plane: u32,
    rows: impl Iterator<Item = &'a [u8]>,
    output: &mut VideoFrameRef<&mut gst::BufferRef>,
) -> Option<()> {
    let (height, (width, _)) = views.plane_height(plane).zip(views.row_bytes(plane))?;
    let stride =
        usize::try_from(*output.plane_stride().get(plane as usize)?).ok().filter(|&stride| stride > 0)?;
    let targets = output.plane_data_mut(plane).ok()?.chunks_mut(stride);
    for (source, target) in rows.zip(targets).take(height) {
        target.get_mut(..width)?.copy_from_slice(source.get(..width)?);
    }
    Some(())
}
