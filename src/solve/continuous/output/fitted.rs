//! How the correspondences of a frame fit the path that was found.

use crate::correspond::Correspondence;
use crate::solve::continuous::fit::solver::Solver;
use nalgebra::{Matrix2, Vector2};

/// Standard deviations of a coordinate within which a residual is an inlier's, as where the inliers of a pair are counted.
const REACH: f64 = 3.0;

/// A correspondence of a frame, and how it fits the motion that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct FittedCorrespondence {
    /// Where the frame shows the point, in pixels of the full frame, pixel centres at integers.
    pub position: Vector2<f64>,
    /// How far the point was measured to move from the frame to the next one, in pixels; of a frame that is joined to none
    /// after it, from the one before to it.
    pub displacement: Vector2<f64>,
    /// What the motion of the picture as a whole leaves of the displacement, in pixels.
    pub residual: Vector2<f64>,
    /// Whether the residual lies within three standard deviations of what the covariance of the measurement and the usual
    /// residual of the pair let expect. An outlier is measured wrongly, or shows what moves by itself, parallax, or what is
    /// fixed to the frame.
    pub is_inlier: bool,
}

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
    /// Compares the correspondences with a solver's path; `centre` and `radius` in pixels. Those that the path does not reach
    /// are left out.
    pub fn fit(&self, solver: &Solver, centre: Vector2<f64>, radius: f64) -> Vec<FittedCorrespondence> {
        let fitted = |found: &Correspondence| {
            let ends = [found.from, found.to].map(|pixel| (pixel - centre) / radius);
            let place = |end: usize| solver.time(self.stamps[end], solver.scan_axis.place(ends[end]));
            let (from, to) = (solver.flow.at(place(0))?, solver.flow.at(place(1))?);
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
