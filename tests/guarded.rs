//! Planes that begin and end at pages that nobody may read or write: a kernel that reaches past a plane, by raw pointer
//! too, ends the process with a segmentation fault.
#![cfg(unix)]

use nalgebra::Vector2;
use rsrectify::correspond::{Pyramid, Sampler};
use rsrectify::motion::{FrameMotion, MotionPath, Twist};
use rsrectify::plane::{Luma, Plane, PlaneLayout, PlaneMut, SampleFormat};
use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};
use rsrectify::warp::{BorderMode, CpuLevel, Interpolation, Placement, WarpSettings, Warper};
use rustix::mm::{MapFlags, MprotectFlags, ProtFlags, mmap_anonymous, mprotect, munmap};

const FORMATS: [SampleFormat; 5] =
    [SampleFormat::U8, SampleFormat::U10, SampleFormat::U10_HIGH, SampleFormat::U12, SampleFormat::U16];
const INTERPOLATIONS: [Interpolation; 4] =
    [Interpolation::Nearest, Interpolation::Linear, Interpolation::Cubic, Interpolation::Lanczos];
const BORDERS: [BorderMode; 3] = [BorderMode::Replicate, BorderMode::Mirror, BorderMode::Constant];
const DIRECTIONS: [ReadoutDirection; 4] = [
    ReadoutDirection::TopToBottom,
    ReadoutDirection::BottomToTop,
    ReadoutDirection::LeftToRight,
    ReadoutDirection::RightToLeft,
];

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
    let readout = Readout::new(layout.width, layout.height, random.pick(&DIRECTIONS), time, 1.0);
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
                let settings = WarpSettings { interpolation, border, zoom, ..WarpSettings::default() };
                let picture = random.bytes(from.required_bytes().unwrap());
                for level in CpuLevel::supported() {
                    let mut warper = Warper::with_cpu(level);
                    warper.prepare(&motion, &settings);
                    let rectified = |source: &[u8], target: &mut [u8]| {
                        let source = Plane::new(source, from).unwrap();
                        let mut target = PlaneMut::new(target, to).unwrap();
                        warper.warp(&source, &mut target, Placement::FULL, [9; 4]).unwrap();
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
                            sampler.build(&Luma { plane, weights }, pyramid);
                        }
                        let [first, second] = &pyramids;
                        let mut found = Vec::new();
                        sampler.correspond(first, first, |point: Vector2<f64>| point, &mut found);
                        let difference = sampler.difference(first, second);
                        (found, difference)
                    };
                    let expected = measure([&pictures[0], &pictures[1]]);
                    assert!(expected.1.is_finite() && expected.1 > 0.0);
                    for flush in [Flush::Start, Flush::End] {
                        let guarded = pictures.each_ref().map(|bytes| Guarded::new(bytes, flush));
                        assert!(measure([guarded[0].bytes(), guarded[1].bytes()]) == expected, "{layout:?}");
                    }
                }
            }
        }
    }
}
