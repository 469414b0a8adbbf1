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
//! | `frames` | number of frames |
//! | `times-fnv1a` | FNV-1a hash, 64 bits in hexadecimal digits, of the frames' times as they are in the index, 8 bytes each |
//! | `index` | offset of the index in the file |
//!
//! **Records**, one a frame, begin after the header in any order:
//!
//! | bytes | |
//! |---|---|
//! | 4 | length of the record in bytes, these included; later minor versions may append to what is below |
//! | 4, 4 | width and height of the frame in pixels |
//! | 1 | readout direction: 0 top to bottom, 1 bottom to top, 2 left to right, 3 right to left |
//! | 1 | kind of the path: 0 uniform, 1 sampled |
//! | 2 | N, samples of a sampled path, 5 to 1025; otherwise 0 |
//! | 2, 2 | columns and rows of the residual mesh, at most 65 536 nodes; 0, 0: none |
//! | 8 | readout time T in seconds |
//! | 8 | share of the correction that is applied, 0 to 1 |
//! | 8 | confidence in the motion, 0 to 1 |
//! | 8 | expected error in pixels; NaN: unknown |
//! | 8 | readout time of the path in seconds |
//! | 8, 8, 8 | uniform: ω in rad/s, vx and vy in px/s at the centre; otherwise 0 |
//! | 8, 8, 8, 8 | origin x and y of the mesh in centred pixels, and its spacing in x and y; without a mesh 0 |
//! | 4 | bytes of what follows |
//! | | integers, zlib-compressed: each as a little-endian base-128 varint (7 bits a byte, the highest bit set in all but the last) of (n << 1) ^ (n >> 63) |
//!
//! The integers are, first, of a sampled path: for each of the eight first elements of the homographies, row by row,
//! the fourth differences over its N samples (differences of differences, four times, the first of each as if 0 came
//! before). The homographies map centred pixels at the shares 0, 1/(N − 1) … 1 of the readout to one common instant.
//! With R half of the longer side of the frame in pixels, an element is its integer times 1/4096, divided by R in the
//! first two columns, and again by R in the last row; 1 is added on the diagonal, and the last element is 1.
//!
//! Then, of the mesh: for each node, row by row, the velocity in x less its prediction, and after all of these the
//! velocities in y. A velocity in pixels per readout is its integer times 1/64 of the spacing in that axis. With the
//! neighbours a to the left, b above and c above a, the prediction is a + b − c, clamped between a and b; in the first
//! row it is a, in the first column b, at the first node 0.
//!
//! **Index**: for each frame, by rising time, 8 bytes with its time in nanoseconds of the clip, signed, and 8 bytes
//! with the offset of its record.

mod clip;
mod error;
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
