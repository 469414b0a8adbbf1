// SPDX-License-Identifier: MIT OR Apache-2.0

//! Frames as careless upstreams make them: padded, split, read-only, too small, with wild timestamps.

use super::setup::Setup;
use gst_video::{VideoInfo, VideoMeta};
use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use std::sync::atomic::{AtomicIsize, Ordering};

/// What is wrong with a frame, if anything.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Defect {
    /// Nothing.
    None,
    /// Fewer bytes than the caps need.
    TooSmall,
    /// No memory at all.
    Empty,
    /// No memory, flagged as repeating the frame before.
    EmptyGap,
    /// A meta that describes another frame.
    OtherMeta,
}

/// A frame to push.
pub struct Frame {
    /// The buffer.
    pub buffer: gst::Buffer,
    /// What is wrong with it.
    pub defect: Defect,
    /// The value of every byte, where the picture has one colour.
    pub shade: Option<u8>,
    /// Whether the planes are where the caps say, or upstream was told that they need not be.
    pub proper_layout: bool,
}

/// Bytes that are counted while they live.
struct Counted(Vec<u8>, Arc<AtomicIsize>);

impl Counted {
    fn new(bytes: Vec<u8>, alive: &Arc<AtomicIsize>) -> Self {
        alive.fetch_add(1, Ordering::SeqCst);
        Self(bytes, alive.clone())
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.1.fetch_sub(1, Ordering::SeqCst);
    }
}

impl AsRef<[u8]> for Counted {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

impl AsMut<[u8]> for Counted {
    fn as_mut(&mut self) -> &mut [u8] {
        &mut self.0
    }
}

/// The timestamps of a stream.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// Time of the next frame.
    next: i64,
    /// From frame to frame; negative in reverse playback.
    step: i64,
}

impl Timing {
    /// Frames from `start` on.
    pub fn new(start: u64, period: u64, reverse: bool) -> Self {
        let step = i64::try_from(period).unwrap_or(i64::MAX).clamp(1, 10_000_000_000);
        Self { next: start as i64, step: if reverse { -step } else { step } }
    }

    fn next(&mut self, rng: &mut ChaCha8Rng, wildness: f64) -> Option<gst::ClockTime> {
        let now = self.next;
        self.next = self.next.saturating_add(self.step);
        if !rng.random_bool(wildness) {
            return Some(gst::ClockTime::from_nseconds(now.max(0) as u64));
        }
        match rng.random_range(0..6) {
            0 => None,
            // As if frames had been dropped.
            1 => {
                self.next = self.next.saturating_add(self.step.saturating_mul(rng.random_range(1..100)));
                Some(gst::ClockTime::from_nseconds(now.max(0) as u64))
            }
            // The time of the last frame again, or shortly before it.
            2 => Some(gst::ClockTime::from_nseconds(now.saturating_sub(self.step).max(0) as u64)),
            3 => Some(gst::ClockTime::from_nseconds(rng.random_range(0..u64::MAX - 1))),
            4 => Some(gst::ClockTime::from_nseconds(u64::MAX - 1)),
            _ => Some(gst::ClockTime::from_nseconds(
                now.saturating_add(rng.random_range(-20_000_000..20_000_000)).max(0) as u64,
            )),
        }
    }
}

const FLAGS: [gst::BufferFlags; 11] = [
    gst::BufferFlags::DISCONT,
    gst::BufferFlags::GAP,
    gst::BufferFlags::LIVE,
    gst::BufferFlags::RESYNC,
    gst::BufferFlags::CORRUPTED,
    gst::BufferFlags::MARKER,
    gst::BufferFlags::HEADER,
    gst::BufferFlags::DROPPABLE,
    gst::BufferFlags::DELTA_UNIT,
    gst::BufferFlags::SYNC_AFTER,
    gst::BufferFlags::NON_DROPPABLE,
];

