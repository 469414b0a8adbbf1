//! Positions: the inverse map as the kernels read it against an independent solution.

use super::*;
use crate::warp::blocks::Block;
use crate::warp::weights::ONE;

/// The forward map of 25.11 with a strength, written out: a rotation about c by the share that
/// is left to the reference.
struct Truth {
    size: [f64; 2],
    direction: ReadoutDirection,
    gamma: f64,
    twist: Twist,
    settings: WarpSettings,
}

impl Truth {
    fn share(&self, x: f64, y: f64) -> f64 {
        match self.direction {
            ReadoutDirection::TopToBottom => (y + 0.5) / self.size[1],
            ReadoutDirection::BottomToTop => 1.0 - (y + 0.5) / self.size[1],
            ReadoutDirection::LeftToRight => (x + 0.5) / self.size[0],
            ReadoutDirection::RightToLeft => 1.0 - (x + 0.5) / self.size[0],
        }
    }

    /// Where the frame's pixel is shown.
    fn forward(&self, x: f64, y: f64) -> [f64; 2] {
        let time = self.settings.strength * (self.settings.reference_row - self.share(x, y)) * self.gamma;
        let centre = [(self.size[0] - 1.0) / 2.0, (self.size[1] - 1.0) / 2.0];
        let (dx, dy) = (x - centre[0], y - centre[1]);
        let v = self.twist.velocity;
        let moved = match self.twist.centre() {
            Some(c) => {
                let (sin, cos) = (self.twist.omega * time).sin_cos();
                let (rx, ry) = (dx - c.x, dy - c.y);
                [c.x + cos * rx - sin * ry, c.y + sin * rx + cos * ry]
            }
            None => [dx + v.x * time, dy + v.y * time],
        };
        [centre[0] + self.settings.zoom * moved[0], centre[1] + self.settings.zoom * moved[1]]
    }

    /// The frame's pixel that is shown at (x, y): Newton with numeric derivatives.
    fn inverse(&self, x: f64, y: f64) -> [f64; 2] {
        let (mut u, mut v) = (x, y);
        for _ in 0..60 {
            let [fx, fy] = self.forward(u, v);
            let (h, a, b) = (1e-3, self.forward(u + 1e-3, v), self.forward(u, v + 1e-3));
            let (j00, j10) = ((a[0] - fx) / h, (a[1] - fy) / h);
            let (j01, j11) = ((b[0] - fx) / h, (b[1] - fy) / h);
            let det = j00 * j11 - j01 * j10;
            u += (j11 * (x - fx) - j01 * (y - fy)) / det;
            v += (j00 * (y - fy) - j10 * (x - fx)) / det;
        }
        let [fx, fy] = self.forward(u, v);
        assert!((fx - x).abs() < 1e-6 && (fy - y).abs() < 1e-6, "no truth at {x}, {y}");
        [u, v]
    }

    fn warper(&self) -> Warper {
        let readout = readout(self.size[0] as usize, self.size[1] as usize, self.direction, self.gamma);
        let mut warper = Warper::new();
        let path = MotionPath { twist: self.twist, readout_time: readout.time };
        warper.prepare(&readout, &path, &self.settings);
        warper
    }
}

fn position(blocks: &[Block], from: isize, at: isize) -> f64 {
    let index = (at - from) as usize;
    let (whole, fraction) = blocks[index / 16].at(index % 16);
    (at + whole) as f64 + f64::from(fraction) / f64::from(ONE)
}

/// The largest error in plane pixels over a sample of rows and columns.
fn largest_error(truth: &Truth, placement: Placement) -> f64 {
    let width = (truth.size[0] / placement.scale[0]) as usize;
    let height = (truth.size[1] / placement.scale[1]) as usize;
    let warper = truth.warper();
    let map = warper.plane_map(placement, width);
    let (mut knots, mut across, mut down) = (Vec::new(), Vec::new(), Vec::new());
    let from = -(width.next_multiple_of(16) as isize);
    let mut worst: f64 = 0.0;
    for row in (0..height).step_by(13).chain([height - 1]) {
        map.across.row(row, 0, &mut knots);
        map.across.blocks(&knots, 0, width as isize - 1, &mut across);
        map.down.row(row, 0, &mut knots);
        map.down.blocks(&knots, from, 2 * width as isize, &mut down);
        for column in (0..width).step_by(11).chain([width - 1]) {
            let x = position(&across, 0, column as isize);
            let left = x.floor();
            let height = |at: f64| position(&down, from, at as isize) - at + row as f64;
            let y = height(left) + (x - left) * (height(left + 1.0) - height(left));
            let frame = |axis: usize, at: f64| placement.scale[axis] * at + placement.offset[axis];
            let [u, v] = truth.inverse(frame(0, column as f64), frame(1, row as f64));
            worst = worst.max((frame(0, x) - u).hypot(frame(1, y) - v) / placement.scale[0]);
        }
    }
    worst
}

const DIRECTIONS: [ReadoutDirection; 4] = [
    ReadoutDirection::TopToBottom,
    ReadoutDirection::BottomToTop,
    ReadoutDirection::LeftToRight,
    ReadoutDirection::RightToLeft,
];

#[test]
fn positions_are_right_to_a_hundredth_of_a_pixel() {
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
                let truth = Truth { size: [1920.0, 1080.0], direction, gamma, twist, settings };
                let error = largest_error(&truth, Placement::FULL);
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
        let truth = Truth { size, direction: ReadoutDirection::TopToBottom, gamma: 0.8, twist, settings };
        let error = largest_error(&truth, Placement::FULL);
        assert!(error < 0.01, "{strength} {zoom}: {error}");
    }
}

#[test]
fn chroma_planes_follow_the_same_map() {
    for offset in [[0.0, 0.5], [0.5, 0.5], [0.0, 0.0]] {
        let settings = WarpSettings::default();
        let twist = Twist::new(0.1, 40.0, -30.0);
        let size = [1920.0, 1080.0];
        let truth = Truth { size, direction: ReadoutDirection::BottomToTop, gamma: 1.0, twist, settings };
        let error = largest_error(&truth, Placement { scale: [2.0, 2.0], offset });
        assert!(error < 0.01, "{offset:?}: {error}");
    }
}

#[test]
fn the_row_at_the_reference_stays() {
    let truth = Truth {
        size: [640.0, 480.0],
        direction: ReadoutDirection::TopToBottom,
        gamma: 1.0,
        twist: Twist::new(0.1, 50.0, 0.0),
        settings: WarpSettings { reference_row: 100.5 / 480.0, ..WarpSettings::default() },
    };
    let warper = truth.warper();
    let map = warper.plane_map(Placement::FULL, 640);
    let (mut knots, mut blocks) = (Vec::new(), Vec::new());
    for table in [&map.across, &map.down] {
        table.row(100, 0, &mut knots);
        table.blocks(&knots, 0, 639, &mut blocks);
        for column in 0..640 {
            let (whole, fraction) = blocks[column / 16].at(column % 16);
            let moved = whole as f64 + f64::from(fraction) / f64::from(ONE);
            assert!(moved.abs() < 0.01, "column {column} moved by {moved}");
        }
    }
}
