//! Enum properties. Names and numbers are stored in project files and presets: never change one.

use gst::glib;
use rsrectify::readout;
use rsrectify::warp;

/// Which edge of the frame, as it arrives, is read first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, glib::Enum)]
#[enum_type(name = "GstRsRectifyReadoutDirection")]
#[repr(i32)]
pub enum ReadoutDirection {
    /// Stands for top to bottom.
    #[default]
    #[enum_value(name = "Automatic (top to bottom)", nick = "auto")]
    Auto = 0,
    /// Row 0 first.
    #[enum_value(name = "Top row first: most cameras held upright", nick = "top-to-bottom")]
    TopToBottom = 1,
    /// The last row first.
    #[enum_value(name = "Bottom row first: a camera upside down", nick = "bottom-to-top")]
    BottomToTop = 2,
    /// Column 0 first.
    #[enum_value(name = "Left column first: a portrait clip", nick = "left-to-right")]
    LeftToRight = 3,
    /// The last column first.
    #[enum_value(name = "Right column first: a portrait clip turned the other way", nick = "right-to-left")]
    RightToLeft = 4,
}

impl From<ReadoutDirection> for readout::ReadoutDirection {
    fn from(direction: ReadoutDirection) -> Self {
        match direction {
            ReadoutDirection::Auto | ReadoutDirection::TopToBottom => Self::TopToBottom,
            ReadoutDirection::BottomToTop => Self::BottomToTop,
            ReadoutDirection::LeftToRight => Self::LeftToRight,
            ReadoutDirection::RightToLeft => Self::RightToLeft,
        }
    }
}

impl From<readout::ReadoutDirection> for ReadoutDirection {
    fn from(direction: readout::ReadoutDirection) -> Self {
        match direction {
            readout::ReadoutDirection::TopToBottom => Self::TopToBottom,
            readout::ReadoutDirection::BottomToTop => Self::BottomToTop,
            readout::ReadoutDirection::LeftToRight => Self::LeftToRight,
            readout::ReadoutDirection::RightToLeft => Self::RightToLeft,
        }
    }
}

/// How the motion is estimated. Number 2 is kept for a continuous-time estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, glib::Enum)]
#[enum_type(name = "GstRsRectifyEstimator")]
#[repr(i32)]
pub enum Estimator {
    /// Stands for sequential.
    #[default]
    #[enum_value(name = "Automatic (sequential)", nick = "auto")]
    Auto = 0,
    /// Frame by frame, each from its neighbour: 25.7 to 25.10.
    #[enum_value(name = "Sequential: each frame from its neighbours", nick = "sequential")]
    Sequential = 1,
}

/// What a frame's motion can be. Number 1 is kept for translation alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, glib::Enum)]
#[enum_type(name = "GstRsRectifyModel")]
#[repr(i32)]
pub enum Model {
    /// Stands for rotation.
    #[default]
    #[enum_value(name = "Automatic (rotation)", nick = "auto")]
    Auto = 0,
    /// A 2D rotation about any centre, translations included: 25.2.
    #[enum_value(name = "Rotation in the image plane about any centre", nick = "rotation")]
    Rotation = 2,
}

/// How samples between pixels are made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, glib::Enum)]
#[enum_type(name = "GstRsRectifyInterpolation")]
#[repr(i32)]
pub enum Interpolation {
    /// The nearest sample.
    #[enum_value(name = "Nearest sample: fastest, jagged", nick = "nearest")]
    Nearest = 0,
    /// 2 × 2 samples.
    #[enum_value(name = "Linear: 2 x 2 samples, softens", nick = "linear")]
    Linear = 1,
    /// 4 × 4 samples.
    #[default]
    #[enum_value(name = "Cubic: 4 x 4 samples", nick = "cubic")]
    Cubic = 2,
    /// 6 × 6 samples.
    #[enum_value(name = "Lanczos: 6 x 6 samples, sharpest", nick = "lanczos")]
    Lanczos = 3,
}

impl From<Interpolation> for warp::Interpolation {
    fn from(interpolation: Interpolation) -> Self {
        match interpolation {
            Interpolation::Nearest => Self::Nearest,
            Interpolation::Linear => Self::Linear,
            Interpolation::Cubic => Self::Cubic,
            Interpolation::Lanczos => Self::Lanczos,
        }
    }
}

/// What is shown where the frame saw nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, glib::Enum)]
#[enum_type(name = "GstRsRectifyBorderMode")]
#[repr(i32)]
pub enum BorderMode {
    /// The nearest edge sample.
    #[default]
    #[enum_value(name = "Repeat the edge", nick = "replicate")]
    Replicate = 0,
    /// The picture mirrored at its edge.
    #[enum_value(name = "Mirror the picture at its edge", nick = "mirror")]
    Mirror = 1,
    /// `border-color`.
    #[enum_value(name = "Fill with border-color", nick = "constant")]
    Constant = 2,
    /// Enlarged by `crop`; what is still uncovered repeats the edge.
    #[enum_value(name = "Enlarge the picture by crop to push the borders out", nick = "crop")]
    Crop = 3,
}

impl From<BorderMode> for warp::BorderMode {
    fn from(mode: BorderMode) -> Self {
        match mode {
            BorderMode::Replicate | BorderMode::Crop => Self::Replicate,
            BorderMode::Mirror => Self::Mirror,
            BorderMode::Constant => Self::Constant,
        }
    }
}
