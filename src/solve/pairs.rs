// SPDX-License-Identifier: MIT OR Apache-2.0

//! Which pairs of frames are fitted, and when a fit explains their motion: the same for both estimators.

/// Fewest correspondences of a pair.
pub const MIN_MATCHES: usize = 16;
/// Longest interval between two frames, in frame periods: across longer ones a path is undetermined, and would cost as much as the
/// missing frames.
pub const MAX_INTERVAL: f64 = 16.0;
/// Residuals below this many times the noise floor count as noise.
const NOISE_FACTOR: f64 = 3.0;
/// Least share of the mean squared displacement that a motion must explain.
const MIN_EXPLAINED: f64 = 0.75;

/// Greatest mean square that counts as noise; `noise` is the standard deviation of a measured coordinate.
pub fn noise_limit(noise: f64) -> f64 {
    (NOISE_FACTOR * noise).powi(2)
}

/// Share of a motion that is explained, 0 to 1, given the mean squares of its residuals and of its displacements.
pub fn explained_share(residual: f64, displaced: f64, noise: f64) -> f64 {
    let allowed = noise_limit(noise) + (1.0 - MIN_EXPLAINED) * displaced;
    (1.0 - residual / allowed).clamp(0.0, 1.0)
}
