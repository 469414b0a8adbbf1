//! How far a motion is trusted, and how much of its correction is applied.

/// From this confidence on the whole correction is applied.
const FULL_TRUST: f64 = 0.5;
/// Confidence grows with the share of grid nodes whose correspondences follow the motion, up to this share.
const FULL_COVERAGE: f64 = 0.1;

/// The factor by which a confidence is less where only so many correspondences, on a grid of `nodes`, follow the motion:
/// 0 to 1.
pub fn coverage(inliers: usize, nodes: usize) -> f64 {
    (inliers as f64 / (FULL_COVERAGE * nodes as f64).max(1.0)).min(1.0)
}

/// Share of an uncertain correction that is applied at a confidence; 1 and more: all of it.
pub fn weight(confidence: f64) -> f64 {
    confidence / FULL_TRUST
}
