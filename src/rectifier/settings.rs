//! How a stream is analysed.

use crate::motion::Model;
pub use crate::pyramid::Effort;
use crate::readout::{ReadoutDirection, ReadoutPrior, ReadoutTime};

/// The motion estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Estimator {
    /// Splines over exposure time; the readout is estimated from the picture unless given.
    #[default]
    Continuous,
    /// The paper's estimator: one 2D rotation per frame, each computed from that of its neighbour.
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
    /// At how many pixels frames are analysed.
    pub effort: Effort,
    /// Columns of the sampling grid.
    pub grid_columns: usize,
    /// Rows of the sampling grid.
    pub grid_rows: usize,
    /// Number of later frames needed before a frame's motion is available.
    pub lookahead: usize,
    /// The motion estimator.
    pub estimator: Estimator,
    /// The motion model of the continuous estimator.
    pub model: Model,
    /// Focal length in frame widths; `None` to estimate it from the picture. At least 0.354, a field of view
    /// of 110°; smaller values are raised to that.
    pub focal_length: Option<f64>,
    /// Which edge of the frame is read first; `None` to estimate it from the picture. The sequential
    /// estimator takes `None` as top to bottom.
    pub direction: Option<ReadoutDirection>,
    /// The readout time, if known.
    pub readout_time: ReadoutTime,
    /// Prior of the readout if it is unknown; ignored if it contradicts `direction`, and by the sequential
    /// estimator.
    pub readout_prior: Option<ReadoutPrior>,
    /// Whether the frames were moved after their readout, as by stabilisation in the camera, so that only the
    /// changes of their lean are used; `None` to find out from the picture. Ignored by the sequential estimator.
    pub stabilised: Option<bool>,
    /// Whether [`FrameSolution::fitted`](super::FrameSolution::fitted) is filled, which takes memory for each frame.
    pub keep_correspondences: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            effort: Effort::Balanced,
            grid_columns: 32,
            grid_rows: 24,
            lookahead: 4,
            estimator: Estimator::Continuous,
            model: Model::Auto,
            focal_length: None,
            direction: None,
            readout_time: ReadoutTime::Unknown,
            readout_prior: None,
            stabilised: None,
            keep_correspondences: false,
        }
    }
}
