// SPDX-License-Identifier: MIT OR Apache-2.0

//! Values of the element's properties, as the command line has them.

use clap::ValueEnum;
use rsrectify::motion;
use rsrectify::readout;
use rsrectify::rectifier;

/// The edge that is read first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Direction {
    Auto,
    TopToBottom,
    BottomToTop,
    LeftToRight,
    RightToLeft,
}

/// How finely frames are analysed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Effort {
    /// At half the width and height of `balanced`.
    Fast,
    /// At up to 960 pixels along the longer side.
    Balanced,
}

impl From<Effort> for rectifier::Effort {
    fn from(effort: Effort) -> Self {
        match effort {
            Effort::Fast => Self::Fast,
            Effort::Balanced => Self::Balanced,
        }
    }
}

/// How the motion is estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Estimator {
    Auto,
    Sequential,
    Continuous,
}

/// Whether the frames were moved after their readout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Stabilised {
    Auto,
    No,
    Yes,
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

/// What motion the picture can have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Model {
    Auto,
    Translation,
    Rotation,
    Similarity,
    Affine,
    Homography,
    #[value(name = "rotation-3d")]
    Rotation3d,
}

impl From<readout::ReadoutDirection> for Direction {
    fn from(direction: readout::ReadoutDirection) -> Self {
        match direction {
            readout::ReadoutDirection::TopToBottom => Self::TopToBottom,
            readout::ReadoutDirection::BottomToTop => Self::BottomToTop,
            readout::ReadoutDirection::LeftToRight => Self::LeftToRight,
            readout::ReadoutDirection::RightToLeft => Self::RightToLeft,
        }
    }
}

impl From<Direction> for Option<readout::ReadoutDirection> {
    fn from(direction: Direction) -> Self {
        match direction {
            Direction::Auto => None,
            Direction::TopToBottom => Some(readout::ReadoutDirection::TopToBottom),
            Direction::BottomToTop => Some(readout::ReadoutDirection::BottomToTop),
            Direction::LeftToRight => Some(readout::ReadoutDirection::LeftToRight),
            Direction::RightToLeft => Some(readout::ReadoutDirection::RightToLeft),
        }
    }
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

/// The name of a value, on the command line and as the element's properties have it.
pub fn name_of(value: &impl ValueEnum) -> String {
    value.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
}
