// SPDX-License-Identifier: MIT OR Apache-2.0

//! Homographies of least weighted squares.

use nalgebra::{Matrix3, Point2, SMatrix, SVector, Vector2};

/// One linear step of weighted least squares of the transfer error: the homography, with a last entry of 1, that takes the first place
/// of each pair to the second; `None` where the pairs do not determine it. Places should lie about the origin at distances of
/// about 1. The last entry of `before` is 1.
///
/// R. Hartley and A. Zisserman, *Multiple View Geometry*, 2003, section 4.1, each equation divided by the denominator of the
/// homography `before`, so that its residual is one of places.
pub fn linear_step(
    before: &Matrix3<f64>,
    pairs: impl Iterator<Item = ([Vector2<f64>; 2], f64)>,
) -> Option<Matrix3<f64>> {
    let mut normal = SMatrix::<f64, 8, 8>::zeros();
    let mut right = SVector::<f64, 8>::zeros();
    for ([a, b], weight) in pairs {
        let scale = weight / (before.row(2) * a.push(1.0)).x.powi(2);
        let rows = [
            ([a.x, a.y, 1.0, 0.0, 0.0, 0.0, -a.x * b.x, -a.y * b.x], b.x),
            ([0.0, 0.0, 0.0, a.x, a.y, 1.0, -a.x * b.y, -a.y * b.y], b.y),
        ];
        for (row, value) in rows {
            let row = SVector::from(row);
            normal += row * row.transpose() * scale;
            right += row * (value * scale);
        }
    }
    let h = normal.cholesky()?.solve(&right);
    Some(Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0))
}

/// H x, dehomogenised.
pub fn apply(homography: &Matrix3<f64>, x: Vector2<f64>) -> Vector2<f64> {
    homography.transform_point(&Point2::from(x)).coords
}
