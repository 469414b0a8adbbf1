//! How a stream is analysed.

use crate::motion::Model;
use crate::readout::{ReadoutDirection, ReadoutPrior, ReadoutTime};

/// How motion is estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Estimator {
    /// Splines over exposure time, with the readout found from the picture where it is not given.
    #[default]
    Continuous,
    /// The paper's: one 2D rotation a frame, each from its neighbour.
    Sequential,
}

/// How a stream is analysed.
///
/// ```
/// let mut settings = rsrectify::rectifier::Settings::default();
/// settings.lookahead = 8;
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Settings {
    /// Columns of the sampling grid.
    pub grid_columns: usize,
    /// Rows of the sampling grid.
    pub grid_rows: usize,
    /// Frames waited for before a frame's motion is given out.
    pub lookahead: usize,
    /// How motion is estimated.
    pub estimator: Estimator,
    /// The image motions that the continuous estimator looks for.
    pub model: Model,
    /// Focal length in frame widths; `None` if it is to be found from the picture. Less than 0.354, a field of view of
    /// 110°, counts as that.
    pub focal_length: Option<f64>,
    /// Which edge of the frame is read first; `None` if it is to be found from the picture, which the
    /// sequential estimator takes as from top to bottom.
    pub direction: Option<ReadoutDirection>,
    /// What is known of the readout time.
    pub readout_time: ReadoutTime,
    /// What is expected of the readout where it is not known; one that contradicts `direction` is not heeded, nor is any by
    /// the sequential estimator.
    pub readout_prior: Option<ReadoutPrior>,
    /// Whether [`FrameSolution::fitted`](super::FrameSolution::fitted) is filled, which takes memory for each frame.
    pub keep_correspondences: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            grid_columns: 32,
            grid_rows: 24,
            lookahead: 4,
            estimator: Estimator::Continuous,
            model: Model::Auto,
            focal_length: None,
            direction: None,
            readout_time: ReadoutTime::Unknown,
            readout_prior: None,
            keep_correspondences: false,
        }
    }
}
