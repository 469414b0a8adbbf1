//! Two luma planes → point correspondences.

use nalgebra::Vector2;

/// The same scene point in a frame and in a later one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correspondence {
    /// Pixels of the full frame (pixel centres at integers) in the first frame.
    pub from: Vector2<f64>,
    /// Pixels of the full frame in the second frame.
    pub to: Vector2<f64>,
    /// The smaller eigenvalue of the patch's gradient matrix, per pixel, in squared grey levels
    /// (0 to 255): how well the patch can be located.
    pub texture: f32,
    /// Root mean square difference of the two patches in grey levels after brightness was matched.
    pub residual: f32,
}
