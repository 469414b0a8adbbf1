//! One point of the flow → a correspondence to sub-pixel accuracy, with its covariance.
//!
//! A patch of 16 × 16 analysed pixels is registered once more on the finest level, from where the flow has it, by the
//! inverse-compositional steps of `template`: with the local distortion taken out, cubic interpolation and free contrast.
//!
//! The covariance is that of least squares with a prior. With H = ∑ g·gᵀ over the patch, s² the residual's variance and
//! σ_f the flow's own deviation, it is C = κ·(H′/s² + I/σ_f²)⁻¹ + σ₀²·I, where H′ = H − n·s²/4·I takes out what noise
//! adds to H: a central difference of two pixels with variance s²/2 each has s²/4, the difference of two frames s².
//! Along an edge H′ vanishes and C tends to the flow's variance. κ and σ₀ stand for what is no white noise: the
//! residual of interpolation, blur and compression is correlated from pixel to pixel.

use super::correspondence::{Correspondence, to_full};
use super::patch::FINE;
use super::template::{Effort, Template};
use crate::cpu::for_each_cpu;
use crate::pyramid::Level;
use nalgebra::{Matrix2, Vector2};

/// Patches that correlate less show something else.
const LEAST_CORRELATION: f32 = 0.7;

/// A point that steps further than this from where the flow has it, in analysed pixels, has been lost: the flow's
/// finest level has pixels of two, and is right to less than one of them where it is trusted.
const MOST_STRAY: f32 = 2.0;

/// The flow's deviation σ_f in analysed pixels, where it is trusted.
const FLOW_DEVIATION: f32 = 0.7;

/// Variance of the residual, at least: that of 8-bit quantisation in both frames, squared grey levels.
const LEAST_VARIANCE: f32 = 1.0 / 6.0;

/// κ: how much larger the variance is than white noise of the residual's variance would make it.
const CORRELATED: f32 = 1.0;

/// σ₀ in analysed pixels: what remains on footage without noise.
const FLOOR: f32 = 0.02;

/// Damping in squared grey levels a pixel, which keeps the flow along an edge: s²/(n·σ_f²) at s = 3, n = 256.
const DAMPING: f32 = 0.07;

const EFFORT: Effort = Effort { iterations: 5, tolerance: 0.02 };

/// Where a point starts from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    /// The top left pixel of its patch.
    pub(super) corner: (usize, usize),
    /// Displacement in analysed pixels.
    pub(super) shift: Vector2<f32>,
    /// I + ∂shift/∂x.
    pub(super) distortion: Matrix2<f32>,
}

for_each_cpu! {
    /// Registers a point; `None` where its patch leaves the frame or is not found again near the start.
    pub(super) fn polish(levels: [&Level; 2], start: &Start, scale: f64) -> Option<Correspondence> {
        let [first, second] = levels;
        let from = Vector2::new(start.corner.0 as f32, start.corner.1 as f32);
        let back = start.distortion.try_inverse()?;
        let template = Template::distorted(first, start.corner, &back, DAMPING)?;
        let found = template.find(second, from + start.shift, EFFORT)?;
        let strays = (found.corner - from - start.shift).norm();
        // Not a number is refused too.
        if !(strays <= MOST_STRAY && found.correlation >= LEAST_CORRELATION && template.texture >= 0.0) {
            return None;
        }
        let middle = 0.5 * (FINE as f32 - 1.0);
        let centre = |corner: Vector2<f32>| to_full(corner.add_scalar(middle), scale);
        let covariance = covariance(template.matrix, found.residual)?;
        Some(Correspondence {
            from: centre(from),
            to: centre(found.corner),
            texture: template.texture,
            residual: found.residual,
            covariance: covariance.map(f64::from) * (scale * scale),
        })
    }
}

/// C in squared analysed pixels, given H (without damping) and the residual's deviation s.
fn covariance(information: Matrix2<f32>, residual: f32) -> Option<Matrix2<f32>> {
    let variance = (residual * residual).max(LEAST_VARIANCE);
    let eigen = information.symmetric_eigen();
    let noise = (FINE * FINE) as f32 * 0.25 * variance;
    let along = eigen.eigenvalues.map(|value| {
        let own = (value - noise).max(0.1 * value).max(0.0);
        CORRELATED / (own / variance + 1.0 / (FLOW_DEVIATION * FLOW_DEVIATION)) + FLOOR * FLOOR
    });
    let covariance = eigen.eigenvectors * Matrix2::from_diagonal(&along) * eigen.eigenvectors.transpose();
    covariance.iter().all(|value| value.is_finite()).then_some(covariance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn along_an_edge_the_flow_s_own_deviation_stays() {
        // Gradients along x only.
        let found = covariance(Matrix2::new(256.0 * 400.0, 0.0, 0.0, 0.0), 2.0).unwrap();
        let across = CORRELATED * 4.0 / (256.0 * 400.0 - 256.0) + FLOOR * FLOOR;
        assert!((found.m11 / across - 1.0).abs() < 0.01, "{found}");
        assert!((found.m22 / (CORRELATED * FLOW_DEVIATION * FLOW_DEVIATION) - 1.0).abs() < 0.01, "{found}");
        assert!(found.m12.abs() < 1e-6);
    }
}
