// SPDX-License-Identifier: MIT OR Apache-2.0

//! The bytes of a frame that are no picture: ends of rows, gaps between planes and behind them.
//!
//! They are cleared in every frame that is made here: what was in that memory before would go into files that hold frames as
//! they lie in memory.

use super::formats::FrameViews;
use gst_video::{VideoInfo, VideoMeta};
use std::ops::Range;

/// What the places of the bytes depend on, beside the format.
#[derive(Debug, Default, PartialEq)]
struct Places {
    offsets: Vec<usize>,
    strides: Vec<i32>,
    size: usize,
}

/// Where the padding of frames lies that are laid out like the last one.
#[derive(Debug, Default)]
pub struct Padding {
    places: Places,
    gaps: Vec<Range<usize>>,
}

impl Padding {
    /// Clears the padding of a frame into which the picture is yet to be written; `Err` says why it cannot be done.
    ///
    /// Where a row ends with samples that no pixel has, as packed 4:2:2 of odd width does, the pixel beside them is cleared,
    /// too.
    pub fn clear(&mut self, views: &FrameViews, frame: &mut gst::BufferRef) -> Result<(), &'static str> {
        let info = views.info();
        if !Places::read(info, frame, |offsets, strides| self.places.are(offsets, strides, frame.size())) {
            self.places = Places::read(info, frame, |offsets, strides| Places {
                offsets: offsets.to_vec(),
                strides: strides.to_vec(),
                size: frame.size(),
            });
            self.gaps = self.places.gaps(views);
        }
        if self.gaps.is_empty() {
            return Ok(());
        }
        let mut first = 0;
        for index in 0..frame.n_memory() {
            let mut map =
                frame.map_range_writable(index..=index).map_err(|_| "cannot map the output frame")?;
            let end = first + map.len();
            for gap in self.gaps.iter().filter(|gap| gap.start < end && gap.end > first) {
                let part = gap.start.max(first) - first..gap.end.min(end) - first;
                map.get_mut(part).unwrap_or_default().fill(0);
            }
            first = end;
        }
        Ok(())
    }
}

impl Places {
    /// Offsets and strides of a frame's planes.
    fn read<R>(info: &VideoInfo, frame: &gst::BufferRef, read: impl FnOnce(&[usize], &[i32]) -> R) -> R {
        match frame.meta::<VideoMeta>() {
            Some(meta) => read(meta.offset(), meta.stride()),
            None => read(info.offset(), info.stride()),
        }
    }

    fn are(&self, offsets: &[usize], strides: &[i32], size: usize) -> bool {
        self.size == size && self.offsets == offsets && self.strides == strides
    }

    /// The bytes that no row takes, in order.
    fn gaps(&self, views: &FrameViews) -> Vec<Range<usize>> {
        let mut rows: Vec<Range<usize>> = Vec::new();
        for plane in 0..views.info().n_planes() {
            let index = plane as usize;
            let Some((offset, stride)) = self.offsets.get(index).zip(self.strides.get(index)) else {
                continue;
            };
            let Some((height, (_, bytes))) = views.plane_height(plane).zip(views.row_bytes(plane)) else {
                continue;
            };
            let Ok(stride) = usize::try_from(*stride) else { continue };
            rows.extend((0..height).map(|row| {
                let start = offset.saturating_add(row.saturating_mul(stride));
                start..start.saturating_add(bytes)
            }));
        }
        rows.sort_unstable_by_key(|row| row.start);
        rows.push(self.size..self.size);
        let mut gaps: Vec<Range<usize>> = Vec::new();
        let mut at = 0;
        for row in rows {
            if row.start > at {
                gaps.push(at..row.start);
            }
            at = row.end.max(at);
        }
        gaps
    }
}
