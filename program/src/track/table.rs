// SPDX-License-Identifier: MIT OR Apache-2.0

//! The motion of frames and rows, as CSV and JSON.

use super::velocity::Instant;
use crate::analysis::Frame;
use crate::property_values::{Direction, name_of};
use anyhow::Result;
use rsrectify::nalgebra::Vector2;
use serde::Serialize;
use std::io::Write;

/// The motion of a frame.
#[derive(Debug, Serialize)]
pub struct FrameRow {
    pub frame: u64,
    /// When its readout begins, in seconds of the clip.
    pub time: Option<f64>,
    pub origin: &'static str,
    pub confidence: f64,
    /// Pixels; absent where it cannot be told.
    pub expected_error: Option<f64>,
    /// Of the picture in the mean over the readout: rad/s, px/s at the image centre.
    pub omega: f64,
    pub vx: f64,
    pub vy: f64,
    pub readout_ms: f64,
    pub readout_direction: String,
    pub readout_deviation: f64,
    pub correspondences: usize,
    pub inliers: usize,
    pub residual: f64,
    /// Why the frame keeps its picture; absent of one that is corrected.
    pub as_recorded: Option<String>,
}

/// The motion of a row, of a column where the readout runs sideways.
#[derive(Debug, Serialize)]
pub struct LineRow {
    pub line: usize,
    /// When it was exposed, in seconds of the clip.
    pub time: Option<f64>,
    /// Pixels from where the frame shows its middle to where that is at mid-readout.
    pub dx: f64,
    pub dy: f64,
    /// Of the picture at that instant, at the line's middle: px/s, rad/s.
    pub vx: f64,
    pub vy: f64,
    pub omega: f64,
}

/// The columns of frames.
pub const FRAME_HEADER: &str = "frame,time,origin,confidence,expected_error,omega,vx,vy,readout_ms,readout_direction,\
readout_deviation,correspondences,inliers,residual,as_recorded";
/// The columns of rows.
pub const LINE_HEADER: &str = "frame,line,time,dx,dy,vx,vy,omega";

fn number(value: Option<f64>) -> String {
    value.map_or(String::new(), |value| format!("{value:.6}"))
}

impl FrameRow {
    /// Of the frame with this number.
    pub fn new(index: u64, frame: &Frame) -> Self {
        let solution = &frame.solution;
        let readout = solution.motion.readout();
        let twist = solution.motion.path().mean_twist();
        Self {
            frame: index,
            time: frame.time,
            origin: solution.origin.name(),
            confidence: solution.confidence,
            expected_error: solution.expected_error,
            omega: twist.omega,
            vx: twist.velocity.x,
            vy: twist.velocity.y,
            readout_ms: readout.time() * 1e3,
            readout_direction: name_of(&Direction::from(readout.direction())),
            readout_deviation: solution.readout_deviation,
            correspondences: solution.correspondences,
            inliers: solution.inliers,
            residual: solution.residual,
            as_recorded: solution.as_recorded.map(|reason| reason.to_string()),
        }
    }

    /// As a line of CSV.
    pub fn write(&self, out: &mut dyn Write) -> Result<()> {
        write!(out, "{},{},{},{:.4},", self.frame, number(self.time), self.origin, self.confidence)?;
        write!(out, "{},{:.6},{:.3},{:.3},", number(self.expected_error), self.omega, self.vx, self.vy)?;
        write!(out, "{:.4},{},{:.4},", self.readout_ms, self.readout_direction, self.readout_deviation)?;
        // No reason holds a comma.
        let as_recorded = self.as_recorded.as_deref().unwrap_or_default();
        writeln!(out, "{},{},{:.4},{as_recorded}", self.correspondences, self.inliers, self.residual)?;
        Ok(())
    }
}

impl LineRow {
    /// Of all lines of a frame.
    pub fn of(frame: &Frame) -> impl Iterator<Item = Self> + '_ {
        let motion = &frame.solution.motion;
        let readout = motion.readout();
        let centre = motion.centre();
        let by_rows = readout.direction().is_by_rows();
        let [columns, rows] = motion.area().ranges();
        (if by_rows { rows } else { columns }).map(move |line| {
            let along = line as f64;
            let pixel = if by_rows { Vector2::new(centre.x, along) } else { Vector2::new(along, centre.y) };
            let share = motion.share(pixel);
            let (here, point) = (Instant::new(motion, share), pixel - centre);
            let (shift, velocity) = (here.shift(point, 0.5), here.velocity(point));
            Self {
                line,
                time: frame.time.map(|time| time + readout.time() * share),
                dx: shift.x,
                dy: shift.y,
                vx: velocity.x,
                vy: velocity.y,
                omega: here.rotation(point),
            }
        })
    }

    /// As a line of CSV.
    pub fn write(&self, frame: u64, out: &mut dyn Write) -> Result<()> {
        write!(out, "{frame},{},{},{:.4},{:.4},", self.line, number(self.time), self.dx, self.dy)?;
        writeln!(out, "{:.3},{:.3},{:.6}", self.vx, self.vy, self.omega)?;
        Ok(())
    }
}
