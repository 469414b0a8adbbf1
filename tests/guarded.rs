// SPDX-License-Identifier: MIT OR Apache-2.0

//! Planes, and buffers of the library, that begin and end at pages that nobody may read or write: a kernel that reaches
//! past them, by raw pointer too, ends the process with a segmentation fault.
#![cfg(unix)]

use nalgebra::Vector2;
use rsrectify::correspond::{Correspondence, Pyramid, Sampler};
use rsrectify::flow::FlowField;
use rsrectify::motion::{FrameMotion, MotionPath, Twist};
use rsrectify::plane::{Luma, Plane, PlaneLayout, PlaneMut, SampleFormat};
use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};
use rsrectify::warp::{BorderMode, CpuLevel, Fill, Interpolation, SampleGrid, WarpSettings, Warper};
use rustix::mm::{MapFlags, MprotectFlags, ProtFlags, mmap_anonymous, mprotect, munmap};
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

const FORMATS: [SampleFormat; 5] =
    [SampleFormat::U8, SampleFormat::U10, SampleFormat::U10_HIGH, SampleFormat::U12, SampleFormat::U16];
const INTERPOLATIONS: [Interpolation; 4] =
    [Interpolation::Nearest, Interpolation::Linear, Interpolation::Cubic, Interpolation::Lanczos];
const BORDERS: [BorderMode; 3] =
    [BorderMode::Replicate, BorderMode::Mirror, BorderMode::Constant(Fill::packed([9; 4]))];
const DIRECTIONS: [ReadoutDirection; 4] = [
    ReadoutDirection::TopToBottom,
    ReadoutDirection::BottomToTop,
    ReadoutDirection::LeftToRight,
    ReadoutDirection::RightToLeft,
];

/// Puts large allocations next to forbidden pages, as are the levels of a pyramid, which the kernels of the flow read: every
/// other one begins behind such a page, the others end at one.
struct GuardedHeap;

/// Bytes from which an allocation is large: the smallest level of a pyramid has some 5,000.
const LARGE: usize = 4096;

/// Large allocations so far.
static COUNT: AtomicUsize = AtomicUsize::new(0);

#[global_allocator]
static HEAP: GuardedHeap = GuardedHeap;

// SAFETY: small allocations are the system's. A large one is a mapping of its own, at least as long, of which a page on
// either side is inaccessible; what begins there is aligned to a page, what ends there moved down to its alignment.
unsafe impl GlobalAlloc for GuardedHeap {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let page = rustix::param::page_size();
        if layout.size() < LARGE || layout.align() > page {
            // SAFETY: the caller's promise.
            return unsafe { System.alloc(layout) };
        }
        let inside = layout.size().next_multiple_of(page);
        let at_start = COUNT.fetch_add(1, Ordering::Relaxed).is_multiple_of(2);
        let start = if at_start { 0 } else { (inside - layout.size()) & !(layout.align() - 1) };
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: a new mapping wherever there is space, of which the first and the last page become inaccessible.
        unsafe {
            let map = mmap_anonymous(std::ptr::null_mut(), inside + 2 * page, protection, MapFlags::PRIVATE);
            let Ok(map) = map else { return std::ptr::null_mut() };
            let guards =
                [map, map.byte_add(page + inside)].map(|guard| mprotect(guard, page, MprotectFlags::empty()));
            if guards.iter().any(Result::is_err) {
                return std::ptr::null_mut();
            }
            map.byte_add(page + start).cast()
        }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        let page = rustix::param::page_size();
        if layout.size() < LARGE || layout.align() > page {
            // SAFETY: the caller's promise, and `alloc` took it from the system.
            return unsafe { System.dealloc(at, layout) };
        }
        // SAFETY: the first byte lies in the first accessible page of the mapping that `alloc` made.
        unsafe {
            let map = at.byte_sub(at.addr() % page + page);
            munmap(map.cast(), layout.size().next_multiple_of(page) + 2 * page).ok();
        }
    }
}

/// Which end of the bytes lies next to a forbidden page.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Flush {
    Start,
    End,
}

