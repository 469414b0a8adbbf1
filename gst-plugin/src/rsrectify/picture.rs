//! The pictures in buffers: mapped and copied, whatever their metas claim.

use super::formats::FrameLayout;
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
    let is_other = |meta: gst::MetaRef<'_, VideoMeta>| {
        meta.format() != info.format() || meta.width() < info.width() || meta.height() < info.height()
    };
    if buffer.meta::<VideoMeta>().is_some_and(is_other) {
        return Err("its video meta describes another frame");
    }
    VideoFrameRef::from_buffer_ref_readable(buffer, info).map_err(|_| "cannot map the frame for reading")
}

/// Copies the picture of one buffer into another; `Err` says why it cannot be done.
///
/// Rows are copied as a whole: `gst_video_frame_copy` leaves the last chroma sample of a packed 4:2:2 row of
/// odd width.
pub fn copy(
    layout: &FrameLayout,
    input: &gst::BufferRef,
    output: &mut gst::BufferRef,
) -> Result<(), &'static str> {
    let info = layout.info();
    let input = map_readable(input, info)?;
    let mut output = VideoFrameRef::from_buffer_ref_writable(output, info)
        .map_err(|_| "cannot map the output frame for writing")?;
    for view in layout.views() {
        view.plane(&input).ok_or("the buffer does not hold a whole frame")?;
        view.plane_mut(&mut output).ok_or("the output buffer is too small")?;
    }
    for plane in 0..info.n_planes() {
        copy_plane(layout, plane, &input, &mut output).ok_or("input and output frames differ")?;
    }
    Ok(())
}

fn copy_plane(
    layout: &FrameLayout,
    plane: u32,
    input: &VideoFrameRef<&gst::BufferRef>,
    output: &mut VideoFrameRef<&mut gst::BufferRef>,
) -> Option<()> {
    let index = plane as usize;
    let rows = layout.plane_height(plane)?;
    let stride = |strides: &[i32]| strides.get(index).and_then(|&stride| usize::try_from(stride).ok());
    let (from, to) = (stride(input.plane_stride())?, stride(output.plane_stride())?);
    let row = stride(layout.info().stride())?.min(from).min(to);
    let (source, target) = (input.plane_data(plane).ok()?, output.plane_data_mut(plane).ok()?);
    if row == 0 {
        return None;
    }
    for (source, target) in source.chunks(from).zip(target.chunks_mut(to)).take(rows) {
        // The padding of the last row need not be there.
        let bytes = row.min(source.len()).min(target.len());
        target.get_mut(..bytes)?.copy_from_slice(source.get(..bytes)?);
    }
    Some(())
}
