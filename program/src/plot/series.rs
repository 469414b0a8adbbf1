// SPDX-License-Identifier: MIT OR Apache-2.0

//! Frames → what is plotted of them.

use crate::estimate::Estimate;
use rsrectify::readout::ReadoutDirection;
use rsrectify::rectifier::{FrameSolution, Origin};

/// A frame as it is plotted.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// Seconds of the clip.
    pub time: f64,
    /// What it says of the motion; nothing of a frame that is left as it is.
    pub motion: Option<Motion>,
    /// The signed readout time in milliseconds as it was believed then.
    pub readout: Estimate,
    /// Which edge was believed to be read first.
    pub direction: ReadoutDirection,
}

/// The motion of a frame.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// Pixels a frame by which the picture moves at its centre, to the right and down.
    pub shift: [f64; 2],
    /// Degrees a frame by which it turns, clockwise.
    pub turn: f64,
    /// 0 to 1.
    pub confidence: f64,
    /// Pixels; absent where it cannot be told.
    pub expected_error: Option<f64>,
}

/// The frames of a clip.
#[derive(Debug, Default)]
pub struct Series {
    frames: Vec<Point>,
    /// Times in seconds, as far as they are known.
    times: Vec<Option<f64>>,
}

impl Series {
    /// Adds the frame that is shown at a time in seconds. Rates are by the second, until it is known how many frames there are in one.
    pub fn add(&mut self, time: Option<f64>, solution: &FrameSolution) {
        let readout = solution.motion.readout();
        let twist = solution.motion.path().mean_twist();
        let motion = Motion {
            shift: [twist.velocity.x, twist.velocity.y],
            turn: twist.omega.to_degrees(),
            confidence: solution.confidence,
            expected_error: solution.expected_error,
        };
        self.times.push(time);
        self.frames.push(Point {
            time: 0.0,
            motion: (solution.origin != Origin::Untouched).then_some(motion),
            readout: Estimate::of_readout(readout, solution.readout_deviation),
            direction: readout.direction(),
        });
    }

    /// The points of a clip whose frames are so many seconds apart; none where that is not known.
    pub fn points(self, period: Option<f64>) -> Vec<Point> {
        let Some(period) = period else { return Vec::new() };
        let points = self.frames.into_iter().zip(self.times).enumerate();
        let point = |(index, (mut point, time)): (usize, (Point, Option<f64>))| {
            point.time = time.unwrap_or(index as f64 * period);
            if let Some(motion) = &mut point.motion {
                motion.shift = motion.shift.map(|rate| rate * period);
                motion.turn *= period;
            }
            // The deviation was one of the ratio to the frame duration.
            point.readout.deviation *= 1e3 * period;
            point
        };
        points.map(point).collect()
    }
}
