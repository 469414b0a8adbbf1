// SPDX-License-Identifier: MIT OR Apache-2.0

//! Enum properties. Names and numbers are stored in project files and presets: never change one.

use gst::glib;
use rsrectify::motion;
use rsrectify::readout;
use rsrectify::{rectifier, warp};

/// Has GStreamer's documentation name the enums.
#[cfg(feature = "doc")]
pub(super) fn document() {
    use gst::prelude::*;
    let types = [
        ReadoutDirection::static_type(),
        Effort::static_type(),
        Estimator::static_type(),
        Model::static_type(),
        Stabilised::static_type(),
        Interpolation::static_type(),
        BorderMode::static_type(),
    ];
    types.into_iter().for_each(|of| of.mark_as_plugin_api(gst::PluginAPIFlags::empty()));
}

/// Which edge of the frame, as it arrives, is read first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, glib::Enum)]
#[enum_type(name = "GstRsRectifyReadoutDirection")]
#[repr(i32)]
pub enum ReadoutDirection {
    /// Found from the picture; the sequential estimator takes it as top to bottom.
    #[default]
    #[enum_value(name = "Automatic: found from the picture", nick = "auto")]
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

impl From<ReadoutDirection> for Option<readout::ReadoutDirection> {
    fn from(direction: ReadoutDirection) -> Self {
        use readout::ReadoutDirection as Known;
        match direction {
            ReadoutDirection::Auto => None,
            ReadoutDirection::TopToBottom => Some(Known::TopToBottom),
            ReadoutDirection::BottomToTop => Some(Known::BottomToTop),
            ReadoutDirection::LeftToRight => Some(Known::LeftToRight),
            ReadoutDirection::RightToLeft => Some(Known::RightToLeft),
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

/// How much time the analysis of a frame may take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, glib::Enum)]
#[enum_type(name = "GstRsRectifyEffort")]
#[repr(i32)]
pub enum Effort {
    /// The default.
    #[default]
    #[enum_value(name = "Balanced: analysed at up to 960 pixels along the longer side", nick = "balanced")]
    Balanced = 0,
    /// For slow machines and large frames.
    #[enum_value(
        name = "Fast: analysed at half of that width and height, at least 320 pixels",
        nick = "fast"
    )]
    Fast = 1,
}

impl From<Effort> for rectifier::Effort {
    fn from(effort: Effort) -> Self {
        match effort {
            Effort::Balanced => Self::Balanced,
            Effort::Fast => Self::Fast,
        }
    }
}

/// How the motion is estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, glib::Enum)]
#[enum_type(name = "GstRsRectifyEstimator")]
#[repr(i32)]
pub enum Estimator {
    /// Stands for continuous.
    #[default]
    #[enum_value(name = "Automatic (continuous)", nick = "auto")]
    Auto = 0,
    /// Frame by frame, each from its neighbour: 25.7 to 25.10.
    #[enum_value(name = "Sequential: each frame from its neighbours", nick = "sequential")]
    Sequential = 1,
    /// Splines over exposure time.
    #[enum_value(name = "Continuous: a path through all rows of a few frames", nick = "continuous")]
    Continuous = 2,
}

impl From<Estimator> for rectifier::Estimator {
    fn from(estimator: Estimator) -> Self {
        match estimator {
            Estimator::Auto | Estimator::Continuous => Self::Continuous,
            Estimator::Sequential => Self::Sequential,
        }
    }
}

/// What a frame's motion can be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, glib::Enum)]
#[enum_type(name = "GstRsRectifyModel")]
#[repr(i32)]
pub enum Model {
    /// What the picture bears out; the sequential estimator takes it as rotation.
    #[default]
    #[enum_value(name = "Automatic: what the picture bears out", nick = "auto")]
    Auto = 0,
    /// A translation of the picture.
    #[enum_value(name = "Translation in the image plane", nick = "translation")]
    Translation = 1,
    /// A 2D rotation about any centre, translations included: 25.2.
    #[enum_value(name = "Rotation in the image plane about any centre", nick = "rotation")]
    Rotation = 2,
    /// Rotation and scale.
    #[enum_value(name = "Rotation and scale in the image plane", nick = "similarity")]
    Similarity = 3,
    /// Rotation, scale and shears.
    #[enum_value(name = "Affine motion of the image plane", nick = "affine")]
    Affine = 4,
    /// A plane in space before a moving camera.
    #[enum_value(name = "Homography: a plane before a moving camera", nick = "homography")]
    Homography = 5,
    /// A camera that turns.
    #[enum_value(name = "Rotation of the camera in space", nick = "rotation-3d")]
    Rotation3d = 6,
}

impl From<Model> for motion::Model {
    fn from(model: Model) -> Self {
        match model {
            Model::Auto => Self::Auto,
            Model::Translation => Self::Translation,
            Model::Rotation => Self::Rotation,
            Model::Similarity => Self::Similarity,
            Model::Affine => Self::Affine,
            Model::Homography => Self::Homography,
            Model::Rotation3d => Self::Rotation3d,
        }
    }
}

/// Whether the frames were moved after their readout, as by stabilisation in the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, glib::Enum)]
#[enum_type(name = "GstRsRectifyStabilised")]
#[repr(i32)]
pub enum Stabilised {
    /// Found from the picture.
    #[default]
    #[enum_value(name = "Automatic: found from the picture", nick = "auto")]
    Auto = 0,
    /// They are rectified by their motion.
    #[enum_value(name = "No: frames are rectified by their motion", nick = "no")]
    No = 1,
    /// They are rectified by the changes of their lean alone.
    #[enum_value(name = "Yes: frames are rectified by the changes of their lean alone", nick = "yes")]
    Yes = 2,
}

impl From<Stabilised> for Option<bool> {
    fn from(stabilised: Stabilised) -> Self {
        match stabilised {
            Stabilised::Auto => None,
            Stabilised::No => Some(false),
            Stabilised::Yes => Some(true),
        }
    }
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

impl BorderMode {
    /// The library's mode, with `border-color` as samples.
    pub fn filled_with(self, fill: warp::Fill) -> warp::BorderMode {
        match self {
            Self::Replicate | Self::Crop => warp::BorderMode::Replicate,
            Self::Mirror => warp::BorderMode::Mirror,
            Self::Constant => warp::BorderMode::Constant(fill),
        }
    }
}
