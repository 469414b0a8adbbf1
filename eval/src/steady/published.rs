// SPDX-License-Identifier: MIT OR Apache-2.0

//! The published stabilisers, on correspondences from the library's sampler.

use anyhow::Result;
use baselines::correspondences::Follower;
use baselines::methods::content_preserving::ContentPreserving;
use baselines::methods::subspace::Subspace;
use baselines::methods::{Correction, Corrections, Input, Method};
use nalgebra::Vector2;
use render::media::Clip;
use rsrectify::motion::image_centre;
use rsrectify::readout::Readout;

/// Where subspace stabilisation and content-preserving warps show the pixels of each frame, at a zoom. `deviation` is that of their
/// low-pass filters in seconds. Neither is told the shutter: of `readout` they see the size of the frame. Content-preserving
/// warps are told the focal length in pixels.
///
/// # Errors
/// Those of the methods.
pub fn solve(
    clip: &Clip,
    readout: Readout,
    focal: f64,
    deviation: f64,
    zoom: f64,
) -> Result<[Corrections; 2]> {
    let mut follower = Follower::new(clip.width, clip.height);
    let pairs = clip.frames.iter().map(|frame| follower.follow(frame));
    let pairs: Vec<_> = pairs.filter_map(Result::transpose).collect::<Result<_>>()?;
    let period = 1.0 / clip.fps;
    let stamps = (0..clip.frames.len()).map(|frame| frame as f64 * period).collect();
    let input = Input { readout, focal, period, stamps, pairs: &pairs };
    let centre = image_centre(clip.width, clip.height);
    let zoomed = |shown: Box<dyn Correction>| {
        Box::new(move |pixel: Vector2<f64>| (shown.correct(pixel) - centre) * zoom + centre)
            as Box<dyn Correction>
    };
    let solved = |method: &dyn Method| -> Result<Corrections> {
        Ok(method.solve(&input)?.into_iter().map(zoomed).collect())
    };
    Ok([solved(&Subspace { deviation })?, solved(&ContentPreserving { deviation })?])
}
