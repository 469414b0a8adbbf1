// SPDX-License-Identifier: MIT OR Apache-2.0

//! Coded video, by way of GStreamer's command line: any clip to frames, and frames through H.264.
//!
//! Frames go in and out as raw RGBA, the one layout whose rows GStreamer never pads.

use crate::scene::Frame;
use anyhow::{Context, Result, bail, ensure};
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{BufWriter, ErrorKind, Write};
use std::path::Path;
use std::process::Command;

/// The program that runs the pipelines.
const LAUNCH: &str = "gst-launch-1.0";

/// A clip in memory.
#[derive(Clone, Debug)]
pub struct Clip {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Frames a second, nominally: timestamps are not kept.
    pub fps: f64,
    /// The frames in the order in which they are shown.
    pub frames: Vec<Frame>,
}

/// Decodes the video of a clip, whatever its container and codec. Pictures stay as they are stored: a
/// rotation that the container asks for is not carried out.
///
/// # Errors
/// If the file or `gst-launch-1.0` is missing, or GStreamer cannot decode the file; with its message.
pub fn decode(path: &Path) -> Result<Clip> {
    ensure!(path.is_file(), "there is no file {}", path.display());
    run(path, "! decodebin").with_context(|| format!("cannot decode {}", path.display()))
}

/// What is left of frames after H.264 at `kilobits` a second: encoded by x264 as a phone would, with
/// key frames a second apart and no B-frames, and decoded again.
///
/// One thread and one pass, so that the same frames always give the same result.
///
/// # Errors
/// If `gst-launch-1.0`, x264 or the decoder is missing; with GStreamer's message.
pub fn through_h264(frames: Vec<Frame>, fps: f64, kilobits: u32) -> Result<Vec<Frame>> {
    let Some(Frame { width, height, .. }) = frames.first() else {
        return Ok(frames);
    };
    let (second, rate) = (fps.round(), (fps * 1000.0).round());
    let middle = format!(
        "! rawvideoparse format=rgba width={width} height={height} framerate={rate}/1000 \
         ! videoconvert ! video/x-raw,format=I420,colorimetry=bt709 \
         ! x264enc bitrate={kilobits} key-int-max={second} bframes=0 threads=1 ! h264parse ! avdec_h264"
    );
    let folder = tempfile::tempdir()?;
    let raw = folder.path().join("raw");
    write_rgba(&raw, &frames)?;
    let coded = run(&raw, &middle).context("cannot take frames through H.264")?.frames;
    ensure!(coded.len() == frames.len(), "{} frames became {} in H.264", frames.len(), coded.len());
    Ok(coded)
}

fn write_rgba(path: &Path, frames: &[Frame]) -> Result<()> {
    let mut out = BufWriter::new(File::create(path)?);
    for pixel in frames.iter().flat_map(|frame| frame.rgb.chunks_exact(3)) {
        out.write_all(&[pixel[0], pixel[1], pixel[2], 255])?;
    }
    Ok(out.flush()?)
}

/// Runs `filesrc ! middle ! filesink` and reads what comes out, converted to RGBA.
fn run(input: &Path, middle: &str) -> Result<Clip> {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("out");
    let location = |path: &Path| {
        let mut property = OsString::from("location=");
        property.push(path);
        property
    };
    let to_file = "! videoconvert ! video/x-raw,format=RGBA ! filesink name=out";
    let mut command = Command::new(LAUNCH);
    // `-v` prints the caps, which tell the frame size.
    command.args(["-v", "filesrc"]).arg(location(input));
    command.args(middle.split_whitespace()).args(to_file.split_whitespace()).arg(location(&out));
    let ran = match command.output() {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            bail!("{LAUNCH} is missing; scripts/setup installs it, with the elements that are used here")
        }
        ran => ran.with_context(|| format!("cannot run {LAUNCH}"))?,
    };
    ensure!(ran.status.success(), "{LAUNCH}: {}", String::from_utf8_lossy(&ran.stderr).trim());
    let report = String::from_utf8_lossy(&ran.stdout);
    let caps = report.lines().rfind(|line| line.contains("GstFileSink:out.GstPad:sink: caps = "));
    let (width, height, fps) = caps.and_then(layout).context("GStreamer found no video")?;
    let bytes = fs::read(&out)?;
    let frames = bytes.chunks_exact(4 * width * height).map(|rgba| opaque(width, height, rgba)).collect();
    Ok(Clip { width, height, fps, frames })
}

