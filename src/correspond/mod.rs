// SPDX-License-Identifier: MIT OR Apache-2.0

//! Two luma planes → point correspondences.
//!
//! | step | file | what it does |
//! |---|---|---|
//! | reduce | [`pyramid`](crate::pyramid) | luma → grey of at most 960 pixels a side, and coarser levels |
//! | flow | [`flow`](crate::flow) | dense optical flow, both ways |
//! | place | `grid` | the measured points: the centres of a uniform grid of cells |
//! | sample | `sampler` | the flow at these points, and which of them are kept |
//! | distortion | `distortion` | local distortion at a point, from the displacements of its neighbours |
//! | polish | `polish` | registration of one point to sub-pixel accuracy, and its covariance |
//! | register | `template` | one patch: inverse-compositional Lucas–Kanade |
//! | select | `certain` | correspondences of small variance, for solvers that assume one noise level |
//! | kernels | `patch` | patches at sub-pixel positions, distorted patches, sums |
//!
//! Three coordinate systems occur: *full-frame* pixels, used by callers; *analysed* pixels, those
//! of the reduced grey; and pixels of level l, each 2^l analysed pixels wide. In all of them pixel
//! centres are integers, so that going to a system s times coarser is x ↦ (x + ½)/s − ½.
//!
//! # Cost
//!
//! For 1920×1080 in 8 bits, hence 960×540 analysed, on a grid of 32×24, without the flow:
//!
//! | step | bytes read and written | multiply-adds |
//! |---|---|---|
//! | reduce | 2.1 MB + 2.1 MB | 2.1 M vertical, 0.5 M horizontal |
//! | halve | 2.8 MB + 0.7 MB | 2.8 M |
//! | polish | in cache | 768 points × at most 5 samplings × 3.5 k = 13 M, and a template of 15 k operations |

mod certain;
mod correspondence;
mod distortion;
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
