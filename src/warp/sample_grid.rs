// SPDX-License-Identifier: MIT OR Apache-2.0

//! Where the samples of a plane lie in the frame.

/// Where the samples of a plane lie in the frame: frame pixel = scale · plane pixel + offset, per axis,
/// pixel centres at integers.
///
/// Chroma of 4:2:0 has scale 2, and offset 0 if sited on the luma pixel, ½ if sited between two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleGrid {
    /// Frame pixels from one plane pixel to the next, in x and y.
    pub scale: [f64; 2],
    /// Frame pixel of plane pixel (0, 0).
    pub offset: [f64; 2],
}

impl SampleGrid {
    /// A plane of the frame's own size.
    pub const FULL: Self = Self { scale: [1.0, 1.0], offset: [0.0, 0.0] };

    /// Chroma of 4:2:0 as MPEG-2 and its successors site it: on every other luma column, between two luma rows.
    pub const CHROMA_420: Self = Self { scale: [2.0, 2.0], offset: [0.0, 0.5] };

    /// Whether scales are positive and all numbers finite.
    pub(super) fn is_valid(&self) -> bool {
        let numbers = self.scale.iter().chain(&self.offset);
        numbers.into_iter().all(|number| number.is_finite()) && self.scale.iter().all(|&scale| scale > 0.0)
    }
}
