//! The continuous estimator: the motion path as splines over exposure time.
//!
//! | file | what it does |
//! |---|---|
//! | `spline` | uniform cubic B-splines |
//! | `path` | one spline for each generator of the homographies, 17 coefficients a block |
//! | `flow` | path → where points go: the homographies that its velocities add up to |
//! | `overlay` | which correspondences show what is fixed to the frame: overlays, the bonnet |
//! | `pair` | correspondences of two frames, and the tracks that they continue |
//! | `dominant` | which of them move as most of the picture does |
//! | `residuals` | their residuals, each whitened by its covariance |
//! | `tracks` | what is new in a residual, given the one of the same point in the pair before |
//! | `normal` | what a pair says of the path, γ and κ: normal equations |
//! | `sums` | what the matches of a pair that are exposed at about the same time add up to |
//! | `equations` | the same over the coefficients of the path |
//! | `evaluated` | the pairs of a window with their residuals and normal equations |
//! | `smoothness` | the prior on how the path goes on, its strength by MacKay's evidence |
//! | `prediction` | how it goes on where it vibrates |
//! | `banded` | banded Cholesky factors, and the inverse inside the band |
//! | `running` | what was seen so far of a number that belongs to the camera |
//! | `solver` | Gauss–Newton over a window for one scan axis and one knot density |
//! | `search` | fits from several starts, side by side |
//! | `pair_window` | the pairs that a path is fitted to |
//! | `hypothesis` | one edge that may be read first: a solver, its knot density, its likelihood |
//! | `bank` | the hypotheses about the camera: its posterior, what is stated and applied of it |
//! | `evidence` | which of two hypotheses the frames so far speak for |
//! | `camera` | what is known of the camera, and believed of the rest |
//! | `stream` | frames in, motions out: window, choice of the axis, confidence, residual field |
//!
//! # Units
//!
//! Points are in units of the *radius*, half the frame's width, from the image centre; paths and
//! residuals in pixels (of the full frame, at the radius); timestamps and γ, the signed readout time, in
//! frame periods. The path's own clock counts *blocks*: one to a frame period, two and a half where the
//! picture vibrates. A line is exposed at t = t_k + γ·p, p its place along the scan axis from the top (left)
//! edge; γ < 0 where the opposite edge is read first. κ = (radius/f)² stands for the focal length f.
//!
//! The equations, one by one, are in `docs/method.md`.

mod banded;
mod bank;
mod camera;
mod dominant;
mod equations;
mod evaluated;
mod evidence;
mod flow;
mod hypothesis;
mod normal;
mod overlay;
mod pair;
mod pair_window;
mod path;
mod pixels;
mod prediction;
mod residuals;
mod running;
mod search;
mod smoothness;
mod solver;
mod spline;
mod stream;
mod sums;
mod tracks;

pub use camera::Camera;
pub use stream::{Continuous, Motion, PairMeasurement};