/// Bytes next to a forbidden page.
struct Guarded {
    map: *mut std::ffi::c_void,
    mapped: usize,
    /// Offset of the bytes in the map.
    start: usize,
    len: usize,
}

impl Guarded {
    fn new(bytes: &[u8], flush: Flush) -> Self {
        let page = rustix::param::page_size();
        let inside = bytes.len().next_multiple_of(page).max(page);
        let mapped = inside + 2 * page;
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: a new mapping wherever there is space; the first and the last page, which are within it, become
        // inaccessible before anything refers to them.
        let map = unsafe {
            let map = mmap_anonymous(std::ptr::null_mut(), mapped, protection, MapFlags::PRIVATE).unwrap();
            mprotect(map, page, MprotectFlags::empty()).unwrap();
            mprotect(map.byte_add(page + inside), page, MprotectFlags::empty()).unwrap();
            map
        };
        let start = if flush == Flush::Start { page } else { page + inside - bytes.len() };
        let mut guarded = Self { map, mapped, start, len: bytes.len() };
        guarded.bytes_mut().copy_from_slice(bytes);
        guarded
    }

    fn bytes(&self) -> &[u8] {
        // SAFETY: within the accessible pages of a mapping that lives as long as `self`, which lends it out once.
        unsafe { std::slice::from_raw_parts(self.map.byte_add(self.start).cast(), self.len) }
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        // SAFETY: as above, and `self` is borrowed exclusively.
        unsafe { std::slice::from_raw_parts_mut(self.map.byte_add(self.start).cast(), self.len) }
    }
}

impl Drop for Guarded {
    fn drop(&mut self) {
        // SAFETY: the mapping that `new` made; no reference to it outlives `self`.
        unsafe { munmap(self.map, self.mapped).unwrap() };
    }
}

/// Repeatable pseudo-random numbers (xorshift).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() >> 11) as usize % limit
    }

    fn pick<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())]
    }

    /// From −1 to 1.
    fn signed(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| (self.next() >> 24) as u8).collect()
    }
}

/// A layout without a byte to spare behind the last sample.
fn layout(random: &mut Random, format: SampleFormat, channels: usize, spare: usize) -> PlaneLayout {
    let (width, height) = (random.pick(&[1, 2, 7, 15, 16, 17, 31, 33, 47, 64, 65]), 1 + random.below(40));
    let step = channels + spare;
    // Words need not be aligned.
    let stride = ((width - 1) * step + channels) * format.bytes() + random.below(19);
    PlaneLayout { width, height, stride, step, channels, format }
}

fn motion(random: &mut Random, layout: &PlaneLayout) -> FrameMotion {
    let time = ReadoutTime::Seconds(1.0);
    let readout = Readout::new(layout.width, layout.height, random.pick(&DIRECTIONS), time, 1.0).unwrap();
    // From fractions of a pixel to more than the frame.
    let reach = random.pick(&[0.6, 5.0, 80.0]);
    let twist = Twist::new(0.4 * random.signed(), reach * random.signed(), reach * random.signed());
    FrameMotion::new(readout, MotionPath::uniform(twist, 1.0))
}

