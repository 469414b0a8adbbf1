// SPDX-License-Identifier: MIT OR Apache-2.0

//! Positions: the blocks of the inverse map against an independent solution.

use super::*;
use crate::warp::blocks::Block;
use crate::warp::weights::ONE;

/// The forward map of a motion in closed form.
pub(super) struct Truth<'a> {
    pub size: [f64; 2],
    pub direction: ReadoutDirection,
    pub settings: WarpSettings,
    /// Moves a point (centred) from the first share to the second.
    pub carry: &'a dyn Fn([f64; 2], f64, f64) -> [f64; 2],
}

impl Truth<'_> {
    fn share(&self, x: f64, y: f64) -> f64 {
        match self.direction {
            ReadoutDirection::TopToBottom => (y + 0.5) / self.size[1],
            ReadoutDirection::BottomToTop => 1.0 - (y + 0.5) / self.size[1],
            ReadoutDirection::LeftToRight => (x + 0.5) / self.size[0],
            ReadoutDirection::RightToLeft => 1.0 - (x + 0.5) / self.size[0],
        }
    }

    /// The output position of a pixel of the frame.
    pub fn forward(&self, x: f64, y: f64) -> [f64; 2] {
        let WarpSettings { strength, zoom, reference_row, .. } = self.settings;
        let centre = [(self.size[0] - 1.0) / 2.0, (self.size[1] - 1.0) / 2.0];
        let seen = [x - centre[0], y - centre[1]];
        let moved = (self.carry)(seen, self.share(x, y), reference_row);
        [0, 1].map(|axis| centre[axis] + zoom * (seen[axis] + strength * (moved[axis] - seen[axis])))
    }

    /// The pixel of the frame at output (x, y): Newton with numeric derivatives.
    pub fn inverse(&self, x: f64, y: f64) -> [f64; 2] {
        let (mut u, mut v) = (x, y);
        for _ in 0..60 {
            let [fx, fy] = self.forward(u, v);
            let (h, a, b) = (1e-3, self.forward(u + 1e-3, v), self.forward(u, v + 1e-3));
            let (j00, j10) = ((a[0] - fx) / h, (a[1] - fy) / h);
            let (j01, j11) = ((b[0] - fx) / h, (b[1] - fy) / h);
            let det = j00 * j11 - j01 * j10;
            u += (j11 * (x - fx) - j01 * (y - fy)) / det;
            v += (j00 * (y - fy) - j10 * (x - fx)) / det;
            if (fx - x).hypot(fy - y) < 1e-8 {
                break;
            }
        }
        let [fx, fy] = self.forward(u, v);
        assert!((fx - x).abs() < 1e-6 && (fy - y).abs() < 1e-6, "no truth at {x}, {y}");
        [u, v]
    }

    pub fn warper(&self, path: &MotionPath) -> Warper {
        let readout = readout(self.size[0] as usize, self.size[1] as usize, self.direction, 1.0);
        let mut warper = Warper::new();
        warper.solve(&FrameMotion::new(readout, path.clone()), &self.settings);
        warper
    }
}

/// 25.11: a rotation about c over the share from the exposure to the reference; at one frame a second, so
/// that the twist is per frame, with the readout ratio `gamma`.
fn turn(twist: Twist, gamma: f64) -> impl Fn([f64; 2], f64, f64) -> [f64; 2] {
    move |[x, y], from, to| {
        let time = (to - from) * gamma;
        match twist.centre() {
            Some(c) => {
                let (sin, cos) = (twist.omega * time).sin_cos();
                let (rx, ry) = (x - c.x, y - c.y);
                [c.x + cos * rx - sin * ry, c.y + sin * rx + cos * ry]
            }
            None => [x + twist.velocity.x * time, y + twist.velocity.y * time],
        }
    }
}

fn position(blocks: &[Block], from: isize, at: isize) -> f64 {
    let index = (at - from) as usize;
    let (whole, fraction) = blocks[index / 16].at(index % 16);
    (at + whole) as f64 + f64::from(fraction) / f64::from(ONE)
}

/// The largest error in plane pixels over a sample of rows and columns.
fn largest_error(truth: &Truth, path: &MotionPath, grid: SampleGrid) -> f64 {
    let mut worst: f64 = 0.0;
    for_each_sample(truth, path, grid, |shown, [x, y]| {
        let [u, v] = truth.inverse(shown[0], shown[1]);
        worst = worst.max((x - u).hypot(y - v) / grid.scale[0]);
    });
    worst
}

