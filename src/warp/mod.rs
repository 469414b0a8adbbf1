//! A frame's motion path and a plane → the rectified plane.

use crate::motion::MotionPath;
use crate::plane::{Plane, PlaneMut};
use crate::readout::Readout;
use thiserror::Error;

/// How samples between pixels are made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Interpolation {
    /// The nearest sample.
    Nearest,
    /// 2 × 2 samples.
    Linear,
    /// 4 × 4 samples, Catmull–Rom kernel.
    #[default]
    Cubic,
    /// 6 × 6 samples, Lanczos kernel with three lobes.
    Lanczos,
}

/// What is shown where the frame saw nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum BorderMode {
    /// The nearest edge sample.
    #[default]
    Replicate,
    /// The picture mirrored at its edge.
    Mirror,
    /// A fill value.
    Constant,
}

/// How a frame is rectified.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WarpSettings {
    /// How samples between pixels are made.
    pub interpolation: Interpolation,
    /// What is shown where the frame saw nothing.
    pub border: BorderMode,
    /// Share of the readout whose instant the output shows, 0 to 1; 0 = first read.
    pub reference_row: f64,
    /// How much of the correction is applied, 0 to 1.
    pub strength: f64,
    /// The picture is enlarged about its centre by this factor, at least 1, to push borders out.
    pub zoom: f64,
}

impl Default for WarpSettings {
    fn default() -> Self {
        Self {
            interpolation: Interpolation::Cubic,
            border: BorderMode::Replicate,
            reference_row: 0.5,
            strength: 1.0,
            zoom: 1.0,
        }
    }
}

/// Where a plane's pixels lie in the frame: frame pixel = scale · plane pixel + offset, per axis,
/// pixel centres at integers.
///
/// Chroma of 4:2:0 has scale 2; offset 0 where it is sited on the luma pixel, ½ where it is sited
/// between two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Frame pixels from one plane pixel to the next, in x and y.
    pub scale: [f64; 2],
    /// Frame pixel of plane pixel (0, 0).
    pub offset: [f64; 2],
}

impl Placement {
    /// A plane of the frame's own size.
    pub const FULL: Self = Self { scale: [1.0, 1.0], offset: [0.0, 0.0] };
}

/// Why a plane cannot be rectified.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum WarpError {
    /// Source and destination differ in size, channels or sample format.
    #[error("source and destination planes differ in size, channels or sample format")]
    Mismatch,
}

/// Rectifies the planes of one frame after another; keeps its buffers.
#[derive(Debug, Default)]
pub struct Warper {}

impl Warper {
    /// A warper with empty buffers.
    pub fn new() -> Self {
        Self::default()
    }

    /// Computes the inverse map of one frame; [`warp`](Self::warp) then serves all its planes.
    pub fn prepare(&mut self, readout: &Readout, path: &MotionPath, settings: &WarpSettings) {
        let _ = (readout, path, settings);
    }

    /// Fills `dst` with the rectified `src`.
    ///
    /// `fill` holds one sample value a channel (before the format's shift) for
    /// [`BorderMode::Constant`].
    pub fn warp(
        &self,
        src: &Plane<'_>,
        dst: &mut PlaneMut<'_>,
        placement: Placement,
        fill: [u16; 4],
    ) -> Result<(), WarpError> {
        let _ = (src, dst, placement, fill);
        Ok(())
    }
}
