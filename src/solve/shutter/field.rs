//! The displacement between two frames as a quadratic in the place, fitted robustly.
//!
//! Places are *charted*: centred, in halves of the frame's longer side. Displacements have the same
//! unit, so that all coefficients are of the size of what they do at the frame's edge.

use crate::solve::median::{MEDIAN_TO_VARIANCE, median};
use nalgebra::{Matrix6, SMatrix, Vector2, Vector6};

/// Fewer points than this say nothing.
const MIN_POINTS: usize = 32;
/// Reweighted rounds of the linear fit, which is not bent by what moves on its own, then of the
/// quadratic one.
const ROUNDS: [usize; 2] = [8, 5];
/// The loss reaches this many standard deviations of the inliers.
const REACH: f64 = 6.0;
/// Curvature over half the frame as a share of the displacement: a pan bends the picture by (half the
/// width / focal length)².
const CURVATURE: f64 = 0.3;
/// Points whose errors go together, as those of one thing in the scene do.
const TOGETHER: f64 = 10.0;
/// Bands in which a ripple is looked for, over the longer side.
const BANDS: usize = 24;

/// A correspondence on the chart: the middle of its two ends, and the way from the first to the second.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moved {
    pub middle: Vector2<f64>,
    pub way: Vector2<f64>,
}

/// The terms 1, x, y, x², xy, y² of a quadratic.
pub(super) fn terms(at: Vector2<f64>) -> Vector6<f64> {
    Vector6::new(1.0, at.x, at.y, at.x * at.x, at.x * at.y, at.y * at.y)
}

/// A quadratic displacement field: a row for each of the [`terms`], a column for each component.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Field(pub SMatrix<f64, 6, 2>);

impl Field {
    pub fn at(&self, place: Vector2<f64>) -> Vector2<f64> {
        self.0.transpose() * terms(place)
    }

    /// How much of each of the [`generators`] it holds.
    pub fn motion(&self) -> Vector6<f64> {
        let (x, y) = (self.0.column(0), self.0.column(1));
        Vector6::new(
            x[0],
            y[0],
            (y[1] - x[2]) / 2.0,
            (x[1] + y[2]) / 2.0,
            (x[3] + y[4]) / 2.0,
            (x[4] + y[5]) / 2.0,
        )
    }

    /// What no combination of the [`generators`] has: the lean ∂dx/∂y + ∂dy/∂x, and the stretch
    /// ∂dy/∂y − ∂dx/∂x. (Nor have they four of the ways to be curved; but those say as much of the scene.)
    pub fn distortion(&self) -> Vector2<f64> {
        let (x, y) = (self.0.column(0), self.0.column(1));
        Vector2::new(x[2] + y[1], y[2] - x[1])
    }
}

/// The velocity fields of a rigid image motion: along x, along y, roll, zoom, and perspective along
/// x and along y. They move rows and columns alike.
pub(super) fn generators(at: Vector2<f64>) -> [Vector2<f64>; 6] {
    let (x, y) = (at.x, at.y);
    [
        Vector2::new(1.0, 0.0),
        Vector2::new(0.0, 1.0),
        Vector2::new(-y, x),
        at,
        Vector2::new(x * x, x * y),
        Vector2::new(x * y, y * y),
    ]
}

/// The field of most points, by least squares reweighted with the loss of Geman and McClure, first
/// linear, then quadratic. `noise` is the standard deviation of a coordinate below which the spread
/// is not believed; `errors` is a buffer. `None` where the points are too few or too close together.
pub(super) fn robust_field(points: &[Moved], noise: f64, errors: &mut Vec<f64>) -> Option<Field> {
    if points.len() < MIN_POINTS {
        return None;
    }
    let mut field = weighted_field(points, |_| 1.0, 3, 0.0)?;
    let moved = points.iter().map(|point| point.way.norm_squared()).sum::<f64>() / points.len() as f64;
    for (rounds, count) in ROUNDS.into_iter().zip([3, 6]) {
        for _ in 0..rounds {
            let reach = reach_of(points, &field, noise, errors);
            let weight = |error: f64| (reach / (reach + error)).powi(2);
            // What is curved by chance is worth less than that nothing is: points in a corner of the
            // frame, or at different depths, cannot tell.
            let flatness =
                TOGETHER * (reach / (REACH * REACH)) / (CURVATURE * CURVATURE * moved.max(noise * noise));
            field = weighted_field(points, |point| weight(error(point, &field)), count, flatness)?;
        }
    }
    Some(field)
}

/// Half the squared distance of a point from where the field takes it.
fn error(point: &Moved, field: &Field) -> f64 {
    (point.way - field.at(point.middle)).norm_squared() / 2.0
}

/// The reach that follows the spread of the better half of the points.
fn reach_of(points: &[Moved], field: &Field, noise: f64, errors: &mut Vec<f64>) -> f64 {
    errors.clear();
    errors.extend(points.iter().map(|point| error(point, field)));
    REACH * REACH * (2.0 * median(errors) * MEDIAN_TO_VARIANCE).max(noise * noise)
}

/// Least squares in the first `count` terms, with the weight `flatness` of no curvature.
fn weighted_field(
    points: &[Moved],
    weight: impl Fn(&Moved) -> f64,
    count: usize,
    flatness: f64,
) -> Option<Field> {
    let mut normal = Matrix6::zeros();
    let mut right = SMatrix::<f64, 6, 2>::zeros();
    for point in points {
        let (w, terms) = (weight(point), terms(point.middle));
        normal += terms * terms.transpose() * w;
        right += terms * point.way.transpose() * w;
    }
    for term in 3..6 {
        normal[(term, term)] += flatness;
    }
    for unused in count..6 {
        normal.row_mut(unused).fill(0.0);
        normal.column_mut(unused).fill(0.0);
        right.row_mut(unused).fill(0.0);
        normal[(unused, unused)] = 1.0;
    }
    let field = normal.cholesky()?.solve(&right);
    field.iter().all(|value| value.is_finite()).then_some(Field(field))
}

/// The mean square that bands of columns (axis 0) or of rows (axis 1) move beyond a field, without what
/// chance makes of it: motion that is fast against the readout.
pub(super) fn ripple(points: &[Moved], field: &Field, axis: usize) -> f64 {
    let mut bands = [(0.0, Vector2::zeros(), 0.0); BANDS];
    for point in points {
        let left = point.way - field.at(point.middle);
        let band = ((point.middle[axis] + 1.0) * (BANDS as f64 / 2.0)).clamp(0.0, BANDS as f64 - 1.0);
        let (count, sum, squares) = &mut bands[band as usize];
        *count += 1.0;
        *sum += left;
        *squares += left.norm_squared();
    }
    let (mut total, mut used) = (0.0, 0.0);
    for (count, sum, squares) in bands.into_iter().filter(|(count, ..)| *count > 3.0) {
        // The variance of a mean of `count` that do not go together.
        let mean = sum.norm_squared() / (count * count);
        total += mean - (squares / count - mean) / (count - 1.0);
        used += 1.0;
    }
    if used > 0.0 { (total / used).max(0.0) } else { 0.0 }
}
