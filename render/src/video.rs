// SPDX-License-Identifier: MIT OR Apache-2.0

//! Frames to uncompressed video files.

use crate::scene::Frame;
use anyhow::{Context, Result};
use std::fs::File;
use std::io::{BufWriter, ErrorKind, Write};
use std::path::Path;

/// Writes frames as YUV4MPEG2 in 4:2:0 (BT.709, limited range) to a file, or to the standard output
/// for `-`, until its reader goes away.
pub fn write(
    path: &Path,
    [width, height]: [usize; 2],
    fps: f64,
    frames: impl Iterator<Item = Frame>,
) -> Result<()> {
    let out: Box<dyn Write> = if path.as_os_str() == "-" {
        Box::new(std::io::stdout().lock())
    } else {
        Box::new(File::create(path).with_context(|| format!("cannot write {}", path.display()))?)
    };
    let rate = y4m::Ratio::new((fps * 1000.0).round() as usize, 1000);
    let mut encoder = y4m::encode(width, height, rate)
        .with_colorspace(y4m::Colorspace::C420)
        .with_pixel_aspect(y4m::Ratio::new(1, 1))
        .write_header(BufWriter::new(out))?;
    for frame in frames {
        let planes = frame.planes();
        match encoder.write_frame(&y4m::Frame::new([&planes.y, &planes.u, &planes.v], None)) {
            // The reader has seen enough, as `| head` has.
            Err(y4m::Error::IoError(error)) if error.kind() == ErrorKind::BrokenPipe => break,
            written => written?,
        }
    }
    Ok(())
}
