// SPDX-License-Identifier: MIT OR Apache-2.0

//! Borrowed views of image planes: size, stride, samples of 8 to 16 bits.
//!
//! A [`Plane`] is bytes plus a [`PlaneLayout`]. One layout serves planar, semi-planar and packed
//! pictures: packed formats are several views of the same bytes, each starting at its own sample.

use std::ops::Range;
use thiserror::Error;

/// How one sample is stored. Samples of more than 8 bits are 16-bit little-endian words.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SampleFormat {
    bits: u8,
    shift: u8,
}

impl SampleFormat {
    /// One byte a sample.
    pub const U8: Self = Self { bits: 8, shift: 0 };
    /// 10 bits in the low end of a 16-bit word (`I420_10LE` and its kin).
    pub const U10: Self = Self { bits: 10, shift: 0 };
    /// 10 bits in the high end of a 16-bit word (`P010_10LE`).
    pub const U10_HIGH: Self = Self { bits: 10, shift: 6 };
    /// 12 bits in the low end of a 16-bit word.
    pub const U12: Self = Self { bits: 12, shift: 0 };
    /// 12 bits in the high end of a 16-bit word (`P012_LE`).
    pub const U12_HIGH: Self = Self { bits: 12, shift: 4 };
    /// 16 bits.
    pub const U16: Self = Self { bits: 16, shift: 0 };

    /// Significant bits of a sample.
    #[must_use]
    pub const fn bits(self) -> u32 {
        self.bits as u32
    }

    /// How far the significant bits are shifted up inside the stored word.
    #[must_use]
    pub const fn shift(self) -> u32 {
        self.shift as u32
    }

    /// Bytes that one stored sample takes: 1 or 2.
    #[must_use]
    pub const fn bytes(self) -> usize {
        if self.bits <= 8 { 1 } else { 2 }
    }

    /// The largest sample value, before the shift.
    #[must_use]
    pub const fn max_value(self) -> u16 {
        (((1u32 << self.bits) - 1) & 0xffff) as u16
    }
}

/// Where the samples of a plane lie in its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PlaneLayout {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Bytes from one row to the next.
    pub stride: usize,
    /// Samples from one pixel to the next; at least `channels`.
    pub step: usize,
    /// Samples of one pixel that belong to this view, one after another: 1 to 4.
    pub channels: usize,
    /// How each sample is stored.
    pub format: SampleFormat,
}

impl PlaneLayout {
    /// A plane of one channel without padding.
    #[must_use]
    pub const fn packed(width: usize, height: usize, format: SampleFormat) -> Self {
        // On overflow the stride saturates; no buffer is large enough for it, which `Plane::new` reports.
        let stride = width.saturating_mul(format.bytes());
        Self { width, height, stride, step: 1, channels: 1, format }
    }

    /// Bytes from the first sample to the end of the last one: the least length of a buffer.
    /// `None` on overflow of `usize`.
    #[must_use]
    pub fn required_bytes(&self) -> Option<usize> {
        if self.width == 0 || self.height == 0 {
            return Some(0);
        }
        let row = (self.width - 1).checked_mul(self.step)?.checked_add(self.channels)?;
        let row = row.checked_mul(self.format.bytes())?;
        (self.height - 1).checked_mul(self.stride)?.checked_add(row)
    }

    /// The layout, if `len` bytes are enough. The step of a plane one pixel wide and the stride of a single
    /// row are not used: they are set to the size of a pixel and of a row, so that arithmetic with them
    /// cannot overflow.
    fn checked(self, len: usize) -> Result<Self, PlaneError> {
        self.check(len)?;
        let step = if self.width > 1 { self.step } else { self.channels };
        let row = self.width.saturating_mul(step).saturating_mul(self.format.bytes());
        Ok(Self { step, stride: if self.height > 1 { self.stride } else { row }, ..self })
    }

    /// The layout of a part with at least a pixel, and the byte with which it begins; `None` where it is not within the plane.
    fn part(&self, columns: &Range<usize>, rows: &Range<usize>) -> Option<(Self, usize)> {
        let is_within = |part: &Range<usize>, count| part.start < part.end && part.end <= count;
        (is_within(columns, self.width) && is_within(rows, self.height)).then(|| {
            let start = rows.start * self.stride + columns.start * self.step * self.format.bytes();
            (Self { width: columns.len(), height: rows.len(), ..*self }, start)
        })
    }

    fn check(&self, len: usize) -> Result<(), PlaneError> {
        if !(1..=4).contains(&self.channels) || self.step < self.channels {
            return Err(PlaneError::Channels { channels: self.channels, step: self.step });
        }
        let row = self.width.saturating_mul(self.step).saturating_sub(self.step - self.channels);
        let row = row.saturating_mul(self.format.bytes());
        if self.height > 1 && self.stride < row {
            return Err(PlaneError::Stride { stride: self.stride, row });
        }
        match self.required_bytes() {
            Some(needed) if needed <= len => Ok(()),
            Some(needed) => Err(PlaneError::TooShort { len, needed }),
            None => Err(PlaneError::TooShort { len, needed: usize::MAX }),
        }
    }
}

