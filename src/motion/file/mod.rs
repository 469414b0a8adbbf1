// SPDX-License-Identifier: MIT OR Apache-2.0

//! Motion files: the motion of every frame of a clip, found once and applied anywhere.
//!
//! A rectifier that looks ahead writes them; a filter that is given one frame at a time, in any order, reads from
//! them what the warp needs. Frames are found by their *time* in the clip, not by a number, so that trimmed, split
//! and re-timed clips and proxies of another size can be rectified with one file
//! (see [`FrameMotion::scaled_to`](super::FrameMotion::scaled_to)).
//!
//! # The format, version 1.0
//!
//! Numbers are little-endian, floating-point numbers IEEE 754.
//!
//! **Header**: 1024 bytes of UTF-8 text. The first line is `rsrectify motion 1.0`, with the major and the minor
//! version; a reader of another major version must refuse the file. Each further line is a key, a colon and a space,
//! and a value; keys that a reader does not know are to be ignored. The text is padded with spaces, and the last byte
//! ends a line.
//!
//! | key | value |
//! |---|---|
//! | `clip` | name of the clip's file; control characters are replaced |
//! | `clip-bytes` | size of that file |
//! | `turned` | degrees by which players turn the frames clockwise to show them upright: 0, 90, 180 or 270; the motions are those of the frames before |
//! | `mirrored` | `yes` if players also mirror the frames, `no` otherwise |
//! | `pixel-aspect` | width over height of a pixel, as `64:45` |
//! | `zoom` | factor, 1 or more, by which the rectified frames are to be enlarged about their centre, so that no border is seen |
//! | `frames` | number of frames |
//! | `times-fnv1a` | FNV-1a hash, 64 bits in hexadecimal digits, of the frames' times as they are in the index, 8 bytes each |
//! | `index` | offset of the index in the file |
//!
//! **Records**, one a frame, begin after the header in any order:
//!
//! | bytes | |
//! |---|---|
//! | 4 | length of the record in bytes, these included; later minor versions may append to what is below |
//! | 4, 4 | width and height of the picture in pixels: of the frame, without the bars beside it |
//! | 1 | readout direction: 0 top to bottom, 1 bottom to top, 2 left to right, 3 right to left |
//! | 1 | kind of the path: 0 uniform, 1 sampled |
//! | 2 | N, samples of a sampled path, 5 to 1025; otherwise 0 |
//! | 2, 2 | columns and rows of the residual mesh, at most 65 536 nodes; 0, 0: none |
//! | 2 | 1 if the frame is stabilised and has a placement, plus 2 if bars lie beside the picture |
//! | 8 | readout time T in seconds |
//! | 8 | share of the correction that is applied, 0 to 1 |
//! | 8 | confidence in the motion, 0 to 1 |
//! | 8 | expected error in pixels; NaN: unknown |
//! | 8 | readout time of the path in seconds |
//! | 8, 8, 8 | uniform: ω in rad/s, vx and vy in px/s at the centre; otherwise 0 |
//! | 8, 8, 8, 8 | origin x and y of the mesh in centred pixels, and its spacing in x and y; without a mesh 0 |
//! | 4 | how many bytes the integers take |
//! | 4 | checksum: the low 32 bits of the FNV-1a hash (64 bits) of bytes 4 to 121 and of all that follows: placement, place and integers |
//! | 8 × 8 | only with a placement: the first eight elements of its homography, row by row; the last is 1 |
//! | 4, 4, 4, 4 | only with bars: width and height of the frame, column and row of the picture's first pixel |
//! | | the integers, coded as below |
//!
//! The placement maps centred pixels of the picture at the middle of the readout to where the output shows them, before the zoom.
//!
//! The integers are, first, of a sampled path: for each of the eight first elements of the homographies, row by row,
//! the fourth differences over its N samples (differences of differences, four times, the first of each as if 0 came
//! before). The homographies map centred pixels at the shares 0, 1/(N − 1) … 1 of the readout to one common instant.
//! With R half of the longer side of the picture in pixels, an element is its integer times 1/4096, divided by R in the
//! first two columns, and again by R in the last row; 1 is added on the diagonal, and the last element is 1.
//!
//! Then, of the mesh: for each node, row by row, the velocity in x less its prediction, and after all of these the
//! velocities in y. A velocity in pixels per readout is its integer times 1/24 of the spacing in that axis. With the
//! integers W to the left of the node, N above it, NW, NE, WW and NN, the prediction is
//! ⌊(21 W + 20 N − 12 NW + NE + WW + NN + 16) / 32⌋. Outside of the mesh, NN and NE stand for N, and WW for W; in the first
//! column W and NW, too, stand for N, in the first row all but WW for W; at the first node all are 0.
//!
//! **Integers** are coded bit by bit, each bit with a probability that is learnt from the bits before in the same context. A probability
//! p, in 1/65536, that a bit is set is 32768 at first. After each bit, of which n came before (255 at most), it grows by
//! 2·(65536·bit − p)/(2n + 3), rounded towards 0. The coder has an interval that begins at `low`, 0, and is
//! `range` long, 2³² − 1, in units of 2⁻³²: a set bit takes the first ⌊range/2¹⁶⌋·p of it, a bit that is not set the rest.
//! While range is below 2²⁴ both are multiplied by 2⁸ and their unit is divided by that. The bytes are the digits to the base 256,
//! behind the point, of a number in the last interval; zeros at their end are left out.
//!
//! Of an integer, the first bit is set if it is 0, the second one if it is negative; the rest codes its magnitude. A *long* magnitude
//! m ≥ 1 of b bits is b − 1 set bits, each in the context of its place, and, if b < 64, one that is not set; then its lower b − 1 bits from the
//! highest on, with an even probability that is not learnt. The magnitude of an error of the mesh is counted: a bit for each number
//! from 1 to 20, in the context of the number, that is set where it is the magnitude; one above 20 is coded as long less 20.
//!
//! Activities have 13 classes, by the upper limits 0, 1, 2, 3, 4, 6, 8, 12, 17, 25, 40 and 70. The context of all bits of an integer of the
//! path is its place for the first four of an element, then the class of the sum of the magnitudes of the two before, at most 7.
//! The contexts of the mesh, the same in x and in y, are the class of |W − NW| + |N − NW| + |N − NE| and the magnitudes
//! of the errors at W and N, 0 outside of the mesh; and, for the first two bits, the fraction of the prediction before it is rounded
//! down, in eighths. Those of what is beyond 20 depend on its place alone.
//!
//! **Index**: for each frame, by rising time, 8 bytes with its time in nanoseconds of the clip, signed, and 8 bytes
//! with the offset of its record.

mod arithmetic;
mod clip;
mod error;
mod hash;
mod header;
mod packed;
mod reader;
mod record;
mod source;
#[cfg(test)]
mod tests;
mod writer;

pub use clip::Clip;
pub use error::{MotionFileError, RecordError};
pub use reader::MotionFile;
pub use record::MotionRecord;
pub use writer::MotionWriter;
