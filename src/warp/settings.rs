//! How a frame is rectified.

/// How samples between pixels are made.
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

/// What is shown where the frame saw nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
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
///
/// ```
/// let mut settings = rsrectify::warp::WarpSettings::default();
/// settings.strength = 0.5;
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct WarpSettings {
    /// How samples between pixels are made.
    pub interpolation: Interpolation,
    /// What is shown where the frame saw nothing.
    pub border: BorderMode,
    /// Share of the readout whose instant the output shows, 0 to 1; 0 = first read.
    pub reference_row: f64,
    /// Share of the correction that is applied, 0 to 1: each point of the picture is displaced by this
    /// share of its whole displacement, so that a frame fades steadily into the one that arrived,
    /// whatever its motion.
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
