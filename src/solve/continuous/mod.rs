// SPDX-License-Identifier: MIT OR Apache-2.0

//! The continuous estimator: correspondences of successive frames → the motion path of a window as splines over exposure
//! time, and with it the readout time, the edge that is read first and the focal length.
//!
//! The folders have the order of the data; none imports from a later one. The same order, with all equations:
//! `docs/method.md`.
//!
//! | folder | object | unknowns |
//! |---|---|---|
//! | `data` | pairs of frames: matches, tracks, which matches show the scene | |
//! | `timing` | whether frames were exposed when their timestamps say so, and stand where the camera saw them | timeline |
//! | `trajectory` | splines for eight generators of the homographies, and the homographies that they integrate to | coefficients cⱼᵢ, 17 a block |
//! | `linear` | whitened residuals and their innovations, robust weights, normal equations, banded Cholesky factor | σ², τ² of a pair |
//! | `prior` | smoothness of the path, prediction of a vibration, beliefs about γ and κ | variances, weights |
//! | `fit` | Gauss–Newton over a window → posterior and evidence; fits from several starts | γ, κ |
//! | `camera` | hypotheses of scan axis and knot density: their odds, when one is tried, added or dropped | probabilities |
//! | `output` | expected error of a correction, share that is applied, inliers | |
//! | `smoother` | frames in, solutions out, a few frames later | |
//!
//! # Units
//!
//! | quantity | unit |
//! |---|---|
//! | points | the *radius*, half the frame's width, from the image centre |
//! | paths, coefficients, residuals | analysed pixels (at the radius) |
//! | timestamps, γ | frame periods; γ is the signed readout time |
//! | the path's own clock | *blocks*: one to a frame period, two and a half where the picture vibrates |
//! | κ | 1: (R/f)², R half the frame's width and f the focal length |
//! | evidence, odds | nats |
//!
//! A line is exposed at t = t_k + γ·p, p its place along the scan axis, 0 at the top (left) edge and 1 at the other; γ < 0
//! where the opposite edge is read first.
//!
//! # Cost
//!
//! Of a step with four pairs before (six, where it vibrates) and four ahead, γ = 0.9, in multiply-adds:
//!
//! | | calm | vibrating |
//! |---|---|---|
//! | blocks, unknowns of the path | 14, 238 | 32, 544 |
//! | coefficients that a pair depends on | 58 | 154 |
//! | entries of a row before the diagonal, mean and most | 35, 84 | 111, 186 |
//! | residuals and sums, 8 or 10 × 400 matches | 1.4 M | 1.7 M |
//! | spreading, 8 or 10 × 24 bands × 3 × 32² | 0.6 M | 0.8 M |
//! | Cholesky, Σ b²/2 over the rows | 0.2 M | 3.9 M |
//! | inverse inside the band | 0.45 M | 8 M |
//!
//! With tracks a pair depends on a third more coefficients; factor and inverse take up to twice as much, spreading twice and
//! sums three times as much. Residuals, sums and spreading are due only for pairs whose displacements have moved. A
//! hypothesis takes up to four steps a frame (36, six of them a frame, where the prediction of a vibration is first
//! estimated), and while there are several, one more without the inverse for its evidence. The first window whose readout
//! is unknown takes up to twenty from each of three starts for each axis, most of them while the lookahead fills, later
//! ones up to twelve until γ has converged.

mod camera;
mod data;
mod fit;
mod linear;
mod output;
mod prior;
mod smoother;
mod timing;
mod trajectory;

pub use camera::Camera;
pub use smoother::Continuous;
