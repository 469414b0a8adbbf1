// SPDX-License-Identifier: MIT OR Apache-2.0

//! One point of the flow → a correspondence to sub-pixel accuracy, with its covariance.
//!
//! A patch of 16 × 16 analysed pixels is registered again on the finest level, starting from the flow, by the
//! inverse-compositional steps of `template`: with local distortion, cubic interpolation and free contrast.
//!
//! The covariance is that of least squares with a prior. With H = ∑ g·gᵀ over the patch, s² the residual's
//! variance and σ_f the flow's standard deviation, it is C = (H′/s² + I/σ_f²)⁻¹ + σ₀²·I, where H′ = H −
//! n·s²/4·I removes the contribution of noise to H: a central difference of two pixels with variance s²/2
//! each has s²/4, the difference of two frames s². Along an edge H′ vanishes and C tends to the flow's
//! variance. σ₀ models errors that are not white noise: the residual of interpolation, blur and
//! compression is correlated from pixel to pixel.

use super::correspondence::{Correspondence, to_full};
use super::patch::{AREA, centre};
use super::template::{StoppingCriterion, Template};
use crate::lanes::WordCpu;
use crate::pyramid::Level;
use nalgebra::{Matrix2, Vector2};

/// Patches whose coefficient of correlation is less are rejected as different scene points.
const MIN_CORRELATION: f32 = 0.7;

/// A point further than this from the flow, in analysed pixels, is rejected: pixels of the flow's finest
/// level are two analysed pixels wide, and confident flow is accurate to less than one of them.
const MAX_DISTANCE_FROM_FLOW: f32 = 2.0;

/// Standard deviation σ_f of confident flow, in analysed pixels.
const FLOW_DEVIATION: f32 = 0.7;

/// Least variance of the residual, in squared grey levels: 8-bit quantisation of both frames.
const MIN_RESIDUAL_VARIANCE: f32 = 1.0 / 6.0;

/// σ₀ in analysed pixels: the standard deviation on footage without noise.
const MIN_DEVIATION: f32 = 0.02;

/// Damping in squared grey levels per pixel, which keeps the flow's displacement along an edge: s²/(n·σ_f²)
/// at s = 3, n = 256.
const DAMPING: f32 = 0.07;

const STOPPING: StoppingCriterion = StoppingCriterion { iterations: 5, tolerance: 0.02 };

/// Initial estimate of a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct InitialEstimate {
    /// Top left pixel of the patch.
    pub(super) corner: (usize, usize),
    /// Displacement in analysed pixels.
    pub(super) shift: Vector2<f32>,
    /// I + ∂shift/∂x.
    pub(super) distortion: Matrix2<f32>,
}

/// Registers a point; `None` if its patch leaves the frame or is not found near the initial estimate. `template` is
/// scratch.
#[inline(always)]
pub(super) fn polish<C: WordCpu>(
    template: &mut Template<C>,
    [first, second]: [&Level; 2],
    start: &InitialEstimate,
    scale: f64,
) -> Option<Correspondence> {
    let from = Vector2::new(start.corner.0 as f32, start.corner.1 as f32);
    let back = start.distortion.try_inverse()?;
    template.take(first, start.corner, &back, DAMPING)?;
    let found = template.find(second, from + start.shift, STOPPING)?;
    let distance = (found.corner - from - start.shift).norm();
    // Also rejects NaN.
    if !(distance <= MAX_DISTANCE_FROM_FLOW
        && found.correlation >= MIN_CORRELATION
        && template.texture >= 0.0)
    {
        return None;
    }
    let covariance = covariance(template.matrix, found.residual)?;
    Some(Correspondence {
        from: to_full(centre(from), scale),
        to: to_full(centre(found.corner), scale),
        texture: template.texture,
        residual: found.residual,
        covariance: covariance.map(f64::from) * (scale * scale),
    })
}

/// C in squared analysed pixels, from H (without damping) and the residual's standard deviation s.
#[inline(always)]
fn covariance(information: Matrix2<f32>, residual: f32) -> Option<Matrix2<f32>> {
    let variance = (residual * residual).max(MIN_RESIDUAL_VARIANCE);
    let noise = AREA * 0.25 * variance;
    let along = |value: f32| {
        let own = (value - noise).max(0.1 * value).max(0.0);
        1.0 / (own / variance + 1.0 / (FLOW_DEVIATION * FLOW_DEVIATION)) + MIN_DEVIATION * MIN_DEVIATION
    };
    // The eigenvectors are those of H: C is linear in H, with the eigenvalues in their places.
    let (xx, xy, yy) = (information.m11, information.m12, information.m22);
    let (middle, half) = (0.5 * (xx + yy), (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt());
    let [low, high] = [along(middle - half), along(middle + half)];
    let slope = if half > f32::EPSILON * middle { 0.5 * (high - low) / half } else { 0.0 };
    let mean = 0.5 * (low + high);
    let (across, beside) = (0.5 * slope * (xx - yy), slope * xy);
    let covariance = Matrix2::new(mean + across, beside, beside, mean - across);
    covariance.iter().all(|value| value.is_finite()).then_some(covariance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn along_an_edge_the_variance_is_that_of_the_flow() {
        // Gradients along x only.
        let found = covariance(Matrix2::new(256.0 * 400.0, 0.0, 0.0, 0.0), 2.0).unwrap();
        let across = 4.0 / (256.0 * 400.0 - 256.0) + MIN_DEVIATION * MIN_DEVIATION;
        assert!((found.m11 / across - 1.0).abs() < 0.01, "{found}");
        assert!((found.m22 / (FLOW_DEVIATION * FLOW_DEVIATION) - 1.0).abs() < 0.01, "{found}");
        assert!(found.m12.abs() < 1e-6);
    }

    /// C = f(H) by the eigenvectors of H, for matrices of many directions and shapes.
    #[test]
    fn the_covariance_has_the_eigenvectors_of_the_gradients() {
        for k in 0..100 {
            let (angle, ratio) = (0.1 * k as f32, (k % 7) as f32 / 6.0);
            let [long, short] = [angle.sin_cos(), (-angle.cos(), angle.sin())];
            let [long, short] = [Vector2::new(long.1, long.0), Vector2::new(short.0, short.1)];
            let long = long.normalize();
            let short = Vector2::new(-long.y, long.x) * short.norm();
            let information = long * long.transpose() * 4e4 + short * short.transpose() * (4e4 * ratio);
            let found = covariance(information, 3.0).unwrap();
            for (axis, value) in [(long, 4e4), (short, 4e4 * ratio)] {
                let own = (value - 64.0 * 9.0f32).max(0.1 * value);
                let expected = 1.0 / (own / 9.0 + 1.0 / (0.7 * 0.7)) + 0.02 * 0.02;
                assert!((found * axis - axis * expected).norm() < 1e-3 * expected, "{k}: {found}");
            }
        }
    }
}