/// Why bytes and a layout are not a valid plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum PlaneError {
    /// The buffer ends before the last sample.
    #[error("plane needs {needed} bytes, the buffer holds {len}")]
    TooShort {
        /// Bytes in the buffer.
        len: usize,
        /// Bytes needed.
        needed: usize,
    },
    /// Rows overlap.
    #[error("stride of {stride} bytes is shorter than a row of {row} bytes")]
    Stride {
        /// The stride in bytes.
        stride: usize,
        /// A row in bytes.
        row: usize,
    },
    /// Not 1 to 4 channels, or pixels overlap.
    #[error("{channels} channels at a step of {step} samples: need 1 to 4 channels and step >= channels")]
    Channels {
        /// Channels asked for.
        channels: usize,
        /// Step in samples.
        step: usize,
    },
}

/// A read-only view of a plane.
#[derive(Clone, Copy, Debug)]
pub struct Plane<'a> {
    data: &'a [u8],
    layout: PlaneLayout,
}

impl<'a> Plane<'a> {
    /// Checks that `data`, which starts at the first sample, holds the whole plane.
    ///
    /// # Errors
    /// If it does not, or the layout is invalid; see [`PlaneError`].
    pub fn new(data: &'a [u8], layout: PlaneLayout) -> Result<Self, PlaneError> {
        let layout = layout.checked(data.len())?;
        Ok(Self { data, layout })
    }

    /// Where the samples lie.
    #[must_use]
    pub fn layout(&self) -> &PlaneLayout {
        &self.layout
    }

    /// The bytes, from the first sample on.
    #[must_use]
    pub fn data(&self) -> &'a [u8] {
        self.data
    }

    /// The view of a part with at least a pixel; `None` where it is not within the plane.
    pub(crate) fn part(&self, columns: &Range<usize>, rows: &Range<usize>) -> Option<Self> {
        let (layout, start) = self.layout.part(columns, rows)?;
        Self::new(self.data.get(start..)?, layout).ok()
    }

    /// The bytes of row `y`, from its first to its last sample; empty where there is no such row.
    #[must_use]
    pub fn row(&self, y: usize) -> &'a [u8] {
        row_range(&self.layout, y).and_then(|range| self.data.get(range)).unwrap_or(&[])
    }
}

/// A view of a plane that can be written.
#[derive(Debug)]
pub struct PlaneMut<'a> {
    data: &'a mut [u8],
    layout: PlaneLayout,
}

impl<'a> PlaneMut<'a> {
    /// Checks that `data`, which starts at the first sample, holds the whole plane.
    ///
    /// # Errors
    /// If it does not, or the layout is invalid; see [`PlaneError`].
    pub fn new(data: &'a mut [u8], layout: PlaneLayout) -> Result<Self, PlaneError> {
        let layout = layout.checked(data.len())?;
        Ok(Self { data, layout })
    }

    /// Where the samples lie.
    #[must_use]
    pub fn layout(&self) -> &PlaneLayout {
        &self.layout
    }

    /// The bytes, from the first sample on.
    pub fn data_mut(&mut self) -> &mut [u8] {
        self.data
    }

    /// The view of a part with at least a pixel; `None` where it is not within the plane.
    pub(crate) fn part(&mut self, columns: &Range<usize>, rows: &Range<usize>) -> Option<PlaneMut<'_>> {
        let (layout, start) = self.layout.part(columns, rows)?;
        PlaneMut::new(self.data.get_mut(start..)?, layout).ok()
    }

    /// A read-only view of the same samples.
    #[must_use]
    pub fn as_plane(&self) -> Plane<'_> {
        Plane { data: self.data, layout: self.layout }
    }
}

fn row_range(layout: &PlaneLayout, y: usize) -> Option<Range<usize>> {
    if y >= layout.height || layout.width == 0 {
        return None;
    }
    let start = y * layout.stride;
    let samples = (layout.width - 1) * layout.step + layout.channels;
    Some(start..start + samples * layout.format.bytes())
}

/// A plane with channel weights whose weighted sum is the analysed luma.
///
/// Use `Luma::from(plane)` for a plane whose first channel is the luma.
#[derive(Clone, Copy, Debug)]
pub struct Luma<'a> {
    pub(crate) plane: Plane<'a>,
    pub(crate) weights: [f32; 4],
}

