// SPDX-License-Identifier: MIT OR Apache-2.0

//! The input of a pass over one output row, and of the knots.

use crate::plane::Plane;
use crate::warp::blocks::Block;
use crate::warp::border::PlaneBorder;

/// Largest displacement in plane pixels: a scale near zero makes displacements infinite or NaN, which vector
/// kernels and plain Rust would convert to different integers.
pub(in crate::warp) const MAX_DISPLACEMENT: f32 = 4e5;

/// A column of knots: the first of four columns of nodes, and the weights of these.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::warp) struct KnotColumn {
    pub node: usize,
    pub weights: [f32; 4],
}

/// One output row of the vertical pass.
#[derive(Clone, Copy)]
pub(in crate::warp) struct Vertical<'a> {
    /// The source plane.
    pub plane: Plane<'a>,
    /// The picture outside of it.
    pub border: PlaneBorder,
    /// The output row.
    pub row: isize,
    /// The first column, a multiple of 16.
    pub column: isize,
    /// Displacements of the columns.
    pub blocks: &'a [Block],
}

/// One output row of the horizontal pass.
#[derive(Clone, Copy)]
pub(in crate::warp) struct Horizontal<'a, M> {
    /// Samples from the vertical pass, `step` per pixel.
    pub middle: &'a [M],
    /// Column of the first sample.
    pub column: isize,
    /// Samples from one pixel to the next in `middle`.
    pub step: usize,
    /// Displacements of the pixels.
    pub blocks: &'a [Block],
    /// Pixels in the row.
    pub width: usize,
    /// How the output row is stored.
    pub output: OutputFormat,
}

/// How the output row is stored.
#[derive(Clone, Copy)]
pub(in crate::warp) struct OutputFormat {
    /// Bytes a sample: 1 or 2.
    pub bytes: usize,
    /// Samples written per pixel.
    pub channels: usize,
    /// Samples from one pixel to the next.
    pub step: usize,
    /// The largest value, before the shift.
    pub max: u16,
    /// The format's shift.
    pub shift: u32,
}
