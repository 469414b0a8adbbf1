// SPDX-License-Identifier: MIT OR Apache-2.0

//! The residuals of a frame's correspondences.

use crate::correspond::Correspondence;
use crate::lanes::scalar::Scalar;
use crate::solve::continuous::camera::Hypothesis;
use crate::solve::continuous::linear::INLIER_SQUARE;
use crate::solve::solution::FittedCorrespondence;
use nalgebra::{Matrix2, Vector2};

/// A pair of frames and its correspondences.
pub struct FittedPair<'a> {
    /// All that were measured, static overlays included.
    pub found: &'a [Correspondence],
    /// Timestamps of both frames in frame periods.
    pub stamps: [f64; 2],
    /// Whether the result is that of the first frame.
    pub begins: bool,
    /// Standard deviation in pixels of a coordinate of the pair's residuals.
    pub sigma: f64,
}

impl FittedPair<'_> {
    /// The residuals by a hypothesis, of all correspondences on its path; `centre` and `radius` in pixels.
    pub fn fit(
        &self,
        hypothesis: &Hypothesis,
        centre: Vector2<f64>,
        radius: f64,
    ) -> Vec<FittedCorrespondence> {
        let Hypothesis { posterior, setup, .. } = hypothesis;
        let homographies = &posterior.trajectory.homographies;
        let fitted = |found: &Correspondence| {
            let ends = [found.from, found.to].map(|pixel| (pixel - centre) / radius);
            let block = |end: usize| posterior.block(self.stamps[end], setup.scan_axis.place(ends[end]));
            let (from, to) = (homographies.at(block(0))?, homographies.at(block(1))?);
            let residual = (ends[1] - from.carry(Scalar, ends[0], to)) * radius;
            let variance = Matrix2::identity() * (self.sigma * self.sigma) + found.covariance;
            let square = residual.dot(&(variance.try_inverse()? * residual));
            square.is_finite().then_some(FittedCorrespondence {
                position: if self.begins { found.from } else { found.to },
                displacement: found.to - found.from,
                residual,
                is_inlier: square < INLIER_SQUARE,
            })
        };
        self.found.iter().filter_map(fitted).collect()
    }
}
