// SPDX-License-Identifier: MIT OR Apache-2.0

//! The samples that a block of the vertical pass reads: in place if inside the plane, otherwise a copy with
//! the plane's border. Counted for a cubic, mean of all blocks that extend beyond an edge: 250 instructions.

use super::task::Vertical;
use crate::warp::blocks::{BLOCK, Block};
use crate::warp::border::{PlaneBorder, resolve};
use crate::warp::weights::Kernel;
use std::ops::Range;

/// The samples that one block of the vertical pass reads: `bytes` holds 16 pixels in each of `taps + span` rows, which kernels do not
/// check again. So each window is a slice of exactly these; only this file makes windows.
pub(super) struct SourceWindow<'a> {
    /// From pixel 0 in the first tap's row at the least displacement on.
    pub bytes: &'a [u8],
    /// Bytes from one row to the next; 0 if all rows are identical.
    pub stride: usize,
}

/// Byte offsets of the 16 pixels of a row of the window in a row of the plane.
#[expect(clippy::large_enum_variant, reason = "one at a time, on the stack")]
enum Columns {
    /// Contiguous, starting at this byte.
    InPlace(usize),
    /// All at this byte; `None` for the fill value.
    Single(Option<usize>),
    /// Each at its own byte; `None` for the fill value.
    Listed([Option<usize>; BLOCK]),
}

/// The windows of the blocks of one row: what they have in common.
pub(super) struct Windows<'a> {
    task: Vertical<'a>,
    /// Blocks whose columns all lie inside the plane.
    inside: Range<usize>,
    /// Row of the first tap where the displacement is zero.
    top: isize,
    taps: usize,
    height: usize,
    /// Bytes from one row to the next, and of the 16 pixels of a block.
    stride: usize,
    block_bytes: usize,
    /// Byte offset of the first block in a row; wraps around where that lies before the row.
    left: usize,
}

impl<'a> Vertical<'a> {
    /// The windows of this row for the taps of a kernel.
    #[inline(always)]
    pub(super) fn windows<K: Kernel>(&self) -> Windows<'a> {
        let layout = *self.plane.layout();
        let pixel = layout.step * layout.format.bytes();
        let before = (-self.column).max(0) as usize;
        let whole = (self.whole_pixels() - self.column).max(0) as usize;
        Windows {
            task: *self,
            inside: before.div_ceil(BLOCK)..whole / BLOCK,
            top: self.row + K::FIRST,
            taps: K::TAPS,
            height: layout.height,
            stride: layout.stride,
            block_bytes: BLOCK * pixel,
            left: self.column.wrapping_mul(pixel as isize) as usize,
        }
    }
}

impl<'a> Windows<'a> {
    /// The window of a block, the one of this index: `taps + span` rows of 16 pixels.
    #[inline(always)]
    pub(super) fn of<'b>(&self, index: usize, block: &Block, patch: &'b mut Vec<u8>) -> SourceWindow<'b>
    where
        'a: 'b,
    {
        let rows = self.taps + block.span as usize;
        let top = self.top + block.first as isize;
        if self.inside.contains(&index) && top >= 0 && top as usize + rows <= self.height {
            let offset = self.left.wrapping_add(top as usize * self.stride + index * self.block_bytes);
            let end = offset + (rows - 1) * self.stride + self.block_bytes;
            return SourceWindow { bytes: &self.task.plane.data()[offset..end], stride: self.stride };
        }
        self.task.border_window([self.task.column + (index * BLOCK) as isize, top], rows, patch)
    }
}

impl<'a> Vertical<'a> {
    /// Pixels of a row whose step ends within the row; that of the last one may not.
    fn whole_pixels(&self) -> isize {
        let layout = self.plane.layout();
        layout.width as isize - isize::from(layout.step > layout.channels)
    }

