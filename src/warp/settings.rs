// SPDX-License-Identifier: MIT OR Apache-2.0

//! How a frame is rectified.

/// The interpolation kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
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

/// The picture outside the frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum BorderMode {
    /// The nearest edge sample.
    #[default]
    Replicate,
    /// The picture mirrored at its edge.
    Mirror,
    /// One colour.
    Constant(Fill),
}

/// A colour as sample values: of each of a frame's planes, of each of its channels, before the format's
/// [shift](crate::plane::SampleFormat::shift). Larger values than the format has count as its largest.
///
/// ```
/// use rsrectify::warp::{BorderMode, Fill, WarpSettings};
/// let mut settings = WarpSettings::default();
/// // Black in 8-bit Y′CbCr of limited range, planar or semi-planar.
/// settings.border = BorderMode::Constant(Fill::planar([16, 128, 128, 0]));
/// // Opaque black in packed RGBA.
/// settings.border = BorderMode::Constant(Fill::packed([0, 0, 0, 255]));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Fill(pub [[u16; 4]; 4]);

impl Fill {
    /// One value for each plane, in all its channels.
    #[must_use]
    pub const fn planar([a, b, c, d]: [u16; 4]) -> Self {
        Self([[a; 4], [b; 4], [c; 4], [d; 4]])
    }

    /// One value for each channel, in all planes.
    #[must_use]
    pub const fn packed(channels: [u16; 4]) -> Self {
        Self([channels; 4])
    }
}

/// How a frame is rectified.
///
/// ```
/// let mut settings = rsrectify::warp::WarpSettings::default();
/// settings.strength = 0.5;
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct WarpSettings {
    /// The interpolation kernel.
    pub interpolation: Interpolation,
    /// The picture outside the frame.
    pub border: BorderMode,
    /// Share of the readout whose instant the output shows, 0 to 1; 0 = first read.
    pub reference_row: f64,
    /// Share of the correction that is applied, 0 to 1: each point is displaced by this share of its full
    /// displacement, so that 0 gives the original frame and the transition is linear for any motion.
    pub strength: f64,
    /// Magnification about the picture's centre, at least 1, to hide borders.
    pub zoom: f64,
    /// Whether borders are hidden even where a zoom above 1 is too small for it: the placement of such a frame is then applied in
    /// part, and if that is not enough, also the correction of the path.
    pub hide_borders: bool,
}

impl Default for WarpSettings {
    fn default() -> Self {
        Self {
            interpolation: Interpolation::Cubic,
            border: BorderMode::Replicate,
            reference_row: 0.5,
            strength: 1.0,
            zoom: 1.0,
            hide_borders: false,
        }
    }
}