/// Width, height and frames a second of caps as GStreamer prints them.
fn layout(caps: &str) -> Option<(usize, usize, f64)> {
    let field = |name: &str| {
        let value = caps.split(", ").find_map(|field| field.strip_prefix(name)?.strip_prefix("=("))?;
        value.split_once(')').map(|(_kind, value)| value)
    };
    let (count, seconds) = field("framerate")?.split_once('/')?;
    let fps = count.parse::<f64>().ok()? / seconds.parse::<f64>().ok()?;
    Some((field("width")?.parse().ok()?, field("height")?.parse().ok()?, fps))
}

fn opaque(width: usize, height: usize, rgba: &[u8]) -> Frame {
    let rgb = rgba.chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect();
    Frame { width, height, rgb }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::video;

    /// A soft grey frame that differs from frame to frame and along x and y: grey, because files of this
    /// size do not say which matrix their colours are coded with.
    fn frame(width: usize, height: usize, k: usize) -> Frame {
        let pixel = |index: usize| {
            let (x, y) = (index % width, index / width);
            [(60 + 2 * k + x / 4 + y / 3) as u8; 3]
        };
        Frame { width, height, rgb: (0..width * height).flat_map(pixel).collect() }
    }

    /// Of the luma, which H.264 keeps at full size.
    fn psnr(a: &Frame, b: &Frame) -> f64 {
        let (a, b) = (a.luma(), b.luma());
        let squares: f64 = a.iter().zip(&b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
        10.0 * (255.0f64.powi(2) * a.len() as f64 / squares.max(1e-9)).log10()
    }

    #[test]
    fn caps_tell_the_layout() {
        let caps = "/GstPipeline:pipeline0/GstFileSink:out.GstPad:sink: caps = video/x-raw, format=(string)RGBA, \
                    width=(int)162, height=(int)90, interlace-mode=(string)progressive, \
                    framerate=(fraction)30000/1001";
        assert_eq!(layout(caps), Some((162, 90, 30000.0 / 1001.0)));
        assert_eq!(layout("audio/x-raw, rate=(int)48000"), None);
    }

    #[test]
    fn an_uncompressed_clip_comes_back() {
        // A width that GStreamer would pad in other layouts.
        let (width, height) = (162, 90);
        let frames: Vec<Frame> = (0..3).map(|k| frame(width, height, k)).collect();
        let file = tempfile::Builder::new().suffix(".y4m").tempfile().unwrap();
        video::write(file.path(), [width, height], 25.0, frames.iter().cloned()).unwrap();
        let clip = decode(file.path()).unwrap();
        assert_eq!((clip.width, clip.height, clip.fps, clip.frames.len()), (width, height, 25.0, 3));
        for (a, b) in clip.frames.iter().zip(&frames) {
            assert!(psnr(a, b) > 40.0, "{}", psnr(a, b));
        }
    }

    #[test]
    fn more_bits_leave_more_of_the_picture_and_repeat_exactly() {
        let grey = crate::scene::Picture::new(160, 96, vec![[0.5; 3]; 160 * 96]);
        let frames: Vec<Frame> = (0..6).map(|k| grey.sense(12.0, k)).collect();
        let coded = |kilobits| through_h264(frames.clone(), 30.0, kilobits).unwrap();
        let (low, high) = (coded(100), coded(8000));
        let mean = |coded: &[Frame]| coded.iter().zip(&frames).map(|(a, b)| psnr(a, b)).sum::<f64>() / 6.0;
        assert!(mean(&high) > mean(&low) + 2.0, "{} {}", mean(&low), mean(&high));
        assert_eq!(low, coded(100));
    }

    #[test]
    fn coding_keeps_colours() {
        let colour = [0.8, 0.3, 0.2];
        let frame = crate::scene::Picture::new(64, 48, vec![colour; 64 * 48]).sense(0.0, 0);
        let coded = through_h264(vec![frame.clone()], 30.0, 2000).unwrap();
        let worst = coded[0].rgb.iter().zip(&frame.rgb).map(|(a, b)| a.abs_diff(*b)).max();
        // The matrix of another standard would be 15 levels off.
        assert!(worst <= Some(8), "{worst:?}");
    }

    #[test]
    fn what_is_no_clip_is_refused() {
        assert!(decode(Path::new("/nowhere.mp4")).unwrap_err().to_string().contains("/nowhere.mp4"));
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "no video").unwrap();
        assert!(decode(file.path()).is_err());
    }
}
