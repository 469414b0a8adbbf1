// SPDX-License-Identifier: MIT OR Apache-2.0

//! The layout of all planes of a frame.

use super::sample_grid::SampleGrid;
use crate::plane::{Luma, Plane, PlaneError, PlaneLayout, SampleFormat};

/// The planes of a frame, the luma first: how each is stored and where its pixels lie in the frame.
///
/// ```
/// # use rsrectify::{FrameLayout, SampleFormat};
/// // Rows that end with padding.
/// let mut layout = FrameLayout::yuv420(1920, 1080, SampleFormat::U8);
/// for ((plane, _), stride) in layout.planes.iter_mut().zip([2048, 1024, 1024]) {
///     plane.stride = stride;
/// }
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct FrameLayout {
    /// How each plane is stored, and where its samples lie.
    pub planes: Vec<(PlaneLayout, SampleGrid)>,
}

impl FrameLayout {
    /// Planar 4:2:0: luma and two planes of chroma with half the columns and rows, rounded up, at
    /// [`SampleGrid::CHROMA_420`]; without padding.
    #[must_use]
    pub fn yuv420(width: usize, height: usize, format: SampleFormat) -> Self {
        let luma = PlaneLayout::packed(width, height, format);
        let chroma = PlaneLayout::packed(width.div_ceil(2), height.div_ceil(2), format);
        let chroma = (chroma, SampleGrid::CHROMA_420);
        Self { planes: vec![(luma, SampleGrid::FULL), chroma, chroma] }
    }

    /// One plane of 1 to 4 interleaved channels, without padding: RGB, BGRA, grey.
    #[must_use]
    pub fn interleaved(width: usize, height: usize, channels: usize, format: SampleFormat) -> Self {
        let packed = PlaneLayout::packed(width, height, format);
        let stride = packed.stride.saturating_mul(channels);
        Self { planes: vec![(PlaneLayout { stride, step: channels, channels, ..packed }, SampleGrid::FULL)] }
    }

    /// The first channel of the first plane, to be pushed to a [`Rectifier`](crate::Rectifier); see
    /// [`Luma::weighted`] for the luma of RGB.
    ///
    /// # Errors
    /// If the bytes do not hold the plane or the layout is invalid; see [`PlaneError`].
    pub fn luma<'a>(&self, planes: &'a [impl AsRef<[u8]>]) -> Result<Luma<'a>, PlaneError> {
        let bytes = planes.first().map_or(&[] as &[u8], AsRef::as_ref);
        // Without planes the frame has no pixels, which its bytes always hold.
        let none = PlaneLayout::packed(0, 0, SampleFormat::U8);
        let layout = self.planes.first().map_or(none, |(layout, _)| *layout);
        Plane::new(bytes, layout).map(Luma::from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_have_the_sizes_of_their_formats() {
        let sizes = |layout: FrameLayout| -> Vec<_> {
            layout.planes.iter().map(|(plane, _)| plane.required_bytes().unwrap()).collect()
        };
        assert_eq!(sizes(FrameLayout::yuv420(5, 3, SampleFormat::U8)), [15, 6, 6]);
        assert_eq!(sizes(FrameLayout::yuv420(4, 2, SampleFormat::U10)), [16, 4, 4]);
        assert_eq!(sizes(FrameLayout::interleaved(5, 3, 4, SampleFormat::U16)), [120]);
    }

    #[test]
    fn the_luma_is_the_first_plane_and_must_be_there() {
        let layout = FrameLayout::yuv420(4, 2, SampleFormat::U8);
        let planes = [vec![7; 8], vec![1; 2], vec![2; 2]];
        assert_eq!(layout.luma(&planes).unwrap().plane().data(), [7; 8]);
        let missing = PlaneError::TooShort { len: 0, needed: 8 };
        assert_eq!(layout.luma(&[] as &[Vec<u8>]).unwrap_err(), missing);
        let none = FrameLayout { planes: Vec::new() };
        assert_eq!(none.luma(&planes).unwrap().plane().layout().width, 0);
    }
}
