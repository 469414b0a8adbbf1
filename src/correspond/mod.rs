//! Two luma planes → point correspondences.
//!
//! | step | file | what it does |
//! |---|---|---|
//! | reduce | [`pyramid`](crate::pyramid) | any luma view → grey of at most 960 pixels a side, by area average |
//! | halve | `pyramid` | the coarser levels, and the detail image that the search looks at |
//! | place | `grid` | the points that are measured: the middles of a uniform grid of cells |
//! | start | `start` | exhaustive search of large regions on the coarsest level |
//! | track | `tracker` | sub-pixel registration of one patch: inverse-compositional Lucas–Kanade |
//! | sample | `patch` | its kernels: patches between pixels, stretched patches, sums |
//! | agree | `field` | what the neighbours of a point say of its motion and its local distortion |
//! | join | `sampler` | the order of it all, and which points are kept |
//! | refine | `refine`, `search` | on demand: small patches where the points are missing or disagree |
//! | choose | `edges`, `window` | then: which motion is that of a place next to a depth edge |
//!
//! Beside it, in place of all from start to join:
//!
//! | step | file | what it does |
//! |---|---|---|
//! | sample | `dense` | dense optical flow ([`flow`](crate::flow)) at the grid |
//! | polish | `polish` | its registration on the finest level, and its covariance |
//!
//! Three coordinate systems occur: *full-frame* pixels, which callers see; *analysed* pixels, those
//! of the reduced grey; and pixels of level l, each 2^l analysed pixels wide. In all of them pixel
//! centres are integers, so that going to a system s times coarser is x ↦ (x + ½)/s − ½.
//!
//! # Cost
//!
//! For 1920×1080 in 8 bits, hence 960×540 analysed, on a grid of 32×24:
//!
//! | step | bytes read and written | multiply-adds |
//! |---|---|---|
//! | reduce | 2.1 MB + 2.1 MB | 2.1 M vertical, 0.5 M horizontal |
//! | halve | 2.8 MB + 0.7 MB | 0.7 M |
//! | start | in cache | 18 regions × 841 shifts × 256 = 3.9 M |
//! | track, coarse levels | in cache | 768 points × about 10 samplings × 0.9 k = 7 M |
//! | track, full level | in cache | 768 points × about 6 samplings × 3.3 k = 15 M, and two templates of 13 k operations |

mod dense;
mod edges;
mod field;
mod grid;
mod patch;
mod polish;
mod pyramid;
mod refine;
mod sampler;
mod search;
mod start;
#[cfg(test)]
mod tests;
mod tracker;
mod window;

pub use dense::{DenseFrame, DenseSampler};
pub use polish::Measurement;
pub use pyramid::Pyramid;
pub use sampler::Sampler;

use nalgebra::Vector2;

/// The same scene point in a frame and in a later one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correspondence {
    /// Pixels of the full frame (pixel centres at integers) in the first frame.
    pub from: Vector2<f64>,
    /// Pixels of the full frame in the second frame.
    pub to: Vector2<f64>,
    /// The smaller eigenvalue of the patch's gradient matrix, per pixel, in squared grey levels
    /// (0 to 255) per squared analysed pixel: how well the patch can be located. The patch is as the
    /// second frame is to show it, and of its gradients only what neither its mean nor a change of
    /// contrast explains counts.
    pub texture: f32,
    /// Root mean square difference of the two patches in grey levels after brightness was matched.
    pub residual: f32,
}
