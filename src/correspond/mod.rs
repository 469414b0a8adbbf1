//! Two luma planes → point correspondences.
//!
//! | step | file | what it does |
//! |---|---|---|
//! | reduce | [`pyramid`](crate::pyramid) | any luma view → grey of at most 960 pixels a side, and coarser levels |
//! | follow | [`flow`](crate::flow) | dense optical flow, both ways |
//! | place | `grid` | the points that are measured: the middles of a uniform grid of cells |
//! | sample | `sampler` | the flow at these points, and which of them are kept |
//! | agree | `field` | what the neighbours of a point say of its local distortion |
//! | polish | `polish` | registration of one point to sub-pixel accuracy, and its covariance |
//! | register | `template` | one patch: inverse-compositional Lucas–Kanade |
//! | choose | `certain` | those that are certain enough for solvers that know one noise for all |
//! | sum | `patch` | its kernels: patches between pixels, stretched patches, sums |
//!
//! Three coordinate systems occur: *full-frame* pixels, which callers see; *analysed* pixels, those
//! of the reduced grey; and pixels of level l, each 2^l analysed pixels wide. In all of them pixel
//! centres are integers, so that going to a system s times coarser is x ↦ (x + ½)/s − ½.
//!
//! # Cost
//!
//! For 1920×1080 in 8 bits, hence 960×540 analysed, on a grid of 32×24, beside that of the flow:
//!
//! | step | bytes read and written | multiply-adds |
//! |---|---|---|
//! | reduce | 2.1 MB + 2.1 MB | 2.1 M vertical, 0.5 M horizontal |
//! | halve | 2.8 MB + 0.7 MB | 2.8 M |
//! | polish | in cache | 768 points × at most 5 samplings × 3.3 k = 13 M, and a template of 13 k operations |

mod certain;
mod correspondence;
mod field;
mod grid;
mod patch;
mod polish;
mod sampler;
mod template;
#[cfg(test)]
mod tests;

pub use crate::pyramid::Pyramid;
pub use certain::certain;
pub use correspondence::Correspondence;
pub use sampler::Sampler;
