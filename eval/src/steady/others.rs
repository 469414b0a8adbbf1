// SPDX-License-Identifier: MIT OR Apache-2.0

//! Other stabilisers, run by ffmpeg, and where they place each frame.
//!
//! What vid.stab makes of a frame does not depend on what is in it, once the motions are written: two clips of ramps, along x and
//! along y, tell where it takes each pixel from. deshake writes what it does into a log.

use crate::metrics::homography::Homography;
use anyhow::{Context, Result, ensure};
use baselines::methods::{Correction, Corrections};
use nalgebra::{Matrix3, Vector3};
use render::media::{self, Clip};
use render::scene::Frame;
use render::video;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Share of the frame's middle, along each side, in which ramps are read: borders are filled with something else.
const READ: f64 = 0.6;

/// What another stabiliser makes of a clip.
pub struct Stabilised {
    /// The frames.
    pub clip: Clip,
    /// Where it shows each pixel of each frame.
    pub shown: Corrections,
    pub zoom: f64,
}

/// Where pixels are shown, given from where the pixels of the output come.
fn placed(source: &Matrix3<f64>) -> Result<Box<dyn Correction>> {
    let to = Homography(source.try_inverse().context("a frame is shown as a line")?);
    Ok(Box::new(move |pixel| to.apply(pixel)))
}

/// vid.stab in two passes at its defaults.
///
/// # Errors
/// If ffmpeg or its filters are missing.
pub fn vid_stab(clip: &Clip) -> Result<Stabilised> {
    let folder = tempfile::tempdir()?;
    let folder = folder.path();
    write(folder, "in.y4m", clip, &mut clip.frames.iter().cloned())?;
    filter(folder, "in.y4m", "vidstabdetect=result=found.trf", None)?;
    let transform =
        |input: &str, output: &str| filter(folder, input, "vidstabtransform=input=found.trf", Some(output));
    let said = transform("in.y4m", "out.y4m")?;
    let zoom = said.lines().find_map(|line| line.split_once("Final zoom: ").map(|(_, zoom)| zoom.trim()));
    let zoom = 1.0 + zoom.context("vid.stab does not tell its zoom")?.parse::<f64>()? / 100.0;
    let mut sources = Vec::new();
    for axis in [0, 1] {
        write(folder, "ramp.y4m", clip, &mut clip.frames.iter().map(|_| ramp(clip, axis)))?;
        transform("ramp.y4m", "moved.y4m")?;
        let moved = media::decode(&folder.join("moved.y4m"))?;
        sources.push(moved.frames.iter().map(|frame| source(frame, clip, axis)).collect::<Result<Vec<_>>>()?);
    }
    let [along, across] = sources.as_slice() else { unreachable!("two ramps") };
    let shown = along
        .iter()
        .zip(across)
        .map(|(x, y)| placed(&Matrix3::new(x[0], x[1], x[2], y[0], y[1], y[2], 0.0, 0.0, 1.0)));
    let shown = shown.collect::<Result<_>>()?;
    Ok(Stabilised { clip: media::decode(&folder.join("out.y4m"))?, shown, zoom })
}

/// ffmpeg's deshake at its defaults, which looks at no later frame and neither zooms nor crops.
///
/// # Errors
/// If ffmpeg or its filter is missing.
pub fn deshake(clip: &Clip) -> Result<Stabilised> {
    let folder = tempfile::tempdir()?;
    let folder = folder.path();
    write(folder, "in.y4m", clip, &mut clip.frames.iter().cloned())?;
    filter(folder, "in.y4m", "deshake=filename=log.csv", Some("out.y4m"))?;
    let log = fs::read_to_string(folder.join("log.csv")).context("deshake wrote no log")?;
    // A frame a line after the heading: found, averaged and final shift in x and in y, turn and zoom (%), each since the frame
    // before. They add up and shrink by a tenth with each frame.
    let mut sum = Vector3::zeros();
    let mut shown_by = |line: &str| {
        let values: Vec<f64> = line.split(',').filter_map(|value| value.trim().parse().ok()).collect();
        let since = |which: usize| values.get(3 * which + 2).copied().context("deshake's log is another one");
        sum = (sum + Vector3::new(since(0)?, since(1)?, since(2)?)) * 0.9;
        let (sin, cos) = sum.z.sin_cos();
        let scale = 1.0 + since(3)? / 100.0;
        placed(&Matrix3::new(scale * cos, -sin, sum.x, sin, scale * cos, sum.y, 0.0, 0.0, 1.0))
    };
    let shown: Corrections = log.lines().skip(1).map(&mut shown_by).collect::<Result<_>>()?;
    ensure!(
        shown.len() == clip.frames.len(),
        "deshake's log has {} of {} frames",
        shown.len(),
        clip.frames.len()
    );
    Ok(Stabilised { clip: media::decode(&folder.join("out.y4m"))?, shown, zoom: 1.0 })
}