    /// The window of `rows` rows of 16 pixels with top left pixel (left, top), some of them outside the
    /// plane. Not inlined, to keep the common case small.
    #[inline(never)]
    fn border_window<'b>(
        &self,
        [left, top]: [isize; 2],
        rows: usize,
        patch: &'b mut Vec<u8>,
    ) -> SourceWindow<'b>
    where
        'a: 'b,
    {
        let layout = self.plane.layout();
        let data = self.plane.data();
        let height = layout.height as isize;
        // Unless mirrored, all rows beyond an edge are identical.
        let is_uniform = self.border != PlaneBorder::Mirror && (top >= height || top + rows as isize <= 0);
        // Byte offset of the row shown.
        let shown = |row: isize| resolve(row, layout.height, self.border).map(|row| row * layout.stride);
        let columns = self.columns(left);
        let pixel = layout.step * layout.format.bytes();
        let own_bytes = layout.channels * layout.format.bytes();
        let bytes = BLOCK * pixel;
        if let (true, Columns::InPlace(from), Some(row)) = (is_uniform, &columns, shown(top)) {
            return SourceWindow { bytes: &data[row + from..][..bytes], stride: 0 };
        }
        let (rows, stride) = if is_uniform { (1, 0) } else { (rows, bytes) };
        // Samples of other views between a pixel's own samples are not initialised.
        if patch.len() < rows * bytes {
            patch.resize(rows * bytes, 0);
        }
        for index in 0..rows {
            let out = &mut patch[index * bytes..][..bytes];
            match (shown(top + index as isize), &columns) {
                (Some(row), Columns::InPlace(from)) => copy_row(&data[row + from..][..bytes], out),
                (Some(row), Columns::Single(Some(at))) => {
                    copy_pixel(&data[row + at..], out, own_bytes);
                    repeat_first(out, pixel);
                }
                (Some(row), Columns::Listed(columns)) => self.copy_pixels(&data[row..], columns, out),
                _ => self.fill(out, pixel),
            }
        }
        SourceWindow { bytes: &patch[..rows * bytes], stride }
    }

    /// The 16 pixels starting at column `left`.
    fn columns(&self, left: isize) -> Columns {
        let layout = self.plane.layout();
        let width = layout.width as isize;
        let pixel = layout.step * layout.format.bytes();
        let shown = |column: isize| resolve(column, layout.width, self.border).map(|column| column * pixel);
        if left >= 0 && left + BLOCK as isize <= self.whole_pixels() {
            Columns::InPlace(left as usize * pixel)
        } else if self.border != PlaneBorder::Mirror && (left >= width || left + BLOCK as isize <= 0) {
            Columns::Single(shown(left))
        } else {
            Columns::Listed(std::array::from_fn(|index| shown(left + index as isize)))
        }
    }

    /// Not inlined, to keep the common cases small, and so with [`fill`](Self::fill).
    #[inline(never)]
    fn copy_pixels(&self, row: &[u8], columns: &[Option<usize>; BLOCK], out: &mut [u8]) {
        let layout = self.plane.layout();
        let own_bytes = layout.channels * layout.format.bytes();
        for (column, out) in columns.iter().zip(out.chunks_exact_mut(out.len() / BLOCK)) {
            match *column {
                Some(at) => copy_pixel(&row[at..], out, own_bytes),
                None => self.copy_fill(out),
            }
        }
    }

    /// Writes the fill value to all pixels of `out`.
    #[inline(never)]
    fn fill(&self, out: &mut [u8], pixel: usize) {
        self.copy_fill(out);
        repeat_first(out, pixel);
    }

    /// Writes the fill value to the first pixel of `out`.
    fn copy_fill(&self, out: &mut [u8]) {
        let PlaneBorder::Constant(fill) = self.border else { return };
        let layout = self.plane.layout();
        let format = layout.format;
        let samples = out.chunks_exact_mut(format.bytes()).take(layout.channels);
        for (sample, fill) in samples.zip(fill) {
            let stored = fill.min(format.max_value()) << format.shift();
            sample.copy_from_slice(&stored.to_le_bytes()[..format.bytes()]);
        }
    }
}

