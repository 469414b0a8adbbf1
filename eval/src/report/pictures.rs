// SPDX-License-Identifier: MIT OR Apache-2.0

//! How much the rectified pictures of a frame look like the true one.

use crate::metrics::colour;
use crate::metrics::resample::rectified;
use baselines::methods::Correction;
use render::footage::Footage;
use serde::{Deserialize, Serialize};

/// Likeness of a rectified picture to the truth, inside the visibility mask.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Likeness {
    /// Share of pixels within the colour distance of 0.3.
    pub accuracy: f64,
    /// Peak signal-to-noise ratio in dB.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
}

/// Judges the picture that a correction makes of a frame; `None` where no pixel can be judged, the
/// picture is the truth itself, which no number of dB says, or the footage is without pictures of the truth.
pub fn likeness(footage: &Footage, frame: usize, correction: &dyn Correction) -> Option<Likeness> {
    let picture = rectified(&footage.frames[frame], correction).frame;
    let global = footage.truth[frame].global.as_ref()?;
    let (truth, mask) = (&global.picture, &global.visible);
    Some(Likeness {
        accuracy: colour::accuracy(&picture, truth, mask)?,
        psnr: colour::psnr(&picture, truth, mask).filter(|psnr| psnr.is_finite())?,
        ssim: colour::ssim(&picture, truth, mask)?,
    })
}