fn write(folder: &Path, name: &str, clip: &Clip, frames: &mut dyn Iterator<Item = Frame>) -> Result<()> {
    video::write(&folder.join(name), [clip.width, clip.height], clip.fps, frames)
}

/// What ffmpeg says while it filters a file.
fn filter(folder: &Path, input: &str, filter: &str, output: Option<&str>) -> Result<String> {
    let mut command = Command::new("ffmpeg");
    command.current_dir(folder).args(["-nostdin", "-y", "-i", input, "-vf", filter]);
    command.args(output.map_or(["-f", "null", "-"].as_slice(), |_| &[])).args(output);
    let ran = command.output().context("cannot run ffmpeg")?;
    let said = String::from_utf8_lossy(&ran.stderr).into_owned();
    ensure!(ran.status.success(), "ffmpeg: {said}");
    Ok(said)
}

/// A frame whose grey levels rise from 0 to 255 along an axis: whole ones, rounded up or down by place so that they are right in
/// the mean. The places follow Roberts' sequence of low discrepancy in two dimensions.
fn ramp(clip: &Clip, axis: usize) -> Frame {
    let steepness = steepness(clip, axis);
    let grey = |index: usize| {
        let place = [(index % clip.width) as f64, (index / clip.width) as f64];
        let share = (0.754_877_666_2 * place[0] + 0.569_840_291 * place[1]).fract();
        [(steepness * place[axis] + share).floor() as u8; 3]
    };
    let rgb = (0..clip.width * clip.height).flat_map(grey).collect();
    Frame { width: clip.width, height: clip.height, rgb }
}

/// Grey levels a pixel.
fn steepness(clip: &Clip, axis: usize) -> f64 {
    255.0 / ([clip.width, clip.height][axis] as f64 - 1.0)
}

/// From where, along an axis, the pixels of a moved ramp come: a·x + b·y + c by least squares. Its levels are whole numbers,
/// of which there are so many that the place is right to thousandths of a pixel.
fn source(moved: &Frame, clip: &Clip, axis: usize) -> Result<[f64; 3]> {
    let middle = |length: usize| {
        let border = (0.5 * (1.0 - READ) * length as f64) as usize;
        border..length - border
    };
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for y in middle(clip.height) {
        for x in middle(clip.width) {
            let pixel = Vector3::new(x as f64, y as f64, 1.0);
            normal += pixel * pixel.transpose();
            right += pixel * f64::from(moved.rgb[3 * (y * clip.width + x) + 1]);
        }
    }
    let inverse = normal.try_inverse().context("too small a frame")?;
    Ok((inverse * right / steepness(clip, axis)).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moved_ramp_tells_where_its_pixels_come_from() {
        let clip = Clip { width: 320, height: 240, fps: 30.0, frames: Vec::new() };
        for axis in [0, 1] {
            let still = ramp(&clip, axis);
            let [a, b, c] = source(&still, &clip, axis).unwrap();
            let expected = [[1.0, 0.0], [0.0, 1.0]][axis];
            assert!(
                (a - expected[0]).abs() < 1e-4 && (b - expected[1]).abs() < 1e-4 && c.abs() < 0.02,
                "{a} {b} {c}"
            );
        }
    }
}