impl<'a> Luma<'a> {
    /// The weighted sum of a plane's channels; weights past the plane's channels are ignored.
    ///
    /// # Errors
    /// If one of the weights is not finite.
    pub fn weighted(plane: Plane<'a>, weights: [f32; 4]) -> Result<Self, LumaError> {
        match weights.iter().position(|weight| !weight.is_finite()) {
            Some(channel) => Err(LumaError::Weight { channel, weight: weights[channel] }),
            None => Ok(Self { plane, weights }),
        }
    }

    /// The part within these columns and rows; `None` where it is not within the plane or has no pixels.
    pub(crate) fn part(&self, columns: &Range<usize>, rows: &Range<usize>) -> Option<Self> {
        Some(Self { plane: self.plane.part(columns, rows)?, ..*self })
    }

    /// The samples.
    #[must_use]
    pub const fn plane(&self) -> &Plane<'a> {
        &self.plane
    }

    /// Weight of each channel.
    #[must_use]
    pub const fn weights(&self) -> [f32; 4] {
        self.weights
    }
}

/// Why a plane and weights are not a valid luma.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum LumaError {
    /// A weight that is infinite or NaN.
    #[error("weight {weight} of channel {channel} is not finite")]
    Weight {
        /// The channel, counted from 0.
        channel: usize,
        /// Its weight.
        weight: f32,
    },
}

impl<'a> From<Plane<'a>> for Luma<'a> {
    /// The first channel is the luma.
    fn from(plane: Plane<'a>) -> Self {
        Self { plane, weights: [1.0, 0.0, 0.0, 0.0] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_last_row_is_enough() {
        let layout = PlaneLayout { stride: 16, ..PlaneLayout::packed(3, 2, SampleFormat::U8) };
        let data = [0u8; 19];
        assert_eq!(Plane::new(&data, layout).unwrap().row(1).len(), 3);
        assert_eq!(
            Plane::new(&data[..18], layout).unwrap_err(),
            PlaneError::TooShort { len: 18, needed: 19 }
        );
    }

    #[test]
    fn overlapping_rows_and_pixels_are_refused() {
        let layout = PlaneLayout { stride: 2, ..PlaneLayout::packed(3, 2, SampleFormat::U8) };
        assert!(matches!(Plane::new(&[0; 64], layout), Err(PlaneError::Stride { .. })));
        let layout = PlaneLayout { channels: 2, ..PlaneLayout::packed(3, 2, SampleFormat::U8) };
        assert!(matches!(Plane::new(&[0; 64], layout), Err(PlaneError::Channels { .. })));
    }

    #[test]
    fn weights_of_a_luma_are_finite() {
        let plane = Plane::new(
            &[0; 3],
            PlaneLayout { channels: 3, step: 3, ..PlaneLayout::packed(1, 1, SampleFormat::U8) },
        );
        let plane = plane.unwrap();
        assert_eq!(Luma::weighted(plane, [0.3, 0.6, 0.1, 0.0]).unwrap().weights(), [0.3, 0.6, 0.1, 0.0]);
        for weight in [f32::NAN, f32::INFINITY] {
            let error = Luma::weighted(plane, [0.3, weight, 0.1, 0.0]).unwrap_err();
            assert!(matches!(error, LumaError::Weight { channel: 1, .. }), "{error}");
        }
        assert_eq!(Luma::from(plane).weights(), [1.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn absurd_sizes_are_refused_without_overflow() {
        let layout = PlaneLayout {
            height: usize::MAX,
            stride: usize::MAX,
            ..PlaneLayout::packed(9, 9, SampleFormat::U16)
        };
        assert!(Plane::new(&[0; 64], layout).is_err());
        let layout = PlaneLayout::packed(usize::MAX, usize::MAX, SampleFormat::U16);
        assert!(Plane::new(&[0; 64], layout).is_err());
    }

    #[test]
    fn unused_steps_and_strides_are_replaced() {
        let one = PlaneLayout::packed(1, 1, SampleFormat::U16);
        let plane = PlaneLayout { step: usize::MAX, stride: usize::MAX, ..one };
        assert_eq!(*Plane::new(&[0; 2], plane).unwrap().layout(), one);
        assert_eq!(*PlaneMut::new(&mut [0; 2], plane).unwrap().layout(), one);
        let column = PlaneLayout { height: 3, step: usize::MAX, stride: 4, ..one };
        assert_eq!(Plane::new(&[0; 10], column).unwrap().row(2).len(), 2);
    }

    #[test]
    fn formats_know_their_range() {
        assert_eq!((SampleFormat::U8.max_value(), SampleFormat::U8.bytes()), (255, 1));
        assert_eq!((SampleFormat::U10_HIGH.max_value(), SampleFormat::U10_HIGH.bytes()), (1023, 2));
        assert_eq!((SampleFormat::U12_HIGH.max_value(), SampleFormat::U12_HIGH.bytes()), (4095, 2));
        assert_eq!(SampleFormat::U16.max_value(), 65535);
    }
}
