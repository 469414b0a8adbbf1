// SPDX-License-Identifier: MIT OR Apache-2.0

//! A virtual gyroscope in Gyroflow's format.
//!
//! With `orientation,XYZ` the axes are those of a phone that lies on its side: gx about the image's upward axis, gy about
//! its axis to the left, gz about the axis towards the photographer, each anticlockwise for who looks against it. So
//! gx = −Ωy, gy = −Ωx, gz = −Ωz of the image's own axes (right, down, forward). Gyroflow takes a frame's timestamp as the
//! middle of its readout; times are written by that.

use super::velocity::Instant;
use crate::analysis::Frame;
use anyhow::Result;
use rsrectify::readout::ReadoutDirection;
use rsrectify::rectifier::Origin;
use std::io::Write;

/// Instants of each readout that are written.
const INSTANTS: u32 = 16;

/// What stands before the numbers.
pub fn write_header(
    out: &mut dyn Write,
    clip: &str,
    readout_ms: f64,
    direction: ReadoutDirection,
) -> Result<()> {
    let direction = match direction {
        ReadoutDirection::TopToBottom => 0,
        ReadoutDirection::BottomToTop => 1,
        ReadoutDirection::LeftToRight => 2,
        ReadoutDirection::RightToLeft => 3,
    };
    writeln!(out, "GYROFLOW IMU LOG\nversion,1.3\nid,rsrectify\norientation,XYZ")?;
    writeln!(out, "note,from the picture\nvendor,rsrectify\nvideofilename,{clip}")?;
    writeln!(out, "frame_readout_time,{readout_ms:.3}\nframe_readout_direction,{direction}")?;
    writeln!(out, "tscale,0.000001\ngscale,1.0\nt,gx,gy,gz")?;
    Ok(())
}

/// The turns of a frame: microseconds and rad/s. `focal` is the focal length in frame widths.
///
/// A frame without a motion is written as one that does not turn: a gap would be filled with the turn after it. A repeated
/// frame is not written: nothing was seen at its time.
pub fn write_frame(out: &mut dyn Write, frame: &Frame, focal: f64) -> Result<()> {
    let Some(time) = frame.time.filter(|_| frame.solution.origin != Origin::Repeated) else { return Ok(()) };
    let motion = &frame.solution.motion;
    let readout = motion.readout();
    let instants = if readout.time() > 0.0 { INSTANTS } else { 1 };
    for index in 0..instants {
        let share = (f64::from(index) + 0.5) / f64::from(instants);
        let turn = Instant::new(motion, share).turn(focal * readout.width() as f64).unwrap_or_default();
        let time = (time + readout.time() * (share - 0.5)) * 1e6;
        writeln!(out, "{time:.0},{:.6},{:.6},{:.6}", -turn.y, -turn.x, -turn.z)?;
    }
    Ok(())
}
