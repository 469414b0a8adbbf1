//! How the correspondences of a frame fit the path that was found.

use crate::correspond::Correspondence;
use crate::solve::FittedCorrespondence;
use crate::solve::continuous::camera::Hypothesis;
use nalgebra::{Matrix2, Vector2};

/// Standard deviations of a coordinate within which a residual is an inlier's, as where the inliers of a pair are counted.
const REACH: f64 = 3.0;

/// The pair of frames whose correspondences are fitted.
pub struct FittedPair<'a> {
    /// All that were measured, those too that the path was not fitted to.
    pub found: &'a [Correspondence],
    /// Timestamps of both frames in frame periods.
    pub stamps: [f64; 2],
    /// Whether the frame that is asked for is the first of them.
    pub begins: bool,
    /// Standard deviation in pixels of a coordinate of the residuals of the pair.
    pub sigma: f64,
}

impl FittedPair<'_> {
    /// Compares the correspondences with the path of a hypothesis; `centre` and `radius` in pixels. Those that the path does not
    /// reach are left out.
    pub fn fit(
        &self,
        hypothesis: &Hypothesis,
        centre: Vector2<f64>,
        radius: f64,
    ) -> Vec<FittedCorrespondence> {
        let Hypothesis { posterior, setup, .. } = hypothesis;
        let fitted = |found: &Correspondence| {
            let ends = [found.from, found.to].map(|pixel| (pixel - centre) / radius);
            let block = |end: usize| posterior.block(self.stamps[end], setup.scan_axis.place(ends[end]));
            let (from, to) = (
                posterior.trajectory.homographies.at(block(0))?,
                posterior.trajectory.homographies.at(block(1))?,
            );
            let residual = (ends[1] - from.carry(ends[0], to)) * radius;
            let variance = Matrix2::identity() * (self.sigma * self.sigma) + found.covariance;
            let square = residual.dot(&(variance.try_inverse()? * residual));
            square.is_finite().then_some(FittedCorrespondence {
                position: if self.begins { found.from } else { found.to },
                displacement: found.to - found.from,
                residual,
                // Of two coordinates.
                is_inlier: square < 2.0 * REACH * REACH,
            })
        };
        self.found.iter().filter_map(fitted).collect()
    }
}