/// Makes frame `number`; `strides_welcome` is what the element told upstream.
pub fn frame(
    rng: &mut ChaCha8Rng,
    setup: &Setup,
    info: &VideoInfo,
    timing: &mut Timing,
    number: usize,
    strides_welcome: bool,
    alive: &Arc<AtomicIsize>,
) -> Frame {
    let defect = match rng.random_bool(setup.defects) {
        false => Defect::None,
        true => *[Defect::TooSmall, Defect::Empty, Defect::EmptyGap, Defect::EmptyGap, Defect::OtherMeta]
            .choose(rng)
            .unwrap_or(&Defect::Empty),
    };
    let flat = rng.random_bool(setup.flat);
    let shade = 16 + (number % 200) as u8;
    let padded = rng.random_bool(0.3) && (strides_welcome || rng.random_bool(setup.defects));
    let layout = if padded { Layout::padded(rng, info) } else { Layout::of_caps(info) };
    let mut bytes = layout.paint(info, shade, if flat { None } else { Some(number) });
    let mut proper_layout = !padded || strides_welcome;
    match defect {
        Defect::TooSmall => bytes.truncate(rng.random_range(0..bytes.len().max(1))),
        _ if !padded && rng.random_bool(setup.defects) => {
            // More than the caps need, with nothing to explain it.
            bytes.extend_from_slice(&[0xaa; 37]);
            proper_layout = false;
        }
        _ => (),
    }
    let mut buffer = match defect {
        Defect::Empty | Defect::EmptyGap => gst::Buffer::new(),
        _ => stored(rng, bytes, padded.then_some(&layout), alive),
    };
    let inner = buffer.make_mut();
    if padded && defect != Defect::Empty && defect != Defect::EmptyGap {
        let flags = gst_video::VideoFrameFlags::empty();
        let (format, width, height) = (info.format(), info.width(), info.height());
        let (offsets, strides) = (&layout.offsets, &layout.strides);
        // A meta larger than a buffer that is too small is refused by GStreamer itself.
        let _ = VideoMeta::add_full(inner, flags, format, width, height, offsets, strides);
    }
    if defect == Defect::OtherMeta {
        let flags = gst_video::VideoFrameFlags::empty();
        let (format, width, height) = (info.format(), info.width(), info.height());
        let _ = VideoMeta::add(inner, flags, format, width.div_ceil(2).max(1), height.div_ceil(3).max(1));
    }
    if rng.random_bool(0.1) {
        gst_video::VideoRegionOfInterestMeta::add(inner, "face", (0, 0, 1, 1));
    }
    if rng.random_bool(0.02) {
        gst_video::VideoCropMeta::add(inner, (0, 0, info.width(), info.height()));
    }
    describe(rng, setup, inner, timing, number);
    if defect == Defect::EmptyGap {
        inner.set_flags(gst::BufferFlags::GAP);
    }
    let whole = defect == Defect::None && info.n_components() > 0 && info.comp_depth(0) == 8;
    Frame { buffer, defect, shade: (flat && whole && !setup.paints_borders).then_some(shade), proper_layout }
}

/// Sets what the buffer says of itself.
fn describe(
    rng: &mut ChaCha8Rng,
    setup: &Setup,
    buffer: &mut gst::BufferRef,
    timing: &mut Timing,
    number: usize,
) {
    buffer.set_offset(number as u64);
    buffer.set_offset_end(rng.random());
    buffer.set_pts(timing.next(rng, setup.wild_times));
    if rng.random_bool(0.5) {
        buffer.set_dts(gst::ClockTime::from_nseconds(rng.random_range(0..u64::MAX - 1)));
    }
    if rng.random_bool(0.7) {
        let step = timing.step.unsigned_abs();
        let length = if rng.random_bool(setup.wild_times) { rng.random_range(0..u64::MAX - 1) } else { step };
        buffer.set_duration(gst::ClockTime::from_nseconds(length));
    }
    if rng.random_bool(setup.flags)
        && let Some(&flag) = FLAGS.choose(rng)
    {
        buffer.set_flags(flag);
    }
}

