// SPDX-License-Identifier: MIT OR Apache-2.0

//! Memory that a stream takes from the heap once it runs: the buffers of pictures are kept from frame to frame.

use rayon::ThreadPoolBuilder;
use rsrectify::plane::{Luma, Plane, PlaneLayout, PlaneMut, SampleFormat};
use rsrectify::rectifier::{Duplicate, Settings};
use rsrectify::warp::{SampleGrid, WarpSettings};
use rsrectify::{Rectifier, Warper};

const SIZE: [usize; 2] = [640, 480];
const RATE: f64 = 30.0;
/// Frames after which all buffers have grown: the first solutions are due, and the readout was sought.
const START: usize = 48;
const FRAMES: usize = 68;
/// What a frame takes at most, for the correspondences of its pair, their tracks, and its solution. That does not grow with the
/// picture. Measured: 457 allocations, 1.16 MB; the median frame takes 345, 0.63 MB.
const MOST_ALLOCATIONS: u64 = 500;
const MOST_BYTES: u64 = 1_200_000;

/// A wall that sways sideways, read row by row through the whole frame period. It sways at two frequencies: what sways at one
/// looks much the same read from the opposite edge.
fn frame(index: usize) -> Vec<u8> {
    let [width, height] = SIZE;
    let sway = |time: f64| {
        let [slow, fast] = [1.5, 4.0].map(|frequency| (frequency * std::f64::consts::TAU * time).sin());
        30.0 * slow + 8.0 * fast
    };
    let wall = |x: f64, y: f64| {
        let value =
            (x * 0.11).sin() * (y * 0.13).cos() + (x * 0.031 + y * 0.047).sin() + (x * 0.27 - y * 0.2).cos();
        (128.0 + 36.0 * value) as u8
    };
    let row = |y: usize| {
        let exposed = (index as f64 + (y as f64 + 0.5) / height as f64) / RATE;
        (0..width).map(move |x| wall(x as f64 - sway(exposed), y as f64))
    };
    (0..height).flat_map(row).collect()
}

#[test]
fn a_frame_of_a_running_stream_takes_little_memory() {
    let [width, height] = SIZE;
    let layout = PlaneLayout::packed(width, height, SampleFormat::U8);
    let frames: Vec<Vec<u8>> = (0..FRAMES).map(frame).collect();
    let mut rectified = vec![0; width * height];
    let mut rectifier = Rectifier::new(Settings::default(), width, height, Some(1.0 / RATE)).unwrap();
    let mut warper = Warper::new();
    let mut given_out = 0;
    let mut step = |index: usize| {
        let luma = Plane::new(&frames[index], layout).unwrap();
        rectifier.push(&Luma::from(luma), Some(index as f64 / RATE), Duplicate::Detect).unwrap();
        while let Some(solution) = rectifier.pop() {
            let source = Plane::new(&frames[given_out], layout).unwrap();
            let mut target = PlaneMut::new(&mut rectified, layout).unwrap();
            let prepared = warper.prepare(&solution.motion, &WarpSettings::default());
            prepared.warp(&source, &mut target, SampleGrid::FULL).unwrap();
            given_out += 1;
        }
    };
    // Allocations are counted on one thread.
    let pool = ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().unwrap();
    let counted = pool.install(|| {
        (0..START).for_each(&mut step);
        (START..FRAMES).map(|index| allocation_counter::measure(|| step(index))).collect::<Vec<_>>()
    });
    let most = |of: fn(&allocation_counter::AllocationInfo) -> u64| counted.iter().map(of).max().unwrap();
    let [count, bytes] = [most(|info| info.count_total), most(|info| info.bytes_total)];
    assert_eq!(given_out, FRAMES - Settings::default().lookahead);
    assert!(count < MOST_ALLOCATIONS && bytes < MOST_BYTES, "{bytes} bytes in {count} allocations");
}