/// Calls `check` with output positions and the corresponding positions in the frame, in frame pixels.
pub(super) fn for_each_sample(
    truth: &Truth,
    path: &MotionPath,
    grid: SampleGrid,
    mut check: impl FnMut([f64; 2], [f64; 2]),
) {
    let width = (truth.size[0] / grid.scale[0]) as usize;
    let height = (truth.size[1] / grid.scale[1]) as usize;
    let warper = truth.warper(path);
    let map = warper.plane_map(grid, width);
    let (mut knots, mut across, mut down) = (Vec::new(), Vec::new(), Vec::new());
    let from = -(width.next_multiple_of(16) as isize);
    for row in (0..height).step_by(13).chain([height - 1]) {
        let row_knots = map.across.row(CpuLevel::Scalar, row, 0, &mut knots);
        map.across.blocks(CpuLevel::Scalar, row_knots, 0, width as isize - 1, &mut across);
        let row_knots = map.down.row(CpuLevel::Scalar, row, 0, &mut knots);
        map.down.blocks(CpuLevel::Scalar, row_knots, from, 2 * width as isize, &mut down);
        for column in (0..width).step_by(11).chain([width - 1]) {
            let x = position(&across, 0, column as isize);
            let left = x.floor();
            let height = |at: f64| position(&down, from, at as isize) - at + row as f64;
            let y = height(left) + (x - left) * (height(left + 1.0) - height(left));
            let frame = |axis: usize, at: f64| grid.scale[axis] * at + grid.offset[axis];
            check([frame(0, column as f64), frame(1, row as f64)], [frame(0, x), frame(1, y)]);
        }
    }
}

pub(super) const DIRECTIONS: [ReadoutDirection; 4] = [
    ReadoutDirection::TopToBottom,
    ReadoutDirection::BottomToTop,
    ReadoutDirection::LeftToRight,
    ReadoutDirection::RightToLeft,
];

#[test]
fn positions_are_accurate_to_a_hundredth_of_a_pixel() {
    let twists = [
        Twist::new(0.2, 0.0, 0.0),
        Twist::new(-0.2, 60.0, -150.0),
        Twist::new(0.0, 150.0, 150.0),
        Twist::new(0.02, -20.0, 8.0),
    ];
    let mut worst: f64 = 0.0;
    for direction in DIRECTIONS {
        for (twist, gamma) in twists.into_iter().zip([1.0, 1.0, 0.6, 0.3]) {
            for reference_row in [0.0, 0.5, 1.0] {
                let settings = WarpSettings { reference_row, ..WarpSettings::default() };
                let carry = turn(twist, gamma);
                let truth = Truth { size: [1920.0, 1080.0], direction, settings, carry: &carry };
                let path = MotionPath::uniform(twist, gamma);
                let error = largest_error(&truth, &path, SampleGrid::FULL);
                assert!(error < 0.01, "{direction:?} {twist:?} {reference_row}: {error}");
                worst = worst.max(error);
            }
        }
    }
    println!("largest error {worst:.5} px");
}

#[test]
fn strength_and_zoom_are_in_the_map() {
    for (strength, zoom) in [(0.5, 1.0), (1.0, 1.1), (0.7, 1.5)] {
        let settings = WarpSettings { strength, zoom, ..WarpSettings::default() };
        let twist = Twist::new(0.15, 40.0, -30.0);
        let size = [1280.0, 720.0];
        let carry = turn(twist, 0.8);
        let truth = Truth { size, direction: ReadoutDirection::TopToBottom, settings, carry: &carry };
        let error = largest_error(&truth, &MotionPath::uniform(twist, 0.8), SampleGrid::FULL);
        assert!(error < 0.01, "{strength} {zoom}: {error}");
    }
}

#[test]
fn chroma_planes_follow_the_same_map() {
    for offset in [[0.0, 0.5], [0.5, 0.5], [0.0, 0.0]] {
        let settings = WarpSettings::default();
        let twist = Twist::new(0.1, 40.0, -30.0);
        let size = [1920.0, 1080.0];
        let carry = turn(twist, 1.0);
        let truth = Truth { size, direction: ReadoutDirection::BottomToTop, settings, carry: &carry };
        let path = MotionPath::uniform(twist, 1.0);
        let error = largest_error(&truth, &path, SampleGrid { scale: [2.0, 2.0], offset });
        assert!(error < 0.01, "{offset:?}: {error}");
    }
}

#[test]
fn the_row_at_the_reference_stays() {
    let readout = readout(640, 480, ReadoutDirection::TopToBottom, 1.0);
    let mut warper = Warper::new();
    let settings = WarpSettings { reference_row: 100.5 / 480.0, ..WarpSettings::default() };
    warper.solve(&FrameMotion::new(readout, path(&readout, 0.1, 50.0, 0.0)), &settings);
    let map = warper.plane_map(SampleGrid::FULL, 640);
    let (mut knots, mut blocks) = (Vec::new(), Vec::new());
    for table in [&map.across, &map.down] {
        let row_knots = table.row(CpuLevel::Scalar, 100, 0, &mut knots);
        table.blocks(CpuLevel::Scalar, row_knots, 0, 639, &mut blocks);
        for column in 0..640 {
            let (whole, fraction) = blocks[column / 16].at(column % 16);
            let moved = whole as f64 + f64::from(fraction) / f64::from(ONE);
            assert!(moved.abs() < 0.01, "column {column} moved by {moved}");
        }
    }
}
