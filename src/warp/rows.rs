// SPDX-License-Identifier: MIT OR Apache-2.0

//! Processes the rows of a plane in bands, one band per task of the thread pool.

use super::blocks::{BLOCK, Block};
use super::border::PlaneBorder;
use super::kernels::{self, Fixed, Float, Horizontal, OutputFormat, Passes, Vertical};
use super::knots::KnotTable;
use super::settings::Interpolation;
use crate::cpu::{CpuLevel, for_each_cpu};
use crate::parallel::*;
use crate::plane::{Plane, PlaneLayout, PlaneMut};
use std::cell::RefCell;

/// Rows in a band: 68 bands for 1080 rows.
const BAND: usize = 16;

/// The warp of one plane.
pub(super) struct PlaneTask<'a> {
    pub level: CpuLevel,
    pub interpolation: Interpolation,
    pub border: PlaneBorder,
    pub across: &'a KnotTable,
    pub down: &'a KnotTable,
    pub source: Plane<'a>,
}

/// Buffers of one thread, reused for all frames.
#[derive(Default)]
struct RowBuffers {
    knots: Vec<i32>,
    across: Vec<Block>,
    down: Vec<Block>,
    patch: Vec<u8>,
    integers: Vec<i16>,
    floats: Vec<f32>,
}

thread_local! {
    static SCRATCH: RefCell<RowBuffers> = RefCell::default();
}

/// Calls `row` with each row of `dst` (from its first sample on) and its index, in bands.
pub(super) fn for_each_row(dst: &mut PlaneMut<'_>, row: impl Fn(usize, &mut [u8]) + Sync) {
    let PlaneLayout { height, stride, .. } = *dst.layout();
    // The stride of a single row is not used.
    let stride = if height > 1 { stride } else { dst.data_mut().len() }.max(1);
    dst.data_mut().par_chunks_mut(BAND * stride).enumerate().for_each(|(band, bytes)| {
        for (index, bytes) in bytes.chunks_mut(stride).enumerate() {
            if band * BAND + index < height {
                row(band * BAND + index, bytes);
            }
        }
    });
}

impl PlaneTask<'_> {
    /// Fills `dst`, which has the source's size, channels and format.
    pub fn run(&self, dst: &mut PlaneMut<'_>) {
        let layout = *dst.layout();
        let output = OutputFormat {
            bytes: layout.format.bytes(),
            channels: layout.channels,
            step: layout.step,
            max: layout.format.max_value(),
            shift: layout.format.shift(),
        };
        for_each_row(dst, |index, row| {
            SCRATCH.with_borrow_mut(|scratch| self.row(index, output, row, scratch));
        });
    }

    fn row(&self, index: usize, output: OutputFormat, row: &mut [u8], scratch: &mut RowBuffers) {
        let layout = self.source.layout();
        let (first, last, round) = kernels::reach(self.interpolation);
        let knots = self.across.row(self.level, index, round, &mut scratch.knots);
        self.across.blocks(self.level, knots, 0, layout.width as isize - 1, &mut scratch.across);
        let (from, to) = columns_read(self.level, &scratch.across);
        let from = (from + first).div_euclid(BLOCK as isize) * BLOCK as isize;
        let knots = self.down.row(self.level, index, round, &mut scratch.knots);
        self.down.blocks(self.level, knots, from, to + last, &mut scratch.down);

        let vertical = Vertical {
            plane: self.source,
            border: self.border,
            row: index as isize,
            column: from,
            blocks: &scratch.down,
        };
        let RowBuffers { across, patch, integers, floats, .. } = scratch;
        if output.bytes == 1 {
            self.passes::<Fixed>(&vertical, across, output, patch, integers, row);
        } else {
            self.passes::<Float>(&vertical, across, output, patch, floats, row);
        }
    }

    /// Both passes of one row; `patch` and `middle` are buffers.
    fn passes<A: Passes>(
        &self,
        vertical: &Vertical<'_>,
        across: &[Block],
        output: OutputFormat,
        patch: &mut Vec<u8>,
        middle: &mut Vec<A::Number>,
        row: &mut [u8],
    ) {
        kernels::vertical::<A>(self.level, self.interpolation, vertical, patch, middle);
        let PlaneLayout { width, step, .. } = *self.source.layout();
        let horizontal = Horizontal { middle, column: vertical.column, step, blocks: across, width, output };
        kernels::horizontal::<A>(self.level, self.interpolation, &horizontal, row);
    }
}

/// First and last source column of the pixels of these blocks.
fn columns_read(level: CpuLevel, blocks: &[Block]) -> (isize, isize) {
    let (first, last) = extremes(level, blocks);
    (first as isize, last as isize + BLOCK as isize - 1)
}

for_each_cpu! {
    /// The least and the largest source column of the first pixel of a block. No overflow: displacements are
    /// limited by `MAX_DISPLACEMENT`.
    fn extremes(blocks: &[Block]) -> (i32, i32) {
        let (mut least, mut largest, mut left) = (i32::MAX, i32::MIN, 0i32);
        for block in blocks {
            let first = left.wrapping_add(block.first);
            least = least.min(first);
            largest = largest.max(first.wrapping_add(block.span));
            left = left.wrapping_add(BLOCK as i32);
        }
        (least, largest)
    }
}

/// Copies a plane's own samples; samples of other views between them are not written.
pub(super) fn copy(src: &Plane<'_>, dst: &mut PlaneMut<'_>) {
    let (from, to) = (*src.layout(), *dst.layout());
    let bytes = to.format.bytes();
    let own_bytes = to.channels * bytes;
    for_each_row(dst, |index, row| {
        let source = src.row(index);
        if to.step == to.channels && from.step == from.channels {
            row[..source.len()].copy_from_slice(source);
            return;
        }
        let pixels = row.chunks_mut(to.step * bytes).zip(source.chunks(from.step * bytes));
        for (out, pixel) in pixels.take(to.width) {
            out[..own_bytes].copy_from_slice(&pixel[..own_bytes]);
        }
    });
}
