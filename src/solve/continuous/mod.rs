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
//! | `deviation` | how far off a correction may be, how much of it is applied |
//! | `evidence` | which of two hypotheses the frames so far speak for |
//! | `fitted` | how the correspondences of a frame fit the path that was found |
//! | `camera` | what is known of the camera, and believed of the rest |
//! | `stream` | frames in, motions out: window, choice of the axis, confidence, residual field |
//!
//! # Units
//!
//! Points are in units of the *radius*, half the frame's width, from the image centre; paths and
//! residuals in analysed pixels (at the radius); timestamps and γ, the signed readout time, in
//! frame periods. The path's own clock counts *blocks*: one to a frame period, two and a half where the
//! picture vibrates. A line is exposed at t = t_k + γ·p, p its place along the scan axis from the top (left)
//! edge; γ < 0 where the opposite edge is read first. κ = (radius/f)² stands for the focal length f.
//!
//! The equations are in `docs/method.md`.
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
//! sums three times as much. Up to four steps are taken a frame for each hypothesis (36, twelve of them a frame, where it
//! is first learnt how a vibration goes on); while there are several, the evidence of each costs another one, without the
//! inverse, and the step of the next frame finds all pairs but its first and its last done. The first window of a stream
//! whose readout is sought takes up to twenty from each of two starts for each edge, most of them while the lookahead
//! fills, later ones up to twelve until γ rests.

mod camera;
mod data;
mod fit;
mod linear;
mod output;
mod prior;
mod smoother;
mod trajectory;

pub use camera::Camera;
pub use smoother::Continuous;