/// The bytes in a buffer: of one or more memories, some of them only for reading, some within others.
///
/// Where a meta tells where the planes are, GStreamer maps each of them from one memory.
fn stored(
    rng: &mut ChaCha8Rng,
    bytes: Vec<u8>,
    described: Option<&Layout>,
    alive: &Arc<AtomicIsize>,
) -> gst::Buffer {
    let middle = match described {
        Some(layout) => layout.offsets.last().copied().unwrap_or(0),
        None => rng.random_range(0..bytes.len().max(1)),
    };
    match rng.random_range(0..8) {
        0 => gst::Buffer::from_slice(Counted::new(bytes, alive)),
        1 if (1..bytes.len()).contains(&middle) => {
            let mut buffer = gst::Buffer::new();
            for part in [&bytes[..middle], &bytes[middle..]] {
                let memory = gst::Memory::from_mut_slice(Counted::new(part.to_vec(), alive));
                buffer.make_mut().append_memory(memory);
            }
            buffer
        }
        2 => {
            let length = bytes.len();
            let mut longer = vec![0x55; 13];
            longer.extend(bytes);
            longer.extend([0x55; 7]);
            let buffer = gst::Buffer::from_mut_slice(Counted::new(longer, alive));
            buffer.copy_region(gst::BufferCopyFlags::MEMORY, 13..13 + length).unwrap_or(buffer)
        }
        _ => gst::Buffer::from_mut_slice(Counted::new(bytes, alive)),
    }
}

/// Where the planes are.
struct Layout {
    offsets: Vec<usize>,
    strides: Vec<i32>,
    rows: Vec<usize>,
    size: usize,
}

impl Layout {
    fn of_caps(info: &VideoInfo) -> Self {
        Self {
            offsets: info.offset().to_vec(),
            strides: info.stride().to_vec(),
            rows: plane_rows(info),
            size: info.size(),
        }
    }

    /// Rows with more bytes than needed, planes with gaps between.
    fn padded(rng: &mut ChaCha8Rng, info: &VideoInfo) -> Self {
        let pad = *[2usize, 6, 16, 64].choose(rng).unwrap_or(&16);
        let (mut offsets, mut strides, mut size) = (Vec::new(), Vec::new(), rng.random_range(0..3) * pad);
        let rows = plane_rows(info);
        for (plane, &rows) in rows.iter().enumerate() {
            let stride = info.stride()[plane] as usize + pad;
            offsets.push(size);
            strides.push(stride as i32);
            size += stride * rows + rng.random_range(0..3) * pad;
        }
        Self { offsets, strides, rows, size }
    }

    /// A picture of one colour or, moved by its number, of speckles; what is no picture has another value.
    fn paint(&self, info: &VideoInfo, shade: u8, speckles: Option<usize>) -> Vec<u8> {
        let mut bytes = vec![shade ^ 0xff; self.size];
        for (plane, &offset) in self.offsets.iter().enumerate() {
            let (stride, used) = (self.strides[plane] as usize, info.stride()[plane] as usize);
            for row in 0..self.rows[plane] {
                let start = offset + row * stride;
                let Some(line) = bytes.get_mut(start..start + used) else { continue };
                match speckles {
                    None => line.fill(shade),
                    Some(number) => {
                        line.iter_mut().enumerate().for_each(|(x, byte)| *byte = speckle(x, row, number));
                    }
                }
            }
        }
        bytes
    }
}

/// How many rows each plane has.
fn plane_rows(info: &VideoInfo) -> Vec<usize> {
    let rows = |plane: u32| {
        let component = (0..info.n_components() as u8).find(|&c| info.comp_plane(c) == plane);
        component.map_or(0, |component| info.comp_height(component) as usize)
    };
    (0..info.n_planes()).map(rows).collect()
}

/// A texture that moves by 3 bytes and 2 rows a frame.
fn speckle(x: usize, row: usize, number: usize) -> u8 {
    let (x, y) = ((x + 3 * number) / 5, (row + 2 * number) / 5);
    let hash = (x.wrapping_mul(0x9e37) ^ y.wrapping_mul(0x85eb)) ^ x.wrapping_mul(y);
    (hash.wrapping_mul(0x2545) >> 4) as u8
}