#[test]
fn the_warp_stays_within_its_planes() {
    let mut random = Random(0x2545_f491_4f6c_dd1d);
    for format in FORMATS {
        for (channels, spare) in (1..=4).flat_map(|channels| (0..3).map(move |spare| (channels, spare))) {
            for (interpolation, border) in INTERPOLATIONS.into_iter().flat_map(|i| BORDERS.map(|b| (i, b))) {
                let from = layout(&mut random, format, channels, spare);
                let step = channels + random.below(3);
                let stride = ((from.width - 1) * step + channels) * format.bytes() + random.below(19);
                let to = PlaneLayout { step, stride, ..from };
                let motion = motion(&mut random, &from);
                let zoom = if random.below(4) == 0 { 1.0 + random.signed().abs() } else { 1.0 };
                let mut settings = WarpSettings::default();
                (settings.interpolation, settings.border, settings.zoom) = (interpolation, border, zoom);
                let picture = random.bytes(from.required_bytes().unwrap());
                for level in CpuLevel::supported() {
                    let mut warper = Warper::with_cpu(level);
                    let frame = warper.prepare(&motion, &settings);
                    let rectified = |source: &[u8], target: &mut [u8]| {
                        let source = Plane::new(source, from).unwrap();
                        let mut target = PlaneMut::new(target, to).unwrap();
                        frame.warp(&source, &mut target, SampleGrid::FULL).unwrap();
                    };
                    let len = to.required_bytes().unwrap();
                    // With other samples before and behind, which must not matter.
                    let around = [random.bytes(64), picture.clone(), random.bytes(64)].concat();
                    let mut expected = vec![0x5a; len + 64];
                    rectified(&around[64..], &mut expected);
                    for flush in [Flush::Start, Flush::End] {
                        let source = Guarded::new(&picture, flush);
                        let mut target = Guarded::new(&vec![0x5a; len], flush);
                        rectified(source.bytes(), target.bytes_mut());
                        assert!(target.bytes() == &expected[..len], "{level} {interpolation:?} {from:?}");
                    }
                    assert!(expected[len..].iter().all(|byte| *byte == 0x5a), "{level} {to:?}");
                }
            }
        }
    }
}

/// What is measured of two pyramids: correspondences, flow both ways, difference.
fn flow_of(
    sampler: &mut Sampler,
    [first, second]: &[Pyramid; 2],
) -> (Vec<Correspondence>, [FlowField; 2], f64) {
    let mut found = Vec::new();
    // Of one frame and another there are displacements to everywhere.
    let away = |point: Vector2<f64>| Vector2::new(-2.0 * point.x, 3.0 * point.y);
    sampler.correspond(first, second, away, &mut found);
    let flow = [sampler.flow().forward().clone(), sampler.flow().backward().clone()];
    sampler.correspond(first, first, |point: Vector2<f64>| point, &mut found);
    let difference = sampler.difference(first, second);
    assert!(difference.is_finite() && difference > 0.0);
    (found, flow, difference)
}

#[test]
fn the_analysis_stays_within_its_luma() {
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    for format in FORMATS {
        for (channels, spare) in [(1, 0), (1, 1), (1, 3), (2, 0), (3, 0), (3, 1), (4, 0)] {
            // The second is reduced, by a ratio that is not whole.
            for (width, height) in [(97, 65), (1203, 37), (130, 77)] {
                let step = channels + spare;
                let stride = ((width - 1) * step + channels) * format.bytes() + random.below(11);
                let layout = PlaneLayout { width, height, stride, step, channels, format };
                let weights = [0.3, 0.4, 0.2, 0.1].map(|weight| if channels == 1 { 1.0 } else { weight });
                let pictures = [(); 2].map(|()| random.bytes(layout.required_bytes().unwrap()));
                for level in CpuLevel::supported() {
                    let mut sampler = Sampler::with_cpu(level, width, height, 12, 8);
                    let mut measure = |bytes: [&[u8]; 2]| {
                        let mut pyramids = [Pyramid::new(), Pyramid::new()];
                        for (bytes, pyramid) in bytes.into_iter().zip(&mut pyramids) {
                            let plane = Plane::new(bytes, layout).unwrap();
                            sampler.build(&Luma::weighted(plane, weights).unwrap(), pyramid);
                        }
                        // The flow reads the pyramids alone, whose sizes do not depend on how samples lie in the plane.
                        let flow = (step == 1).then(|| flow_of(&mut sampler, &pyramids));
                        (pyramids, flow)
                    };
                    let expected = measure([&pictures[0], &pictures[1]]);
                    for flush in [Flush::Start, Flush::End] {
                        let guarded = pictures.each_ref().map(|bytes| Guarded::new(bytes, flush));
                        assert!(measure([guarded[0].bytes(), guarded[1].bytes()]) == expected, "{layout:?}");
                    }
                }
            }
        }
    }
}