/// Copies the view's own samples of a pixel, `own_bytes` in all.
#[inline(always)]
fn copy_pixel(pixel: &[u8], out: &mut [u8], own_bytes: usize) {
    // Avoids a call for a single byte.
    if own_bytes == 1 {
        out[0] = pixel[0];
    } else {
        out[..own_bytes].copy_from_slice(&pixel[..own_bytes]);
    }
}

/// Copies 16 pixels.
fn copy_row(pixels: &[u8], out: &mut [u8]) {
    // A constant size compiles to a load and a store.
    match (<&[u8; BLOCK]>::try_from(pixels), <&mut [u8; BLOCK]>::try_from(&mut *out)) {
        (Ok(pixels), Ok(out)) => *out = *pixels,
        _ => out.copy_from_slice(pixels),
    }
}

/// Copies the first of 16 pixels to all others.
fn repeat_first(out: &mut [u8], pixel: usize) {
    if let Ok(out) = <&mut [u8; BLOCK]>::try_from(&mut *out) {
        *out = [out[0]; BLOCK];
        return;
    }
    let mut filled = pixel;
    while filled < out.len() {
        let (from, to) = out.split_at_mut(filled);
        to[..filled].copy_from_slice(from);
        filled *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::{Plane, PlaneLayout, SampleFormat};
    use crate::warp::weights::Cubic;

    const FILL: [u16; 4] = [9, 8, 7, 6];

    /// Two bytes for all formats, the second zero for 8 bits.
    fn sample(bytes: &[u8], at: usize, size: usize) -> [u8; 2] {
        [bytes[at], if size == 2 { bytes[at + 1] } else { 0 }]
    }

    #[test]
    fn windows_show_what_each_sample_resolves_to() {
        let borders = [PlaneBorder::Replicate, PlaneBorder::Mirror, PlaneBorder::Constant(FILL)];
        let layouts = [(1, 1, 0), (1, 2, 1), (2, 2, 3), (3, 4, 0), (4, 4, 4)];
        for format in [SampleFormat::U8, SampleFormat::U12_HIGH] {
            for (width, height) in [(1, 1), (16, 5), (32, 9), (41, 3)] {
                for (channels, step, spare) in layouts {
                    let size = format.bytes();
                    let stride = (width * step + spare) * size;
                    let layout = PlaneLayout { width, height, stride, step, channels, format };
                    let data: Vec<u8> =
                        (0..layout.required_bytes().unwrap()).map(|index| (index * 37 % 251) as u8).collect();
                    let plane = Plane::new(&data, layout).unwrap();
                    for border in borders {
                        for row in -7..height as isize + 7 {
                            check(&Vertical {
                                plane,
                                border,
                                row,
                                column: -32,
                                blocks: &[Block::default(); 7],
                            });
                        }
                    }
                }
            }
        }
    }

    /// Compares all own samples of all windows.
    fn check(task: &Vertical<'_>) {
        let layout = task.plane.layout();
        let size = layout.format.bytes();
        for index in 0..task.blocks.len() {
            let mut patch = Vec::new();
            let window = task.windows::<Cubic>().of(index, &task.blocks[index], &mut patch);
            for (tap, pixel, channel) in
                (0..4 * 16 * layout.channels).map(|sample| (sample % 4, sample / 4 % 16, sample / 64))
            {
                let at = tap * window.stride + (pixel * layout.step + channel) * size;
                let row = resolve(task.row + tap as isize - 1, layout.height, task.border);
                let column = resolve(task.column + (16 * index + pixel) as isize, layout.width, task.border);
                let truth = match row.zip(column) {
                    Some((row, column)) => {
                        sample(task.plane.row(row), (column * layout.step + channel) * size, size)
                    }
                    None => (FILL[channel] << layout.format.shift()).to_le_bytes(),
                };
                assert_eq!(
                    sample(window.bytes, at, size),
                    truth,
                    "{layout:?} {:?} {index} {tap} {pixel}",
                    task.border
                );
            }
        }
    }
}
